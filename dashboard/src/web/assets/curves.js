// Success by group, and the table of the newest evaluation.

import { Charts, sample } from "./chart.js";
import { count, element, fill, interval, minutes, percent } from "./format.js";
import { model } from "./model.js";
import { placeOf } from "./options.js";

/** @import { Curve, Spec } from "./chart.js" */
/** @import { Options, Run } from "./options.js" */
/** @import { Acting, History, Evaluation, Rate } from "./types" */

const GROUPS = ["train 2-6", "train 7-11", "train 12-16", "test 12-16", "test special", "validation 2-6", "validation"];
/** Success on all blueprints. */
const ALL = "all";

/**
 * Returns the rate of a group, or of all blueprints, in an evaluation; `null` if it has none.
 * @param {Evaluation} evaluation
 * @param {string} group
 * @param {Acting} acting
 * @returns {Rate | null}
 */
function rateOf(evaluation, group, acting) {
  const found = group === ALL ? evaluation.all : evaluation.groups.find(({ name }) => name === group);
  return (found && found[acting]) || null;
}

/**
 * Returns the success of a run on a group.
 * @param {Run} run
 * @param {string} group
 * @param {Acting} acting
 * @param {Options} options
 */
function placesOf(run, group, acting, options) {
  return run.evaluations.flatMap((evaluation) => {
    const rate = rateOf(evaluation, group, acting);
    return rate ? [{ x: placeOf(run, evaluation, options.axis.name), y: rate.rate, low: rate.wilson_low, high: rate.wilson_high }] : [];
  });
}

/**
 * Returns the newest rates of some curves in words.
 * @param {Curve[]} curves
 */
const newest = (curves) => curves.map(({ name, places }) => `${name} ${places.length > 0 ? percent(places[places.length - 1].y) : "not evaluated"}`).join(", ");

/**
 * Returns one chart with a curve per group of a single run, or one chart per group with a curve per run.
 * @param {Run[]} runs
 * @param {Acting} acting
 * @param {Options} options
 * @returns {Spec[]}
 */
function specsOf(runs, acting, options) {
  const rates = { text: percent, isRate: true };
  if (runs.length === 1) {
    const curves = GROUPS.map((name, look) => ({ name, look, places: placesOf(runs[0], name, acting, options) }));
    const known = curves.filter(({ places }) => places.length > 0);
    const drawn = known.length > 0 ? known : [{ name: ALL, look: 0, places: placesOf(runs[0], ALL, acting, options) }];
    const label = `Success by group over ${runs[0].evaluations.length} evaluations; newest: ${newest(drawn)}`;
    return [{ ...rates, title: `${acting} actions`, label, curves: drawn, isTall: true }];
  }
  const all = [ALL, ...GROUPS].map((group) => ({
    group, curves: runs.map((run, look) => ({ name: run.name, look, places: placesOf(run, group, acting, options) })),
  }));
  const known = all.filter(({ curves }) => curves.some(({ places }) => places.length > 0));
  // A single group is all blueprints.
  const shown = known.length === 2 ? known.slice(0, 1) : known;
  return shown.map(({ group, curves }) => ({
    ...rates, title: group === ALL ? "all blueprints" : group, label: `Success on ${group} by run; newest: ${newest(curves)}`, curves, isTall: group === ALL,
  }));
}

/** Says when the first evaluation comes. */
function awaited() {
  const { kind, n_env_steps: target, origin } = model.about || {};
  if (kind !== "training") return "Nothing was evaluated.";
  const { every = {}, evaluate_last: isLast = false } = origin?.settings.evaluator || {};
  const { steps, versions } = every;
  if (steps > target) return isLast ? "No evaluation yet; the only one is that of the last weights." : "This run is too short to be evaluated.";
  if (steps) return `No evaluation yet; the first comes after ${count(steps)} environment steps.`;
  if (versions) return `No evaluation yet; the first comes with version ${versions} of the weights.`;
  return "No evaluation yet; the first comes after the first update.";
}

export class Curves {
  /**
   * @param {HTMLElement} place
   * @param {Options} options
   */
  constructor(place, options) {
    this.place = place;
    this.options = options;
    this.charts = new Charts(element("div", { class: "charts" }), options);
  }

  /**
   * Draws success by group. Before the first evaluation ends, shows the preliminary numbers of `now`, if any.
   * @param {Run[]} runs
   * @param {Acting} acting
   * @param {{ success: Rate, text: string } | null} now
   */
  show(runs, acting, now) {
    const evaluated = runs.map((run) => ({ ...run, evaluations: run.evaluations.filter((evaluation) => evaluation.all[acting]) }));
    const n = Math.max(...evaluated.map(({ evaluations }) => evaluations.length));
    if (n === 0) {
      const soFar = now ? `${percent(now.success.rate)} so far, ${now.text}.` : awaited();
      this.place.replaceChildren(element("p", { class: "empty" }, soFar));
      return;
    }
    if (n === 1 && runs.length === 1) {
      // The table below already shows all numbers.
      this.place.replaceChildren();
      return;
    }
    if (this.place.firstChild !== this.charts.place) this.place.replaceChildren(this.charts.place);
    this.charts.show(specsOf(evaluated, acting, this.options));
  }
}

/**
 * Shows the newest evaluation by group.
 * @param {HTMLTableElement} table
 * @param {History} history
 * @param {boolean} isKey whether the groups are the curves above
 */
export function drawGroups(table, history, isKey) {
  const last = history.evaluations[history.evaluations.length - 1];
  if (!last) {
    table.replaceChildren();
    return;
  }
  const cells = (/** @type {Rate | null} */ rate) => (rate ? [percent(rate.rate), interval(rate), String(rate.n_episodes)] : ["–", "–", "–"]);
  const actings = /** @type {const} */ (["greedy", "sampled"]).filter((acting) => last.all[acting]);
  const rows = [...last.groups, last.all].map((group) => {
    const look = GROUPS.indexOf(group.name);
    const first = isKey && look >= 0 ? [sample(look), group.name] : [group.name];
    return [first, String(group.n_blueprints), ...actings.flatMap((acting) => cells(group[acting]))];
  });
  const caption = `Newest evaluation: weights ${last.weights_version}, ${count(last.n_env_steps)} steps, took ${minutes(last.elapsed_s)}`;
  const heads = ["group", "blueprints", ...actings.flatMap((acting) => [acting, "95 % interval", "episodes"])];
  fill(table, caption, heads, rows);
}
