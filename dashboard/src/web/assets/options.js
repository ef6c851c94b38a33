// How all charts of a training are drawn: their x axis, smoothing, logarithmic axes, and the part that is shown.

import { address } from "./address.js";
import { $, count, element, isNumber, minutes } from "./format.js";

/** @import { Evaluation, Point } from "./types" */

/**
 * A run with its evaluations, and the learner's updates.
 * @typedef {{ name: string, evaluations: Evaluation[], points: Point[] }} Run
 */

/**
 * What a curve may be drawn against: a field of the learner's points.
 * @typedef {object} Axis
 * @property {string} name
 * @property {string} title
 * @property {(value: number) => string} text
 */

/** @type {Axis[]} */
const AXES = [
  { name: "n_env_steps", title: "environment steps", text: count },
  { name: "elapsed_s", title: "time", text: minutes },
  { name: "n_episodes", title: "episodes", text: count },
  { name: "weights_version", title: "versions of the weights", text: count },
];

/**
 * Returns where an evaluation lies on an axis; not a number if the learner's points do not tell.
 * @param {Run} run
 * @param {Evaluation} evaluation
 * @param {string} axis
 */
export function placeOf({ points }, evaluation, axis) {
  if (axis === "n_env_steps") return evaluation.n_env_steps;
  if (axis === "weights_version") return evaluation.weights_version;
  const known = points.filter((point) => isNumber(point[axis]));
  if (known.length === 0) return NaN;
  // A training starts at zero of everything.
  const places = [{ steps: 0, value: 0 }, ...known.map((point) => ({ steps: point.n_env_steps, value: point[axis] }))];
  const next = places.findIndex(({ steps }) => steps >= evaluation.n_env_steps);
  if (next < 0) return places[places.length - 1].value;
  if (next === 0) return places[0].value;
  const [from, to] = [places[next - 1], places[next]];
  return from.value + ((to.value - from.value) * (evaluation.n_env_steps - from.steps)) / (to.steps - from.steps);
}

/**
 * Returns the exponential moving average of the values, each with this weight on those before it.
 * @param {number[]} values
 * @param {number} weight from 0 to 1
 */
export function smoothed(values, weight) {
  let [sum, whole] = [0, 0];
  // Divided by the sum of all weights, because the first values have none before them.
  return values.map((value) => {
    [sum, whole] = [weight * sum + (1 - weight) * value, weight * whole + (1 - weight)];
    return sum / whole;
  });
}

export class Options {
  axis = AXES[0];
  /** The weight of the values before, from 0 for none. */
  smoothing = 0;
  isLogX = false;
  isLogY = false;
  /**
   * The first and the last place on the x axis; `null` for all.
   * @type {[number, number] | null}
   */
  range = null;

  /** @param {() => void} changed called when the charts must be drawn again */
  constructor(changed) {
    this.changed = changed;
  }

  /** @param {[number, number] | null} range */
  zoom(range) {
    this.range = range;
    this.changed();
  }
}

/** The options that the user sets above the charts, and that the address keeps. */
export class ChosenOptions extends Options {
  /** @param {() => void} changed */
  constructor(changed) {
    super(changed);
    $("chart-axis").append(...AXES.map(({ name, title }) => element("option", { value: name }, title)));
    $("chart-options").addEventListener("input", () => this.read());
    $("chart-whole").addEventListener("click", () => this.zoom(null));
  }

  /** Takes in what the user chose. Another axis shows all of it. */
  read() {
    const axis = AXES.find(({ name }) => name === $("chart-axis").value);
    const isLogX = $("chart-log-x").checked;
    if (axis !== this.axis || isLogX !== this.isLogX) this.range = null;
    [this.axis, this.isLogX, this.isLogY] = [axis, isLogX, $("chart-log-y").checked];
    this.smoothing = Number($("chart-smoothing").value);
    this.keep();
    this.changed();
  }

  /** @param {[number, number] | null} range */
  zoom(range) {
    this.range = range;
    this.keep();
    this.changed();
  }

  /** Writes the options into the address. */
  keep() {
    const log = `${this.isLogX ? "x" : ""}${this.isLogY ? "y" : ""}`;
    address.set({
      axis: this.axis === AXES[0] ? null : this.axis.name, smoothing: this.smoothing || null, log,
      zoom: this.range && this.range.map((value) => Number(value.toPrecision(6))).join(","),
    });
    this.tell();
  }

  /** Reads the options from the address. */
  restore() {
    this.axis = AXES.find(({ name }) => name === address.get("axis")) || AXES[0];
    this.smoothing = Math.min(Math.max(Number(address.get("smoothing")) || 0, 0), Number($("chart-smoothing").max));
    [this.isLogX, this.isLogY] = ["x", "y"].map((axis) => (address.get("log") || "").includes(axis));
    const [from, to] = (address.get("zoom") || "").split(",").map(Number);
    this.range = from < to && (from > 0 || !this.isLogX) ? /** @type {[number, number]} */ ([from, to]) : null;
    $("chart-axis").value = this.axis.name;
    $("chart-smoothing").value = String(this.smoothing);
    [$("chart-log-x").checked, $("chart-log-y").checked] = [this.isLogX, this.isLogY];
    this.tell();
    this.changed();
  }

  tell() {
    $("chart-smoothing-text").textContent = this.smoothing ? this.smoothing.toFixed(2) : "off";
    $("chart-whole").disabled = this.range === null;
  }

  /**
   * Offers only the axes that the runs have numbers for.
   * @param {Run[]} runs
   */
  offer(runs) {
    for (const option of $("chart-axis").options) {
      option.disabled = option.value !== AXES[0].name && !runs.some(({ points }) => points.some((point) => isNumber(point[option.value])));
    }
  }
}
