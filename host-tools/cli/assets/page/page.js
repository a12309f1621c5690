// Page of one finger: shows the server's messages and sends the user's commands.
import { Strip, view } from "./charts.js";
import { choices, connectControls, progress, reachable, say, settings, trouble } from "./controls.js";
import { Finger, Sensor } from "./finger.js";
import { Raw } from "./raw.js";
import { large, values } from "./readout.js";
import { selfTest } from "./selftest.js";
import { Spectrum } from "./spectrum.js";
import { ago, status } from "./status.js";
import { age, frozen, hasMatrix, judgesContact, latest, LONGEST, made, number, stale, state, take, unit, words, write } from "./store.js";

const $ = (id) => document.getElementById(id);
let socket, finger, sensors = [], strips = [], spectrum, raw, wanted = true, bare, mode, picked = "";

// —— the link ——
/** Fills the list of fingers; returns the one in the page's address, or else the first. */
function choosable(names) {
  const asked = new URLSearchParams(location.search).get("finger");
  const which = asked in names ? asked : 0;
  choices($("finger"), names.map((name, i) => [String(i), name]), String(which));
  $("finger").parentElement.hidden = names.length < 2;
  return which;
}

function connect(which) {
  socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}/finger/${which}`);
  socket.onmessage = (event) => receive(JSON.parse(event.data));
  socket.onopen = () => { if ($("channel").value) ask("channel", { name: $("channel").value }); };
  socket.onclose = ({ reason }) => {
    trouble(reason || "the taxel program does not answer: it has ended, or the connection to it is broken (SSH, network); this page continues when the program answers");
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
  const changed = take(message);
  trouble(state.trouble);
  if ("self_test" in message) selfTest($("self-test-panel"), message.self_test, state.facts.taxels);
  if (changed) layout();
  wanted = true;
}

function learn(facts) {
  const { board, serial, firmware, calibration, live } = facts;
  state.facts = facts;
  finger = new Finger($("map"), facts.taxels);
  const parts = [serial ?? "", board ? `on ${board}` : "", firmware ? `firmware ${firmware}` : ""];
  parts.push(live ? (calibration ? `calibration ${calibration}` : "uncalibrated") : facts.calibration_serial ? `calibration ${facts.calibration_serial}` : "");
  $("identity").textContent = parts.filter(Boolean).join(" · ");
  document.title = serial ? `taxel · ${serial}` : "taxel";
  settings(facts);
}

// —— page elements, built from the columns ——
/** Groups measured columns into charts by name and unit. Without a calibration there are no newtons to draw. */
function charts(names) {
  const groups = [];
  const group = (title, pick, labels) => {
    const found = pick.filter((name) => names.includes(name));
    if (found.length) groups.push([title, unit(found[0]), found, labels.filter((_, i) => names.includes(pick[i]))]);
  };
  if (!bare) group("Force", ["f_n", "fx_n", "fy_n", "fz_n"], ["|F|", "x", "y", "z into skin"]);
  if (!bare || judgesContact()) group("Contact point", ["x_mm", "y_mm"], ["x", "y"]);
  if (bare) return groups;
  group("Slip margin", ["slip_margin"], ["1 unloaded, 0 slides"]);
  group("Torsion", ["torsion_nmm"], ["about the normal"]);
  if (!names.includes("fz_n")) {
    // A finger with force sensors only.
    for (let s = 0; names.includes(`s${s}_fz_n`); s++) {
      group(`Sensor ${s}`, ["x", "y", "z"].map((axis) => `s${s}_f${axis}_n`), ["x", "y", "z"]);
    }
  }
  return groups;
}

/** Whether the finger says that it has no calibration of a force. */
const uncalibrated = () => {
  const bit = (state.facts.flags ?? []).find(([, name]) => name === "uncalibrated")?.[0] ?? 0;
  return (latest("status") & bit) !== 0;
};

/** State of calibration that the charts depend on. */
const stage = () => [uncalibrated(), judgesContact()].join();

function layout() {
  const names = Object.keys(state.at);
  [bare, mode] = [uncalibrated(), stage()];
  const codes = names.filter((name) => /^(lit|dark|bridge_s\d)_/.test(name));
  $("raw-panel").hidden = !codes.length;
  $("raw-panel").open = bare;
  $("first-light").hidden = !bare;
  raw.build(codes, state.facts.taxels, state.facts.full_scale);
  $("strips").replaceChildren();
  if (!names.length) return $("strips").append(made("p", "quiet", "Waiting for the first frame …"));
  strips = state.strips = charts(state.ranged).map((group) => new Strip($("strips"), ...group));
  if (!strips.length && !bare) $("strips").append(made("p", "quiet", "No measured values in the stream: choose the field “force” or “sensors”."));
  $("sensors").replaceChildren();
  $("sensors-panel").hidden = true;
  sensors = [];
  for (let s = 0; names.includes(`s${s}_fz_n`); s++) sensors.push(null);
  const options = names.filter((name) => !["t_us", "seq", "status", "contact", "slip", "saturated", "dead", "bridge_faults"].includes(name));
  const first = bare ? codes.find((name) => number(latest(name))) : "fz_n";
  $("channel").value = picked;
  choices($("channel"), options.map((name) => [name, words(name)]), first);
  channel();
}

function channel() {
  spectrum.build(unit($("channel").value));
  ask("channel", { name: $("channel").value });
}

// —— drawing, once a frame of the screen ——
/** Interval between updates of the numbers, in milliseconds; people read no faster. */
const READ = 100;
let read = -Infinity;

function draw(now) {
  requestAnimationFrame(draw);
  if (!wanted) return;
  wanted = false;
  const reads = now - read >= READ;
  if (reads) { read = now; vitals(); }
  if (!finger) return;
  const begun = performance.now();
  const names = Object.keys(state.at);
  if (reads && names.length && number(latest("status")) && stage() !== mode) layout();
  const signals = "c_r0c0" in state.at ? Array.from({ length: 16 }, (_, k) => latest(`c_r${k >> 2}c${k & 3}`)) : undefined;
  const force = ["fx_n", "fy_n", "fz_n"].map(latest), point = ["x_mm", "y_mm"].map(latest);
  const contacts = [1, 2].map((i) => ["x_mm", "y_mm"].map((end) => latest(`contact${i}_${end}`)));
  finger.draw({ signals, saturated: latest("saturated") ?? 0, dead: latest("dead") ?? 0, point, force, contacts });
  sensors.forEach((sensor, s) => {
    const given = ["x", "y", "z"].map((axis) => latest(`s${s}_f${axis}_n`));
    if (!given.some((f) => number(f) || f !== null && f !== "absent" && f !== "uncalibrated")) return;
    $("sensors-panel").hidden = false;
    sensors[s] = sensor ?? new Sensor($("sensors"), s);
    sensors[s].draw(given);
  });
  if (reads) {
    write($("scale"), !hasMatrix() ? "This finger has no matrix of taxels." : !judgesContact() ? "The taxels' signals take a bias or a calibration." : signals ? `Blue came nearer, orange went away; full colour is ${finger.full.toFixed(2)} of full scale.` : names.length ? "The taxels are in the field “signals”." : "");
    large(force, point);
    values(force, point);
    status();
    if (!$("raw-panel").hidden && $("raw-panel").open) raw.draw(view.paused ?? state, latest, state.rate);
  }
  const end = view.paused ? "paused" : stale() ? "last" : "now";
  strips.forEach((strip) => strip.draw(view.paused ?? state, end, state.rate));
  if (state.spectrum && !view.paused) spectra();
  state.draws++;
  state.drawn.push(performance.now() - begun);
  if (state.drawn.length > 600) state.drawn.splice(0, 300);
}

function spectra() {
  const { step_hz, lines, filled, channel } = state.spectrum;
  spectrum.show(Boolean(lines));
  if (lines) spectrum.draw(step_hz, lines);
  else write($("peak"), !channel ? "" : filled > 0 ? `collecting, ${Math.round(filled * 100)} %` : "this channel has no value");
  state.spectrumShown = state.spectrum;
  state.spectrum = null;
}

function vitals() {
  const old = stale();
  document.body.classList.toggle("stale", old);
  $("as-of").hidden = !old;
  if (old) write($("as-of"), `as of ${ago(age())} ago`);
  write($("rate"), number(state.rate) && !old ? `${state.rate.toFixed(0)} Hz` : "–");
  write($("lost"), String(state.lost ?? "–"));
  write($("echo"), number(state.echo_ms) && !old ? `${state.echo_ms.toFixed(1)} ms` : "–");
  write($("clock"), state.clock && !old ? `± ${state.clock[1].toFixed(2)} ms` : "–");
  const [ppm] = state.clock ?? [null];
  $("clock").title = number(ppm) ? `it runs ${Math.round(ppm)} parts per million faster than this machine's` : "how fast it runs is known after ten seconds";
  progress();
  reachable();
}

// —— the charts' view ——
/** Pauses the charts or lets them move; numbers and status go on. */
function pause(on) {
  view.paused = on ? frozen() : null;
  view.zoom = null;
  shownView();
}

function shownView() {
  $("pause").setAttribute("aria-pressed", Boolean(view.paused));
  write($("pause"), view.paused ? "Resume charts" : "Pause charts");
  $("paused").hidden = !view.paused;
  $("hint").hidden = Boolean(view.paused);
  write($("paused"), view.zoom ? `zoomed to ${(view.zoom[1] - view.zoom[0]).toPrecision(2)} s, double-click for all` : "paused, the numbers go on");
  wanted = true;
}

function lengthen(by) {
  const list = $("window");
  list.selectedIndex = Math.max(0, Math.min(list.options.length - 1, list.selectedIndex + by));
  list.onchange();
}

view.onzoom = (ends) => {
  if (!view.paused) view.paused = frozen();
  view.zoom = ends;
  shownView();
};
view.onreset = () => { view.zoom = null; shownView(); };
view.onpoint = () => {
  strips.forEach((strip) => strip.point());
  wanted = true;
};
$("pause").onclick = () => pause(!view.paused);
$("window").onchange = () => {
  view.length = Math.min(LONGEST, Number($("window").value));
  view.zoom = null;
  shownView();
};

// —— user input ——
connectControls(ask);
$("channel").onchange = () => { picked = $("channel").value; channel(); };
$("self-test-close").onclick = () => { $("self-test-panel").hidden = true; };
$("raw-panel").ontoggle = () => { wanted = true; };
document.onkeydown = (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select") || event.key === " " && event.target.closest("button, summary")) return;
  if (event.key === "+" || event.key === "-") return lengthen(event.key === "+" ? -1 : 1);
  const id = { b: "bias", r: "record", t: "self-test", p: "pause", " ": state.playback ? "play" : "pause" }[event.key];
  if (!id || !$(id).offsetParent) return;
  event.preventDefault();
  $(id).click();
};
$("finger").onchange = () => { location.search = `?finger=${$("finger").value}`; };
addEventListener("resize", () => { strips.forEach((strip) => strip.resize()); spectrum.resize(); wanted = true; });
matchMedia("(prefers-color-scheme: dark)").onchange = () => {
  strips.forEach((strip) => strip.build());
  spectrum.build(spectrum.unit);
  raw.theme();
  wanted = true;
};
// Without messages the age still grows.
setInterval(() => { wanted = wanted || stale(); }, 250);

spectrum = new Spectrum($("spectrum"), $("peak"));
raw = new Raw($("raw"), $("raw-when"));
/** State for the tests and for scripts in the browser's console. */
window.taxel = state;
state.spectrumChart = spectrum;
state.paused = () => view.paused;
fetch("fingers").then((answer) => answer.json()).then((names) => {
  connect(choosable(names));
  requestAnimationFrame(draw);
});
