(() => {
  const SPAN_S = 60;  // what the charts show, s
  const OLD_S = 1;  // a stream without a sample for so long has no reader in this state, or the guard would have stopped
  const QUIET_MS = 2000;  // after this long without a message the run counts as lost
  const at = (id) => document.getElementById(id);
  const [stop, pause, alarm] = [at("stop"), at("pause"), at("alert")];
  let [wire, now, signals, charts, question, last, after, past, refused, offered, before] = [null, {}, {}, {}, null, 0, null, null, "", "", ""];

  // --- the line to the run; a lost one is made anew
  const send = (message) => { if (wire?.readyState === WebSocket.OPEN) wire.send(JSON.stringify(message)); };
  const warn = (text) => { alarm.hidden = !text; alarm.textContent = text; };
  const connect = () => {
    wire = new WebSocket(`ws://${location.host}/wire${location.search}`);
    wire.onmessage = (event) => {
      const message = JSON.parse(event.data);
      last = Date.now();
      if (message.refused) { refused = message.refused; setTimeout(() => { refused = ""; }, 6000); return; }
      if (message.after) { after = message.after; return ended(); }
      if (message.run) { at("rows").replaceChildren(); at("events").replaceChildren(); }
      update(message);
    };
    wire.onclose = () => { if (!after) setTimeout(connect, 1000); };
  };
  setInterval(() => {
    const lost = !now.ended && !after && Date.now() - last > QUIET_MS, joined = wire.readyState === WebSocket.OPEN;
    document.body.dataset.lost = lost;
    stop.disabled = pause.disabled = at("hold").disabled = !joined || Boolean(now.ended || after);
    warn(lost ? `No message from the run: ${joined ? "Stop may not reach it" : "this page can stop nothing now"}. Use the robot’s emergency stop.` : refused ? `Refused: ${refused}` : "");
  }, 500);
  stop.addEventListener("click", () => send({do: "stop"}));
  pause.addEventListener("click", () => send({do: now.paused ? "resume" : "pause"}));
  at("hold").addEventListener("click", () => send({do: "hold", on: !now.between?.hold}));
  for (const button of at("question").querySelectorAll("button"))
    button.addEventListener("click", () => send({do: "answer", number: question.number, done: Boolean(button.dataset.done)}));

  // --- messages from the run
  const words = (name) => name.replaceAll("_", " ");
  const clock = (s) => s < 90 ? `${Math.ceil(s)} s` : s < 5400 ? `${Math.round(s / 60)} min` : `${(s / 3600).toFixed(1)} h`;
  const cells = (row, values, kind = "td") => { row.append(...values.map((value) => { const cell = document.createElement(kind); cell.textContent = value; return cell; })); return row; };
  const line = (values, kind) => cells(document.createElement("tr"), values, kind);
  const part = (text, kind) => { const made = document.createElement("span"); made.className = kind; made.textContent = text; return made; };
  const bars = (place, all, word, least = () => 0) => at(place).replaceChildren(...(all ?? []).map(([name, value, limit, unit, acts = true]) => {
    const low = Math.min(least(name), value);
    let digits = Math.min(6, Math.max(0, 3 - Math.floor(Math.log10(Math.abs(limit) || 1))));
    while (digits < 6 && value !== limit && value.toFixed(digits) === limit.toFixed(digits)) digits += 1;
    const bar = document.createElement("div"), share = limit > low ? Math.min(1, (value - low) / (limit - low)) : 0;
    bar.className = !acts ? "bar idle" : share > 0.8 ? "bar near" : "bar";
    bar.append(`${name} ${value.toFixed(digits)}, ${word} ${limit.toFixed(digits)} ${unit}${acts || now.ended ? "" : " – recorded only, stops nothing now"}`, document.createElement("i"));
    bar.lastChild.style.setProperty("--share", `${100 * share}%`);
    return bar;
  }));
  const banner = (text, kind) => {
    document.body.dataset.kind = kind;
    at("banner").hidden = !text;
    at("banner").firstElementChild.textContent = text;
    at("next").hidden = !after;
  };
  const held = () => Boolean(now.between?.offer?.home);
  const byHand = () => {  // the buttons stay while they are the same: a click takes longer than a message
    const {possible, hold, offer, doing, said} = now.between ?? {};
    at("hold").hidden = !possible || held() || Boolean(now.ended);
    at("hold").setAttribute("aria-pressed", Boolean(hold));
    at("hold").textContent = hold ? "Holds after this trial" : "Hold after this trial";
    at("hand").hidden = !held();
    const key = JSON.stringify([offer, doing, said]);
    if (!held() || key === offered) return;
    offered = key;
    const buttons = Object.entries(offer).flatMap(([what, targets]) => targets.map((target) => Object.assign(document.createElement("button"), {type: "button", textContent: `${what} ${target}`, disabled: Boolean(doing), onclick: () => send({do: what, target})})));
    at("hand").replaceChildren(...buttons.flatMap((each) => [each, " "]), doing ? `${doing} …` : said);
  };
  const verdict = () => {
    const counts = now.counts ?? [], done = counts.reduce((sum, [, number]) => sum + number, 0);
    const said = counts.map(([name, number, good]) => part(`${words(name)}: ${number}`, good ? "good" : "missed"));
    const bad = counts.reduce((sum, [, number, good]) => sum + (good ? 0 : number), 0);
    large("verdict", `${done} of ${now.run?.trials ?? "–"}${done ? " done" : ""}`, ...(done ? [": ", bad ? part(`${bad} failed`, "missed") : part("none failed", "good")] : [" trials"]));
    if (done && !now.ended) said[0].prepend("So far, ");
    at("counts").replaceChildren(...said.flatMap((each, place) => place ? [", ", each] : [each]));
  };
  const large = (id, ...content) => {  // on one line whatever its length: narrower letters, as high as the others
    const [line, width] = [at(id), at("headline").clientWidth], key = `${width} ${content.map((each) => each.textContent ?? each)}`;
    if (line.dataset.key === key) return;
    line.dataset.key = key;
    line.replaceChildren(...content);
    line.style.transform = `scaleX(${Math.min(1, width / line.offsetWidth)})`;
  };
  const update = (message) => {
    if (message.diagram) { signals = {}; if (!past) clear(); at("events").replaceChildren(); diagram(message.diagram); }
    if (message.paused && !now.paused) before = now.state;
    now = {...now, ...message};
    [at("title").textContent, at("title").title] = [now.run.title, now.run.folder];
    verdict();
    const left = Number.isFinite(now.left_s) && !now.paused ? `; about ${clock(now.left_s)} left in all` : "";
    at("now").textContent = now.ended ? "" : `Now trial ${now.trial ?? "–"}, ${now.factors ?? ""}: ${Number((now.t_s ?? 0).toPrecision(4))} s${left}`;
    large("state", now.ended ? "ENDED" : held() ? "HELD" : now.state || "begins");
    document.body.dataset.state = now.ended ? "ended" : now.state;
    document.title = `${at("state").textContent}: ${now.run.title}`;
    if (!past) at("whose").textContent = whose();
    if (now.ended) banner(now.by ? `The run was ${now.by}: ${now.ended}` : `The run has ended: ${now.ended}`, now.by ? "broken" : "done");
    else if (held()) banner("HELD between two trials: nothing moves, but for what is asked for here, under the guard. Resume begins the next trial.", "paused");
    else if (now.paused) banner(`PAUSED${now.pressed_by ? ` by ${now.pressed_by}` : ""}: nothing moves; the guard watches ${(now.margins ?? []).map(([name]) => name).join(", ") || "on"}. Detected in this trial: ${now.detected || "nothing yet"}.${now.resumes_in ? ` On Resume this trial goes on in ${now.resumes_in}${before === now.resumes_in ? ", where it was" : before ? `; it was in ${before}` : ""}.` : ""}`, "paused");
    else banner("", "running");
    byHand();
    pause.textContent = now.paused ? "Resume" : "Pause";
    stop.setAttribute("aria-pressed", now.stopped);
    stop.textContent = now.stopped ? "Stopped" : "Stop";
    question = now.question;
    at("question").hidden = !question;
    at("question").firstElementChild.textContent = question?.text ?? "";
    for (const state of at("diagram").querySelectorAll("[data-state]")) {
      state.classList.toggle("here", !now.ended && state.dataset.state === now.state);
      state.classList.toggle("last", Boolean(now.ended) && state.dataset.state === now.state);
      state.classList.toggle("next", Boolean(now.paused) && !now.ended && !held() && state.dataset.state === now.resumes_in);
    }
    bars("thresholds", now.thresholds, "alarm at", (name) => (signals[`detector.${name}`]?.y ?? []).reduce((low, value) => value < low ? value : low, Infinity));
    bars("margins", now.margins, "stop at");
    at("streams").replaceChildren(...(now.streams ?? []).map(([name, age_s, lost]) => Object.assign(line([name, age_s < OLD_S ? `${Math.max(0, age_s).toFixed(2)} s` : clock(age_s), lost]), {className: age_s < OLD_S ? "" : "old"})));
    for (const [trial, outcome, row, success] of message.rows ?? []) {
      const names = ["trial", "outcome", ...Object.keys(row)].slice(0, 9);
      at("heads").replaceChildren(line(names, "th"));
      const result = line([trial, words(outcome), ...Object.values(row)].slice(0, 9));
      result.cells[1].className = success ? "good" : "missed";
      Object.assign(result, {tabIndex: 0, onclick: () => open(trial, result), onkeydown: (event) => { if (event.key === "Enter") open(trial, result); }});
      at("rows").prepend(result);
    }
    for (const [t_s, text] of message.events ?? []) {
      const item = document.createElement("li");
      item.textContent = `${t_s.toFixed(3)} s  ${text}`;
      at("events").prepend(item);
    }
    while (at("events").children.length > 200) at("events").lastChild.remove();
    for (const [stream, piece] of Object.entries(message.signals ?? {})) grow(stream, piece);
    soon();
  };

  // --- after the run: how it ended, its report, how it goes on
  const ended = () => {
    const killed = after.status === "running", good = after.status === "done" && !after.code;
    if (!now.ended) Object.assign(now, {ended: killed ? "without a last word" : after.reason || after.status});
    large("state", killed ? "GONE" : good ? "DONE" : now.by || after.status === "aborted" ? "STOPPED" : after.status === "done" ? "ENDED" : "FAULT");
    document.body.dataset.state = "ended";
    for (const state of at("diagram").querySelectorAll("[data-state]")) state.classList.remove("here", "next");
    banner(killed ? "The program of this run is gone without an end: look at the bench." : good && !now.by ? "The run is complete." : at("banner").firstElementChild.textContent || `The run has ended: ${now.ended}`, good ? "done" : "broken");
    stop.disabled = pause.disabled = true;
    at("next").replaceChildren();
    if (after.report) {
      const link = Object.assign(document.createElement("a"), {href: `/report${location.search}`, textContent: "Open the report", target: "_blank"});
      at("next").append(...(after.said ? [after.said, " "] : []), link);
    } else at("next").append("No report is written yet");
    if (after.status !== "done") at("next").append(". To go on, in the terminal at the bench: ", Object.assign(document.createElement("code"), {textContent: `run.py resume ${after.folder}`}));
  };

  // --- a trial that has ended, in place of the present one
  const open = async (trial, row) => {
    const answer = await fetch(`/trial${location.search}&number=${trial}`).catch(() => null);
    if (!answer?.ok) return warn(`Trial ${trial}: ${answer ? await answer.text() : "the page's program is gone"}`);
    past = {};
    clear();
    for (const [stream, piece] of Object.entries((await answer.json()).signals)) grow(stream, piece, past);
    soon();
    for (const each of at("rows").rows) each.classList.toggle("open", each === row);
    [at("whose").textContent, at("back").hidden] = [`Signals of trial ${trial}`, false];
    at("whose").scrollIntoView({block: "center"});
  };
  at("back").addEventListener("click", () => {
    past = null;
    clear();
    for (const each of at("rows").rows) each.classList.remove("open");
    [at("whose").textContent, at("back").hidden] = [whose(), true];
  });

  // --- charts: a signal each over one axis of time, with the threshold that it is held against
  const whose = () => now.ended ? "Signals of the last trial" : "Signals now";
  const clear = () => { charts = {}; at("panels").replaceChildren(); soon(); };
  const grow = (stream, {t, y, label, title, threshold, gap_s}, kept = signals) => {
    const seen = kept[stream] ??= {t: [], y: [], threshold: NaN, label: stream};
    if (label !== undefined) Object.assign(seen, {label, title});
    if (threshold !== undefined) seen.threshold = threshold;
    if (seen.t.length && t.length && t[0] - seen.t.at(-1) > gap_s) { seen.t.push(t[0]); seen.y.push(NaN); }
    seen.t.push(...t);
    seen.y.push(...y.map((value) => value ?? NaN));
    const from = kept === signals ? seen.t.findIndex((t_s) => t_s >= now.t_s - SPAN_S) : 0;
    if (from > 0) { seen.t.splice(0, from); seen.y.splice(0, from); }
  };
  const box = (stream, {label, title}) => {
    const made = Object.assign(document.createElement("div"), {role: "img", ariaLabel: label});
    made.dataset.stream = stream;
    const unit = label.includes(", ") ? ` (${label.split(", ").pop()})` : "";
    made.append(Object.assign(document.createElement("p"), {textContent: title ? `${title}${unit}; dashed: threshold` : label}), svg("svg", {height: tall, width: "100%"}));
    at("panels").append(made);
    return made;
  };
  const show = (stream, seen, {start, end}) => {
    if (![...seen.y, seen.threshold].some(Number.isFinite)) return;
    const stands = stream.startsWith("detector.");  // a statistic stands until the next decision
    const idle = !past && (now.thresholds ?? []).some(([name, , , , acts]) => `detector.${name}` === stream && !acts);
    const curves = [{look: stands ? `signal statistic${idle ? " idle" : ""}` : "signal", t: seen.t, y: seen.y, stands}];
    if (Number.isFinite(seen.threshold)) curves.push({look: "threshold", t: [start, end], y: [seen.threshold, seen.threshold]});
    plot((charts[stream] ??= box(stream, seen)).lastChild, {start, end, unit: "s", curves});
  };
  const spanOf = (shown) => {
    const ends = Object.values(shown).flatMap(({t}) => t.length ? [t[0], t.at(-1)] : []);
    return past ? {start: Math.min(...ends), end: Math.max(...ends)} : {start: Math.max(Math.min(...ends, now.t_s - 1), now.t_s - SPAN_S), end: now.t_s};
  };
  let [timer, due] = [0, 0];
  const soon = () => { timer ||= setTimeout(paint, Math.max(0, due - performance.now())); };
  const paint = () => {  // a slow machine draws more seldom: clicks come first
    const begun = performance.now();
    timer = 0;
    const shown = past ?? signals, span = spanOf(shown);
    const order = Object.keys((past ? null : now.signals) ?? shown);  // what decides comes first, whenever it came
    if (!document.hidden) for (const [stream, seen] of Object.entries(shown)) {
      if (!order.includes(stream)) { charts[stream]?.remove(); delete charts[stream]; continue; }
      show(stream, seen, span);
      if (charts[stream]) charts[stream].style.order = order.indexOf(stream);
    }
    due = 5 * performance.now() - 4 * begun;
  };
  addEventListener("resize", () => { soon(); if (now.run) verdict(); if (at("state").textContent) large("state", at("state").textContent); });
  document.addEventListener("visibilitychange", soon);
  theme();

  // --- states one below the other; ways to the next one straight, others around
  const diagram = ({states, ways}) => {
    const [wide, high, pitch] = [130, 24, 42];
    const drawing = svg("svg", {viewBox: `0 0 220 ${pitch * states.length}`, role: "img", "aria-label": `States: ${states.join(", ")}`});
    const place = (name) => states.indexOf(name) * pitch + 2;
    const [named, labels] = [new Map(), []];
    for (const [from, to, event] of ways) named.set(`${from} ${to}`, [...(named.get(`${from} ${to}`) ?? []), event]);
    for (const [ends, events] of named) {
      const [[from, to], event] = [ends.split(" "), [...new Set(events)].join(" or ")];
      const [a, b] = [place(from), place(to)];
      if (b === a + pitch) {
        drawing.append(svg("path", {d: `M 60 ${a + high} V ${b - 1} m -3 -5 l 3 5 l 3 -5`}));
        labels.push(svg("text", {class: "way", x: 66, y: a + high + 12}, event));
      } else if (a !== b) {
        const out = Math.min(85, 18 + 9 * Math.abs(b - a) / pitch);
        const way = svg("path", {d: `M ${wide + 1} ${a + 15} C ${wide + out} ${a + 15} ${wide + out} ${b + 9} ${wide + 1} ${b + 9} m 6 -3 l -6 3 l 6 3`});
        way.append(svg("title", {}, `${from} to ${to}: ${event}`));
        drawing.append(way);
      }
    }
    drawing.append(...labels);  // over the ways that go around
    for (const name of states) {
      const state = svg("g", {"data-state": name});
      state.append(svg("rect", {x: 1, y: place(name), width: wide, height: high, rx: 4}), svg("text", {x: 8, y: place(name) + 16}, name));
      drawing.append(state);
    }
    at("diagram").replaceChildren(drawing);
  };
  connect();
})();
