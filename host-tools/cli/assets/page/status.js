// Status in words: one verdict that is true now, the flags set now, and flags that have just ended.
import { FLAGS } from "./flags.js";
import { age, hasMatrix, judgesContact, latest, made, number, stale, state, write } from "./store.js";

const $ = (id) => document.getElementById(id);
/** Seconds that an ended flag stays visible. */
const LINGER = 4;
/** Flags that are true of a contact only, and their words once it has ended. */
const OF_CONTACT = { "slip-warning": "It was about to slip", slides: "It slid", "not-single": "It was not a single contact" };
/** Flags that the verdict tells, worst first. */
const VERDICTS = ["slides", "slip-warning", "contact"];

/** Age in words: "3 s", "2 min". */
export const ago = (seconds) => (seconds < 1 ? `${seconds.toFixed(1)} s` : seconds < 120 ? `${Math.floor(seconds)} s` : `${Math.floor(seconds / 60)} min`);

/** Flags set now, and those that ended within the last seconds. Without contact none of a contact is set. */
export function current() {
  const bits = latest("status") ?? 0;
  const now = state.times.at(-1) ?? 0;
  const all = (state.facts.flags ?? []).map(([bit, name]) => ({ name, set: (bits & bit) !== 0, past: now - (state.flagged[name] ?? -Infinity) }));
  const touches = all.some(({ name, set }) => name === "contact" && set);
  const flags = all.filter(({ name }) => !name.startsWith("ran-"));
  const set = flags.filter(({ name, set }) => set && (touches || !(name in OF_CONTACT)));
  const ended = flags.filter((flag) => flag.name !== "contact" && !set.includes(flag) && flag.past < LINGER);
  const ran = all.filter(({ name, set }) => set && name.startsWith("ran-")).map(({ name }) => name.slice(4));
  return { set: set.map(({ name }) => name), ended, ran };
}

/** Verdict: kind, words, and remedy. */
function verdict(set) {
  if (!("status" in state.at) || !number(latest("status"))) return ["", "No word from the finger", ""];
  if (stale()) return ["", "No word from the finger", `The numbers are ${ago(age())} old.`];
  const broken = set.some((name) => name !== "slides" && FLAGS[name]?.[0] === "bad");
  const fault = broken ? "There is a fault: see the flags." : "";
  const worst = VERDICTS.find((name) => set.includes(name));
  if (!worst && !judgesContact() && set.includes("uncalibrated")) {
    return ["warn", "Contact is not known", hasMatrix() ? "Take a bias while nothing touches, or upload a calibration." : "Without a matrix it takes a calibration of the force sensors."];
  }
  if (!worst) return [broken ? "warn" : "", "Nothing touches the finger", fault];
  const grip = latest("grip_n");
  const [kind, words, todo] = FLAGS[worst] ?? ["warn", worst, ""];
  if (worst === "contact" && broken) return ["warn", words, fault];
  return [kind, words, todo.replace("grip_n", number(grip) ? `${grip.toFixed(2)} N` : "grip_n")];
}

/** Shows verdict and flags. */
export function status() {
  const { set, ended, ran } = current();
  const [kind, words, todo] = verdict(set);
  const panel = $("verdict");
  if (panel.className !== kind) panel.className = kind;
  write(panel.firstElementChild, words);
  write(panel.lastElementChild, todo);
  const rest = stale() ? [] : set.filter((name) => !VERDICTS.includes(name));
  const past = stale() ? [] : ended;
  const key = [kind, rest, ended.map(({ name, past }) => name + Math.floor(past * 2)), ran, stale()].join("|");
  if (key === state.flagKey) return;
  state.flagKey = key;
  const items = rest.map((name) => item(...(FLAGS[name] ?? ["warn", name, ""])));
  // An ended flag is told in the past tense and has no remedy.
  items.push(...past.map(({ name, past }) => {
    const [kind, words] = FLAGS[name] ?? ["warn", name];
    return item(`${kind} past`, `${OF_CONTACT[name] ?? `Has ended: ${words.replace(/:.*/, "")}`}, ${ago(past)} ago`, "");
  }));
  if (!items.length) items.push(item("", stale() ? "Unknown" : kind === "warn" || kind === "bad" ? "No other warning" : "No fault, no warning", ""));
  if (ran.length && !stale()) items.push(item("ran", "", `Estimators that ran: ${ran.join(", ")}`));
  $("flags").replaceChildren(...items);
}

function item(kind, words, todo) {
  const line = made("li", kind);
  if (words) line.append(made("strong", "", words));
  if (todo) line.append(made("span", "", todo));
  return line;
}
