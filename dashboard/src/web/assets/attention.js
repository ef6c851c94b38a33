// The network's attention over an episode: a strip of the goal's blocks over time, and shading of the blocks.

import { address } from "./address.js";
import { element, svg } from "./format.js";

/** @import { Attended, Episode, Rgb } from "./types" */

/** Color scale from 0 to 50 % or more attention, as in the video clips. */
const SHADES = [[240, 242, 246], [247, 164, 66], [140, 14, 84]];

/**
 * Returns the color of a block with this attention.
 * @param {number} percent
 * @returns {Rgb}
 */
export function shade(percent) {
  const at = Math.min(percent / 50, 1) * (SHADES.length - 1);
  const low = Math.min(Math.floor(at), SHADES.length - 2);
  return SHADES[low].map((x, i) => Math.round(x + (SHADES[low + 1][i] - x) * (at - low)));
}

/**
 * @typedef {object} Parts
 * @property {HTMLElement} part holds the choice, and is hidden without attention
 * @property {HTMLSelectElement} choice the source
 * @property {HTMLElement} strip
 * @property {HTMLElement} note
 */

export class Attention {
  /** @type {Attended | null} */
  attention = null;
  /**
   * The goal's blocks.
   * @type {number[]}
   */
  blocks;
  /** @type {Rgb[]} */
  colors;
  /**
   * Marks the time in the strip.
   * @type {SVGLineElement}
   */
  now;

  /**
   * @param {Parts} parts
   * @param {() => void} changed called when the user selects another source
   */
  constructor(parts, changed) {
    this.parts = parts;
    parts.choice.addEventListener("change", () => {
      address.set({ eye: parts.choice.value === "-1" ? null : parts.choice.value });
      this.draw();
      changed();
    });
  }

  /** @param {Episode} episode */
  show(episode) {
    this.attention = episode.attention;
    this.parts.part.hidden = !this.attention;
    if (!this.attention) return;
    this.blocks = episode.goal.map(([block]) => block);
    this.colors = episode.colors;
    const options = ["off", ...this.attention.sources].map((name, i) => element("option", { value: String(i - 1) }, name));
    this.parts.choice.replaceChildren(...options);
    this.parts.note.textContent = `Attention of weights ${this.attention.weights_version}, no matter who acted. Each row is a block of the goal; the last row is all others.`;
    this.restore();
  }

  /** Selects the source that the address names. */
  restore() {
    if (!this.attention) return;
    const source = Number(address.get("eye") ?? -1);
    this.parts.choice.value = this.attention.sources[source] ? String(source) : "-1";
    this.draw();
  }

  /**
   * Returns the attention of the selected source in percent by block, or `null` if none is selected.
   * @param {number} time in scenes
   */
  at(time) {
    const source = Number(this.parts.choice.value);
    return this.attention && source >= 0 ? this.attention.percent[source][Math.floor(time)] : null;
  }

  /**
   * Returns the block that each block attends to most by the selected source, or else by the mean over the heads of the
   * last layer, and the percent, if it tells.
   * @param {number} time in scenes
   */
  most(time) {
    return this.attention?.most.at(Number(this.parts.choice.value))?.[Math.floor(time)] || null;
  }

  draw() {
    const source = Number(this.parts.choice.value);
    this.parts.strip.hidden = source < 0;
    if (source < 0) return;
    const scenes = this.attention.percent[source];
    const rest = (/** @type {number[]} */ scene) => scene.reduce((sum, x, block) => sum + (this.blocks.includes(block) ? 0 : x), 0);
    const rows = [...this.blocks.map((block) => (/** @type {number[]} */ scene) => scene[block]), rest];
    const last = scenes.length - 1;
    const label = `Attention of ${this.attention.sources[source]} over ${last} steps`;
    const whole = { preserveAspectRatio: "none", role: "img" };
    const names = svg("svg", { ...whole, class: "names", viewBox: `0 0 1 ${rows.length}`, "aria-label": "Colors of the rows' blocks" });
    const drawing = svg("svg", { ...whole, viewBox: `0 0 ${last} ${rows.length}`, "aria-label": label });
    rows.forEach((share, row) => {
      const color = this.blocks[row] === undefined ? [128, 128, 128] : this.colors[this.blocks[row]];
      names.append(svg("rect", { x: 0, y: row + 0.1, width: 1, height: 0.8, fill: `rgb(${color.join(",")})` }));
      // Around its step, as in the chart of rewards below.
      scenes.forEach((scene, step) => {
        drawing.append(svg("rect", { x: step - 0.5, y: row, width: 1.02, height: 1.02, fill: `rgb(${shade(share(scene)).join(",")})` }));
      });
    });
    this.now = svg("line", { class: "now", y1: 0, y2: rows.length });
    drawing.append(this.now);
    this.parts.strip.style.height = `${Math.min(rows.length * 14, 160)}px`;
    this.parts.strip.replaceChildren(names, drawing);
  }

  /** @param {number} time in scenes */
  seek(time) {
    if (!this.attention || Number(this.parts.choice.value) < 0) return;
    this.now.setAttribute("x1", String(Math.floor(time)));
    this.now.setAttribute("x2", String(Math.floor(time)));
  }
}
