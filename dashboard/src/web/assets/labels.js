// The label of the block under the pointer: its type, who holds it, and its connections.

import { joined } from "./verdict.js";

/** @import { View } from "./view.js" */

/**
 * Describes a block at the shown moment.
 * @param {View} view
 * @param {number} block
 */
function describe({ episode, time, attention, most }, block) {
  const scene = episode.scenes[Math.floor(time)];
  const cells = episode.half_extents_m[block].map((half) => Math.round((2 * half) / episode.unit_m));
  const gripper = scene.held.indexOf(block);
  const all = joined(scene, block);
  const wrong = all.filter(([, , isRight]) => !isRight).length;
  const wanted = episode.links.filter((pair) => pair.includes(block)).length;
  return [
    `${episode.names[block]}, ${cells.join("×")}`,
    gripper < 0 ? "" : `held by gripper ${gripper + 1}`,
    wanted > 0 ? `${all.length - wrong} of ${wanted} ${wanted === 1 ? "connection" : "connections"}` : "not part of the goal",
    wrong > 0 ? `${wrong} wrong` : "",
    attention ? `${Math.round(attention[block])} % of the attention` : "",
    most ? `attends most to ${episode.names[most[block][0]]} (${most[block][1]} %)` : "",
  ].filter(Boolean).join(" · ");
}

export class Label {
  /** Where the pointer is on the canvas, pixels. @type {[number, number] | null} */
  at = null;

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {HTMLElement} label
   * @param {View} view
   */
  constructor(canvas, label, view) {
    this.label = label;
    this.view = view;
    canvas.addEventListener("pointermove", (event) => this.point(event.buttons === 0 ? [event.offsetX, event.offsetY] : null));
    // A finger does not hover.
    canvas.addEventListener("click", (event) => this.point([event.offsetX, event.offsetY]));
    canvas.addEventListener("pointerleave", (event) => { if (event.pointerType === "mouse") this.point(null); });
  }

  /** @param {[number, number] | null} at */
  point(at) {
    this.at = at;
    this.draw();
  }

  /** Labels what is under the pointer now. */
  draw() {
    const block = this.at && this.view.episode ? this.view.space.blockAt(...this.at) : null;
    this.label.hidden = block === null;
    if (block === null) return;
    this.label.textContent = describe(this.view, block);
    const room = this.label.parentElement.clientWidth - this.label.offsetWidth;
    this.label.style.left = `${Math.max(Math.min(this.at[0] + 14, room), 0)}px`;
    this.label.style.top = `${this.at[1] + 16}px`;
  }
}
