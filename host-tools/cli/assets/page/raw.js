// Raw codes of every channel as small strips in the taxels' places: the first light of a new finger.
import { paint } from "./charts.js";
import { made, number, write } from "./store.js";

/** Time span of a strip, in seconds. */
const SPAN = 10;
/** Smallest height of a strip as a share of full scale, so that noise looks small. */
const LEAST = .01;
/** Change that counts as a response, as a share of full scale. */
const MOVED = .005;

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
  constructor(holder) {
    this.holder = holder;
    this.cells = [];
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
    this.stroke = paint("--z");
  }

  /** Draws all strips from the ticks, and the latest codes. */
  draw({ times, low, high }, latest) {
    const end = times.at(-1) ?? 0;
    let from = times.length;
    while (from > 0 && times[from - 1] > end - SPAN) from--;
    for (const { name, cell, canvas, value } of this.cells) {
      // A channel that the finger lacks has no code.
      const code = latest(name);
      if (cell.hidden !== !number(code)) cell.hidden = !number(code);
      if (!number(code)) continue;
      write(value, String(code));
      const [least, most] = this.strip(canvas, times, low[name], high[name], from, end);
      cell.classList.toggle("moved", most - least > MOVED * this.full);
    }
    for (const group of this.holder.children) group.hidden = [...group.querySelectorAll(".cell")].every((cell) => cell.hidden);
  }

  strip(canvas, times, low, high, from, end) {
    const scale = devicePixelRatio;
    const [wide, tall] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (canvas.width !== wide || canvas.height !== tall) Object.assign(canvas, { width: wide, height: tall });
    let [least, most] = [Infinity, -Infinity];
    for (let i = from; i < times.length; i++) {
      if (low[i] !== null && low[i] < least) least = low[i];
      if (high[i] !== null && high[i] > most) most = high[i];
    }
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, wide, tall);
    if (most < least) return [0, 0];
    const span = Math.max(most - least, LEAST * this.full);
    const floor = (most + least - span) / 2;
    const y = (code) => tall - 1 - (code - floor) / span * (tall - 2);
    pen.strokeStyle = this.stroke;
    pen.lineWidth = scale;
    pen.beginPath();
    for (let i = from; i < times.length; i++) {
      if (low[i] === null) continue;
      const x = (1 - (end - times[i]) / SPAN) * wide;
      pen.lineTo(x, y(low[i]));
      pen.lineTo(x, y(high[i]));
    }
    pen.stroke();
    return [least, most];
  }
}
