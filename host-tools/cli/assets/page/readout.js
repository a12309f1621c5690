// Numbers of the finger: force, shear and place large with their standard deviations, and the list of all values.
import { current } from "./status.js";
import { fixed, latest, made, number, write } from "./store.js";

const $ = (id) => document.getElementById(id);

/** Text of a standard deviation; a missing one has its reason. */
function deviation(sigmas, digits, unit) {
  if (sigmas.every(number)) return `± ${sigmas.map((sigma) => fixed(sigma, digits)).join(", ± ")} ${unit}`;
  const why = sigmas.find((sigma) => typeof sigma === "string");
  if (why === "no contact") return "no contact, so 0 without ±";
  return why === undefined ? "± needs the field “uncertainty”" : `± unknown: ${why}`;
}

/** Standard deviation of the length of a vector. */
export function lengthSigma(vector, sigmas) {
  if (!sigmas.every(number)) return sigmas.find((sigma) => !number(sigma));
  const length = Math.hypot(...vector);
  // A vector near zero has no known direction: the largest deviation is on the safe side.
  if (length < Math.max(...sigmas)) return Math.max(...sigmas);
  return Math.hypot(...vector.map((part, i) => part * sigmas[i])) / length;
}

function show(id, values, digits, unit, sigmas, more = "") {
  const cell = $(id);
  const given = values.every(number);
  const why = values.find((value) => typeof value === "string") ?? "not in the stream";
  write(cell.querySelector("output"), given ? values.map((value) => fixed(value, digits)).join(", ") : why);
  cell.classList.toggle("why", !given);
  write(cell.querySelector(".unit"), given ? unit : "");
  write(cell.querySelector(".sigma"), given ? deviation(sigmas, digits, unit) + more : "");
}

/** Shows force, shear and place. */
export function large(force, point) {
  const sigmas = ["fx", "fy", "fz"].map((name) => latest(`${name}_sigma_n`));
  const places = ["x", "y"].map((name) => latest(`${name}_sigma_mm`));
  const [x, y] = force;
  show("big-normal", [force[2]], 3, "N", [sigmas[2]]);
  const shear = number(x) && number(y) ? Math.hypot(x, y) : number(x) ? y : x;
  const sure = number(shear) && shear > .02;
  const towards = sure ? `, towards ${Math.round(Math.atan2(y, x) * 180 / Math.PI)}°`.replace("-", "−") : "";
  show("big-shear", [shear], 3, "N", [lengthSigma([x, y], sigmas.slice(0, 2))], towards);
  const all = force.every(number) ? Math.hypot(...force) : force.find((part) => !number(part));
  show("big-force", [all], 3, "N", [lengthSigma(force, sigmas)]);
  // Between two contacts lies a place that nothing touches.
  show("big-place", current().set.includes("not-single") ? ["not a single contact"] : point, 2, "mm", places);
}

/** Lists the finger's values; a missing value shows its reason. */
export function values(force, point) {
  const rows = [
    ["force x", force[0], "N", 3, "fx_sigma_n"], ["force y", force[1], "N", 3, "fy_sigma_n"], ["force z", force[2], "N", 3, "fz_sigma_n"],
    ["at x", point[0], "mm", 2, "x_sigma_mm"], ["at y", point[1], "mm", 2, "y_sigma_mm"],
    ["torsion", latest("torsion_nmm"), "N·mm", 2], ["slip margin", latest("slip_margin"), "", 2],
    ["friction", latest("friction"), "", 2], ["grip wanted", latest("grip_n"), "N", 2],
  ];
  // Two contacts are rare, so that reasons for a missing one are not shown.
  for (const i of [1, 2]) {
    const [x, y, fz] = ["x_mm", "y_mm", "fz_n"].map((end) => latest(`contact${i}_${end}`));
    if (number(fz)) rows.push([`contact ${i} x`, x, "mm", 2], [`contact ${i} y`, y, "mm", 2], [`contact ${i} force`, fz, "N", 2]);
  }
  const there = rows.filter(([, given]) => given !== null);
  const list = $("values");
  list.dataset.seq = latest("seq");
  while (list.children.length > 2 * there.length) list.lastChild.remove();
  there.forEach(([name, given, its, digits, sigma], i) => {
    const dt = list.children[2 * i] ?? list.appendChild(made("dt"));
    const dd = list.children[2 * i + 1] ?? list.appendChild(made("dd"));
    const deviates = latest(sigma);
    write(dt, name);
    write(dd, number(given) ? `${fixed(given, digits)}${number(deviates) ? ` ± ${fixed(deviates, digits)}` : ""} ${its}` : given);
    dd.className = number(given) ? "" : "why";
    dd.dataset.value = given;
  });
}
