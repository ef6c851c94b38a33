// The grippers: a claw for each, which comes to its block, closes on it, opens and leaves, above a line to the floor.

import { BoxGeometry, Mesh, MeshLambertMaterial, Vector3 } from "./three.js";
import { turn } from "./solid.js";

/** @import { Color } from "./three.js" */
/** @import { Episode, Pose, Vector } from "./types" */

/** How far an open claw is from each side of its block, and how high it rises between two blocks, meters. */
const [OPEN_M, RISE_M] = [0.035, 0.12];

/** Thickness and length of a finger, meters. */
const [FINGER_M, FINGER_LENGTH_M] = [0.014, 0.07];

/**
 * How a claw is placed: `at` is the middle of the face that it comes from, `up` points out of that face, `across` from
 * finger to finger, and `gap` is half the distance of the fingers, meters.
 * @typedef {{ at: Vector3, up: Vector3, across: Vector3, gap: number }} Grip
 */

/**
 * Returns the grip on a block, from the side that is up, across its shorter width.
 * @param {Pose} pose
 * @param {Vector} half half its size, meters
 * @returns {Grip}
 */
function gripOn(pose, half) {
  const axes = [0, 1, 2].map((axis) => new Vector3().fromArray(turn(pose.slice(3), [0, 1, 2].map((k) => Number(k === axis)))));
  const [top, ...sides] = [0, 1, 2].sort((a, b) => Math.abs(axes[b].z) - Math.abs(axes[a].z));
  const up = axes[top].clone().multiplyScalar(axes[top].z < 0 ? -1 : 1);
  const narrow = sides.reduce((a, b) => (half[b] < half[a] ? b : a));
  return { at: new Vector3().fromArray(pose).addScaledVector(up, half[top]), up, across: axes[narrow], gap: half[narrow] };
}

/**
 * Returns the grip on the way from one to another, with the claw raised and open in between.
 * @param {Grip} from
 * @param {Grip} to
 * @param {number} share from 0 to 1
 * @returns {Grip}
 */
function onTheWay(from, to, share) {
  const away = Math.sin(Math.PI * share);
  const mix = (/** @type {"up" | "across"} */ name) => {
    // A finger is as good on the one side as on the other.
    const sign = name === "across" && from.across.dot(to.across) < 0 ? -1 : 1;
    return from[name].clone().multiplyScalar(1 - share).addScaledVector(to[name], sign * share).normalize();
  };
  const at = from.at.clone().lerp(to.at, share).add(new Vector3(0, 0, RISE_M * away));
  return { at, up: mix("up"), across: mix("across"), gap: from.gap + (to.gap - from.gap) * share + OPEN_M * away };
}

/** Returns the grip with the claw open and off the block. @type {(grip: Grip, rise: number) => Grip} */
const off = (grip, rise) => ({ ...grip, at: grip.at.clone().add(new Vector3(0, 0, rise)), gap: grip.gap + OPEN_M });

/** A part of a claw. @type {(x: number, y: number, z: number, paint: MeshLambertMaterial) => Mesh} */
const part = (x, y, z, paint) => new Mesh(new BoxGeometry(x, y, z), paint);

export class Gripper {
  /**
   * @param {number} index of the gripper
   * @param {Color} color
   */
  constructor(index, color) {
    this.index = index;
    this.color = color;
    const paint = new MeshLambertMaterial({ color });
    const faint = new MeshLambertMaterial({ color, transparent: true, opacity: 0.55 });
    // The palm lies in its own x and y, its fingers point down, and they move along y.
    this.claw = part(0.03, 1, 0.016, paint);
    this.fingers = [-1, 1].map(() => part(0.03, FINGER_M, FINGER_LENGTH_M, paint));
    this.stem = part(0.014, 0.014, 0.34, paint);
    this.line = part(0.004, 0.004, 1, faint);
    this.foot = part(0.05, 0.05, 0.002, faint);
    this.parts = [this.claw, ...this.fingers, this.stem, this.line, this.foot];
    for (const mesh of [this.claw, ...this.fingers, this.stem]) mesh.castShadow = true;
  }

  /**
   * Returns the grip at a time, in scenes; `null` if the gripper never holds a block.
   * @param {Episode} episode
   * @param {Pose[]} poses of the blocks at that time
   * @param {number} time
   * @returns {Grip | null}
   */
  at({ scenes, half_extents_m: halves }, poses, time) {
    const held = (/** @type {number} */ scene) => scenes[scene]?.held[this.index] ?? null;
    let [before, after] = [Math.floor(time), Math.ceil(time)];
    while (before >= 0 && held(before) === null) before -= 1;
    while (after < scenes.length && held(after) === null) after += 1;
    const [left, next] = [held(before), held(after)];
    const on = (/** @type {number} */ block) => gripOn(poses[block], halves[block]);
    if (left === null && next === null) return null;
    if (left === null) return off(on(next), Math.min(0.1 * (after - time), 3 * RISE_M));
    if (next === null) return off(gripOn(scenes[before].blocks[left], halves[left]), Math.min(0.1 * (time - before), 3 * RISE_M));
    if (left === next && after - before <= 1) return on(left);
    return onTheWay(gripOn(scenes[before].blocks[left], halves[left]), on(next), (time - before) / (after - before));
  }

  /**
   * Moves the claw to a grip; `null` hides it.
   * @param {Grip | null} grip
   */
  show(grip) {
    for (const mesh of this.parts) mesh.visible = grip !== null;
    if (!grip) return;
    const up = grip.up.clone().normalize();
    const across = grip.across.clone().addScaledVector(up, -grip.across.dot(up)).normalize();
    const along = across.clone().cross(up);
    /** @type {(mesh: Mesh, side: number, height: number) => void} */
    const set = (mesh, side, height) => {
      mesh.quaternion.setFromRotationMatrix(mesh.matrix.makeBasis(along, across, up));
      mesh.position.copy(grip.at).addScaledVector(across, side).addScaledVector(up, height);
    };
    set(this.claw, 0, 0.02);
    this.claw.scale.y = 2 * (grip.gap + FINGER_M);
    this.fingers.forEach((finger, i) => set(finger, (i === 0 ? -1 : 1) * (grip.gap + FINGER_M / 2), 0.028 - FINGER_LENGTH_M / 2));
    set(this.stem, 0, 0.02 + 0.17);
    const { x, y, z } = grip.at;
    this.line.position.set(x, y, z / 2);
    this.line.scale.z = Math.max(z, 0.001);
    this.foot.position.set(x, y, 0.002);
  }
}
