// A camera that follows the construction: the box that it shows at each scene, from the goal's blocks and its location.

import { apart3, placed } from "./solid.js";

/** @import { Box, Episode, Pose, Scene, Vector } from "./types" */

/** Loose blocks farther than this (meters) from the middle of the goal's blocks may be out of view, as in videos. */
const REACH_M = 1.6;

/** Blocks farther than this from the origin have fallen off the world, meters. */
const WORLD_M = 10;

/** Returns the corner with the lowest or highest coordinates. @type {(pick: (...all: number[]) => number, points: Vector[]) => Vector} */
const corner = (pick, points) => [0, 1, 2].map((i) => pick(...points.map((point) => point[i])));

/** Returns the box around points, and what is near them, meters. @type {(points: Vector[], half: number) => Box} */
const around = (points, half) => [corner(Math.min, points).map((x) => x - half), corner(Math.max, points).map((x) => x + half)];

/** @type {(boxes: Box[]) => Box} */
const union = (boxes) => [corner(Math.min, boxes.map(([low]) => low)), corner(Math.max, boxes.map(([, high]) => high))];

/**
 * Returns the box around the goal's blocks.
 * @param {Episode} episode
 * @param {Pose[]} poses
 */
export const boxAround = ({ goal, half_extents_m: halves }, poses) => union(goal.map(([block]) => around([poses[block]], Math.max(...halves[block]))));

/** Number of scenes over which the camera movement is smoothed. */
export const FOLLOW_STEPS = 14;

export class Follow {
  /**
   * What the camera shows at each scene and while it settles.
   * @type {Box[]}
   */
  boxes;

  /** @param {Episode} episode */
  constructor({ goal, scenes, half_extents_m: halves }) {
    /** @type {(scene: Scene) => Box} */
    const place = ({ goal_frame: frame }) => around(goal.map(([, pose]) => placed(frame, pose)), 0.1);
    const needed = scenes.map((scene) => {
      const median = [0, 1].map((i) => goal.map(([block]) => scene.blocks[block][i]).sort((a, b) => a - b)[goal.length >> 1]);
      const wanted = goal.filter(([block, pose]) => {
        const at = scene.blocks[block];
        const isNear = [0, 1].every((i) => Math.abs(at[i] - median[i]) < REACH_M);
        const isBuilt = apart3(at, placed(scene.goal_frame, pose)) < 0.02;
        // A policy in training may throw blocks far away. Blocks that are in place or held stay in view.
        return [0, 1, 2].every((i) => Math.abs(at[i]) < WORLD_M) && (isNear || isBuilt || scene.held.includes(block));
      });
      const boxes = wanted.map(([block]) => around([scene.blocks[block]], Math.max(...halves[block])));
      // Until blocks are connected, the location of the goal is undetermined.
      return union(scene.n_connected > 0 || boxes.length === 0 ? [place(scene), ...boxes] : boxes);
    });
    // Zooms out before a block needs room and zooms in slowly: each box is a mean of boxes that all contain what its
    // scene needs.
    const ahead = needed.map((_, i) => union(needed.slice(i, i + FOLLOW_STEPS + 1)));
    const last = scenes.length - 1;
    const at = (/** @type {number} */ i) => ahead[Math.min(Math.max(i, 0), last)];
    this.boxes = Array.from({ length: scenes.length + FOLLOW_STEPS }, (_, i) => {
      const before = Array.from({ length: FOLLOW_STEPS + 1 }, (__, back) => at(i - back));
      return [0, 1].map((side) => [0, 1, 2].map((axis) => before.reduce((sum, box) => sum + box[side][axis], 0) / before.length));
    });
  }

  /**
   * Returns the box to show.
   * @param {number} time in scenes; beyond the last while the camera settles
   * @returns {Box}
   */
  at(time) {
    const last = this.boxes.length - 1;
    if (time >= last) return this.boxes[last];
    const from = Math.floor(time);
    const to = from + 1;
    return [0, 1].map((side) => this.boxes[from][side].map((x, i) => x + (this.boxes[to][side][i] - x) * (time - from)));
  }
}
