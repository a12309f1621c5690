// Data of one finger as the server sends it: the latest row, and ticks of the last two minutes.

/** Longest time span of a chart, in seconds. */
export const LONGEST = 120;
export const number = (value) => typeof value === "number";

/** State of the page; tests and scripts in the browser's console read it too. */
export const state = {
  at: {}, facts: {}, ranged: [], times: [], low: {}, high: {}, latest: [], flagged: {}, drawn: [], draws: 0,
  /** Moment of the last message, and of the last row. */
  told: 0, heard: -Infinity,
};

/** Latest cell of a column: a number, a reason, or null. */
export const latest = (name) => state.latest[state.at[name]] ?? null;

/** Seconds since the last row; 0 for a playback. */
export const age = () => (state.playback || !state.times.length ? 0 : (performance.now() - state.heard) / 1000);

/** Whether rows should have come and have not: the numbers are old. */
export const stale = () => state.times.length > 0 && age() > Math.max(.5, 4 / (state.rate || 10));

const some = (pattern) => Object.keys(state.at).some((name) => pattern.test(name) && latest(name) !== null);
/** Whether the finger has a matrix of taxels, as far as the stream tells. */
export const hasMatrix = () => !("c_r0c0" in state.at) || some(/^(c_|lit_)r\dc\d$/);
/** Whether contact is judged: by the matrix's signals, which take a bias or a calibration. */
export const judgesContact = () => !("c_r0c0" in state.at) || some(/^c_r\dc\d$/);

/** Takes a message; returns whether the columns have changed. */
export function take(message) {
  const now = performance.now();
  if (message.restart) forget();
  const changed = message.columns && arrange(message.columns);
  Object.assign(state, message);
  state.told = now;
  if (number(message.age)) state.heard = now - 1000 * message.age;
  const { time, status, low, high } = message.ticks;
  for (let i = 0; i < time.length; i++) {
    state.times.push(time[i]);
    for (const [bit, name] of state.facts.flags ?? []) if (status[i] & bit) state.flagged[name] = time[i];
    state.ranged.forEach((name, k) => {
      state.low[name].push(low[i][k]);
      state.high[name].push(high[i][k]);
    });
  }
  drop();
  return changed;
}

/** Sets the columns of the following rows. Columns that remain keep their ticks. */
function arrange(columns) {
  const names = columns.map((column) => column.name);
  const same = names.join() === Object.keys(state.at).join();
  state.at = Object.fromEntries(names.map((name, i) => [name, i]));
  state.ranged = columns.filter((column) => column.ranged).map((column) => column.name);
  const [low, high] = [state.low, state.high];
  const none = () => state.times.map(() => null);
  state.low = Object.fromEntries(state.ranged.map((name) => [name, low[name] ?? none()]));
  state.high = Object.fromEntries(state.ranged.map((name) => [name, high[name] ?? none()]));
  return !same;
}

/** Forgets all ticks, after a seek or when the finger has restarted. */
function forget() {
  state.times = [];
  for (const name of state.ranged) [state.low[name], state.high[name]] = [[], []];
  state.flagged = {};
}

/** Drops ticks that no chart can show. */
function drop() {
  const before = (state.times.at(-1) ?? 0) - LONGEST - 1;
  let old = 0;
  while (old < state.times.length && state.times[old] < before) old++;
  if (old < 600) return;
  state.times.splice(0, old);
  for (const name of state.ranged) { state.low[name].splice(0, old); state.high[name].splice(0, old); }
}

/** Copy of the ticks, which stands still while charts are paused. */
export function frozen() {
  const copy = (columns) => Object.fromEntries(Object.entries(columns).map(([name, values]) => [name, values.slice()]));
  return { times: state.times.slice(), low: copy(state.low), high: copy(state.high) };
}

const UNITS = { n: "N", mm: "mm", nmm: "N·mm" };
/** Unit of a column, from its name. */
export const unit = (name) => UNITS[/_([a-z]+)$/.exec(name)?.[1]] ?? (/^(lit|dark|bridge|aux)_/.test(name) ? "codes" : /^(c_r|s\d_u)/.test(name) ? "of full scale" : "");

const WORDS = {
  fx_n: "force x", fy_n: "force y", fz_n: "force z", f_n: "force |F|", x_mm: "contact x", y_mm: "contact y", torsion_nmm: "torsion",
  slip_margin: "slip margin", grip_n: "grip wanted", aux_vref: "reference", aux_temp: "thermometer",
};
/** Name of a column in words. */
export function words(name) {
  if (name in WORDS) return WORDS[name];
  const parts = [
    [/^c_r(\d)c(\d)$/, "taxel row $1, column $2: signal"], [/^lit_r(\d)c(\d)$/, "taxel row $1, column $2: code"],
    [/^dark_c(\d)$/, "column $1 in the dark: code"], [/^bridge_s(\d)_(.)$/, "sensor $1, midpoint $2: code"],
    [/^s(\d)_f(.)_n$/, "sensor $1: force $2"], [/^s(\d)_u(.)$/, "sensor $1: signal $2"], [/^contact(\d)_(.)_mm$/, "contact $1: $2"],
    [/^contact(\d)_fz_n$/, "contact $1: force z"], [/^(.+)_sigma_(n|mm)$/, "± of $1"],
  ];
  const found = parts.find(([pattern]) => pattern.test(name));
  return found ? name.replace(...found) : name.replaceAll("_", " ");
}

/** Formats a number with so many decimals and a true minus sign; a rounded zero has no sign. */
export const fixed = (value, digits) => value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1").replace("-", "−");

/** Sets a text only if it changes, to avoid a new layout. */
export function write(made, text) {
  if (made.textContent !== text) made.textContent = text;
}

/** Makes an element with a class and a text. */
export function made(kind, className = "", textContent = "") {
  return Object.assign(document.createElement(kind), { className, textContent });
}
