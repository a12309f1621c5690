// Spectrum of one channel, in decibels over a logarithmic frequency, with its peak named.
import { axes, paint, uPlot } from "./charts.js";
import { made, number, write } from "./store.js";

/** Decibels from the bottom of the axis to its top. */
const DEPTH = 100;
/** Step of the axis, and of its top if a line exceeds the usual one, in decibels. */
const RISE = 20;
/**
 * Amplitude of 0 dB: its name, its size in the channel's unit, and the usual top of the axis in decibels. The
 * tops are 1 N, 1 mm, 1 N·mm, full scale of a 16-bit code, full scale, and 1, so that noise at rest stays low.
 */
const REFERENCES = {
  N: ["1 mN", 1e-3, 60], mm: ["1 µm", 1e-3, 60], "N·mm": ["1 µN·m", 1e-3, 60],
  codes: ["1 code", 1, 100], "of full scale": ["full scale", 1, 0], "": ["1", 1, 0],
};
/** Lowest frequency of a peak, in hertz: slower changes are the load, not vibration. */
const SLOWEST = 2;
/** Decibels by which a peak stands out. The largest of a thousand lines of noise does by some 12. */
const PROMINENT = 18;
const TALL = 180;
/** Distance from the pointer within which the largest line is read, in pixels. */
const NEAR = 3;

/**
 * Largest line that stands out of its surroundings, half an octave to each side: frequency and amplitude; null
 * if there is none. The slope of a changing load is no peak.
 */
export function peak(step, lines) {
  const sums = [0];
  for (const line of lines) sums.push(sums.at(-1) + decibels(line));
  let best = null;
  for (let i = Math.max(8, Math.ceil(SLOWEST / step)); i < lines.length; i++) {
    // The window's own width, some lines, must not fill the surroundings.
    const reach = Math.max(8, .4 * i);
    const [from, to] = [Math.max(1, Math.floor(i - reach)), Math.min(lines.length, Math.ceil(i + reach))];
    const around = (sums[to] - sums[from]) / (to - from);
    if (decibels(lines[i]) - around > PROMINENT && !(lines[i] <= lines[best])) best = i;
  }
  return best === null ? null : { hz: best * step, amplitude: lines[best] };
}

const decibels = (amplitude) => 20 * Math.log10(Math.max(amplitude, 1e-9));

const signed = (value, digits) => value.toFixed(digits).replace("-", "−");
const hertz = (hz) => `${hz.toFixed(hz < 100 ? 1 : 0)} Hz`;

export class Spectrum {
  /** Chart in `holder`; `note` tells what has no place on it: progress, no peak, the line under the pointer. */
  constructor(holder, note) {
    Object.assign(this, { holder, note, label: made("div", "peak") });
    this.build("");
    this.show(false);
  }

  build(unit) {
    this.unit = unit;
    this.plot?.destroy();
    this.peak = null;
    [this.name, this.reference, this.top] = REFERENCES[unit] ?? REFERENCES[""];
    const stroke = paint("--z");
    const [frequency, value] = axes(`dB re ${this.name}`);
    Object.assign(value, { incrs: [RISE], space: 15 });
    frequency.values = (plot, splits) => splits.map((f) => (f === null ? "" : `${Number(f.toPrecision(3))} Hz`));
    this.plot = new uPlot({
      width: Math.max(240, this.holder.clientWidth || 600),
      height: TALL,
      series: [{}, { stroke, width: 1.25, points: { show: false } }],
      axes: [frequency, value],
      scales: {
        x: { time: false, distr: 3, range: (plot, low, high) => [1, high || 1000] },
        y: { range: (plot, low, high) => { const top = Math.max(this.top, Math.ceil((high ?? 0) / RISE) * RISE); return [top - DEPTH, top]; } },
      },
      cursor: { y: false, points: { show: false }, drag: { x: false, y: false } },
      legend: { show: false },
      hooks: { draw: [() => this.mark()], setCursor: [() => this.tell()] },
    }, [[], []], this.holder);
    this.plot.over.append(this.label);
  }

  /** Circles the peak and writes its frequency and amplitude beside it. */
  mark() {
    this.label.hidden = !this.peak;
    if (!this.peak) return;
    const { plot, peak, label } = this;
    const [x, y] = [plot.valToPos(peak.hz, "x", true), plot.valToPos(peak.db, "y", true)];
    plot.ctx.beginPath();
    plot.ctx.arc(x, y, 4 * devicePixelRatio, 0, 2 * Math.PI);
    plot.ctx.strokeStyle = paint("--ink");
    plot.ctx.lineWidth = 1.5 * devicePixelRatio;
    plot.ctx.stroke();
    write(label, `${hertz(peak.hz)} · ${Number(peak.amplitude.toPrecision(2))} ${this.unit}`.trim());
    const [left, top] = [plot.valToPos(peak.hz, "x"), plot.valToPos(peak.db, "y")];
    const room = left + 10 + label.offsetWidth < plot.over.clientWidth;
    label.style.left = `${room ? left + 10 : left - 10 - label.offsetWidth}px`;
    label.style.top = `${Math.max(0, top - label.offsetHeight / 2)}px`;
  }

  /** Largest line within some pixels of the pointer, because several share one pixel; else the nearest. */
  pointed(left) {
    const { plot } = this;
    const [frequencies, levels] = plot.data;
    const [from, to] = [left - NEAR, left + NEAR].map((at) => plot.posToVal(at, "x"));
    let best = plot.cursor.idx;
    frequencies.forEach((hz, i) => { if (hz >= from && hz <= to && !(levels[i] <= levels[best])) best = i; });
    return [frequencies[best], levels[best]];
  }

  /** Tells the line under the pointer, or else why no peak is marked. */
  tell() {
    const { left } = this.plot.cursor;
    const [hz, db] = left >= 0 ? this.pointed(left) : [];
    const pointed = number(hz) && number(db);
    const lines = this.plot.data[0].length;
    write(this.note, pointed ? `${hertz(hz)}: ${signed(db, 0)} dB re ${this.name}` : lines && !this.peak ? "no peak stands out" : "");
  }

  resize() {
    this.plot.setSize({ width: Math.max(240, this.holder.clientWidth), height: TALL });
  }

  /** Shows or hides the chart, because axes without a line carry no information. */
  show(yes) {
    if (this.holder.hidden !== yes) return;
    this.holder.hidden = !yes;
    if (yes) this.resize();
  }

  draw(step, lines) {
    const found = peak(step, lines);
    const level = (line) => decibels(line / this.reference);
    this.peak = found && { ...found, db: level(found.amplitude) };
    const from = Math.max(1, Math.ceil(1 / step));
    const shown = lines.slice(from);
    this.plot.setData([shown.map((_, i) => (from + i) * step), shown.map(level)]);
    this.tell();
  }
}
