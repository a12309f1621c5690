// Controls of the finger and of a playback: buttons, settings, fields, recording.
import { age, made, number, stale, state, write } from "./store.js";

const $ = (id) => document.getElementById(id);
/** Silence after which a finger counts as gone without a message, in seconds: a short stall disables nothing. */
const GONE = 2;
let ask, dragging = false, unreachable = "";

/** Shows the outcome of an order. */
export function say({ done, failed }) {
  const text = done ?? failed;
  if (!text && $("said").textContent !== "…") return;
  $("said").textContent = text;
  $("said").className = failed === undefined ? "" : "failed";
}

function command(id, order, more) {
  $(id).onclick = () => { say({ done: "…" }); ask(order, more?.()); };
}

/** Connects the controls with the function that sends an order. */
export function connectControls(send) {
  ask = send;
  command("bias", "bias");
  command("clear-bias", "clear-bias");
  command("self-test", "self-test");
  command("record", "record", () => ({ on: !state.recording }));
  command("play", "play", () => ({ on: !state.playback?.runs }));
  $("filter").onchange = () => ask("filter", { hz: Number($("filter").value) });
  $("method").onchange = () => ask("method", { name: $("method").value });
  $("rate-form").onsubmit = (event) => {
    event.preventDefault();
    ask("rate", { hz: Math.round(Number($("rate-input").value)) });
  };
  $("scrubber").oninput = () => { dragging = true; };
  $("scrubber").onchange = () => { dragging = false; ask("seek", { to: Number($("scrubber").value) }); };
}

/** Shows the finger's settings. */
export function settings(facts) {
  const { live } = facts;
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

/** Disables what a finger must answer while it is gone, and says why; does nothing without a change. */
export function reachable() {
  const trouble = $("trouble").textContent;
  const gone = stale() && (trouble || age() > GONE);
  const why = gone ? `The finger does not answer: ${trouble || "no frame comes"}` : "";
  if (why === unreachable) return;
  unreachable = why;
  for (const control of $("live-controls").querySelectorAll("button, input, select")) {
    control.dataset.title ??= control.title;
    control.disabled = Boolean(why);
    control.title = why || control.dataset.title;
  }
}

/** Formats a count of bytes. */
function size(bytes) {
  return bytes < 1e6 ? `${(bytes / 1e3).toFixed(0)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}

/** Shows the recording in progress and the place of a playback. */
export function progress() {
  const { recording, playback } = state;
  $("record").setAttribute("aria-pressed", Boolean(recording));
  write($("record"), recording ? "End recording" : "Record");
  $("recording").hidden = !recording;
  if (recording) {
    const { seconds, rows, bytes, name } = recording;
    write($("recording"), `${seconds.toFixed(1)} s · ${rows.toLocaleString("en")} rows · ${size(bytes)} · with codes · ${name}`);
  }
  $("playback").hidden = !playback;
  if (!playback) return;
  $("no-controls").hidden = true;
  const { at, of, runs } = playback;
  write($("play"), runs ? "Pause" : "Play");
  $("scrubber").max = of ?? Math.max(1, at);
  if (!dragging) $("scrubber").value = at;
  write($("place"), `${at.toFixed(1)} s${number(of) ? ` of ${of.toFixed(1)} s` : ""}`);
}

/** Shows why there is no stream, or another notice; null hides it. */
export function trouble(text) {
  if ($("trouble").textContent === (text ?? "")) return;
  $("trouble").textContent = text ?? "";
  $("trouble").hidden = !text;
}

/** Fills a list with options; keeps the choice if it is still there. */
export function choices(list, options, otherwise) {
  const chosen = list.value;
  list.replaceChildren(...options.map(([name, text]) => Object.assign(made("option"), { value: name, textContent: text })));
  const values = options.map(([name]) => name);
  list.value = values.includes(chosen) ? chosen : values.includes(otherwise) ? otherwise : values[0] ?? "";
}
