// The reward terms of an episode, each as the cumulative sum from the first step on.

import { DASHES } from "./curves.js";
import { decimal, element, svg } from "./format.js";

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
   * Marks the time in the chart.
   * @type {SVGLineElement}
   */
  now;

  /**
   * @param {HTMLElement} place
   * @param {HTMLElement} legend
   * @param {(step: number) => void} go called with the step that the user clicks
   */
  constructor(place, legend, go) {
    this.place = place;
    this.go = go;
    this.values = TERMS.map(([title], i) => {
      const value = element("dd", {}, "–");
      const line = svg("line", { class: `curve g${i}`, x1: 0, x2: 22, y1: 6, y2: 6, "stroke-dasharray": DASHES[i] });
      legend.append(element("div", {}, element("dt", {}, svg("svg", { class: "dot", viewBox: "0 0 22 12", "aria-hidden": "true" }, line), title), value));
      return value;
    });
  }

  /** @param {Episode} episode */
  show(episode) {
    this.scenes = episode.scenes;
    const last = this.scenes.length - 1;
    const all = this.scenes.flatMap((scene) => TERMS.map(([, value]) => value(scene)));
    const [low, high] = [Math.min(...all, 0), Math.max(...all, 0)];
    const y = (/** @type {number} */ value) => (high > low ? 2 + (1 - (value - low) / (high - low)) * 96 : 50);
    const said = TERMS.map(([title, value]) => `${title} ${decimal(value(this.scenes[last]))}`).join(", ");
    const label = `Reward by term over ${last} steps; at the end: ${said}`;
    // Stretched to the available width; lines keep their thickness.
    const drawing = svg("svg", { viewBox: `0 0 ${Math.max(last, 1)} 100`, preserveAspectRatio: "none", role: "img", "aria-label": label });
    drawing.append(svg("line", { class: "grid", x1: 0, x2: Math.max(last, 1), y1: y(0), y2: y(0) }));
    TERMS.forEach(([, value], i) => {
      const points = this.scenes.map((scene, step) => `${step},${y(value(scene)).toFixed(1)}`).join(" ");
      drawing.append(svg("polyline", { class: `curve g${i}`, "stroke-dasharray": DASHES[i], points }));
    });
    this.now = svg("line", { class: "now", y1: 0, y2: 100 });
    drawing.append(this.now);
    const stepAt = (/** @type {MouseEvent} */ event) => Math.min(Math.max(Math.round((event.offsetX / (drawing.clientWidth || 1)) * last), 0), last);
    drawing.addEventListener("pointermove", (event) => this.tell(stepAt(event)));
    drawing.addEventListener("pointerleave", () => this.tell(this.time));
    drawing.addEventListener("click", (event) => this.go(stepAt(event)));
    const range = `reward ${decimal(low)} to ${decimal(high)}, steps 0 to ${last}; a click goes to a step`;
    this.place.replaceChildren(drawing, element("small", { class: "quiet" }, range));
  }

  /** @param {number} time in scenes */
  seek(time) {
    this.time = time;
    this.tell(time);
  }

  /**
   * Marks a time and shows the values at it.
   * @param {number} time in scenes
   */
  tell(time) {
    this.now.setAttribute("x1", String(time));
    this.now.setAttribute("x2", String(time));
    const scene = this.scenes[Math.floor(time)];
    TERMS.forEach(([, value], i) => { this.values[i].textContent = value(scene).toFixed(2); });
  }
}
