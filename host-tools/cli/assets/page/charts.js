// Strip charts of measured columns and the spectrum of a channel, by uPlot.
const uPlot = window.uPlot;
/** Time span of a strip chart, in seconds. */
const WINDOW = 20;
const tall = () => (innerWidth > 832 ? 190 : 165);
const short = (values) => values.map((value) => String(Number(value.toPrecision(3))));

/** Returns a style sheet's colour for the canvas, as computed for the present theme. */
function paint(name) {
  const probe = document.createElement("span");
  probe.style.color = `var(${name})`;
  document.body.append(probe);
  const made = getComputedStyle(probe).color;
  probe.remove();
  return made;
}

function faded(rgb) {
  return rgb.replace(/^rgb\(/, "rgba(").replace(/\)$/, ", .25)");
}

function axes(unit) {
  const common = { stroke: paint("--quiet"), grid: { stroke: paint("--line"), width: 1 }, ticks: { stroke: paint("--line"), width: 1 }, font: "12px system-ui, sans-serif" };
  return [{ ...common }, { ...common, size: 62, values: (plot, splits) => (plot.bare ? splits.map(() => "") : short(splits)), label: unit, labelSize: 18, labelFont: "12px system-ui, sans-serif" }];
}

/** Reduces ticks to one point per pixel, with minimum and maximum of its time span, so that no peak is lost. */
function thinned(times, lows, highs, step) {
  const points = [[], ...lows.flatMap(() => [[], []])];
  let stretch;
  times.forEach((time, i) => {
    const its = Math.floor(time / step);
    const fresh = its !== stretch;
    stretch = its;
    const at = fresh ? points[0].push(0) - 1 : points[0].length - 1;
    points[0][at] = time;
    lows.forEach((low, k) => {
      const [least, most] = [points[2 * k + 1], points[2 * k + 2]];
      const [was, is] = [fresh ? null : least[at], low[i]];
      least[at] = was === null ? is : is === null ? was : Math.min(was, is);
      const [had, has] = [fresh ? null : most[at], highs[k][i]];
      most[at] = had === null ? has : has === null ? had : Math.max(had, has);
    });
  });
  return points;
}

/** Strip chart of some columns over the last seconds, as bands from minimum to maximum. */
export class Strip {
  constructor(parent, title, unit, names, labels) {
    this.names = names;
    const figure = document.createElement("div");
    figure.className = "chart";
    const heading = document.createElement("h3");
    heading.append(title);
    const colours = ["--x", "--y", "--z"].slice(names.length === 1 ? 2 : 0);
    names.forEach((name, i) => {
      const key = document.createElement("span");
      key.className = "key";
      const swatch = document.createElement("i");
      swatch.style.background = `var(${colours[i % 3]})`;
      key.append(swatch, labels[i]);
      if (names.length > 1) heading.append(key);
    });
    figure.append(heading);
    this.holder = document.createElement("div");
    figure.append(this.holder);
    parent.append(figure);
    this.unit = unit;
    this.colours = colours;
    this.build();
  }

  build() {
    this.plot?.destroy();
    this.now = undefined;
    const series = [{}];
    const bands = [];
    this.names.forEach((name, i) => {
      const stroke = paint(this.colours[i % 3]);
      series.push({ stroke, width: 1.25, points: { show: false } }, { stroke, width: 1.25, points: { show: false } });
      bands.push({ series: [2 * i + 2, 2 * i + 1], fill: faded(stroke) });
    });
    const [time, value] = axes(this.unit);
    // Seconds before now, because the finger's own clock has no meaning for a reader.
    time.values = (plot, splits) => splits.map((t) => (t === 0 ? "now" : `${t} s`));
    this.plot = new uPlot({
      width: Math.max(240, this.holder.clientWidth || 600),
      height: tall(),
      series,
      bands,
      axes: [time, value],
      scales: { x: { time: false, range: [-WINDOW, 0] }, y: { range: span } },
      cursor: { show: false },
      legend: { show: false },
    }, [[]].concat(this.names.flatMap(() => [[], []])), this.holder);
  }

  resize() {
    this.now = undefined;
    this.plot.setSize({ width: Math.max(240, this.holder.clientWidth), height: tall() });
  }

  /** Draws the chart if it has moved by a pixel or more. */
  draw(times, lows, highs) {
    const now = times.at(-1) ?? 0;
    const moved = Math.abs(now - (this.now ?? -Infinity));
    if (moved < WINDOW / this.plot.bbox.width) return;
    this.now = now;
    const step = WINDOW / this.plot.bbox.width;
    const of = (columns) => this.names.map((name) => columns[name]);
    const [ends, ...values] = thinned(times, of(lows), of(highs), step);
    this.plot.setData([ends.map((time) => time - now), ...values]);
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

export class Spectrum {
  constructor(holder) {
    this.holder = holder;
    this.build("");
    this.show(false);
  }

  build(unit) {
    this.unit = unit;
    this.plot?.destroy();
    const stroke = paint("--z");
    const [hertz, value] = axes(unit ? `amplitude, ${unit}` : "amplitude");
    hertz.values = (plot, splits) => splits.map((f) => `${f} Hz`);
    this.plot = new uPlot({
      width: Math.max(240, this.holder.clientWidth || 600),
      height: 180,
      series: [{}, { stroke, width: 1.25, fill: faded(stroke), points: { show: false } }],
      axes: [hertz, value],
      scales: { x: { time: false }, y: { range: (plot, low, high) => [0, high > 0 ? high * 1.1 : 1] } },
      cursor: { show: false },
      legend: { show: false },
    }, [[], []], this.holder);
  }

  resize() {
    this.plot.setSize({ width: Math.max(240, this.holder.clientWidth), height: 180 });
  }

  /** Shows or hides the chart, because axes without a line carry no information. */
  show(yes) {
    if (this.holder.hidden !== yes) return;
    this.holder.hidden = !yes;
    if (yes) this.resize();
  }

  draw(step, lines) {
    this.plot.setData([lines.map((_, i) => i * step), lines]);
  }
}

export { WINDOW };
