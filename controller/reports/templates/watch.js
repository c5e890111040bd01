(() => {
  const SPAN_S = 60;  // what the charts show, s
  const QUIET_MS = 2000;  // after this long without a message the run counts as lost
  const at = (id) => document.getElementById(id);
  const [stop, pause, alarm] = [at("stop"), at("pause"), at("alert")];
  let [wire, now, signals, charts, question, last] = [null, {}, {}, {}, null, 0];

  // --- the line to the run; a lost one is made anew
  const send = (message) => { if (wire?.readyState === WebSocket.OPEN) wire.send(JSON.stringify(message)); };
  const warn = (text) => { alarm.hidden = !text; alarm.textContent = text; };
  const connect = () => {
    wire = new WebSocket(`ws://${location.host}/wire${location.search}`);
    wire.onopen = () => { at("rows").replaceChildren(); at("events").replaceChildren(); };
    wire.onmessage = (event) => { last = Date.now(); update(JSON.parse(event.data)); };
    wire.onclose = () => { if (!now.ended) setTimeout(connect, 1000); };
  };
  setInterval(() => {
    const lost = !now.ended && Date.now() - last > QUIET_MS;
    document.body.dataset.lost = lost;
    stop.disabled = pause.disabled = wire.readyState !== WebSocket.OPEN || Boolean(now.ended);
    warn(lost ? "No message from the run: this page can stop nothing now. Use the robot’s emergency stop." : now.ended ? `The run has ended: ${now.ended}` : "");
  }, 500);
  stop.addEventListener("click", () => send({do: "stop"}));
  pause.addEventListener("click", () => send({do: now.paused ? "resume" : "pause"}));
  for (const button of at("question").querySelectorAll("button"))
    button.addEventListener("click", () => send({do: "answer", number: question.number, done: Boolean(button.dataset.done)}));

  // --- messages from the run
  const cells = (row, values, kind = "td") => { row.append(...values.map((value) => { const cell = document.createElement(kind); cell.textContent = value; return cell; })); return row; };
  const line = (values, kind) => cells(document.createElement("tr"), values, kind);
  const update = (message) => {
    if (message.refused) return console.warn(message.refused);
    if (message.diagram) { signals = {}; charts = {}; at("panels").replaceChildren(); at("events").replaceChildren(); diagram(message.diagram); }
    now = {...now, ...message};
    at("title").textContent = `${now.run.title} · ${now.run.folder}`;
    at("now").textContent = now.ended ? now.ended : `Trial ${now.trial ?? "–"}, ${now.factors ?? ""}: ${now.state || "begins"}, ${Number((now.t_s ?? 0).toPrecision(4))} s`;
    document.body.dataset.state = now.ended ? "ended" : now.state;
    pause.textContent = now.paused ? "Resume" : "Pause";
    stop.setAttribute("aria-pressed", now.stopped);
    stop.textContent = now.stopped ? "Stopped" : "Stop";
    stop.title = now.stopped ? `Go on with: run.py resume ${now.run.folder}` : "";
    question = now.question;
    at("question").hidden = !question;
    at("question").firstElementChild.textContent = question?.text ?? "";
    for (const state of at("diagram").querySelectorAll("[data-state]")) state.classList.toggle("here", state.dataset.state === now.state);
    at("margins").replaceChildren(...(now.margins ?? []).map(([name, value, limit, unit]) => {
      const label = document.createElement("label"), meter = document.createElement("meter");
      Object.assign(meter, {max: limit, high: 0.8 * limit, value});
      label.append(`${name} ${value.toFixed(2)} of ${limit.toFixed(1)} ${unit}`, meter);
      return label;
    }));
    at("streams").replaceChildren(...(now.streams ?? []).map(([name, age_s, lost]) => line([name, `${Math.max(0, age_s).toFixed(2)} s`, lost])));
    for (const [trial, outcome, row, success] of message.rows) {
      const names = ["trial", "outcome", ...Object.keys(row)].slice(0, 9);
      at("heads").replaceChildren(line(names, "th"));
      const result = line([trial, outcome.replaceAll("_", " "), ...Object.values(row)].slice(0, 9));
      result.classList.toggle("missed", !success);
      at("rows").prepend(result);
    }
    at("count").textContent = `${at("rows").rows.length} of ${now.run.trials}`;
    for (const [t_s, text] of message.events ?? []) {
      const item = document.createElement("li");
      item.textContent = `${t_s.toFixed(3)} s  ${text}`;
      at("events").prepend(item);
    }
    while (at("events").children.length > 200) at("events").lastChild.remove();
    for (const [stream, piece] of Object.entries(message.signals ?? {})) grow(stream, piece);
  };

  // --- charts: a signal each, with the threshold that it is held against
  const grow = (stream, {t, y, label, title, threshold}) => {
    const seen = signals[stream] ??= {t: [], y: [], threshold: NaN, label: stream};
    if (label !== undefined) Object.assign(seen, {label, title});
    if (threshold !== undefined) seen.threshold = threshold;
    seen.t.push(...t);
    seen.y.push(...y);
    const from = seen.t.findIndex((t_s) => t_s >= now.t_s - SPAN_S);
    if (from > 0) { seen.t.splice(0, from); seen.y.splice(0, from); }
  };
  const show = (stream, seen) => {
    if (!seen.t.length) return;
    const drawn = charts[stream] ??= draw(stream, seen);
    drawn.source.data = stream.startsWith("detector.") ? steps(seen) : {t: seen.t.slice(), y: seen.y.slice()};
    const span = {start: Math.max(0, now.t_s - SPAN_S), end: Math.max(now.t_s, 1)};
    drawn.limit.data = Number.isFinite(seen.threshold) ? {t: [span.start, span.end], y: [seen.threshold, seen.threshold]} : {t: [], y: []};
    Object.assign(drawn.range, span);
  };
  const draw = (stream, {label, title}) => {
    const ink = inks();
    const range = new Bokeh.Range1d({start: 0, end: 1});
    const plot = chart(ink, {height: 150, x_range: range, y_axis_label: label, title, tools: "", toolbar_location: null});
    const source = new Bokeh.ColumnDataSource({data: {t: [], y: []}});
    plot.line({field: "t"}, {field: "y"}, {source, line_color: ink.ours, line_width: 1.4});
    const limit = new Bokeh.ColumnDataSource({data: {t: [], y: []}});
    plot.line({field: "t"}, {field: "y"}, {source: limit, line_color: ink.truth, line_dash: [6, 4]});
    const box = document.createElement("div");
    box.setAttribute("role", "img");
    box.setAttribute("aria-label", label);
    box.dataset.stream = stream;
    at("panels").append(box);
    Bokeh.Plotting.show(plot, box);
    return {source, limit, range};
  };
  const paint = () => {  // a slow machine draws more seldom: clicks come first
    const begun = performance.now();
    if (!document.hidden) for (const [stream, seen] of Object.entries(signals)) show(stream, seen);
    setTimeout(paint, Math.max(200, 4 * (performance.now() - begun)));
  };
  paint();
  theme(() => { charts = {}; at("panels").replaceChildren(); });

  // --- states one below the other; ways to the next one straight, others around
  const svg = (name, given, text = "") => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(given)) made.setAttribute(key, value);
    made.textContent = text;
    return made;
  };
  const diagram = ({states, ways}) => {
    const [wide, high, pitch] = [130, 24, 42];
    const drawing = svg("svg", {viewBox: `0 0 220 ${pitch * states.length}`, role: "img", "aria-label": `States: ${states.join(", ")}`});
    const place = (name) => states.indexOf(name) * pitch + 2;
    const named = new Map();
    for (const [from, to, event] of ways) named.set(`${from} ${to}`, [...(named.get(`${from} ${to}`) ?? []), event]);
    for (const [ends, events] of named) {
      const [[from, to], event] = [ends.split(" "), [...new Set(events)].join(" or ")];
      const [a, b] = [place(from), place(to)];
      if (b === a + pitch) {
        drawing.append(svg("path", {d: `M 60 ${a + high} V ${b - 1} m -3 -5 l 3 5 l 3 -5`}), svg("text", {class: "way", x: 66, y: a + high + 12}, event));
      } else if (a !== b) {
        const out = Math.min(85, 18 + 9 * Math.abs(b - a) / pitch);
        const way = svg("path", {d: `M ${wide + 1} ${a + 15} C ${wide + out} ${a + 15} ${wide + out} ${b + 9} ${wide + 1} ${b + 9} m 6 -3 l -6 3 l 6 3`});
        way.append(svg("title", {}, `${from} to ${to}: ${event}`));
        drawing.append(way);
      }
    }
    for (const name of states) {
      const state = svg("g", {"data-state": name});
      state.append(svg("rect", {x: 1, y: place(name), width: wide, height: high, rx: 4}), svg("text", {x: 8, y: place(name) + 16}, name));
      drawing.append(state);
    }
    at("diagram").replaceChildren(drawing);
  };
  connect();
})();
