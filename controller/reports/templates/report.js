(() => {
  const signals = JSON.parse(document.getElementById("signals").textContent);
  theme();

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

  // --- plots: one axis of time and one cursor for all of a trial's
  const codes = (text) => new Uint16Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const unpacked = (curve, ms, given) => {
    const [t0, t1, low, high] = curve.span;
    return {
      ...given,
      t: Array.from(codes(curve.t), (w) => ms(t0 + (w / 65534) * (t1 - t0))),
      y: Array.from(codes(curve.y), (w) => w === 65535 ? NaN : low + (w / 65534) * (high - low)),
    };
  };
  const curves_of = ({whose, curves, threshold}, ms) => {
    const computed = whose === "paper" ? "paper-s" : "statistic";
    const drawn = curves.map((curve, place) => unpacked(curve, ms, {look: [threshold ? computed : "signal", "rival", "paper-s"][place % 3], stands: Boolean(threshold), dots: Boolean(threshold)}));
    return threshold ? [...drawn, unpacked(threshold, ms, {look: "threshold", stands: true})] : drawn;
  };
  const headed = (target, {title, label, drawing}) => {
    const unit = /,/.test(label) ? label.slice(label.lastIndexOf(",")) : "";
    target.append(Object.assign(document.createElement("p"), {className: "head", textContent: title ? `${title}${unit}` : label}), drawing);
  };
  const drawn_of = (trial, ms) => trial.panels.map((each) => ({...each, curves: curves_of(each, ms), drawing: svg("svg", {height: tall, width: "100%"})}));
  const readout = panel.querySelector(".readout");
  const pointing = (panels, view, repaint) => {  // a drag zooms, the pointer is a cursor in every plot
    const whole = [view.start, view.end];
    const time_at = (drawing, event) => {
      const {left: from, width} = drawing.getBoundingClientRect();
      return view.start + Math.min(1, Math.max(0, (event.clientX - from - PLOT.left) / (width - PLOT.left - PLOT.right))) * (view.end - view.start);
    };
    let from = null;
    for (const {drawing} of panels) {
      drawing.addEventListener("pointerdown", (event) => { from = time_at(drawing, event); drawing.setPointerCapture(event.pointerId); });
      drawing.addEventListener("pointermove", (event) => {
        const at = time_at(drawing, event);
        readout.textContent = `${at.toFixed(1)} ms: ` + panels.map(({label, curves: [{t, y}]}) => {
          const value = at <= t.at(-1) ? y[place_of(t, at) - 1] ?? NaN : NaN;
          return `${label} ${Number.isFinite(value) ? value.toPrecision(5) : "–"}`;
        }).join(" · ");
        view.cursor = at;
        view.span = from === null ? null : [Math.min(from, at), Math.max(from, at)];
        repaint();
      });
      drawing.addEventListener("pointerup", () => {
        if (view.span && view.span[1] - view.span[0] > 0.01 * (view.end - view.start)) [view.start, view.end] = view.span;
        from = view.span = null;
        repaint();
      });
      drawing.addEventListener("dblclick", () => { [view.start, view.end] = whole; repaint(); });
    }
  };
  let repaints = [];
  const heroes = [...document.querySelectorAll("[data-hero]")].flatMap((box) => {  // the first figure: what decided, and what it heard
    const {key, streams, span, zero, marks} = JSON.parse(box.dataset.hero), ms = (t) => 1000 * (t - zero);
    const panels = signals[key] ? drawn_of(signals[key], ms).filter(({stream}) => streams.includes(stream)).sort((a, b) => streams.indexOf(a.stream) - streams.indexOf(b.stream)) : [];
    for (const each of panels) headed(box, each);
    const crossed = Object.entries(marks).map(([look, t]) => ({look, t: ms(t)}));
    return panels.map(({drawing, curves}) => () => plot(drawing, {start: ms(span[0]), end: ms(span[1]), curves: curves.slice(0, 1).concat(curves.filter(({look}) => look === "threshold")).map((curve) => ({...curve, look: curve.look === "paper-s" ? "statistic" : curve.look, dots: false})), marks: crossed}));
  });
  const resized = () => { for (const each of [...heroes, ...repaints]) each(); };
  addEventListener("resize", resized);
  resized();
  const draw = () => {
    panel.hidden = keys.length === 0;
    const place = document.getElementById("signals-shown");
    place.replaceChildren();
    repaints = [];
    readout.textContent = "";
    for (const row of document.querySelectorAll("tr[data-trial]")) row.classList.toggle("open", keys.includes(row.dataset.trial));
    for (const key of keys) {
      const trial = signals[key];
      const box = document.createElement("div");
      box.className = "signals plots";
      const heading = document.createElement("h3");
      heading.textContent = trial && trial.panels.length ? trial.title : "The signals of this trial are in the recording alone.";
      box.append(heading);
      place.append(box);
      if (!trial || !trial.panels.length) continue;
      const ms = (t) => 1000 * (t - trial.zero[1]);
      const ends = trial.panels.flatMap(({curves}) => curves.map(({span}) => span));
      const [from, to] = [ms(Math.min(...ends.map((span) => span[0]))), ms(Math.max(...ends.map((span) => span[1])))];
      const at = whole.getAttribute("aria-pressed") === "true" || trial.around === null ? null : ms(trial.around);
      const [start, end] = at === null ? [from, to] : [Math.max(from, at - 500), Math.min(to, at + 500)];
      const bands = trial.states.map(([t, name], number) => ({look: number % 2 ? "band odd" : "band", from: ms(t), to: number + 1 < trial.states.length ? ms(trial.states[number + 1][0]) : to, name}));
      const legend = document.createElement("p");
      legend.className = "note legend";
      const entry = (look, text) => {
        const item = document.createElement("span");
        item.className = "key " + look;
        item.textContent = text;
        legend.append(item, " ");
      };
      const when = ([t, name]) => `${name} ${ms(t).toFixed(0)} ms`;
      for (const {look, from: left, to: right, name} of bands) if (right >= start && left <= end) entry(look, `${name} from ${left.toFixed(0)} ms`);
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
      const target = document.createElement("div");
      target.setAttribute("role", "img");
      target.setAttribute("aria-label", `${trial.title}: ${trial.panels.map(({label}) => label).join(", ")}`);
      box.append(legend, target, summary);
      const marks = trial.marks.map(([t, , whose]) => ({look: whose === "paper" ? "paper-s" : "statistic", t: ms(t)}));
      if (trial.decided) marks.push({look: "decided", t: ms(trial.decided)});
      if (trial.stood) marks.push({look: "stood", t: ms(trial.stood)});
      marks.push(...trial.truths.map(([, t]) => ({look: "zero", t: ms(t)})));
      const panels = drawn_of(trial, ms);
      for (const each of panels) headed(target, each);
      target.append(Object.assign(document.createElement("p"), {className: "axis", textContent: `ms after ${trial.zero[0]}`}));
      const view = {start, end, cursor: null, span: null};
      const repaint = () => {
        const over = view.span ? [{look: "chosen", from: view.span[0], to: view.span[1]}] : [];
        for (const {drawing, curves} of panels) plot(drawing, {...view, curves, bands: [...bands, ...over], marks: view.cursor === null ? marks : [...marks, {look: "cursor", t: view.cursor}]});
      };
      pointing(panels, view, repaint);
      repaints.push(repaint);
      repaint();
    }
    place.dataset.ready = keys.join(" ");
  };
  const asked = new URLSearchParams(location.search).get("trial");
  if (asked) open(/^r/.test(asked) ? asked : "r0t" + asked);
})();
