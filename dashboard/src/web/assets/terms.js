// The reward terms of an episode, each as the cumulative sum from the first step on.

import { Chart, sample } from "./chart.js";
import { decimal, element } from "./format.js";
import { Options } from "./options.js";

/** @import { Episode, Scene } from "./types" */

/** @type {[string, (scene: Scene) => number][]} */
const TERMS = [
  ["all", (scene) => scene.reward],
  ["connected", (scene) => scene.reward_terms.connected],
  ["wrong connections", (scene) => scene.reward_terms.wrong],
  ["magnets near", (scene) => scene.reward_terms.magnets],
  ["blocks near", (scene) => scene.reward_terms.blocks],
  ["heavy contacts", (scene) => scene.reward_terms.force],
];

export class Terms {
  time = 0;
  /** @type {Scene[]} */
  scenes;

  /**
   * @param {HTMLElement} place
   * @param {HTMLElement} legend
   * @param {(step: number) => void} go called with the step that the user clicks
   */
  constructor(place, legend, go) {
    const options = new Options(() => this.chart.draw());
    options.axis = { name: "step", title: "steps", text: String };
    this.chart = new Chart(options, {
      go: (x) => go(Math.min(Math.max(Math.round(x), 0), this.scenes.length - 1)),
      tell: (x) => this.tell(x === null ? this.time : x),
    });
    place.append(this.chart.root);
    this.values = TERMS.map(([title], look) => {
      const value = element("dd", {}, "–");
      legend.append(element("div", {}, element("dt", {}, sample(look), title), value));
      return value;
    });
  }

  /** @param {Episode} episode */
  show(episode) {
    this.scenes = episode.scenes;
    const last = this.scenes.length - 1;
    const said = TERMS.map(([title, value]) => `${title} ${decimal(value(this.scenes[last]))}`).join(", ");
    this.chart.options.range = null;
    this.chart.show({
      title: "", isRate: false, isTall: false, isTold: false, text: decimal,
      label: `Reward by term over ${last} steps; at the end: ${said}. A click, or Enter, goes to a step`,
      curves: TERMS.map(([name, value], look) => ({ name, look, places: this.scenes.map((scene, x) => ({ x, y: value(scene) })) })),
    });
  }

  /** @param {number} time in scenes */
  seek(time) {
    this.time = time;
    this.chart.markAt(time);
    this.tell(time);
  }

  /**
   * Shows the values at a time.
   * @param {number} time in scenes
   */
  tell(time) {
    const scene = this.scenes[Math.min(Math.floor(time), this.scenes.length - 1)];
    TERMS.forEach(([, value], i) => { this.values[i].textContent = value(scene).toFixed(2); });
  }
}
