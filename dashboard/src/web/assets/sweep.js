// A sweep: the success of its points by group, as a table and over environment steps.

import { address } from "./address.js";
import { Charts, DASHES, sample } from "./chart.js";
import { element, fill, percent } from "./format.js";
import { NO_ANSWER, answerAt } from "./model.js";
import { Options } from "./options.js";

/** @import { Curve } from "./chart.js" */
/** @import { Acting, Aggregate, SweepGroup, SweepPoint, SweepResults } from "./types" */

/** The averages over seeds and goals, by their names in the answer. */
const AVERAGES = { mean: "mean", iqm: "interquartile mean" };

/** Curves in one chart: as many as differ by their look. */
const MAX_CURVES = DASHES.length;

/**
 * Returns the name of a column of the table. Points that were evaluated on other goals are not compared.
 * @param {SweepGroup} group
 */
const columnOf = (group) => `${group.group} (${group.n_goals})`;

/**
 * Creates a group of radio buttons.
 * @param {string} name
 * @param {string} legend
 * @param {[string, string][]} choices values and texts
 * @param {string} chosen
 * @param {(value: string) => void} choose
 */
function radios(name, legend, choices, chosen, choose) {
  const labels = choices.map(([value, text]) => {
    const input = element("input", { type: "radio", name, value, ...(value === chosen ? { checked: "" } : {}) });
    input.addEventListener("change", () => choose(value));
    return element("label", {}, input, text);
  });
  return element("fieldset", {}, element("legend", { class: "quiet" }, legend), ...labels);
}

class Sweep {
  /**
   * @param {SweepResults} results
   * @param {number} nServed how many of the runs that are done the page has
   */
  constructor(results, nServed) {
    this.results = results;
    this.nServed = nServed;
    const all = results.points.flatMap(({ groups }) => groups);
    /** @type {[string, string][]} */
    const actings = ["greedy", "sampled"].filter((name) => all.some(({ acting }) => acting === name)).map((name) => [name, name]);
    /** The chosen average. @type {"mean" | "iqm"} */
    this.average = address.get("average") === "iqm" ? "iqm" : "mean";
    /** The chosen actions. @type {string} */
    this.acting = (actings.find(([name]) => name === address.get("actions")) || actings[0] || [""])[0];
    /** The points with curves, and the look of each. @type {Map<number, number>} */
    this.looks = new Map();
    this.chosen().forEach((point, look) => this.looks.set(point, look));
    this.table = element("table", {});
    this.charts = new Charts(element("div", { class: "charts" }), new Options(() => this.drawCharts()));
    this.note = element("p", { class: "quiet" });
    const averages = radios("average", "Average", Object.entries(AVERAGES), this.average, (value) => {
      this.average = value === "iqm" ? "iqm" : "mean";
      address.set({ average: value === "mean" ? null : value });
      this.draw();
    });
    const actions = radios("sweep-acting", "Actions", actings, this.acting, (value) => {
      this.acting = value;
      address.set({ actions: value === actings[0][0] ? null : value });
      this.draw();
    });
    const head = element("div", { class: "bar" }, element("h2", { id: "sweep-title" }, `Sweep ${results.folder}`), averages, ...(actings.length > 1 ? [actions] : []));
    const scroll = element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Success by point and group" }, this.table);
    this.root = element("section", { id: "sweep", class: "card wide", "aria-labelledby": "sweep-title" }, head, scroll, this.note, this.charts.place, this.missing());
  }

  /** Returns the points to draw: those that the address names, or else the best ones, as many as fit. */
  chosen() {
    const { points } = this.results;
    const named = (address.get("curves") || "").split(",").filter(Boolean).map((text) => Number(text) - 1);
    const known = [...new Set(named)].filter((i) => points[i]).slice(0, MAX_CURVES);
    if (known.length > 0) return known;
    const success = (/** @type {SweepPoint} */ { groups }) => {
      const rates = groups.filter(({ acting }) => acting === this.acting).map(({ mean }) => mean);
      return rates.reduce((sum, rate) => sum + rate, 0) / Math.max(rates.length, 1);
    };
    const best = points.flatMap((point, i) => (point.groups.length > 0 ? [{ i, rate: success(point) }] : [])).sort((a, b) => b.rate - a.rate);
    return best.slice(0, MAX_CURVES).map(({ i }) => i).sort((a, b) => a - b);
  }

  /** Lists the runs that are missing in the table. */
  missing() {
    const texts = this.results.points.flatMap(({ name, failed, unfinished }) => [
      ...failed.map(({ seed, status, log }) => `failed: ${name}, seed ${seed} (${status}); see ${log}`),
      ...(unfinished.length > 0 ? [`not finished: ${name}, seeds ${unfinished.join(", ")}`] : []),
    ]);
    return element("ul", { class: "missing" }, ...texts.map((text) => element("li", {}, text)));
  }

  /**
   * Returns a rate and its interval.
   * @param {Aggregate} of
   */
  rate(of) {
    const [value, range] = this.average === "iqm" ? [of.iqm, of.iqm_interval] : [of.mean, of.mean_interval];
    return { value, low: range?.[0], high: range?.[1] };
  }

  draw() {
    this.drawTable();
    this.drawCharts();
  }

  drawTable() {
    const { points, seeds } = this.results;
    const rows = points.map((point, i) => ({ i, point, groups: point.groups.filter(({ acting }) => acting === this.acting) }));
    const columns = [...new Set(rows.flatMap(({ groups }) => groups.map(columnOf)))];
    const cells = rows.map(({ i, point, groups }) => [this.head(i, point), this.seeds(i), ...columns.map((column) => {
      const found = groups.find((group) => columnOf(group) === column);
      if (!found) return "–";
      const { value, low, high } = this.rate(found);
      return low === undefined ? percent(value) : [percent(value), element("small", { class: "quiet" }, `${percent(low)} to ${percent(high)}`)];
    })]);
    const caption = `Success by group (goals) after all steps: ${AVERAGES[this.average]} over seeds and goals${seeds.length > 1 ? ", with 95 % bootstrap intervals" : ""}`;
    fill(this.table, caption, ["point", "seeds", ...columns], cells);
  }

  /**
   * Returns what begins the row of a point: whether its curve is drawn, how it looks, and its name.
   * @param {number} i
   * @param {SweepPoint} point
   */
  head(i, { name, groups }) {
    if (groups.length === 0) return name;
    const look = this.looks.get(i);
    const isFull = look === undefined && this.looks.size >= MAX_CURVES;
    const box = element("input", { type: "checkbox", "aria-label": `Curve of ${name}`, ...(look !== undefined ? { checked: "" } : {}), ...(isFull ? { disabled: "", title: `No more than ${MAX_CURVES} curves fit` } : {}) });
    box.addEventListener("change", () => {
      if (look !== undefined) this.looks.delete(i);
      else this.looks.set(i, DASHES.findIndex((_, free) => ![...this.looks.values()].includes(free)));
      address.set({ curves: [...this.looks.keys()].map((point) => point + 1).join(",") });
      this.draw();
      /** @type {HTMLInputElement} */ (this.table.tBodies[0].rows[i].querySelector("input")).focus();
    });
    return element("label", {}, box, ...(look === undefined ? [] : [sample(look)]), name);
  }

  /**
   * Returns the seeds of a point that are done, each with a link to its run.
   * @param {number} i
   */
  seeds(i) {
    const runs = this.results.done.map((run, place) => ({ ...run, place })).filter(({ point }) => point === i);
    return runs.flatMap(({ seed, place }, k) => {
      const text = String(seed);
      const link = place < this.nServed ? element("a", { href: `?run=${place}#tiles`, "aria-label": `Run with seed ${seed}` }, text) : text;
      return k > 0 ? [" ", link] : [link];
    });
  }

  /** Draws a chart for each group that was evaluated more than once. */
  drawCharts() {
    const all = [...this.looks].map(([i, look]) => ({ look, point: this.results.points[i] }));
    const names = [...new Set(all.flatMap(({ point }) => point.groups.map(({ group }) => group)))];
    const charts = names.map((group) => ({ group, curves: all.map(({ look, point }) => this.curve(group, look, point)) }))
      .map(({ group, curves }) => ({ group, curves: curves.filter(({ places }) => places.length > 1) }))
      .filter(({ curves }) => curves.length > 0);
    const { nServed, results } = this;
    this.note.textContent = [
      charts.length > 0 ? "Success over environment steps. The boxes choose the curves." : "No curves: each group was evaluated once, in the end.",
      nServed < results.done.length ? `The first ${nServed} of ${results.done.length} runs can be opened here.` : "",
    ].join(" ");
    this.charts.show(charts.map(({ group, curves }) => {
      const newest = curves.map(({ name, places }) => `${name} ${percent(places[places.length - 1].y)}`).join(", ");
      const label = `Success on ${group} over environment steps; at last: ${newest}`;
      return { title: group, label, curves, text: percent, isRate: true, isTall: true };
    }));
  }

  /**
   * Returns the curve of a point in a group.
   * @param {string} group
   * @param {number} look
   * @param {SweepPoint} point
   * @returns {Curve}
   */
  curve(group, look, { name, curve }) {
    const places = curve.flatMap(({ n_env_steps, groups }) => {
      const found = groups.find((of) => of.group === group && of.acting === this.acting);
      if (!found) return [];
      const { value, low, high } = this.rate(found);
      return [{ x: n_env_steps, y: value, low, high }];
    });
    return { name, look, places };
  }
}

/**
 * Shows the sweep of the page before its runs.
 * @param {HTMLElement} runs begins what is shown of a run
 * @param {HTMLElement} choice chooses the run
 * @param {number} nServed how many runs there are to choose from
 */
export async function showSweep(runs, choice, nServed) {
  const chosen = element("p", { class: "wide options" }, element("label", {}, "One of its runs: ", choice));
  runs.before(chosen);
  try {
    const sweep = new Sweep(await (await fetch(answerAt("", "sweep"))).json(), nServed);
    chosen.before(sweep.root);
    sweep.draw();
    if (location.hash === `#${runs.id}`) chosen.scrollIntoView();
  } catch {
    chosen.before(element("p", { class: "card wide" }, NO_ANSWER));
  }
}
