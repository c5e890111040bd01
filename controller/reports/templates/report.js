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
      if (place < 0) return row.textContent.toLowerCase().includes(term.toLowerCase());
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
    body.addEventListener("click", (event) => {
      const row = event.target.closest("tr[data-trial]");
      if (row) open(row.dataset.trial);
    });
  }

  // --- a trial's signals, alone or beside another's
  const panel = document.getElementById("trial");
  const beside = document.getElementById("beside");
  let keys = [];
  const open = (key) => {
    keys = beside.getAttribute("aria-pressed") === "true" && keys.length ? [keys[0], key] : [key];
    draw();
    panel.scrollIntoView({block: "start"});
  };
  beside.addEventListener("click", () => {
    const on = beside.getAttribute("aria-pressed") !== "true";
    beside.setAttribute("aria-pressed", on);
    if (!on) { keys = keys.slice(-1); draw(); }
  });
  document.getElementById("close").addEventListener("click", () => { keys = []; draw(); });

  const codes = (text) => new Uint16Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const unpacked = (curve) => {
    const [t0, t1, low, high] = curve.span;
    return {
      t: Array.from(codes(curve.t), (w) => t0 + (w / 65534) * (t1 - t0)),
      y: Array.from(codes(curve.y), (w) => w === 65535 ? NaN : low + (w / 65534) * (high - low)),
    };
  };
  const figure_of = (trial, number, x_range, ink) => {
    const {label, title = "", whose, curves, threshold} = trial.panels[number];
    const plot = chart(ink, {
      height: 170, x_range, y_axis_label: label, title, tools: "box_zoom,xpan,xwheel_zoom,reset,save", toolbar_location: number ? null : "above",
    });
    for (const axis of plot.xaxes) Object.assign(axis, {visible: number === trial.panels.length - 1, axis_label: "time since the trial began (s)"});
    const of = (method) => (method === "paper" ? ink["paper-s"] : ink.ours);
    const lines = [of(whose), ink.rival, ink["paper-s"]];
    const seen = curves.map((curve, place) => {
      const data = threshold ? steps(unpacked(curve)) : unpacked(curve);
      const source = new Bokeh.ColumnDataSource({data});
      return plot.line({field: "t"}, {field: "y"}, {source, line_color: lines[place % 3], line_width: 1.2, name: curve.name});
    });
    plot.add_tools(new Bokeh.HoverTool({renderers: seen, mode: "mouse", tooltips: [["t", "@t{0.0000} s"], [label, "@y{0.0000000}"]]}));
    const across = (dimension, location, options) => plot.add_layout(new Bokeh.Span({dimension, location, ...options}));
    if (threshold) {
      const source = new Bokeh.ColumnDataSource({data: steps(unpacked(threshold))});
      plot.line({field: "t"}, {field: "y"}, {source, line_color: ink.truth, line_dash: [6, 4]});
    }
    for (const [t] of trial.states) across("height", t, {line_color: ink.rule, line_width: 1});
    for (const [t, , whose] of trial.marks) across("height", t, {line_color: of(whose), line_width: 1.5});
    for (const [, t] of trial.truths) across("height", t, {line_color: ink.truth, line_dash: [2, 3], line_width: 1.5});
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
      const summary = document.createElement("p");
      summary.className = "note";
      const ends = trial.panels.flatMap(({curves}) => curves.map(({span}) => span));
      const [from, to] = [Math.min(...ends.map((span) => span[0])), Math.max(...ends.map((span) => span[1]))];
      const at = ([t, name]) => `${name} ${Number(t).toFixed(3)} s`;
      summary.textContent = [
        `States: ${trial.states.map(at).join(", ") || "none"}.`,
        `Detections: ${trial.marks.map(at).join(", ") || "none"}.`,
        trial.thresholds.length ? `Threshold: ${trial.thresholds.map(([, name, value, unit]) => `${name} ${value.toPrecision(5)} ${unit}`.trim()).join(", ")}.` : "",
        trial.truths.length ? `Truth: ${trial.truths.map(([name, t]) => at([t, name])).join(", ")}.` : "",
      ].join(" ");
      const x_range = new Bokeh.Range1d({start: from, end: to});
      const figures = trial.panels.map((_, number) => figure_of(trial, number, x_range, ink));
      const target = document.createElement("div");
      target.setAttribute("role", "img");
      target.setAttribute("aria-label", `${trial.title}: ${trial.panels.map(({label}) => label).join(", ")}`);
      box.append(target, summary);
      await Bokeh.Plotting.show(new Bokeh.Column({children: figures, sizing_mode: "stretch_width"}), target);
      if (mine !== drawing) return;
    }
    place.dataset.ready = keys.join(" ");
  };
})();
