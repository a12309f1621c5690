// The finger from outside: taxels where they are, contact point, force; and the force sensors.
const SVG = "http://www.w3.org/2000/svg";

function element(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent?.append(made);
  return made;
}

function set(made, attributes) {
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
}

const shown = (made, yes) => made.setAttribute("visibility", yes ? "visible" : "hidden");
const number = (value) => typeof value === "number";

/** Millimetres that a newton of shear is long. */
const MM_PER_N = 2;
/** The least signal that fills a taxel's colour: below it there is only noise. */
const LEAST = 0.02;

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
    this.arrow = element("line", { class: "arrow" }, svg);
    this.head = element("polygon", { class: "head", points: "0,-.35 .8,0 0,.35" }, svg);
    this.point = element("g", { class: "point" }, svg);
    element("circle", { r: .45 }, this.point);
    element("path", { d: "M-.8 0H.8M0 -.8V.8" }, this.point);
  }

  /** `signals` may be absent; `point` and `force` are numbers or reasons. */
  draw({ signals, saturated, dead, point, force }) {
    // The strongest signal of late has the full colour.
    const strongest = Math.max(...(signals ?? []).filter(number).map(Math.abs), LEAST);
    this.full = Math.max(strongest, (this.full ?? 0) * .99);
    this.taxels.forEach((cell, k) => {
      const signal = signals?.[k];
      const share = number(signal) ? Math.min(1, Math.abs(signal) / this.full) : 0;
      cell.setAttribute("fill", share > 0 ? `color-mix(in oklab, var(--${signal < 0 ? "near" : "away"}) ${Math.round(share * 100)}%, transparent)` : "transparent");
      const fault = (saturated >> k | dead >> k) & 1;
      cell.classList.toggle("fault", Boolean(fault));
      cell.firstChild.textContent = `row ${k >> 2}, column ${k & 3}: ${number(signal) ? signal.toFixed(4) : "–"}${fault ? saturated >> k & 1 ? ", clipped" : ", dead" : ""}`;
    });
    const there = point.every(number);
    const [x, y] = there ? [point[0], -point[1]] : [0, 0];
    shown(this.point, there);
    this.point.setAttribute("transform", `translate(${x} ${y})`);
    const [fx, fy, fz] = force.map((f) => (number(f) ? f : 0));
    shown(this.press, there && fz > 0);
    set(this.press, { cx: x, cy: y, r: Math.sqrt(Math.max(0, fz)) * .9 });
    const [dx, dy] = [fx * MM_PER_N, -fy * MM_PER_N];
    const sheared = there && Math.hypot(dx, dy) > .15;
    shown(this.arrow, sheared);
    shown(this.head, sheared);
    set(this.arrow, { x1: x, y1: y, x2: x + dx, y2: y + dy });
    const turn = Math.atan2(dy, dx) * 180 / Math.PI;
    this.head.setAttribute("transform", `translate(${x + dx} ${y + dy}) rotate(${turn})`);
  }
}

/** One force sensor: shear as an arrow, normal force as a disc. */
export class Sensor {
  constructor(parent, name) {
    const figure = document.createElement("figure");
    const svg = element("svg", { viewBox: "-1 -1 2 2", role: "img", "aria-label": `force on sensor ${name}` });
    element("circle", { class: "ring", r: .9 }, svg);
    this.press = element("circle", { class: "press", r: 0 }, svg);
    this.arrow = element("line", { class: "arrow", x1: 0, y1: 0 }, svg);
    this.text = document.createElement("figcaption");
    this.name = name;
    figure.append(svg, this.text);
    parent.append(figure);
  }

  draw(force) {
    const given = force.every(number);
    const [x, y, z] = given ? force : [0, 0, 0];
    // A newton is the ring.
    const long = Math.max(1, Math.hypot(x, y));
    set(this.arrow, { x2: x / long * .9, y2: -y / long * .9 });
    this.press.setAttribute("r", Math.min(.9, Math.sqrt(Math.max(0, z)) * .9));
    const why = force.find((f) => typeof f === "string");
    this.text.textContent = `${this.name}: ${given ? `${z.toFixed(2)} N` : why ?? "–"}`;
  }
}
