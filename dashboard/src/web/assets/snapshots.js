// Which of a run's weights build: those of the page, or a snapshot from earlier in the run.

import { count, percent } from "./format.js";
import { answerAt, model } from "./model.js";

/** @import { Acting, Evaluation } from "./types" */

/**
 * Weights by the environment steps after which a snapshot kept them; `null` for those of the page.
 * @typedef {number | null} Weights
 */

/**
 * @typedef {object} Parts
 * @property {HTMLElement} bar holds the parts below, and is hidden without snapshots
 * @property {HTMLInputElement} slider chooses the weights that build
 * @property {HTMLElement} text tells them
 * @property {HTMLElement} through plays all of them
 * @property {HTMLInputElement} beside whether others build beside them
 * @property {HTMLElement} others holds the slider for those
 * @property {HTMLInputElement} other
 * @property {HTMLElement} otherText
 */

/** How the address names the weights of the page beside others. */
const OWN = "policy";

/**
 * Returns the weights that the address names.
 * @param {string | null} text
 * @returns {Weights}
 */
const read = (text) => (text === null || text === OWN ? null : Math.max(Number.parseInt(text, 10) || 0, 0));

export class Snapshots {
  /**
   * Those of the run, by environment steps.
   * @type {number[]}
   */
  all = [];
  /** @type {Weights} */
  chosen = null;
  /** @type {Weights} */
  other = null;
  /** Whether the episodes of all of them follow each other. */
  isThrough = false;
  /** Environment steps of the run when the page asked last. */
  asked = -Infinity;

  /**
   * @param {Parts} parts
   * @param {() => void} changed called when the user has chosen others
   */
  constructor(parts, changed) {
    this.parts = parts;
    parts.slider.addEventListener("input", () => {
      [this.chosen, this.isThrough] = [this.at(parts.slider), false];
      this.draw();
    });
    parts.other.addEventListener("input", () => {
      this.other = this.at(parts.other);
      this.draw();
    });
    parts.beside.addEventListener("change", () => {
      // Two of the same would show nothing.
      if (this.other === this.chosen) this.other = this.chosen === null ? this.all[0] : null;
      this.draw();
    });
    for (const input of [parts.slider, parts.other, parts.beside]) input.addEventListener("change", changed);
    parts.through.addEventListener("click", () => {
      [this.chosen, this.isThrough] = [this.all[0], true];
      this.draw();
      changed();
    });
  }

  /** Asks which snapshots there are. */
  async learn() {
    if (!model.about?.can_play) return;
    try {
      const answer = await fetch(answerAt(model.base, "snapshots"));
      if (answer.ok) this.all = (await answer.json()).snapshots;
    } catch {
      // The event stream reports that the server is unreachable.
    }
    // The first one may be on its way to the disk.
    if (this.all.length === 0) setTimeout(() => { this.asked = -Infinity; }, 1000);
    this.draw();
  }

  /**
   * Asks again now and then while a run learns, which keeps a snapshot every eleventh of it.
   * @param {number} nEnvSteps of the run so far
   */
  follow(nEnvSteps) {
    if (Math.abs(nEnvSteps - this.asked) < model.about?.n_env_steps / 33) return;
    this.asked = nEnvSteps;
    this.learn();
  }

  /**
   * Returns the weights at the place of a slider; the page's own come last.
   * @param {HTMLInputElement} slider
   * @returns {Weights}
   */
  at(slider) {
    return this.all[Number(slider.value)] ?? null;
  }

  /** Goes on to the weights that come next in the run. Returns false if there are none or the user does not want it. */
  next() {
    if (!this.isThrough) return false;
    this.chosen = this.all.find((n) => n > this.chosen) ?? null;
    this.isThrough = this.chosen !== null;
    this.draw();
    return true;
  }

  /**
   * Takes over what the address names.
   * @param {string | null} chosen
   * @param {string | null} other
   */
  restore(chosen, other) {
    [this.chosen, this.other, this.isThrough] = [read(chosen), read(other), false];
    this.parts.beside.checked = other !== null;
    this.draw();
  }

  /** Returns what the address says about it. */
  named() {
    return { snapshot: this.chosen, beside: this.parts.beside.checked ? this.other ?? OWN : null };
  }

  /** Returns the weights that build, one or two beside each other. */
  pair() {
    return this.parts.beside.checked ? [this.chosen, this.other] : [this.chosen];
  }

  /**
   * Returns the evaluation of weights, if the page knows it.
   * @param {Weights} weights
   * @returns {Evaluation | undefined}
   */
  evaluation(weights) {
    const { evaluations } = model.history;
    return weights === null ? evaluations.at(-1) : evaluations.find(({ n_env_steps: n }) => n === weights);
  }

  /**
   * Says which weights these are, and how often they build.
   * @param {Weights} weights
   */
  label(weights) {
    const { [/** @type {Acting} */ (model.acting)]: rate } = this.evaluation(weights)?.all || { greedy: null, sampled: null };
    const built = rate && weights !== null ? `, ${percent(rate.rate)} built` : "";
    const own = model.about?.kind === "training" ? "newest weights" : "the run's policy";
    return weights === null ? own : `after ${count(weights)} steps${built}`;
  }

  /**
   * Names whose picture it is.
   * @param {Weights} weights
   */
  caption(weights) {
    return weights === null ? this.label(weights) : `policy ${this.label(weights)}`;
  }

  /** Shows what is chosen. */
  draw() {
    const { bar, slider, text, beside, others, other, otherText } = this.parts;
    bar.hidden = this.all.length === 0;
    others.hidden = !beside.checked;
    for (const [input, output, weights] of /** @type {const} */ ([[slider, text, this.chosen], [other, otherText, this.other]])) {
      const place = this.all.indexOf(weights);
      input.max = String(this.all.length);
      // One that is no longer there keeps its name, and the server says that it is gone.
      input.value = String(place < 0 ? this.all.length : place);
      output.textContent = this.label(weights);
      input.setAttribute("aria-valuetext", output.textContent);
    }
  }
}
