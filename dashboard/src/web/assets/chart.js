// A chart of one or more curves, drawn by uPlot. It can be pointed at, dragged across, and used with the keyboard.

import { element, isNumber, svg } from "./format.js";
import { smoothed } from "./options.js";
import { logTicks, ticks } from "./ticks.js";
import uPlot from "./uplot.js";

/** @import { Options } from "./options.js" */

/**
 * A place on a curve, with its 95 % interval if it has one.
 * @typedef {{ x: number, y: number, low?: number, high?: number }} Place
 */

/**
 * A curve; `look` is its color and dashes.
 * @typedef {{ name: string, look: number, places: Place[] }} Curve
 */

/**
 * What a chart shows.
 * @typedef {object} Spec
 * @property {string} title above the chart; empty for none
 * @property {string} label what it shows and comes to, for those who do not see it
 * @property {Curve[]} curves
 * @property {(value: number) => string} text a value
 * @property {boolean} isRate whether values are from 0 to 1
 * @property {boolean} isTall whether it is the main chart of its section
 * @property {boolean} [isTold] whether it tells its values itself, as it does unless this is false
 */

/** Dash patterns of the curves, which differ in more than their color. */
export const DASHES = ["none", "7 3", "2 3", "9 3 2 3", "5 5", "7 2 1 2", "1 2"];
/** Curves with fewer places than this have visible dots. */
const MAX_DOTS = 40;
const FONT = "12px system-ui, sans-serif";
/** By how much a key comes nearer. */
const ZOOM = 1.5;
/** How far from the pointer a curve still has a value, as a share of the width. */
const NEAR = 0.05;

/** @param {string} name of a color of the page */
const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/**
 * Creates the piece of a curve that stands for it in texts.
 * @param {number} look
 */
export function sample(look) {
  const line = svg("line", { class: `curve g${look % DASHES.length}`, x1: 0, x2: 22, y1: 6, y2: 6, "stroke-dasharray": DASHES[look % DASHES.length] });
  return svg("svg", { class: "dot", viewBox: "0 0 22 12", "aria-hidden": "true" }, line);
}

/** @param {number} value whose logarithm is wanted */
const hasLog = (value) => value > 0;

/**
 * Returns a number for the y axis.
 * @param {number} value
 */
function brief(value) {
  const size = Math.abs(value);
  return size >= 1e4 || (size < 1e-3 && size > 0) ? value.toExponential(1).replace(".0", "") : String(Number(value.toPrecision(3)));
}

/**
 * Returns the range of the y axis for values from `low` to `high`, if there are any.
 * @param {number | null} low
 * @param {number | null} high
 * @param {boolean} isLog
 * @returns {uPlot.Range.MinMax}
 */
function rangeY(low, high, isLog) {
  if (!isNumber(low) || !isNumber(high)) return isLog ? [0.1, 1] : [0, 1];
  if (isLog) return [low / 1.2, high * 1.2];
  const margin = (high - low) * 0.06 || Math.abs(low) * 0.1 || 1;
  return [low - margin, high + margin];
}

/**
 * Adds the end of the x axis to its marks, if it has room.
 * @param {number[]} marks
 * @param {number} low
 * @param {number} high
 * @param {number} width pixels
 */
const withEnd = (marks, low, high, width) =>
  ((high - (marks[marks.length - 1] ?? low)) / (high - low) > 60 / width ? [...marks, high] : marks);

/**
 * The lines of a curve among the data of a chart: itself, what it was before smoothing, and its interval.
 * @typedef {{ main: number, raw: number | null, low: number | null, high: number | null }} Lines
 */

export class Chart {
  /** @type {Spec} */
  spec;
  /** @type {uPlot | null} */
  plot = null;
  /** What the plot was made for; other data of the same kind fit into it. */
  kind = "";
  /** @type {Lines[]} */
  lines = [];
  /**
   * Where the mark is.
   * @type {number | null}
   */
  marked = null;
  /** How many places a logarithmic x axis leaves out. */
  nLeftOut = 0;
  /** Marks a place on the x axis, which may change often. */
  mark = element("div", { class: "mark", hidden: "" });

  /**
   * @param {Options} options
   * @param {{ sync?: string, go?: (x: number) => void, tell?: (x: number | null) => void }} [how] which charts are
   * pointed at together, and what is called with the place that the user clicks or points at
   */
  constructor(options, how = {}) {
    this.options = options;
    this.how = how;
    this.value = element("b", {});
    this.name = element("span", {});
    this.head = element("h3", {}, this.name, this.value);
    this.place = element("div", { class: "plot", tabindex: "0", role: "img" });
    this.reading = element("p", { class: "reading quiet" });
    this.root = element("div", { class: "chart" }, this.head, this.place, this.reading);
    this.place.addEventListener("keydown", (event) => this.key(event));
    // Only what the user moves along is read out.
    this.place.addEventListener("focus", () => { this.reading.ariaLive = this.value.ariaLive = "polite"; });
    this.place.addEventListener("blur", () => {
      this.reading.ariaLive = this.value.ariaLive = "off";
      this.plot?.setCursor({ left: -10, top: -10 });
    });
    new ResizeObserver(() => this.resize()).observe(this.place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.plot?.redraw(false));
  }

  /** @param {Spec} spec */
  show(spec) {
    this.spec = spec;
    this.root.classList.toggle("tall", spec.isTall);
    this.place.classList.toggle("spark", !spec.isTall);
    this.head.hidden = spec.title === "";
    this.name.textContent = spec.title;
    this.place.ariaLabel = spec.label;
    this.draw();
    if (this.plot && this.plot.cursor.left >= 0) this.point();
    else this.tell(null);
  }

  /** Returns the values of the curves on the axes that are drawn, from left to right. */
  values() {
    const { isLogX } = this.options;
    const all = this.spec.curves.map(({ places }) => places.filter(({ x, y }) => isNumber(x) && isNumber(y)).sort((a, b) => a.x - b.x));
    const kept = all.map((places) => (isLogX ? places.filter(({ x }) => hasLog(x)) : places));
    this.nLeftOut = all.flat().length - kept.flat().length;
    return kept;
  }

  /** Returns whether the y axis is logarithmic, which needs values above 0. */
  isLogY() {
    const { isLogY } = this.options;
    return isLogY && this.spec.curves.every(({ places }) => places.every(({ y }) => !isNumber(y) || hasLog(y)));
  }

  draw() {
    const width = this.place.clientWidth;
    if (!this.spec || width === 0) return;
    const values = this.values();
    const hasRaw = this.options.smoothing > 0;
    const hasBand = values.map((places) => places.some(({ low }) => isNumber(low)));
    const { axis, isLogX } = this.options;
    const looks = this.spec.curves.map(({ look }, i) => [look, hasBand[i], values[i].length < MAX_DOTS]);
    const kind = JSON.stringify([looks, hasRaw, isLogX, this.isLogY(), axis.name, this.spec.isTall]);
    const data = this.data(values, hasRaw, hasBand);
    if (this.plot && kind === this.kind) {
      this.plot.setData(data);
      return;
    }
    this.plot?.destroy();
    this.kind = kind;
    this.plot = new uPlot({ ...this.layout(width), series: this.series(values, hasRaw, hasBand), bands: this.bands() }, data, this.place);
    this.plot.over.append(this.mark);
    this.remark();
    this.plot.over.addEventListener("click", ({ offsetX }) => this.how.go?.(this.plot.posToVal(offsetX, "x")));
  }

  /**
   * Returns the data as uPlot takes them: all places on the x axis, then each line's values there.
   * @param {Place[][]} values
   * @param {boolean} hasRaw
   * @param {boolean[]} hasBand
   * @returns {uPlot.AlignedData}
   */
  data(values, hasRaw, hasBand) {
    /** @type {[number[], ...number[][]][]} */
    const tables = [];
    let n = 1;
    this.lines = values.map((places, i) => {
      const of = (/** @type {"x" | "y" | "low" | "high"} */ name) => places.map((place) => place[name]);
      const raw = of("y");
      const [low, high] = this.isLogY() ? [of("low").map((v) => (hasLog(v) ? v : null)), of("high")] : [of("low"), of("high")];
      const main = hasRaw ? smoothed(raw, this.options.smoothing) : raw;
      tables.push([of("x"), main, ...(hasRaw ? [raw] : []), ...(hasBand[i] ? [low, high] : [])]);
      const at = { main: n, raw: hasRaw ? n + 1 : null, low: hasBand[i] ? n + 1 + Number(hasRaw) : null, high: hasBand[i] ? n + 2 + Number(hasRaw) : null };
      n += tables[i].length - 1;
      return at;
    });
    return uPlot.join(tables);
  }

  /**
   * @param {Place[][]} values
   * @param {boolean} hasRaw
   * @param {boolean[]} hasBand
   * @returns {uPlot.Series[]}
   */
  series(values, hasRaw, hasBand) {
    const unseen = { spanGaps: true, width: 0, points: { show: false } };
    return [{}, ...this.spec.curves.flatMap(({ look }, i) => {
      const stroke = () => color(`--g${look % DASHES.length}`);
      const [line, size] = this.spec.isTall ? [2, 5] : [1.5, 4];
      const dash = DASHES[look % DASHES.length].split(" ").map(Number).filter((v) => v > 0);
      const main = { spanGaps: true, stroke, width: line, dash, points: { show: values[i].length < MAX_DOTS, size, fill: stroke } };
      const raw = { spanGaps: true, stroke, width: 1, alpha: 0.35, points: { show: false } };
      return [main, ...(hasRaw ? [raw] : []), ...(hasBand[i] ? [unseen, unseen] : [])];
    })];
  }

  /** @returns {uPlot.Band[]} */
  bands() {
    return this.lines.flatMap(({ low, high }, i) => {
      const fill = () => `color-mix(in srgb, ${color(`--g${this.spec.curves[i].look % DASHES.length}`)} 16%, transparent)`;
      return low === null ? [] : [{ series: /** @type {[number, number]} */ ([high, low]), fill }];
    });
  }

  /**
   * @param {number} width
   * @returns {Omit<uPlot.Options, "series">}
   */
  layout(width) {
    const { isTall, isRate } = this.spec;
    const { axis, isLogX } = this.options;
    const isLogY = this.isLogY();
    const grid = { stroke: () => color("--line"), width: 1 };
    const look = { stroke: () => color("--quiet"), font: FONT, grid, ticks: { show: false }, filter: (/** @type {any} */ _, /** @type {number[]} */ splits) => splits };
    // The plot may have another width later.
    const nAcross = (/** @type {uPlot} */ plot) => Math.max(Math.floor(plot.width / (isTall ? 150 : 95)), 1);
    const nUp = isTall ? 5 : 3;
    const { sync } = this.how;
    const isMove = (/** @type {string} */ type) => type === "mousemove" || type === "mouseleave";
    return {
      width,
      height: this.height(width),
      padding: [8, 28, 0, 0],
      legend: { show: false },
      scales: {
        x: { time: false, distr: isLogX ? 3 : 1, range: () => this.options.range || this.whole() },
        y: { distr: isLogY ? 3 : 1, range: (_, low, high) => (isRate && !isLogY ? [0, 1] : rangeY(low, high, isLogY)) },
      },
      axes: [
        { ...look, size: 26, gap: 6, splits: (plot, _, low, high) => (isLogX ? logTicks(low, high, nAcross(plot)) : withEnd(ticks(low, high, nAcross(plot), axis.name === "elapsed_s"), low, high, plot.width)),
          values: (_, splits) => splits.map((value) => axis.text(value).replace(/(h|min) 0 .*/, "$1")) },
        { ...look, size: isTall ? 52 : 48, gap: 4, splits: (_, __, low, high) => (isLogY ? logTicks(low, high, nUp) : ticks(low, high, nUp)),
          values: (_, splits) => splits.map(isRate ? (value) => `${Number((100 * value).toPrecision(3))} %` : brief) },
      ],
      cursor: {
        drag: { x: true, y: false, setScale: false },
        bind: { dblclick: () => () => { this.options.zoom(null); return null; } },
        sync: sync ? { key: sync, filters: { pub: isMove, sub: isMove } } : undefined,
        dataIdx: (plot, series, place, x) => this.nearest(plot, series, place, x),
        points: { size: isTall ? 8 : 6 },
      },
      hooks: { setSelect: [() => this.select()], setCursor: [() => this.point()], draw: [() => this.remark()] },
    };
  }

  /** @param {number} width */
  height(width) {
    if (!this.spec.isTall) return 116;
    return width < 500 ? 210 : 280;
  }

  resize() {
    const width = this.place.clientWidth;
    if (!this.plot) this.draw();
    else if (width > 0 && width !== this.plot.width) this.plot.setSize({ width, height: this.height(width) });
  }

  /**
   * Returns the whole x axis, which ends at the last place of all curves.
   * @returns {[number, number]}
   */
  whole() {
    const { isLogX } = this.options;
    const all = this.values().flatMap((places) => places.map(({ x }) => x));
    const [first, last] = all.length > 0 ? [Math.min(...all), Math.max(...all)] : [0, 1];
    if (isLogX) return first < last ? [first, last] : [first / 2 || 0.5, last * 2 || 2];
    return [Math.min(first, 0), last > Math.min(first, 0) ? last : last + 1];
  }

  /**
   * Returns the index of the value of a line that is nearest to a place, or `null` if none is near.
   * @param {uPlot} plot
   * @param {number} series
   * @param {number} place the index of the place that is nearest
   * @param {number} x
   */
  nearest(plot, series, place, x) {
    // Intervals and what was smoothed have no mark of their own.
    if (series > 0 && !this.lines.some(({ main }) => main === series)) return null;
    const [xs, ys] = [plot.data[0], plot.data[series]];
    const has = (/** @type {number} */ i) => ys[i] !== null && ys[i] !== undefined;
    let [before, after] = [place, place];
    while (before >= 0 && !has(before)) before -= 1;
    while (after < xs.length && !has(after)) after += 1;
    const found = [before, after].filter((i) => i >= 0 && i < xs.length).sort((a, b) => Math.abs(xs[a] - x) - Math.abs(xs[b] - x));
    const { min, max } = plot.scales.x;
    return found.length > 0 && (this.lines.length === 1 || Math.abs(xs[found[0]] - xs[place]) <= NEAR * (max - min)) ? found[0] : null;
  }

  /** Shows what the user dragged across. */
  select() {
    const { left, width } = this.plot.select;
    const range = [left, left + width].map((at) => this.plot.posToVal(at, "x"));
    this.plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    if (width > 3) this.options.zoom([range[0], range[1]]);
  }

  /** Tells the values under the pointer. */
  point() {
    // The plot is not quite there when it first sets its cursor.
    if (!this.plot) return;
    const { idx, idxs } = this.plot.cursor;
    const isThere = isNumber(idx) && this.plot.cursor.left >= 0;
    const x = isThere ? this.plot.data[0][idx] : null;
    this.tell(isThere ? idxs : null, x);
    this.how.tell?.(x);
  }

  /**
   * Tells the values of the curves at these indices of the data, or their last ones.
   * @param {(number | null)[] | null} idxs
   * @param {number | null} [x] the place
   */
  tell(idxs, x = null) {
    const { curves, text, isTall, isTold } = this.spec;
    if (isTold === false) return;
    const at = idxs && this.plot ? idxs : null;
    const readings = curves.map(({ name, look, places }, i) => {
      const known = places.filter(({ y }) => isNumber(y));
      const last = known[known.length - 1];
      const place = at ? this.at(i, at[this.lines[i].main]) : last && { ...last };
      const band = place && isNumber(place.low) ? ` (${text(place.low)} to ${text(place.high)})` : "";
      return { name, look, value: place ? `${text(place.y)}${isTall ? band : ""}` : "–" };
    });
    const where = at ? ` at ${this.options.axis.text(x)}${this.options.axis.name === "n_env_steps" ? " steps" : ""}` : "";
    if (curves.length === 1) {
      this.value.textContent = `${readings[0].value}${where}`;
      this.reading.textContent = this.note();
      return;
    }
    this.value.textContent = where.trim();
    this.reading.replaceChildren(...readings.map(({ name, look, value }) => element("span", {}, sample(look), `${name} ${value}`)), this.note());
  }

  /**
   * Returns a curve's value, and its interval, at an index of the data.
   * @param {number} curve
   * @param {number | null} idx
   * @returns {Place | null}
   */
  at(curve, idx) {
    const { main, low, high } = this.lines[curve];
    if (!isNumber(idx)) return null;
    const value = (/** @type {number | null} */ line) => (line === null ? undefined : this.plot.data[line][idx]);
    return { x: this.plot.data[0][idx], y: value(main), low: value(low), high: value(high) };
  }

  /** Returns what the chart leaves out, or that there is little to see. */
  note() {
    const { curves } = this.spec;
    const known = curves.flatMap(({ places }) => places.filter(({ y }) => isNumber(y)));
    const notes = [];
    if (this.nLeftOut > 0) notes.push(`${this.nLeftOut} values at 0 are left out`);
    if (this.options.isLogY && !this.isLogY()) notes.push("linear: not all values are above 0");
    if (known.length === 1) notes.push("one value so far");
    else if (curves.length === 1 && known.every(({ y }) => y === known[0].y)) notes.push("constant");
    const missing = curves.filter(({ places }) => !places.some(({ x, y }) => isNumber(x) && isNumber(y))).map(({ name }) => name);
    if (missing.length > 0 && curves.length > 1) notes.push(`nothing of ${missing.join(", ")}`);
    return notes.join("; ");
  }

  /** @param {number} x where the mark is to be */
  markAt(x) {
    this.marked = x;
    this.remark();
  }

  remark() {
    if (!this.plot || this.marked === null) return;
    const left = this.plot.valToPos(this.marked, "x");
    this.mark.hidden = left < 0 || left > this.plot.over.clientWidth;
    this.mark.style.left = `${left}px`;
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (!this.plot || event.ctrlKey || event.metaKey || event.altKey) return;
    const { plot } = this;
    const n = plot.data[0].length;
    const [first, last] = [plot.valToIdx(plot.scales.x.min), plot.valToIdx(plot.scales.x.max)];
    const from = plot.cursor.left >= 0 && isNumber(plot.cursor.idx) ? plot.cursor.idx : null;
    const stride = event.shiftKey ? 10 : 1;
    const go = (/** @type {number} */ idx) => {
      const to = Math.min(Math.max(idx, first), Math.min(last, n - 1));
      plot.setCursor({ left: plot.valToPos(plot.data[0][to], "x"), top: plot.over.clientHeight / 2 });
    };
    /** @type {Record<string, () => void>} */
    const keys = {
      ArrowLeft: () => go(from === null ? last : from - stride),
      ArrowRight: () => go(from === null ? last : from + stride),
      Home: () => go(first),
      End: () => go(last),
      "+": () => this.near(ZOOM, from),
      "-": () => this.near(1 / ZOOM, from),
      0: () => this.options.zoom(null),
      Enter: () => { if (from !== null) this.how.go?.(plot.data[0][from]); },
      Escape: () => plot.setCursor({ left: -10, top: -10 }),
    };
    const act = n > 0 && keys[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }

  /**
   * Comes nearer to a place by a factor.
   * @param {number} factor
   * @param {number | null} idx the place's index; `null` for the middle
   */
  near(factor, idx) {
    const { isLogX } = this.options;
    const [to, back] = isLogX ? [Math.log10, (/** @type {number} */ v) => 10 ** v] : [Number, Number];
    const [low, high] = [to(this.plot.scales.x.min), to(this.plot.scales.x.max)];
    const middle = idx === null ? (low + high) / 2 : to(this.plot.data[0][idx]);
    const range = [middle - (middle - low) / factor, middle + (high - middle) / factor];
    const whole = this.whole();
    const isWhole = back(range[0]) <= whole[0] && back(range[1]) >= whole[1];
    this.options.zoom(isWhole ? null : [Math.max(back(range[0]), whole[0]), Math.min(back(range[1]), whole[1])]);
  }
}

/** Charts in one place, which stay the same while their curves grow. */
export class Charts {
  /** @type {Map<string, Chart>} */
  all = new Map();

  /**
   * @param {HTMLElement} place
   * @param {Options} options
   */
  constructor(place, options) {
    this.place = place;
    this.options = options;
  }

  /** @param {Spec[]} specs in order; their titles are their names */
  show(specs) {
    const kept = specs.map((spec) => {
      const chart = this.all.get(spec.title) || new Chart(this.options, { sync: "training" });
      this.all.set(spec.title, chart);
      return chart;
    });
    const roots = kept.map(({ root }) => root);
    // Moving an element would take the focus from it.
    if (roots.length !== this.place.children.length || roots.some((root, i) => root !== this.place.children[i])) this.place.replaceChildren(...roots);
    kept.forEach((chart, i) => chart.show(specs[i]));
  }
}
