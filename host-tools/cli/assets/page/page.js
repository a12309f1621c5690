// Page of one finger: shows the server's messages and sends the user's commands.
import { Finger, Sensor } from "./finger.js";
import { Spectrum, Strip, WINDOW } from "./charts.js";
import { FLAGS } from "./flags.js";

const $ = (id) => document.getElementById(id);
const number = (value) => typeof value === "number";
/** Formats a number with so many decimals; a rounded zero has no sign. */
const fixed = (value, digits) => value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1");

const state = { at: {}, facts: {}, times: [], low: {}, high: {}, latest: [], measured: [], flagged: {}, drawn: [], draws: 0 };
let socket, finger, sensors = [], strips = [], spectrum, dragging = false, wanted = true;

// —— the link ——
/** Fills the list of fingers; returns the one in the page's address, or else the first. */
function choosable(names) {
  const asked = new URLSearchParams(location.search).get("finger");
  const which = asked in names ? asked : 0;
  $("finger").replaceChildren(...names.map((name, i) => new Option(name, i)));
  $("finger").value = which;
  $("finger").parentElement.hidden = names.length < 2;
  return which;
}

function connect(which) {
  socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}/finger/${which}`);
  socket.onmessage = (event) => receive(JSON.parse(event.data));
  socket.onopen = () => { if ($("channel").value) ask("channel", { name: $("channel").value }); };
  socket.onclose = () => {
    trouble("the taxel program does not answer: it has ended, or the connection to it is broken (SSH, network); this page continues when the program answers");
    setTimeout(connect, 500, which);
  };
}

function ask(order, more = {}) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ order, ...more }));
}

function receive(message) {
  if ("done" in message || "failed" in message) return say(message);
  if (message.spectrum) return state.spectrum = message.spectrum;
  if (message.facts) learn(message.facts);
  if (message.columns) begin(message.columns);
  Object.assign(state, message);
  const { time, status, low, high } = message.ticks;
  for (let i = 0; i < time.length; i++) {
    state.times.push(time[i]);
    note(status[i], time[i]);
    state.measured.forEach((name, k) => {
      state.low[name].push(low[i][k]);
      state.high[name].push(high[i][k]);
    });
  }
  const before = (state.times.at(-1) ?? 0) - WINDOW - 1;
  let old = 0;
  while (old < state.times.length && state.times[old] < before) old++;
  if (old > 60) {
    state.times.splice(0, old);
    for (const name of state.measured) { state.low[name].splice(0, old); state.high[name].splice(0, old); }
  }
  wanted = true;
}

/** Sets the columns of the following rows and discards earlier ones. */
function begin(columns) {
  const names = columns.map((column) => column.name);
  const same = names.join() === Object.keys(state.at).join();
  state.at = Object.fromEntries(names.map((name, i) => [name, i]));
  state.measured = columns.filter((column) => column.measured).map((column) => column.name);
  state.times = [];
  state.low = Object.fromEntries(state.measured.map((name) => [name, []]));
  state.high = Object.fromEntries(state.measured.map((name) => [name, []]));
  state.flagged = {};
  if (!same) layout(names);
}

// —— page elements, built from the columns ——
const UNITS = { n: "N", mm: "mm", nmm: "N·mm" };
const unit = (name) => UNITS[/_([a-z]+)$/.exec(name)?.[1]] ?? "";

/** Groups measured columns into charts by name and unit. */
function charts(names) {
  const groups = [];
  const take = (title, pick, labels) => {
    const found = pick.filter((name) => names.includes(name));
    if (found.length) groups.push([title, unit(found[0]), found, labels.filter((_, i) => names.includes(pick[i]))]);
  };
  take("Force", ["fx_n", "fy_n", "fz_n"], ["x", "y", "z, into the skin"]);
  take("Contact point", ["x_mm", "y_mm"], ["x", "y"]);
  take("Slip margin", ["slip_margin"], ["margin"]);
  take("Torsion", ["torsion_nmm"], ["torsion"]);
  const grouped = groups.flatMap(([, , found]) => found);
  if (!grouped.some((name) => name.startsWith("f"))) {
    // A finger with force sensors only.
    for (let s = 0; names.includes(`s${s}_fz_n`); s++) {
      take(`Sensor ${s}`, ["x", "y", "z"].map((axis) => `s${s}_f${axis}_n`), ["x", "y", "z"]);
    }
  }
  return groups;
}

function layout(names) {
  $("charts").replaceChildren();
  if (!names.length) return $("charts").append(Object.assign(document.createElement("p"), { className: "quiet", textContent: "Waiting for the first frame …" }));
  strips = charts(state.measured).map((group) => new Strip($("charts"), ...group));
  if (!strips.length) $("charts").textContent = "No measured values in the stream: choose the field “force” or “sensors”.";
  $("sensors").replaceChildren();
  $("sensors-panel").hidden = true;
  sensors = [];
  for (let s = 0; names.includes(`s${s}_fz_n`); s++) sensors.push(null);
  const channel = $("channel").value;
  const options = names.filter((name) => !["t_us", "seq", "status", "contact"].includes(name)).map((name) => new Option(name, name));
  $("channel").replaceChildren(...options);
  $("channel").value = names.includes(channel) ? channel : names.includes("fz_n") ? "fz_n" : options[0]?.value ?? "";
  choose();
}

function choose() {
  spectrum.build(unit($("channel").value));
  ask("channel", { name: $("channel").value });
}

function learn(facts) {
  const { board, serial, firmware, calibration, live } = facts;
  state.facts = facts;
  finger = new Finger($("map"), facts.taxels);
  const parts = [serial ?? "", board ? `on ${board}` : "", firmware ? `firmware ${firmware}` : ""];
  parts.push(live ? (calibration ? `calibration ${calibration}` : "uncalibrated") : facts.calibration_serial ? `calibration ${facts.calibration_serial}` : "");
  $("identity").textContent = parts.filter(Boolean).join(" · ");
  document.title = serial ? `taxel · ${serial}` : "taxel";
  $("live-controls").hidden = !live;
  $("no-controls").hidden = Boolean(live) || Boolean(state.playback);
  if (!live) return;
  if (document.activeElement !== $("rate-input")) $("rate-input").value = Math.round(facts.rate_hz);
  $("rate-input").max = facts.scan_hz;
  $("method").value = facts.method;
  const corners = new Set([0, 5, 10, 20, 50, 100, 200, 500, facts.filter_hz].filter((hz) => hz <= facts.scan_hz / 4));
  $("filter").replaceChildren(...[...corners].sort((a, b) => a - b).map((hz) => new Option(hz ? `${hz} Hz` : "none", hz)));
  $("filter").value = facts.filter_hz;
  // Created once, because a new checkbox would lose the keyboard focus.
  if (!$("fields").children.length) $("fields").append(...facts.field_names.map(fieldBox));
  const chosen = facts.fields.split(",");
  for (const box of $("fields").querySelectorAll("input")) box.checked = chosen.includes(box.value);
}

function fieldBox(name) {
  const label = document.createElement("label");
  const box = Object.assign(document.createElement("input"), { type: "checkbox", value: name });
  box.onchange = () => ask("fields", { list: [...$("fields").querySelectorAll(":checked")].map((one) => one.value).join() });
  label.append(box, ` ${name}`);
  return label;
}

// —— drawing, once a frame of the screen ——
/** Interval between updates of the numbers, in milliseconds; people read no faster. */
const READ = 100;
let read = -Infinity;

/** Sets a text only if it changes, to avoid a new layout. */
function write(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

function draw(now) {
  requestAnimationFrame(draw);
  if (!wanted) return;
  wanted = false;
  const reads = now - read >= READ;
  if (reads) read = now;
  if (reads) vitals();
  if (!finger) return;
  const begun = performance.now();
  const value = (name) => state.latest[state.at[name]] ?? null;
  const signals = "c_r0c0" in state.at ? Array.from({ length: 16 }, (_, k) => value(`c_r${k >> 2}c${k & 3}`)) : undefined;
  const force = ["fx_n", "fy_n", "fz_n"].map(value), point = ["x_mm", "y_mm"].map(value);
  const names = Object.keys(state.at);
  const contacts = [1, 2].map((i) => ["x_mm", "y_mm"].map((end) => value(`contact${i}_${end}`)));
  finger.draw({ signals, saturated: value("saturated") ?? 0, dead: value("dead") ?? 0, point, force, contacts });
  if (reads) write("scale", signals ? `Blue came nearer, orange went away; full colour is ${finger.full.toFixed(2)} of full scale.` : names.length ? "The taxels are in the field “signals”." : "");
  sensors.forEach((sensor, s) => {
    const given = ["x", "y", "z"].map((axis) => value(`s${s}_f${axis}_n`));
    if (!given.some((f) => f !== null && f !== "absent")) return;
    $("sensors-panel").hidden = false;
    sensors[s] = sensor ?? new Sensor($("sensors"), s);
    sensors[s].draw(given);
  });
  if (reads) values(force, point, value);
  flags();
  strips.forEach((strip) => strip.draw(state.times, state.low, state.high));
  if (state.spectrum) {
    const { step_hz, lines, filled, channel } = state.spectrum;
    $("filling").textContent = lines || !channel ? "" : filled > 0 ? `collecting, ${Math.round(filled * 100)} %` : "no value to make one of";
    spectrum.show(Boolean(lines));
    if (lines) spectrum.draw(step_hz, lines);
    state.spectrumShown = state.spectrum;
    state.spectrum = null;
  }
  state.draws++;
  state.drawn.push(performance.now() - begun);
  if (state.drawn.length > 600) state.drawn.splice(0, 300);
}

/** Lists the finger's values; a missing value shows its reason. */
function values(force, point, value) {
  const rows = [
    ["force x", force[0], "N", 3], ["force y", force[1], "N", 3], ["force z", force[2], "N", 3],
    ["at x", point[0], "mm", 2], ["at y", point[1], "mm", 2],
    ["torsion", value("torsion_nmm"), "N·mm", 2], ["slip margin", value("slip_margin"), "", 2],
    ["friction", value("friction"), "", 2], ["grip wanted", value("grip_n"), "N", 2],
  ];
  // Two contacts are rare, so that reasons for a missing one are not shown.
  for (const i of [1, 2]) {
    const [x, y, fz] = ["x_mm", "y_mm", "fz_n"].map((end) => value(`contact${i}_${end}`));
    if (number(fz)) rows.push([`contact ${i} x`, x, "mm", 2], [`contact ${i} y`, y, "mm", 2], [`contact ${i} force`, fz, "N", 2]);
  }
  const there = rows.filter(([, given]) => given !== null);
  const list = $("values");
  list.dataset.seq = value("seq");
  while (list.children.length > 2 * there.length) list.lastChild.remove();
  there.forEach(([name, given, its, digits], i) => {
    const dt = list.children[2 * i] ?? list.appendChild(document.createElement("dt"));
    const dd = list.children[2 * i + 1] ?? list.appendChild(document.createElement("dd"));
    dt.textContent = name;
    dd.textContent = number(given) ? `${fixed(given, digits)} ${its}` : given;
    dd.className = number(given) ? "" : "why";
    dd.dataset.value = given;
  });
}

/** Seconds that a flag stays visible after its last frame. */
const LINGER = 2;

function note(bits, time) {
  for (const [bit, name] of state.facts.flags ?? []) if (bits & bit) state.flagged[name] = time;
}

function flags() {
  const now = state.times.at(-1) ?? 0;
  const bits = state.latest[state.at.status] ?? 0;
  const shown = (state.facts.flags ?? []).filter(([bit, name]) => !name.startsWith("ran-") && (bits & bit || now - (state.flagged[name] ?? -Infinity) < (name === "contact" ? 0 : LINGER)));
  const ran = (state.facts.flags ?? []).filter(([bit, name]) => name.startsWith("ran-") && bits & bit).map(([, name]) => name.slice(4));
  const key = shown.map(([bit, name]) => name + Boolean(bits & bit)).join() + ran.join() + ("status" in state.at);
  if (key === state.flagKey) return;
  state.flagKey = key;
  const items = shown.map(([bit, name]) => {
    const [kind, words, todo] = FLAGS[name] ?? ["warn", name, ""];
    return item(`${kind}${bits & bit ? "" : " past"}`, words, todo);
  });
  if (!shown.some(([, name]) => name === "contact")) items.unshift(item("", "status" in state.at ? "Nothing touches the finger" : "No word from the finger", ""));
  if (ran.length) items.push(item("", "Estimators that ran", ran.join(", ")));
  $("flags").replaceChildren(...items);
}

function item(kind, words, todo) {
  const made = document.createElement("li");
  made.className = kind;
  made.append(Object.assign(document.createElement("strong"), { textContent: words }));
  if (todo) made.append(Object.assign(document.createElement("span"), { textContent: todo }));
  return made;
}

function vitals() {
  write("rate", number(state.rate) ? `${state.rate.toFixed(0)} Hz` : "–");
  write("lost", String(state.lost ?? "–"));
  write("echo", number(state.echo_ms) ? `${state.echo_ms.toFixed(1)} ms` : "–");
  write("clock", state.clock ? `± ${state.clock[1].toFixed(2)} ms` : "–");
  const [ppm] = state.clock ?? [null];
  $("clock").title = number(ppm) ? `it runs ${Math.round(ppm)} parts per million faster than this machine's` : "how fast it runs is known after ten seconds";
  trouble(state.trouble);
  $("record").setAttribute("aria-pressed", Boolean(state.recording));
  write("record", state.recording ? "End recording" : "Record");
  $("playback").hidden = !state.playback;
  if (!state.playback) return;
  $("no-controls").hidden = true;
  const { at, of, runs } = state.playback;
  write("play", runs ? "Pause" : "Play");
  $("scrubber").max = of ?? Math.max(1, at);
  if (!dragging) $("scrubber").value = at;
  write("place", `${at.toFixed(1)} s${of === null ? "" : ` of ${of.toFixed(1)} s`}`);
}

function trouble(text) {
  if ($("trouble").textContent === (text ?? "")) return;
  $("trouble").textContent = text ?? "";
  $("trouble").hidden = !text;
}

function say({ done, failed }) {
  const text = done ?? failed;
  if (!text && $("said").textContent !== "…") return;
  $("said").textContent = text;
  $("said").className = failed === undefined ? "" : "failed";
}

// —— user input ——
function command(id, order, more) {
  $(id).onclick = () => { say({ done: "…" }); ask(order, more?.()); };
}
command("bias", "bias");
command("clear-bias", "clear-bias");
command("self-test", "self-test");
command("record", "record", () => ({ on: !state.recording }));
command("play", "play", () => ({ on: !state.playback?.runs }));
$("filter").onchange = () => ask("filter", { hz: Number($("filter").value) });
$("method").onchange = () => ask("method", { name: $("method").value });
$("channel").onchange = choose;
$("rate-form").onsubmit = (event) => {
  event.preventDefault();
  ask("rate", { hz: Math.round(Number($("rate-input").value)) });
};
$("scrubber").oninput = () => { dragging = true; };
$("scrubber").onchange = () => { dragging = false; ask("seek", { to: Number($("scrubber").value) }); };
document.onkeydown = (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select") || event.key === " " && event.target.closest("button")) return;
  const id = { b: "bias", r: "record", t: "self-test", " ": "play" }[event.key];
  if (!id || !$(id).offsetParent) return;
  event.preventDefault();
  $(id).click();
};
$("finger").onchange = () => { location.search = `?finger=${$("finger").value}`; };
addEventListener("resize", () => { strips.forEach((strip) => strip.resize()); spectrum.resize(); });
matchMedia("(prefers-color-scheme: dark)").onchange = () => { strips.forEach((strip) => strip.build()); spectrum.build(spectrum.unit); wanted = true; };

spectrum = new Spectrum($("spectrum"));
/** State for the tests and for scripts in the browser's console. */
window.taxel = state;
fetch("fingers").then((answer) => answer.json()).then((names) => {
  connect(choosable(names));
  requestAnimationFrame(draw);
});
