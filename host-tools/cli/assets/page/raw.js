// Raw codes of every channel as small strips in the taxels' places: the first light of a new finger.
import { gapOf, paint, thinned, view } from "./charts.js";
import { made, number, write } from "./store.js";

/** Smallest height of a strip as a share of full scale, so that noise looks small. */
const LEAST = .01;
/** Change that counts as a response, as a share of full scale. */
const MOVED = .005;
/** Shortest drag that zooms, in pixels. */
const DRAG = 5;

/** Groups of channels: title, and names row by row; the taxels lie as on the picture of the finger. */
function groups(names, taxels) {
  const xs = [...new Set(taxels.map(([x]) => x))].sort((a, b) => a - b);
  const ys = [...new Set(taxels.map(([, y]) => y))].sort((a, b) => b - a);
  const grid = [];
  taxels.forEach(([x, y], k) => { grid[ys.indexOf(y) * xs.length + xs.indexOf(x)] = `lit_r${k >> 2}c${k & 3}`; });
  const made = [["Taxels, lit", grid], ["Columns, dark", [0, 1, 2, 3].map((c) => `dark_c${c}`)]];
  for (let s = 0; s < 4; s++) made.push([`Force sensor ${s}, midpoints`, [..."abcd"].map((m) => `bridge_s${s}_${m}`)]);
  return made.map(([title, all]) => [title, all.filter((name) => names.includes(name))]).filter(([, all]) => all.length);
}

export class Raw {
  /** Strips in `holder`; the time under the pointer is told in `when`. */
  constructor(holder, when) {
    Object.assign(this, { holder, when, cells: [], from: null });
    const point = (at) => { view.at = at; view.onpoint(); };
    const time = ({ target, offsetX }) => {
      const [from, to] = view.range();
      return target.tagName === "CANVAS" ? from + offsetX / target.clientWidth * (to - from) : null;
    };
    holder.onpointermove = (event) => point(time(event));
    holder.onpointerleave = () => { this.from = null; point(null); };
    holder.onpointerdown = (event) => { this.from = time(event) === null ? null : { at: time(event), x: event.clientX }; };
    holder.onpointerup = (event) => {
      const [begun, to] = [this.from, time(event)];
      this.from = null;
      if (begun && to !== null && Math.abs(event.clientX - begun.x) >= DRAG) view.onzoom([begun.at, to].sort((a, b) => a - b));
    };
    holder.ondblclick = () => view.onreset();
  }

  /** Makes a strip for each code in the stream. */
  build(names, taxels, full) {
    this.full = full || 65535;
    this.cells = [];
    this.holder.replaceChildren(...groups(names, taxels ?? []).map(([title, all]) => {
      const group = made("div", "group");
      const grid = made("div", "grid");
      group.append(made("h3", "", title), grid);
      for (const name of all) {
        const cell = made("figure", "cell");
        const canvas = document.createElement("canvas");
        const [label, value] = [made("span", "quiet", name.replace(/^(lit|dark|bridge_s\d)_/, "")), made("b")];
        const caption = made("figcaption");
        caption.append(label, value);
        cell.append(caption, canvas);
        cell.dataset.name = name;
        grid.append(cell);
        this.cells.push({ name, cell, canvas, value });
      }
      return group;
    }));
    this.theme();
  }

  theme() {
    [this.stroke, this.ink] = [paint("--z"), paint("--quiet")];
  }

  /** Draws the charts' window of all strips, with the latest codes or those under the pointer. */
  draw(ticks, latest, rate) {
    const at = view.at === null ? "" : `at ${view.at.toFixed(3)} s`.replace("-", "−");
    write(this.when, at);
    for (const { name, cell, canvas, value } of this.cells) {
      // A channel that the finger lacks has no code.
      const code = latest(name);
      if (cell.hidden !== !number(code)) cell.hidden = !number(code);
      if (!number(code)) continue;
      const { ends, pointed } = this.strip(canvas, ticks.times, ticks.low[name] ?? [], ticks.high[name] ?? [], rate);
      write(value, at ? [...new Set(pointed)].join(" … ") || "–" : String(code));
      cell.classList.toggle("moved", ends[1] - ends[0] > MOVED * this.full);
    }
    for (const group of this.holder.children) group.hidden = [...group.querySelectorAll(".cell")].every((cell) => cell.hidden);
  }

  /** Draws one strip; returns its lowest and highest code, and those under the pointer. */
  strip(canvas, times, low, high, rate) {
    const scale = devicePixelRatio;
    const [wide, tall] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (canvas.width !== wide || canvas.height !== tall) Object.assign(canvas, { width: wide, height: tall });
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, wide, tall);
    const [from, to] = view.range();
    const step = (to - from) / Math.max(1, wide);
    const now = times.at(-1) ?? 0;
    const [moments, codes] = thinned(times, [low], [high], step, [now + from, now + to], gapOf(step, rate));
    const within = codes.filter((code, i) => code !== null && moments[i] >= now + from && moments[i] <= now + to);
    if (!within.length) return { ends: [0, 0], pointed: [] };
    const ends = [within.reduce((a, b) => Math.min(a, b)), within.reduce((a, b) => Math.max(a, b))];
    const span = Math.max(ends[1] - ends[0], LEAST * this.full);
    const floor = (ends[1] + ends[0] - span) / 2;
    const x = (time) => (time - now - from) / step;
    pen.strokeStyle = this.stroke;
    pen.lineWidth = scale;
    pen.beginPath();
    codes.forEach((code, i) => {
      const y = tall - 1 - (code - floor) / span * (tall - 2);
      if (code === null) return;
      if (i > 0 && codes[i - 1] !== null) pen.lineTo(x(moments[i]), y); else pen.moveTo(x(moments[i]), y);
    });
    pen.stroke();
    return { ends, pointed: view.at === null ? [] : this.point(pen, moments, codes, now + view.at, step, x) };
  }

  /** Marks the time under the pointer; returns the lowest and highest code of its pixel. */
  point(pen, moments, codes, time, step, x) {
    pen.fillStyle = this.ink;
    pen.fillRect(Math.round(x(time)), 0, devicePixelRatio, pen.canvas.height);
    const near = codes.filter((code, i) => code !== null && Math.abs(moments[i] - time) <= step);
    return near.length ? [near.reduce((a, b) => Math.min(a, b)), near.reduce((a, b) => Math.max(a, b))] : [];
  }
}
