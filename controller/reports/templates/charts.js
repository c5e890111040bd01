"use strict";
// What the report and the live page share: light and dark, and an empty chart in the page's own colours.
const root = document.documentElement;

const theme = (changed) => {  // as the system has it, until the switch changes it
  const dark = () => root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  const button = document.getElementById("theme");
  const show = () => { button.textContent = dark() ? "Light" : "Dark"; };
  const change = () => { show(); changed(); };
  button.addEventListener("click", () => { root.dataset.theme = dark() ? "light" : "dark"; change(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", change);
  show();
};

const inks = () => Object.fromEntries(["ink", "soft", "rule", "paper", "ours", "rival", "paper-s", "truth", "band"]
  .map((name) => [name, getComputedStyle(root).getPropertyValue("--" + name).trim()]));

const steps = ({t, y}) => ({  // a statistic stands until the next decision
  t: t.flatMap((at, place) => place ? [at, at] : [at]),
  y: y.flatMap((value, place) => place ? [y[place - 1], value] : [value]),
});

const chart = (ink, options) => {
  const plot = Bokeh.Plotting.figure({
    sizing_mode: "stretch_width", background_fill_color: ink.paper, border_fill_color: ink.paper, outline_line_color: ink.rule, output_backend: "canvas", ...options,
  });
  plot.toolbar.logo = null;
  if (plot.title) Object.assign(plot.title, {text_color: ink.ink, text_font_size: "11px", text_font_style: "normal"});
  for (const axis of [...plot.xaxes, ...plot.yaxes])
    Object.assign(axis, {axis_label_text_color: ink.ink, major_label_text_color: ink.ink, axis_line_color: ink.soft, major_tick_line_color: ink.soft, minor_tick_line_color: null});
  for (const grid of [...plot.xgrids, ...plot.ygrids]) grid.grid_line_color = ink.rule;
  return plot;
};
