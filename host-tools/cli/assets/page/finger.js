// Drawings of the finger: taxels in place, contact point, force, and the force sensors.
const SVG = "http://www.w3.org/2000/svg";

function element(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent?.append(made);
  return made;
}

/** Sets only attributes that change, to avoid redrawing. */
function set(made, attributes) {
  for (const [key, value] of Object.entries(attributes)) {
    if (made.getAttribute(key) !== String(value)) made.setAttribute(key, value);
  }
}

const shown = (made, yes) => set(made, { visibility: yes ? "visible" : "hidden" });
/** Rounds a length to 0.01, which is finer than a pixel. */
const short = (value) => Math.round(value * 100) / 100;
const number = (value) => typeof value === "number";

/** Length of the arrow of 1 N of shear, in millimetres. */
const MM_PER_N = 2;
/** Lowest signal with full colour, as a share of full scale; below it is only noise. */
const LEAST = 0.02;

function cross(parent) {
  const made = element("g", { class: "point" }, parent);
  for (const kind of ["under", "over"]) {
    element("circle", { class: kind, r: .45 }, made);
    element("path", { class: kind, d: "M-.8 0H.8M0 -.8V.8" }, made);
  }
  return made;
}

export class Finger {
  constructor(svg, centres) {
    svg.replaceChildren();
    const far = Math.max(...centres.flat().map(Math.abs)) + 1.9;
    svg.setAttribute("viewBox", `${-far} ${-far} ${2 * far} ${2 * far}`);
    element("rect", { class: "edge", x: -far + .1, y: -far + .1, width: 2 * far - .2, height: 2 * far - .2, rx: 1.2 }, svg);
    this.taxels = centres.map(([x, y]) => {
      const cell = element("rect", { class: "taxel", x: x - 1.05, y: -y - 1.05, width: 2.1, height: 2.1, rx: .25, fill: "transparent" }, svg);
      element("title", {}, cell);
      return cell;
    });
    element("line", { x1: -far + .6, y1: far - .55, x2: -far + 2.6, y2: far - .55, stroke: "var(--quiet)", "stroke-width": .1 }, svg);
    element("text", { x: -far + 2.8, y: far - .4 }, svg).textContent = "2 mm";
    element("text", { x: far - .6, y: far - .4, "text-anchor": "end" }, svg).textContent = `arrow: 1 N = ${MM_PER_N} mm`;
    this.press = element("circle", { class: "press" }, svg);
    // Arrows over the taxels' colours get an edge in the background's colour.
    this.arrows = ["under", "over"].map((kind) => element("line", { class: `arrow ${kind}` }, svg));
    this.head = element("polygon", { class: "head", points: "0,-.35 .8,0 0,.35" }, svg);
    this.point = cross(svg);
    this.contacts = [cross(svg), cross(svg)];
  }

  /**
   * `signals` may be absent; `point`, `force` and `contacts` are numbers or reasons. Two contacts replace
   * the single point, which lies between them.
   */
  draw({ signals, saturated, dead, point, force, contacts }) {
    // The strongest recent signal has the full colour.
    const faults = saturated | dead;
    const sound = (signals ?? []).filter((signal, k) => number(signal) && !(faults >> k & 1));
    const strongest = Math.max(...sound.map(Math.abs), LEAST);
    this.full = Math.max(strongest, (this.full ?? 0) * .99);
    this.taxels.forEach((cell, k) => {
      const signal = signals?.[k];
      const fault = faults >> k & 1;
      const share = number(signal) && !fault ? Math.min(1, Math.abs(signal) / this.full) : 0;
      const percent = Math.round(share * 100);
      set(cell, {
        class: fault ? "taxel fault" : "taxel",
        fill: percent > 0 ? `color-mix(in oklab, var(--${signal < 0 ? "near" : "away"}) ${percent}%, transparent)` : "transparent",
      });
      // Only a hovered taxel shows its tooltip, so that others need no update.
      if (cell.matches(":hover")) cell.firstChild.textContent = `row ${k >> 2}, column ${k & 3}: ${number(signal) ? signal.toFixed(4) : "–"}${fault ? saturated >> k & 1 ? ", clipped" : ", dead" : ""}`;
    });
    const two = contacts.flat().every(number);
    this.contacts.forEach((made, i) => {
      shown(made, two);
      if (two) set(made, { transform: `translate(${short(contacts[i][0])} ${short(-contacts[i][1])})` });
    });
    const there = point.every(number);
    const [x, y] = there ? [short(point[0]), short(-point[1])] : [0, 0];
    shown(this.point, there && !two);
    set(this.point, { transform: `translate(${x} ${y})` });
    const [fx, fy, fz] = force.map((f) => (number(f) ? f : 0));
    shown(this.press, there && fz > 0);
    set(this.press, { cx: x, cy: y, r: short(Math.sqrt(Math.max(0, fz)) * .9) });
    const [dx, dy] = [short(fx * MM_PER_N), short(-fy * MM_PER_N)];
    const sheared = there && Math.hypot(dx, dy) > .15;
    shown(this.head, sheared);
    for (const arrow of this.arrows) {
      shown(arrow, sheared);
      set(arrow, { x1: x, y1: y, x2: x + dx, y2: y + dy });
    }
    const turn = short(Math.atan2(dy, dx) * 180 / Math.PI);
    set(this.head, { transform: `translate(${x + dx} ${y + dy}) rotate(${turn})` });
  }
}

/** Drawing of one force sensor: shear as an arrow, normal force as a disc. */
export class Sensor {
  constructor(parent, name) {
    const figure = document.createElement("figure");
    const svg = element("svg", { viewBox: "-1 -1 2 2", role: "img", "aria-label": `force on sensor ${name}` });
    element("circle", { class: "ring", r: .9 }, svg);
    this.press = element("circle", { class: "press", r: 0 }, svg);
    this.arrow = element("line", { class: "arrow", x1: 0, y1: 0 }, svg);
    this.head = element("polygon", { class: "head", points: "-.1,-.16 .12,0 -.1,.16" }, svg);
    this.text = document.createElement("figcaption");
    this.name = name;
    figure.append(svg, this.text);
    parent.append(figure);
  }

  draw(force) {
    const given = force.every(number);
    const [x, y, z] = given ? force : [0, 0, 0];
    // The ring is 1 N.
    const long = Math.max(1, Math.hypot(x, y));
    const [dx, dy] = [short(x / long * .9), short(-y / long * .9)];
    const sheared = Math.hypot(dx, dy) > .05;
    shown(this.arrow, sheared);
    shown(this.head, sheared);
    set(this.arrow, { x2: dx, y2: dy });
    set(this.head, { transform: `translate(${dx} ${dy}) rotate(${short(Math.atan2(dy, dx) * 180 / Math.PI)})` });
    set(this.press, { r: short(Math.min(.9, Math.sqrt(Math.max(0, z)) * .9)) });
    const why = force.find((f) => typeof f === "string");
    const text = `${this.name}: ${given ? `${z.toFixed(2).replace("-0.00", "0.00").replace("-", "−")} N` : why ?? "–"}`;
    if (this.text.textContent !== text) this.text.textContent = text;
  }
}
