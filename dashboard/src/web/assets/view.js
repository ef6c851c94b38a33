// One picture of an episode: its world at a time, the label of the block under the pointer, and the verdict.

import { FOLLOW_STEPS, Follow, boxAround } from "./follow.js";
import { Label } from "./labels.js";
import { add3, apart3, between, placed } from "./solid.js";
import { upright } from "./upright.js";
import { verdict } from "./verdict.js";

/** @import { Space } from "./space.js" */
/** @import { Episode, Rgb, Vector } from "./types" */

/** @type {Promise<typeof import("./space.js")> | null} */
let spaceModule = null;

/** Loads the 3D module once, with the first episode. */
const loadSpace = () => (spaceModule ||= import("./space.js").catch((error) => {
  // It may not have come through, and the next episode asks again.
  spaceModule = null;
  throw error;
}));

/**
 * @typedef {object} Parts
 * @property {HTMLElement} figure holds the parts below
 * @property {HTMLElement} caption tells who builds
 * @property {HTMLCanvasElement} canvas
 * @property {HTMLElement} label tells the block under the pointer
 * @property {HTMLElement} verdict tells whether the goal is built
 */

export class View {
  /**
   * The world in 3D, once there is an episode.
   * @type {Space}
   */
  space;
  /** @type {Episode} */
  episode;
  /** Steps of the episode. */
  n = 0;
  /** @type {Follow} */
  follow;
  /** The shown moment, in scenes. */
  time = 0;
  /** How long ago the episode ended, in scenes, while a longer one plays on. */
  over = 0;
  /**
   * The attention on each block in percent, if it is to be shown.
   * @type {number[] | null}
   */
  attention = null;
  /**
   * The block that each block attends to most, and the percent.
   * @type {[number, number][] | null}
   */
  most = null;

  /**
   * The block that the user moves right now, and how far, meters.
   * @type {{ block: number, by: Vector } | null}
   */
  moved = null;

  /** @param {Parts} parts */
  constructor(parts) {
    this.parts = parts;
    this.label = new Label(parts.canvas, parts.label, this);
  }

  /**
   * Creates the 3D scene; throws if the browser has no WebGL.
   * @param {() => void} moved called when the user begins to move the camera
   * @param {() => void} stopped called when the user has moved it
   */
  async prepare(moved, stopped) {
    if (this.space) return;
    const { Space } = await loadSpace();
    this.space ||= new Space(this.parts.canvas, moved, stopped);
  }

  /** @param {Episode} episode */
  load(episode) {
    [this.episode, this.moved] = [episode, null];
    this.n = episode.scenes.length - 1;
    this.follow = new Follow(episode);
    this.space.load(episode);
    this.parts.caption.textContent = episode.caption || episode.actor;
  }

  /** Returns the middle of what the camera shows at the end, meters. */
  middle() {
    const [low, high] = this.follow.at(Infinity);
    return low.map((v, k) => (v + high[k]) / 2);
  }

  /**
   * Fits the drawing to the canvas, whose height is to be this. Takes effect at the next render.
   * @param {string} height as a style
   */
  size(height) {
    this.parts.canvas.style.height = height;
    this.space.resize(this.parts.canvas.clientWidth, this.parts.canvas.clientHeight);
  }

  /**
   * Tells what the episode has come to.
   * @param {number} time in scenes
   */
  tell(time) {
    this.time = Math.min(time, this.n);
    this.over = time - this.time;
    const { kind, text } = verdict(this.episode, Math.floor(this.time));
    this.parts.verdict.className = `verdict ${kind}`;
    // Read out only once it stands.
    this.parts.verdict.setAttribute("aria-live", kind === "open" ? "off" : "polite");
    this.parts.verdict.textContent = text;
  }

  /**
   * Draws the world at the time that was told.
   * @param {number} after how far the camera has settled after the end, in scenes
   * @param {{ follows: boolean, hasGhosts: boolean, shades: Rgb[] | null }} how whether the camera follows, whether to
   * show where the goal takes shape, and the blocks' colors instead of their own
   */
  draw(after, { follows, hasGhosts, shades }) {
    const { episode, space, time } = this;
    const [low, high] = [Math.floor(time), Math.min(Math.floor(time) + 1, this.n)];
    const [from, to, share] = [episode.scenes[low], episode.scenes[high], time - low];
    const built = from.blocks.map((pose, block) => between(pose, to.blocks[block], share));
    // What is built turns upright while the camera settles.
    const turned = time === this.n && episode.end === "success" ? Math.min((this.over + after) / FOLLOW_STEPS, 1) : 0;
    const poses = turned > 0 ? upright(built, episode, from.goal_frame, turned) : built;
    if (this.moved) poses[this.moved.block] = [...add3(poses[this.moved.block].slice(0, 3), this.moved.by), ...poses[this.moved.block].slice(3)];
    // The frame jumps when another piece becomes the largest. Interpolate only smaller movements.
    const frame = apart3(from.goal_frame, to.goal_frame) < 0.5 ? between(from.goal_frame, to.goal_frame, share) : from.goal_frame;
    const ghosts = episode.goal.map(([block, pose]) => {
      const there = placed(frame, pose);
      return hasGhosts && turned === 0 && apart3(poses[block], there) > 0.02 ? there : null;
    });
    if (follows) {
      const box = this.follow.at(time + this.over + after);
      const end = turned > 0 ? boxAround(episode, poses) : box;
      const [lowest, highest] = box.map((corner, side) => corner.map((v, k) => v + (end[side][k] - v) * turned));
      space.fit(lowest, highest);
    }
    space.show(poses, turned > 0 ? null : time, turned > 0 ? [] : from.held, shades, ghosts);
    this.label.draw();
  }
}
