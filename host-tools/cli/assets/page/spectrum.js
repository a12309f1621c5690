// Spectrum of one channel, in decibels over a logarithmic frequency, with its peak named.
import { axes, paint, uPlot } from "./charts.js";

/** Decibels shown below the largest line. */
const DEPTH = 100;
/** Lowest frequency of a peak, in hertz: slower changes are the load, not vibration. */
const SLOWEST = 2;
/** Decibels by which a peak stands out. The largest of a thousand lines of noise does by some 12. */
const PROMINENT = 18;
const TALL = 180;

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

export class Spectrum {
  constructor(holder, label) {
    this.holder = holder;
    this.label = label;
    this.build("");
    this.show(false);
  }

  build(unit) {
    this.unit = unit;
    this.plot?.destroy();
    const stroke = paint("--z");
    const [hertz, value] = axes(`dB of 1 ${unit.replace("codes", "code") || "unit"}`);
    hertz.values = (plot, splits) => splits.map((f) => (f === null ? "" : `${Number(f.toPrecision(3))} Hz`));
    const mark = (plot) => {
      if (!this.peak) return;
      const [x, y] = [plot.valToPos(this.peak.hz, "x", true), plot.valToPos(this.peak.db, "y", true)];
      plot.ctx.beginPath();
      plot.ctx.arc(x, y, 4 * devicePixelRatio, 0, 2 * Math.PI);
      plot.ctx.strokeStyle = paint("--ink");
      plot.ctx.lineWidth = 1.5 * devicePixelRatio;
      plot.ctx.stroke();
    };
    this.plot = new uPlot({
      width: Math.max(240, this.holder.clientWidth || 600),
      height: TALL,
      series: [{}, { stroke, width: 1.25, points: { show: false } }],
      axes: [hertz, value],
      scales: {
        x: { time: false, distr: 3, range: (plot, low, high) => [1, high || 1000] },
        y: { range: (plot, low, high) => { const top = Math.ceil(((high ?? 0) + 5) / 10) * 10; return [top - DEPTH, top]; } },
      },
      cursor: { show: false },
      legend: { show: false },
      hooks: { draw: [mark] },
    }, [[], []], this.holder);
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
    this.peak = found && { hz: found.hz, db: decibels(found.amplitude) };
    this.label.textContent = found
      ? `peak ${found.hz.toFixed(found.hz < 100 ? 1 : 0)} Hz: ${Number(found.amplitude.toPrecision(2))} ${this.unit} (${decibels(found.amplitude).toFixed(0).replace("-", "−")} dB)`
      : "no peak stands out";
    const from = Math.max(1, Math.ceil(1 / step));
    const shown = lines.slice(from);
    this.plot.setData([shown.map((_, i) => (from + i) * step), shown.map(decibels)]);
  }
}
