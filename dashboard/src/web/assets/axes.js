// How a block of a drawing lies: the grid directions of its own x and y axes, such as `+x +y`.

import { add3, cross3, dot3 } from "./solid.js";

/** @import { Vector } from "./types" */

/** @type {(name: string) => Vector} */
const axisOf = (name) => [0, 1, 2].map((k) => ("xyz"[k] === name[1] ? (name[0] === "+" ? 1 : -1) : 0));
/** @type {(axis: Vector) => string} */
const nameOf = (axis) => `${axis.some((v) => v > 0) ? "+" : "-"}${"xyz"[axis.findIndex((v) => v !== 0)]}`;

/**
 * Returns the images of the block's own x, y and z axes.
 * @param {string} axes
 */
export function imagesOf(axes) {
  const [x, y] = axes.split(" ").map(axisOf);
  return [x, y, cross3(x, y)];
}

/**
 * Returns the axes after a quarter turn about the axis `about`.
 * @param {string} axes
 * @param {Vector} about
 */
export function quarter(axes, about) {
  const turned = (/** @type {Vector} */ v) => add3(about.map((a) => a * dot3(about, v)), cross3(about, v));
  return axes.split(" ").map((name) => nameOf(turned(axisOf(name)).map(Math.round))).join(" ");
}

/**
 * Returns the rotation as a quaternion x, y, z, w.
 * @param {string} axes
 */
export function quaternionOf(axes) {
  const [x, y, z] = imagesOf(axes);
  const squares = [1 + x[0] - y[1] - z[2], 1 - x[0] + y[1] - z[2], 1 - x[0] - y[1] + z[2], 1 + x[0] + y[1] + z[2]];
  // Start from the largest component, then divide by it to get the others.
  const most = squares.indexOf(Math.max(...squares));
  const rows = [
    [squares[0], x[1] + y[0], x[2] + z[0], y[2] - z[1]],
    [x[1] + y[0], squares[1], y[2] + z[1], z[0] - x[2]],
    [x[2] + z[0], y[2] + z[1], squares[2], x[1] - y[0]],
    [y[2] - z[1], z[0] - x[2], x[1] - y[0], squares[3]],
  ];
  const length = 2 * Math.sqrt(squares[most]);
  return rows[most].map((v) => v / length);
}
