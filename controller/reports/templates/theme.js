"use strict";
// What the report and the live page share: light and dark.
const root = document.documentElement;

const theme = (changed = () => {}) => {  // as the system has it, until the switch changes it
  const dark = () => root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  const button = document.getElementById("theme");
  const show = () => { button.textContent = dark() ? "Light" : "Dark"; };
  const change = () => { show(); changed(); };
  button.addEventListener("click", () => { root.dataset.theme = dark() ? "light" : "dark"; change(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", change);
  show();
};
