// Poses: seven numbers, position in meters and quaternion x, y, z, w.

/** @import { Pose, Vector } from "./types" */

/** @type {(a: Vector, b: Vector) => Vector} */
export const add3 = (a, b) => a.map((x, i) => x + b[i]);
/** @type {(a: Vector, b: Vector) => number} */
export const dot3 = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @type {(a: Vector, b: Vector) => Vector} */
export const cross3 = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/**
 * Returns the distance of two points or poses.
 * @type {(a: Vector | Pose, b: Vector | Pose) => number}
 */
export const apart3 = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);

/**
 * Rotates `v` by the unit quaternion x, y, z, w.
 * @param {number[]} q
 * @param {Vector} v
 */
export function turn(q, v) {
  const t = cross3(q, v).map((x) => 2 * x);
  return add3(add3(v, t.map((x) => x * q[3])), cross3(q, t));
}

/**
 * Converts pose `b` from the frame of `a` to the frame in which `a` is given.
 * @param {Pose} a
 * @param {Pose} b
 * @returns {Pose}
 */
export function placed(a, b) {
  const [p, q] = [a.slice(3), b.slice(3)];
  const vector = add3(add3(cross3(p, q), q.slice(0, 3).map((x) => x * p[3])), p.slice(0, 3).map((x) => x * q[3]));
  return [...add3(a.slice(0, 3), turn(p, b.slice(0, 3))), ...vector, p[3] * q[3] - dot3(p, q)];
}

/**
 * Interpolates from pose `a` to pose `b`.
 * @param {Pose} a
 * @param {Pose} b
 * @param {number} share from 0 for `a` to 1 for `b`
 * @returns {Pose}
 */
export function between(a, b, share) {
  const sign = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6] < 0 ? -1 : 1;
  const mixed = a.map((x, i) => x + ((i < 3 ? b[i] : sign * b[i]) - x) * share);
  const length = Math.hypot(...mixed.slice(3)) || 1;
  return mixed.map((x, i) => (i < 3 ? x : x / length));
}

/**
 * Returns where a ray enters a box: `t` along the ray, and the `axis` of the side that it crosses; `null` if it misses.
 * @param {Vector} from
 * @param {Vector} way
 * @param {Vector} low the box's lowest corner
 * @param {Vector} high its highest corner
 */
export function entry(from, way, low, high) {
  // The ray is inside the box where it is between both planes of all three axes.
  let [enter, leave, axis] = [0, Infinity, -1];
  for (let k = 0; k < 3; k += 1) {
    const [a, b] = [low[k], high[k]].map((plane) => (plane - from[k]) / way[k]);
    if (Math.min(a, b) > enter) [enter, axis] = [Math.min(a, b), k];
    leave = Math.min(leave, Math.max(a, b));
  }
  return axis < 0 || enter >= leave ? null : { t: enter, axis };
}
