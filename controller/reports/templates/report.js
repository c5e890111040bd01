(() => {
  const signals = JSON.parse(document.getElementById("signals").textContent);
  theme(() => draw());

  // --- tables: sort by a head, filter by text and by comparisons such as delay_s>0.2
  const value_of = (row, place) => row.cells[place].dataset.v ?? row.cells[place].textContent.trim();
  const order = (a, b) => {
    const [x, y] = [Number(a), Number(b)];
    if (a === "" || b === "") return (a === "") - (b === "");
    return Number.isNaN(x) || Number.isNaN(y) ? a.localeCompare(b) : x - y;
  };
  for (const table of document.querySelectorAll("table.trials")) {
    const heads = [...table.tHead.rows[0].cells];
    const body = table.tBodies[0];
    heads.forEach((head, place) => head.querySelector("button").addEventListener("click", () => {
      const numbers = [...body.rows].some((row) => value_of(row, place) !== "" && !Number.isNaN(Number(value_of(row, place))));
      const before = head.getAttribute("aria-sort");
      const down = before === null ? numbers : before === "ascending";  // the largest number is what one looks for
      heads.forEach((each) => each.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const empty = (row) => value_of(row, place) === "";
      [...body.rows]
        .sort((a, b) => empty(a) - empty(b) || (down ? -1 : 1) * order(value_of(a, place), value_of(b, place)))
        .forEach((row) => body.append(row));
    }));
    const field = table.closest("section").querySelector("input.filter");
    const shown = table.closest("section").querySelector(".shown");
    const names = heads.map((head) => head.dataset.name);
    const holds = (row, term) => {
      const found = /^([\w.]+)(<=|>=|=|<|>)(.+)$/.exec(term);
      const place = found ? names.indexOf(found[1]) : -1;
      if (place < 0) return row.textContent.toLowerCase().includes(term.toLowerCase().replaceAll("_", " "));
      const [own, other] = [value_of(row, place), found[3]];
      if (own === "") return false;
      const by = order(own, other);
      return {"<": by < 0, ">": by > 0, "=": by === 0, "<=": by <= 0, ">=": by >= 0}[found[2]];
    };
    const filter = () => {
      const terms = field.value.trim().split(/\s+/).filter(Boolean);
      for (const row of body.rows) row.hidden = !terms.every((term) => holds(row, term));
      shown.textContent = `${[...body.rows].filter((row) => !row.hidden).length} of ${body.rows.length}`;
    };
    field.addEventListener("input", filter);
    filter();
    for (const link of document.querySelectorAll("a[data-filter]")) link.addEventListener("click", () => { field.value = link.dataset.filter; filter(); });
    body.addEventListener("click", (event) => {
      const row = event.target.closest("tr[data-trial]");
      if (row) open(row.dataset.trial);
    });
  }

  // --- a trial's signals, alone or beside another's
  const panel = document.getElementById("trial");
  const beside = document.getElementById("beside");
  const whole = document.getElementById("whole");
  const listed = () => [...document.querySelectorAll("tr[data-trial]")].filter((row) => !row.hidden).map((row) => row.dataset.trial);
  let keys = [];
  const address = () => {  // a link that can be sent: ?trial=7, of several runs ?trial=r1t7
    const query = keys.length ? "?trial=" + keys.at(-1).replace(/^r0t/, "") : location.pathname;
    try { history.replaceState(null, "", query); } catch { /* a page in a mail has no address */ }
  };
  const go = (by) => {
    const all = listed();
    const next = all[all.indexOf(keys.at(-1)) + by];
    if (next) open(next);
  };
  document.getElementById("before").addEventListener("click", () => go(-1));
  document.getElementById("next").addEventListener("click", () => go(1));
  document.addEventListener("keydown", (event) => {
    if (keys.length && !event.target.closest("input") && /^Arrow(Left|Right)$/.test(event.key)) go(event.key === "ArrowLeft" ? -1 : 1);
  });
  whole.addEventListener("click", () => { whole.setAttribute("aria-pressed", whole.getAttribute("aria-pressed") !== "true"); draw(); });
  for (const link of document.querySelectorAll("a[data-open]")) link.addEventListener("click", (event) => { event.preventDefault(); open(link.dataset.open); });
  const open = (key) => {
    keys = beside.getAttribute("aria-pressed") === "true" && keys.length ? [keys[0], key] : [key];
    address();
    draw();
    panel.scrollIntoView({block: "start"});
  };
  beside.addEventListener("click", () => {
    const on = beside.getAttribute("aria-pressed") !== "true";
    beside.setAttribute("aria-pressed", on);
    if (!on) { keys = keys.slice(-1); draw(); }
  });
  document.getElementById("close").addEventListener("click", () => { keys = []; address(); draw(); });

  // --- charts in the page's own colours
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
  const codes = (text) => new Uint16Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const unpacked = (curve, ms) => {
    const [t0, t1, low, high] = curve.span;
    return {
      t: Array.from(codes(curve.t), (w) => ms(t0 + (w / 65534) * (t1 - t0))),
      y: Array.from(codes(curve.y), (w) => w === 65535 ? NaN : low + (w / 65534) * (high - low)),
    };
  };
  const figure_of = (trial, number, x_range, ink, ms, bands) => {
    const {label, title = "", whose, curves, threshold} = trial.panels[number];
    const plot = chart(ink, {
      height: 140, x_range, title: title ? `${title}${/,/.test(label) ? label.slice(label.lastIndexOf(",")) : ""}` : label, tools: "box_zoom,xpan,xwheel_zoom,reset,save", toolbar_location: number ? null : "above",
    });
    for (const axis of plot.xaxes) axis.axis_label = number === trial.panels.length - 1 ? `ms after ${trial.zero[0]}` : null;
    for (const [left, right, colour] of bands) plot.add_layout(new Bokeh.BoxAnnotation({left, right, fill_color: colour, fill_alpha: 1, line_alpha: 0, level: "image"}));
    const of = (method) => (method === "paper" ? ink["paper-s"] : ink.ours);
    const lines = [threshold ? of(whose) : ink.ink, ink.rival, ink["paper-s"]];
    const seen = curves.map((curve, place) => {
      const data = threshold ? steps(unpacked(curve, ms)) : unpacked(curve, ms);
      const source = new Bokeh.ColumnDataSource({data});
      return plot.line({field: "t"}, {field: "y"}, {source, line_color: lines[place % 3], line_width: 1.2, name: curve.name});
    });
    if (threshold) plot.scatter({field: "t"}, {field: "y"}, {source: new Bokeh.ColumnDataSource({data: unpacked(curves[0], ms)}), size: 4, fill_color: of(whose), line_color: null});
    plot.add_tools(new Bokeh.HoverTool({renderers: seen, mode: "mouse", tooltips: [["t", "@t{0.0} ms"], [label, "@y{0.0000000}"]]}));
    const across = (dimension, location, options) => plot.add_layout(new Bokeh.Span({dimension, location, ...options}));
    if (threshold) {
      const source = new Bokeh.ColumnDataSource({data: steps(unpacked(threshold, ms))});
      plot.line({field: "t"}, {field: "y"}, {source, line_color: ink.truth, line_dash: [6, 4]});
    }
    for (const [t, , whose] of trial.marks) across("height", ms(t), {line_color: of(whose), line_width: 1});
    if (trial.decided) across("height", ms(trial.decided), {line_color: ink.truth, line_width: 2});
    if (trial.stood) across("height", ms(trial.stood), {line_color: ink["paper-s"], line_width: 2});
    for (const [, t] of trial.truths) across("height", ms(t), {line_color: ink.truth, line_dash: [2, 3], line_width: 1.5});
    return plot;
  };
  let drawing = 0;
  const draw = async () => {
    const mine = ++drawing;
    panel.hidden = keys.length === 0;
    const place = document.getElementById("signals-shown");
    place.replaceChildren();
    place.dataset.ready = "";
    for (const row of document.querySelectorAll("tr[data-trial]")) row.classList.toggle("open", keys.includes(row.dataset.trial));
    const ink = inks();
    for (const key of keys) {
      const trial = signals[key];
      const box = document.createElement("div");
      box.className = "signals";
      const heading = document.createElement("h3");
      heading.textContent = trial && trial.panels.length ? trial.title : "The signals of this trial are in the recording alone.";
      box.append(heading);
      place.append(box);
      if (!trial || !trial.panels.length) continue;
      const ms = (t) => 1000 * (t - trial.zero[1]);
      const ends = trial.panels.flatMap(({curves}) => curves.map(({span}) => span));
      const [from, to] = [ms(Math.min(...ends.map((span) => span[0]))), ms(Math.max(...ends.map((span) => span[1])))];
      const at = whole.getAttribute("aria-pressed") === "true" || !trial.decided ? null : ms(trial.decided);
      const [start, end] = at === null ? [from, to] : [Math.max(from, at - 500), Math.min(to, at + 500)];
      const entered = trial.states.map(([t, name], place) => [ms(t), place + 1 < trial.states.length ? ms(trial.states[place + 1][0]) : to, name]);
      const colours = [ink.band, ink.paper];
      const bands = entered.map(([left, right], place) => [left, right, colours[place % 2]]);
      const legend = document.createElement("p");
      legend.className = "note legend";
      const entry = (look, text, band) => {
        const item = document.createElement("span");
        item.className = "key " + look;
        item.textContent = text;
        if (band) item.style.setProperty("--band", band);
        legend.append(item, " ");
      };
      const when = ([t, name]) => `${name} ${ms(t).toFixed(0)} ms`;
      entered.forEach(([left, right, name], place) => { if (right >= start && left <= end) entry("band", `${name} from ${left.toFixed(0)} ms`, colours[place % 2]); });
      if (trial.panels.some(({threshold}) => !threshold)) entry("signal", "signal");
      if (trial.panels.some(({threshold, whose}) => threshold && whose !== "paper")) entry("statistic", "what our detector computes");
      if (trial.panels.some(({whose}) => whose === "paper")) entry("paper-s", "what the paper’s computes");
      for (const [, name, value, unit] of trial.thresholds) entry("threshold", `threshold of ${name}: ${value.toPrecision(5)} ${unit}`.trim());
      for (const [name, t] of trial.truths) entry("zero", when([t, name]));
      if (trial.decided) entry("decided", when([trial.decided, "decision"]));
      if (trial.stood) entry("stood", when([trial.stood, "stood still"]));
      const summary = document.createElement("p");
      summary.className = "note";
      const shown = trial.marks.filter(([t]) => ms(t) >= start && ms(t) <= end);
      summary.textContent = `Detections here: ${shown.map(when).join(", ") || "none"}.`;
      const x_range = new Bokeh.Range1d({start, end});
      const figures = trial.panels.map((_, number) => figure_of(trial, number, x_range, ink, ms, bands));
      const target = document.createElement("div");
      target.setAttribute("role", "img");
      target.setAttribute("aria-label", `${trial.title}: ${trial.panels.map(({label}) => label).join(", ")}`);
      box.append(legend, target, summary);
      await Bokeh.Plotting.show(new Bokeh.Column({children: figures, sizing_mode: "stretch_width"}), target);
      if (mine !== drawing) return;
    }
    place.dataset.ready = keys.join(" ");
  };
  const asked = new URLSearchParams(location.search).get("trial");
  if (asked) open(/^r/.test(asked) ? asked : "r0t" + asked);
})();
