// Strip charts of measured columns by uPlot: a moving window, pause, zoom and values under the pointer.
import { fixed, made, number, write } from "./store.js";

export const uPlot = window.uPlot;
const tall = () => (innerWidth > 832 ? 180 : 165);
const short = (values) => values.map((value) => String(Number(value.toPrecision(3))).replace("-", "−"));

/** Returns a style sheet's colour for the canvas, as computed for the present theme. */
export function paint(name) {
  const probe = document.createElement("span");
  probe.style.color = `var(${name})`;
  document.body.append(probe);
  const made = getComputedStyle(probe).color;
  probe.remove();
  return made;
}

export function axes(unit) {
  const common = { stroke: paint("--quiet"), grid: { stroke: paint("--line"), width: 1 }, ticks: { stroke: paint("--line"), width: 1 }, font: "12px system-ui, sans-serif" };
  return [{ ...common, size: 30 }, { ...common, size: 62, values: (plot, splits) => (plot.bare ? splits.map(() => "") : short(splits)), label: unit, labelSize: 18, labelFont: "12px system-ui, sans-serif" }];
}

/** Part of the ticks that all charts show. */
export const view = {
  /** Seconds up to the last row. */
  length: 20,
  /** Ticks of a pause; null while the charts move. */
  paused: null,
  /** Zoomed part of a pause, in seconds before its end. */
  zoom: null,
  /** Called when a chart is dragged over. */
  onzoom: () => {},
  onreset: () => {},
  /** Time under the pointer, in seconds before the end; null without a pointer. */
  at: null,
  /** Called when the pointer is over strips that are no chart. */
  onpoint: () => {},
  range() { return this.zoom ?? [-this.length, 0]; },
};

/** Index of the first time that is not before `from`. */
function since(times, from) {
  let [least, most] = [0, times.length];
  while (least < most) {
    const middle = (least + most) >> 1;
    if (times[middle] < from) least = middle + 1; else most = middle;
  }
  return least;
}

/**
 * Reduces ticks to one point per pixel, twice: minimum and maximum of its time span, the nearer to the last
 * point first. No peak is lost, and an edge is one line. A gap in the stream is a gap in the line.
 */
export function thinned(times, lows, highs, step, [from, to], gap) {
  const points = [[], ...lows.map(() => [])];
  const last = lows.map(() => null);
  let i = Math.max(0, since(times, from) - 1);
  const end = Math.min(times.length, since(times, to) + 1);
  while (i < end) {
    const its = Math.floor(times[i] / step);
    const first = i;
    do i++; while (i < end && Math.floor(times[i] / step) === its);
    if (first > 0 && times[first] - times[first - 1] > gap) {
      points[0].push(times[first]);
      for (let k = 0; k < lows.length; k++) { points[k + 1].push(null); last[k] = null; }
    }
    points[0].push(times[i - 1], times[i - 1]);
    for (let k = 0; k < lows.length; k++) {
      let [least, most] = [null, null];
      for (let j = first; j < i; j++) {
        const [low, high] = [lows[k][j], highs[k][j]];
        if (low === null) continue;
        if (least === null || low < least) least = low;
        if (most === null || high > most) most = high;
      }
      const near = last[k] === null || Math.abs(least - last[k]) <= Math.abs(most - last[k]);
      points[k + 1].push(near ? least : most, near ? most : least);
      last[k] = near ? most : least;
    }
  }
  return points;
}

/** Seconds without a tick that are a gap in the stream; ticks of the history may be 20 ms apart. */
export const gapOf = (step, rate) => Math.max(4 * step, 4 / (rate || 10), .05);

/** Colours of a chart's lines: components in order; a single line has that of the normal force. */
const COLOURS = ["--x", "--y", "--z"];
/** Line of a length, which lies under those of its components and is wide enough to show there. */
const LENGTH = { colour: "--length", width: 3.5 };

/** Strip chart of some columns over the last seconds. */
export class Strip {
  constructor(parent, title, unit, names, labels) {
    Object.assign(this, { names, unit });
    this.digits = unit === "mm" || unit === "N·mm" ? 2 : 3;
    const colours = COLOURS.slice(names.length === 1 ? 2 : 0);
    const component = () => ({ colour: colours.shift(), width: 1.25 });
    this.lines = names.map((name) => (name === "f_n" ? LENGTH : component()));
    const figure = made("div", "chart");
    const heading = made("h3", "", title);
    this.keys = names.map((name, i) => {
      const key = made("span", "key");
      const swatch = document.createElement("i");
      swatch.style.background = `var(${this.lines[i].colour})`;
      const value = made("b");
      key.append(swatch, labels[i], value);
      heading.append(key);
      return value;
    });
    this.when = made("span", "when");
    heading.append(this.when);
    figure.classList.toggle("many", names.length > 2);
    this.holder = document.createElement("div");
    figure.append(heading, this.holder);
    parent.append(figure);
    this.build();
  }

  build() {
    this.plot?.destroy();
    this.shown = undefined;
    const series = [{}, ...this.lines.map(({ colour, width }) => ({ stroke: paint(colour), width, points: { show: false } }))];
    const [time, value] = axes(this.unit);
    // Seconds before now, because the finger's own clock has no meaning for a reader.
    time.values = (plot, splits) => splits.map((t) => (t === 0 ? this.end ?? "now" : `${Number(t.toFixed(3))} s`.replace("-", "−")));
    this.plot = new uPlot({
      width: Math.max(240, this.holder.clientWidth || 600),
      height: tall(),
      series,
      axes: [time, value],
      scales: { x: { time: false, range: () => view.range() }, y: { range: span } },
      cursor: {
        y: false,
        sync: { key: "strips" },
        points: { show: false },
        drag: { x: true, y: false, setScale: false },
        bind: { dblclick: () => () => { view.onreset(); return null; } },
      },
      legend: { show: false },
      hooks: { setSelect: [(plot) => this.select(plot)], setCursor: [() => this.read(), (plot) => { view.at = plot.cursor.left >= 0 ? plot.posToVal(plot.cursor.left, "x") : null; }] },
    }, [[], ...this.names.map(() => [])], this.holder);
  }

  select(plot) {
    const { left, width } = plot.select;
    if (width < 5) return;
    const ends = [left, left + width].map((at) => plot.posToVal(at, "x"));
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    view.onzoom(ends);
  }

  resize() {
    this.shown = undefined;
    this.plot.setSize({ width: Math.max(240, this.holder.clientWidth), height: tall() });
  }

  /** Draws the chart if it has moved by a pixel or more, or if something else has changed. */
  draw(ticks, end, rate) {
    const { times, low, high } = ticks;
    const now = times.at(-1) ?? 0;
    const [from, to] = view.range();
    const step = (to - from) / this.plot.bbox.width;
    const shown = [from, to, end, Boolean(view.paused), step].join();
    if (shown === this.shown && Math.abs(now - this.now) < step) return;
    Object.assign(this, { shown, now, end });
    const of = (columns) => this.names.map((name) => columns[name] ?? []);
    const gap = gapOf(step, rate);
    const [ends, ...values] = thinned(times, of(low), of(high), step, [now + from, now + to], gap);
    this.plot.setData([ends.map((time) => time - now), ...values]);
    this.read();
  }

  /** Reads the values at the time under a pointer elsewhere. */
  point() {
    this.plot.setCursor({ left: view.at === null ? -10 : this.plot.valToPos(view.at, "x"), top: 0 }, false, false);
    this.read();
  }

  /** Shows the values under the pointer. */
  read() {
    const at = this.plot?.cursor.idx;
    const there = number(at) && this.plot.cursor.left >= 0;
    write(this.when, there ? `at ${this.plot.data[0][at]?.toFixed(3)} s`.replace("-", "−") : "");
    this.keys.forEach((key, k) => {
      if (!there) return write(key, "");
      // A point is two entries of the same time, minimum and maximum.
      const times = this.plot.data[0];
      const ends = [at - 1, at, at + 1].filter((i) => times[i] === times[at]).map((i) => this.plot.data[k + 1][i]).filter(number);
      if (!ends.length) return write(key, "–");
      const [least, most] = [Math.min(...ends), Math.max(...ends)].map((value) => fixed(value, this.digits));
      write(key, least === most ? least : `${least} … ${most}`);
    });
  }
}

/** Returns a padded range that includes zero. Without a value the axis has no numbers. */
function span(plot, low, high) {
  plot.bare = low === null || high === null || low === undefined;
  if (plot.bare) return [0, 1];
  const [least, most] = [Math.min(0, low), Math.max(0, high)];
  const pad = Math.max((most - least) * .08, .005);
  return [least === 0 ? (most > 0 ? -pad / 2 : -.05) : least - pad, most === 0 ? (least < 0 ? pad / 2 : .05) : most + pad];
}
