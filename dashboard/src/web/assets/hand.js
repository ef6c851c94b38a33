// The hand of the user, which moves or knocks a block in the middle of an episode. The agent goes on from there.

import { element } from "./format.js";
import { add3 } from "./solid.js";

/** @import { Replay } from "./replay.js" */
/** @import { Stage } from "./stage.js" */
/** @import { Episode, Vector } from "./types" */
/** @import { View } from "./view.js" */

/** The server's limit for a displacement along an axis, meters. */
const MAX_MOVE_M = 2;

/** Shorter drags are clicks, meters. */
const MIN_MOVE_M = 0.02;

/** How a block that is knocked begins to move: away from the camera and up, meters per second. */
const [AWAY_MPS, UP_MPS] = [2.5, 1];

/**
 * @typedef {object} Parts
 * @property {HTMLElement} modes what the pointer does
 * @property {HTMLSelectElement} block the block for those without a pointer
 * @property {HTMLButtonElement} push knocks that block
 * @property {HTMLButtonElement} undo
 * @property {HTMLElement} text tells what was done
 */

export class Hand {
  /**
   * The block in the hand: whose picture, in which step, where the pointer took it, and how far it has moved it.
   * @type {{ view: View, block: number, step: number, from: [number, number], by: Vector } | null}
   */
  taken = null;

  /**
   * @param {Replay} replay
   * @param {Stage} stage
   * @param {Parts} parts
   */
  constructor(replay, stage, parts) {
    this.replay = replay;
    this.stage = stage;
    this.parts = parts;
    // The same capture as that of the camera, which begins later and finds itself switched off.
    for (const view of [replay.main, replay.beside]) {
      const { canvas } = view.parts;
      canvas.addEventListener("pointerdown", (event) => this.take(view, event));
      canvas.addEventListener("pointermove", (event) => this.drag(event));
      canvas.addEventListener("pointerup", () => this.release());
      canvas.addEventListener("pointercancel", () => this.drop());
    }
    parts.push.addEventListener("click", () => {
      const step = this.step(replay.main);
      // Without WebGL, there is no camera to knock it away from.
      if (step !== null && replay.main.space) this.knock(replay.main, Number(parts.block.value), step);
    });
    parts.undo.addEventListener("click", () => stage.calm());
    stage.played = (episodes) => this.tell(episodes);
  }

  /** Returns what the pointer does: `look`, `move`, or `push`. */
  mode() {
    return /** @type {HTMLInputElement} */ (this.parts.modes.querySelector("input:checked")).value;
  }

  /**
   * Stops the episode and returns the step in which it can be disturbed, or `null` with a reason.
   * @param {View} view
   */
  step(view) {
    const step = Math.floor(this.replay.time);
    const why = !this.stage.shown ? "This is a recording. Choose a blueprint to have an episode played."
      : step >= view.n ? "The episode has ended here. Go back to an earlier step." : null;
    this.parts.text.textContent = why || "";
    if (why) return null;
    this.replay.play(false);
    this.replay.seek(step);
    return step;
  }

  /**
   * @param {View} view
   * @param {PointerEvent} event
   */
  take(view, event) {
    if (this.mode() === "look" || !event.isPrimary || event.button !== 0 || !view.episode) return;
    const block = view.space.blockAt(event.offsetX, event.offsetY);
    const step = block === null ? null : this.step(view);
    if (step === null) return;
    this.taken = { view, block, step, from: [event.offsetX, event.offsetY], by: [0, 0, 0] };
    view.parts.canvas.setPointerCapture(event.pointerId);
    // The camera stays as it is meanwhile.
    view.space.controls.enabled = false;
  }

  /**
   * Moves the block in the plane that faces the camera, but not into the ground.
   * @param {PointerEvent} event
   */
  drag(event) {
    if (!this.taken || this.mode() !== "move") return;
    const { view, block, step, from } = this.taken;
    const place = view.episode.scenes[step].blocks[block];
    const lowest = Math.min(...view.episode.half_extents_m[block]) - place[2];
    const by = view.space.dragged(place.slice(0, 3), from, [event.offsetX, event.offsetY]);
    this.taken.by = by.map((v, k) => Math.min(Math.max(v, k === 2 ? Math.min(lowest, 0) : -MAX_MOVE_M), MAX_MOVE_M));
    view.moved = { block, by: this.taken.by };
    this.replay.draw();
  }

  /** Lets go of the block. Returns what was in the hand. */
  drop() {
    const { taken } = this;
    this.taken = null;
    if (!taken) return null;
    taken.view.space.controls.enabled = true;
    return taken;
  }

  /** Puts the block where it is, or knocks it. */
  release() {
    const taken = this.drop();
    if (!taken) return;
    const { view, block, step, by } = taken;
    if (this.mode() === "push") this.knock(view, block, step);
    else if (Math.hypot(...by) >= MIN_MOVE_M) this.stage.disturb(step, block, by, [0, 0, 0]);
    else {
      view.moved = null;
      this.replay.draw();
    }
  }

  /**
   * Knocks a block away from the camera.
   * @param {View} view
   * @param {number} block
   * @param {number} step
   */
  knock(view, block, step) {
    const place = view.episode.scenes[step].blocks[block];
    const away = add3(place.slice(0, 2).concat(0), view.space.stand().position.toArray().map((v, k) => (k === 2 ? 0 : -v)));
    const far = Math.hypot(...away) || 1;
    this.stage.disturb(step, block, [0, 0, 0], [(away[0] / far) * AWAY_MPS, (away[1] / far) * AWAY_MPS, UP_MPS]);
  }

  /**
   * Tells what was done to the blocks of an episode, and offers its blocks.
   * @param {Episode[]} episodes those that are shown; none if they cannot be disturbed
   */
  tell(episodes) {
    this.parts.push.disabled = episodes.length === 0;
    this.parts.undo.disabled = this.stage.disturbances.length === 0;
    this.parts.text.textContent = "";
    if (episodes.length === 0) return;
    const [{ names, goal, disturbances, scenes }] = episodes;
    const { value } = this.parts.block;
    this.parts.block.replaceChildren(...goal.map(([block]) => element("option", { value: String(block) }, names[block])));
    if (goal.some(([block]) => String(block) === value)) this.parts.block.value = value;
    const done = disturbances.map(([step, block]) => `step ${step}: ${names[block]}`);
    const left = this.stage.disturbances.length - disturbances.length;
    const late = left > 0 ? `${left} would come after the end, at step ${scenes.length - 1}` : "";
    this.parts.text.textContent = done.length > 0 ? `Disturbed at ${[...done, late].filter(Boolean).join(", ")}.` : late;
  }
}
