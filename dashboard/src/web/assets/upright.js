// The finished structure, turned upright: it is built lying on the side on which it stands most firmly.

import { add3, between, cross3, placed, turn } from "./solid.js";

/** @import { Episode, Pose, Vector } from "./types" */

/** @type {Pose} */
const UNTURNED = [0, 0, 0, 0, 0, 0, 1];

/**
 * Returns how far a block reaches up from its middle, meters.
 * @param {Pose} pose
 * @param {Vector} half half its size, meters
 */
const reach = (pose, half) => [[1, 0, 0], [0, 1, 0], [0, 0, 1]].reduce((sum, axis, k) => sum + Math.abs(turn(pose.slice(3), axis)[2]) * half[k], 0);

/**
 * Returns the turn that brings a direction up, the shortest one.
 * @param {Vector} direction of length 1
 * @returns {Pose}
 */
function toward(direction) {
  const [x, y, z, w] = direction[2] < -0.999 ? [1, 0, 0, 0] : [...cross3(direction, [0, 0, 1]), 1 + direction[2]];
  const length = Math.hypot(x, y, z, w);
  return [0, 0, 0, x / length, y / length, z / length, w / length];
}

/**
 * Turns the goal's blocks together and keeps them on the ground.
 * @param {Pose[]} poses of all blocks
 * @param {Episode} episode
 * @param {Pose} frame of the goal
 * @param {number} share of the way, from 0 to 1
 * @returns {Pose[]}
 */
export function upright(poses, { goal, half_extents_m: halves }, frame, share) {
  const way = between(UNTURNED, toward(turn(frame.slice(3), [0, 0, 1])), share);
  const places = goal.map(([block]) => poses[block].slice(0, 3));
  const middle = places.reduce(add3).map((v) => v / places.length);
  const turned = goal.map(([block], i) => placed(way, [...add3(places[i], middle.map((v) => -v)), ...poses[block].slice(3)]));
  const lowest = Math.min(...goal.map(([block], i) => turned[i][2] - reach(turned[i], halves[block])));
  const all = [...poses];
  goal.forEach(([block], i) => {
    all[block] = [...add3(turned[i].slice(0, 3), [middle[0], middle[1], -lowest]), ...turned[i].slice(3)];
  });
  return all;
}
