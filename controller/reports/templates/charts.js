// What the report and the live page share: plots over time, in the page's own colours.
const svg = (name, given, text = "") => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(given)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
};
const PLOT = {left: 64, right: 12, top: 4, high: 100, below: 18};  // px
const tall = PLOT.top + PLOT.high + PLOT.below;
const ticks = (low, high, most) => {  // round numbers, as texts beside their values
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((times) => times * power >= 0.999 * rough), first = Math.ceil(low / step - 1e-9);
  const text = (value) => (step < 1e-5 || step > 1e5 ? value.toExponential(2) : value.toFixed(Math.max(0, -Math.floor(Math.log10(1.001 * step))))).replace("-", "−");
  return Array.from({length: Math.max(0, Math.floor(high / step + 1e-9) - first + 1)}, (_, place) => [step * (first + place), text(step * (first + place))]);
};
const place_of = (t, at) => {  // of the first that is not before it
  let [low, high] = [0, t.length];
  while (low < high) { const middle = (low + high) >> 1; if (t[middle] < at) low = middle + 1; else high = middle; }
  return low;
};
// Curves {look, t, y, stands, dots}, marks {look, t} across, bands {look, from, to}; nothing where no value is in view
const plot = (drawing, {start, end, unit, curves, marks = [], bands = []}) => {
  const {left, top, high} = PLOT, wide = drawing.clientWidth - PLOT.right - left;
  const seen = curves.map((curve) => [Math.max(0, place_of(curve.t, start) - 1), Math.min(curve.t.length, place_of(curve.t, end) + 1)]);
  let [least, most] = [Infinity, -Infinity];
  curves.forEach(({t, y, stands}, number) => {
    for (let place = seen[number][0]; place < seen[number][1]; place++)
      if (Number.isFinite(y[place]) && (stands || t[place] >= start) && t[place] <= end) [least, most] = [Math.min(least, y[place]), Math.max(most, y[place])];
  });
  if (!(least <= most)) return drawing.replaceChildren();
  const room = 0.08 * (most - least) || 0.05 * Math.abs(most) || 1;
  const x = (t) => (wide * (t - start) / (end - start)).toFixed(1), y = (value) => (high * (most + room - value) / (most - least + 2 * room)).toFixed(1);
  const inside = svg("svg", {x: left, y: top, width: wide, height: high});  // what leaves the plot is cut off
  for (const {look, from, to} of bands) if (to > start && from < end) inside.append(svg("rect", {class: look, x: x(Math.max(from, start)), y: 0, height: high, width: Math.max(0, x(Math.min(to, end)) - x(Math.max(from, start)))}));
  const parts = ticks(least - room, most + room, 5).flatMap(([value, text]) => {
    inside.append(svg("path", {class: "grid", d: `M0 ${y(value)}H${wide}`}));
    return [svg("text", {class: "y", x: left - 6, y: top + Number(y(value)) + 4}, text)];
  });
  for (const [t, text] of ticks(start, end, wide > 430 ? 8 : 4)) parts.push(svg("text", {class: "x", x: left + Number(x(t)), y: top + high + 15}, unit ? `${text} ${unit}` : text));
  for (const {look, t} of marks) if (t >= start && t <= end) inside.append(svg("path", {class: look, d: `M${x(t)} 0V${high}`}));
  curves.forEach((curve, number) => {
    let [way, pen, dots] = ["", "M", ""];
    for (let place = seen[number][0]; place < seen[number][1]; place++) {
      const [at, value] = [x(curve.t[place]), curve.y[place]];
      if (!Number.isFinite(value)) { pen = "M"; continue; }
      way += pen === "L" && curve.stands ? `H${at}V${y(value)}` : `${pen}${at} ${y(value)}`;
      dots += `M${at} ${y(value)}h0`;
      pen = "L";
    }
    inside.append(svg("path", {class: curve.look, d: way}));
    if (curve.dots && seen[number][1] - seen[number][0] < 200) inside.append(svg("path", {class: `${curve.look} dots`, d: dots}));
  });
  drawing.setAttribute("viewBox", `0 0 ${drawing.clientWidth} ${tall}`);  // on paper it is made smaller
  drawing.replaceChildren(inside, ...parts);
};
