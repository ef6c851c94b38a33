// The magnets of a block: a disc per unit square of its surface, with a sign because not everyone can tell red from blue.

import { BufferAttribute, BufferGeometry, Color, Mesh, MeshLambertMaterial } from "./three.js";
import { turn } from "./solid.js";

/** @import { Pose, Rgb, Vector } from "./types" */

/** Colors of negative and positive magnets, as in the video clips. */
const MAGNETS = [[32, 82, 196], [208, 40, 46]];

/** Corners of a disc. */
const N_CORNERS = 20;

/** @param {Rgb} color */
export const rgb = ([r, g, b]) => new Color().setRGB(r / 255, g / 255, b / 255, "srgb");

/** The two other axes of the sides across an axis. @type {(axis: number) => [number, number]} */
const others = (axis) => [(axis + 1) % 3, (axis + 2) % 3];

/**
 * Returns the discs with their signs.
 * @param {Vector} half half the block's size, meters
 * @param {number} unit edge of a cell, meters
 * @param {number[]} flat for each axis, the axis along which a minus lies on the sides across it
 */
function discs(half, unit, flat) {
  /** @type {number[][]} */
  const [places, normals, colors] = [[], [], []];
  const corner = (/** @type {Vector} */ at, /** @type {Vector} */ out, /** @type {Color} */ color) => {
    places.push(...at);
    normals.push(...out);
    colors.push(color.r, color.g, color.b);
  };
  const white = rgb([255, 255, 255]);
  for (let axis = 0; axis < 3; axis += 1) {
    const [u, v] = others(axis);
    const cells = [u, v].map((i) => Math.round((2 * half[i]) / unit));
    for (const side of [-1, 1]) {
      const out = [0, 0, 0];
      out[axis] = side;
      const color = rgb(MAGNETS[side > 0 ? 1 : 0]);
      for (let cell = 0; cell < cells[0] * cells[1]; cell += 1) {
        const middle = [((cell % cells[0]) + 0.5) * unit - half[u], (Math.floor(cell / cells[0]) + 0.5) * unit - half[v]];
        /** @type {(a: number, b: number, lift: number) => Vector} */
        const at = (a, b, lift) => {
          const point = [0, 0, 0];
          [point[axis], point[u], point[v]] = [side * (half[axis] + lift), middle[0] + a * unit, middle[1] + b * unit];
          return point;
        };
        // Counterclockwise from outside.
        /** @type {(points: number[][], lift: number, paint: Color) => void} */
        const triangle = (points, lift, paint) =>
          (side > 0 ? points : [...points].reverse()).forEach(([a, b]) => corner(at(a, b, lift), out, paint));
        for (let i = 0; i < N_CORNERS; i += 1) {
          const [from, to] = [i, i + 1].map((k) => [0.2 * Math.cos((2 * Math.PI * k) / N_CORNERS), 0.2 * Math.sin((2 * Math.PI * k) / N_CORNERS)]);
          triangle([[0, 0], from, to], 0.0006, color);
        }
        const bar = (/** @type {number} */ w, /** @type {number} */ h) => {
          triangle([[-w, -h], [w, -h], [w, h]], 0.0012, white);
          triangle([[-w, -h], [w, h], [-w, h]], 0.0012, white);
        };
        if (side > 0 || flat[axis] === u) bar(0.12, 0.03);
        if (side > 0 || flat[axis] === v) bar(0.03, 0.12);
      }
    }
  }
  const geometry = new BufferGeometry();
  for (const [name, values] of Object.entries({ position: places, normal: normals, color: colors })) {
    geometry.setAttribute(name, new BufferAttribute(new Float32Array(values), 3));
  }
  return geometry;
}

export class Magnets extends Mesh {
  /** For each axis, the axis along which a minus lies on the sides across it. */
  flat = [1, 0, 0];

  /**
   * @param {Vector} half half the block's size, meters
   * @param {number} unit edge of a cell, meters
   */
  constructor(half, unit) {
    super(undefined, new MeshLambertMaterial({ vertexColors: true }));
    this.receiveShadow = true;
    this.half = half;
    this.unit = unit;
    this.draw();
  }

  draw() {
    this.geometry.dispose();
    this.geometry = discs(this.half, this.unit, this.flat);
  }

  /**
   * Lays every minus level, however its block lies: an upright one would look like a 1.
   * @param {Pose} pose of the block
   */
  level(pose) {
    const rise = [0, 1, 2].map((axis) => Math.abs(turn(pose.slice(3), [0, 1, 2].map((k) => Number(k === axis)))[2]));
    const flat = [0, 1, 2].map((axis) => {
      const [u, v] = others(axis);
      // On the top and the bottom either will do, and must not change with every tremor.
      return Math.max(rise[u], rise[v]) < 0.3 ? Math.min(u, v) : rise[u] < rise[v] ? u : v;
    });
    if (flat.join() === this.flat.join()) return;
    this.flat = flat;
    this.draw();
  }
}
