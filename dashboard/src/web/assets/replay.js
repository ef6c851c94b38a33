// The episode player: play, scrub and step; drag, pinch or press keys to move the camera.

import { shade } from "./attention.js";
import { $ } from "./format.js";
import { NO_ANSWER, answerAt, model } from "./model.js";
import { apart3, between, placed } from "./solid.js";

/** @import { Attention } from "./attention.js" */
/** @import { Space } from "./space.js" */
/** @import { Terms } from "./terms.js" */
/** @import { Box, Episode, Video, Scene, Vector } from "./types" */

/** @type {Promise<typeof import("./space.js")> | null} */
let spaceModule = null;

/** Loads the 3D module once, with the first episode. */
const loadSpace = () => (spaceModule ||= import("./space.js").catch((error) => {
  // It may not have come through, and the next episode asks again.
  spaceModule = null;
  throw error;
}));

/** Loose blocks farther than this (meters) from the middle of the goal's blocks may be out of view, as in clips. */
const REACH_M = 1.6;

/** Blocks farther than this from the origin have fallen off the world, meters. */
const WORLD_M = 10;

/** Number of scenes over which the camera movement is smoothed. */
const FOLLOW_STEPS = 14;

/**
 * @typedef {object} Parts
 * @property {HTMLElement} player holds the parts below, and is hidden until there is an episode
 * @property {HTMLCanvasElement} canvas
 * @property {HTMLInputElement} slider
 * @property {HTMLElement} playButton
 * @property {HTMLElement} back
 * @property {HTMLElement} forth
 * @property {HTMLElement} fitButton
 * @property {HTMLElement} fullButton
 * @property {HTMLSelectElement} speedChoice
 * @property {HTMLInputElement} ghost whether to show where the goal takes shape
 * @property {HTMLElement} text tells the step
 * @property {HTMLElement} note
 * @property {Terms} terms
 * @property {Attention} attention
 */

export class Replay {
  /** The shown moment, in scenes. */
  time = 0;
  /** How far the camera has settled after the end, in scenes. */
  after = 0;
  playing = false;
  speed = 1;
  /** Of the player, pixels. */
  width = 0;
  /** Whether the camera follows the construction. */
  follows = true;
  /**
   * The view in 3D, once there is an episode.
   * @type {Space}
   */
  space;
  /** @type {Episode} */
  episode;
  /** Steps of the episode. */
  n = 0;
  /**
   * What the camera shows at each scene and while it settles.
   * @type {Box[]}
   */
  boxes = [];
  /** @type {(() => void) | undefined} */
  ended;

  /** @param {Parts} parts */
  constructor(parts) {
    this.parts = parts;
    this.parts.canvas.addEventListener("keydown", (event) => this.key(event));
    this.parts.canvas.addEventListener("dblclick", () => this.fit());
    this.parts.playButton.addEventListener("click", () => this.play(!this.playing));
    this.parts.back.addEventListener("click", () => this.step(-1));
    this.parts.forth.addEventListener("click", () => this.step(1));
    this.parts.fitButton.addEventListener("click", () => this.fit());
    this.parts.fullButton.addEventListener("click", () => this.full());
    this.parts.speedChoice.addEventListener("change", () => { this.speed = Number(this.parts.speedChoice.value); });
    this.parts.ghost.addEventListener("change", () => this.draw());
    this.parts.slider.addEventListener("input", () => {
      this.play(false);
      this.seek(Number(this.parts.slider.value));
    });
    document.addEventListener("fullscreenchange", () => this.resize());
    new ResizeObserver(([entry]) => {
      // Ignore height changes: `size` causes them.
      if (Math.abs(entry.contentRect.width - this.width) < 1) return;
      this.width = entry.contentRect.width;
      this.resize();
    }).observe(this.parts.player);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      if (!this.space) return;
      this.space.theme();
      this.draw();
    });
  }

  /** Creates the 3D scene. If that fails, shows why and returns false. */
  async prepare() {
    if (this.space) return true;
    try {
      const { Space } = await loadSpace();
      this.space ||= new Space(this.parts.canvas, () => { this.follows = false; });
      return true;
    } catch {
      this.parts.note.textContent = "This browser cannot draw in 3D (WebGL is off or missing), or the program does not answer. The videos below do not need WebGL.";
      return false;
    }
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    /** @type {Record<string, [number, number]>} */
    const keys = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (!this.space) return;
    if (keys[event.key]) this.space.turn(...keys[event.key]);
    else if (event.key === "+" || event.key === "-") {
      this.follows = false;
      this.space.near(event.key === "+" ? 1.15 : 0.87);
    }
    else if (event.key === " ") this.play(!this.playing);
    else if (event.key === "f") this.full();
    else if (event.key === "0") this.fit();
    else if (event.key === ",") this.step(-1);
    else if (event.key === ".") this.step(1);
    else return;
    event.preventDefault();
  }

  /**
   * Shows an episode from its start and calls `ended` when playback reaches its end.
   * @param {Episode} episode
   * @param {() => void} [ended]
   */
  show(episode, ended) {
    this.play(false);
    [this.episode, this.ended] = [episode, ended];
    this.n = episode.scenes.length - 1;
    this.parts.slider.max = String(this.n);
    this.space.load(episode);
    this.parts.terms.show(episode);
    this.parts.attention.show(episode);
    this.plan();
    this.size();
    this.follows = true;
    this.seek(0);
    this.play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  }

  /** Makes the camera follow the construction again. */
  fit() {
    if (!this.episode) return;
    this.follows = true;
    this.draw();
  }

  /** Computes the box to show at each scene and while the camera settles: the goal's blocks and its location. */
  plan() {
    const { goal, scenes, half_extents_m: halves } = this.episode;
    /** @type {(pick: (...all: number[]) => number, points: Vector[]) => Vector} */
    const corner = (pick, points) => [0, 1, 2].map((i) => pick(...points.map((point) => point[i])));
    /** @type {(points: Vector[], half: number) => Box} */
    const around = (points, half) => [corner(Math.min, points).map((x) => x - half), corner(Math.max, points).map((x) => x + half)];
    /** @type {(boxes: Box[]) => Box} */
    const union = (boxes) => [corner(Math.min, boxes.map(([low]) => low)), corner(Math.max, boxes.map(([, high]) => high))];
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
    const at = (/** @type {number} */ i) => ahead[Math.min(Math.max(i, 0), this.n)];
    this.boxes = Array.from({ length: this.n + 1 + FOLLOW_STEPS }, (_, i) => {
      const before = Array.from({ length: FOLLOW_STEPS + 1 }, (__, back) => at(i - back));
      return [0, 1].map((side) => [0, 1, 2].map((axis) => before.reduce((sum, box) => sum + box[side][axis], 0) / before.length));
    });
  }

  /**
   * Returns the box to show.
   * @param {number} time in scenes; beyond the last while the camera settles
   * @returns {Box}
   */
  view(time) {
    const from = Math.min(Math.floor(time), this.boxes.length - 1);
    const to = Math.min(from + 1, this.boxes.length - 1);
    return [0, 1].map((side) => this.boxes[from][side].map((x, i) => x + (this.boxes[to][side][i] - x) * (time - from)));
  }

  /** Moves the camera close to the finished structure once playback has ended. */
  settle() {
    const episode = this.episode;
    /** @type {number | null} */
    let before = null;
    const frame = (/** @type {number} */ now) => {
      if (this.episode !== episode || this.playing || this.time < this.n || this.after >= FOLLOW_STEPS) return;
      this.after = Math.min(this.after + (before === null ? 0 : (now - before) / 1000 / episode.step_s), FOLLOW_STEPS);
      before = now;
      this.draw();
      requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  /** Fits the canvas to the available space. Takes effect at the next render. */
  size() {
    const width = this.parts.canvas.clientWidth;
    if (width === 0) return;
    this.width = width;
    const isFull = this.parts.player.classList.contains("full") || document.fullscreenElement === this.parts.player;
    if (isFull) this.parts.canvas.style.height = "";
    else this.parts.canvas.style.height = `${Math.round(Math.min(Math.max(width * 0.56, 300), 560, window.innerHeight * 0.66))}px`;
    this.space.resize(width, this.parts.canvas.clientHeight);
  }

  resize() {
    if (!this.space || !this.episode) return;
    this.size();
    this.draw();
  }

  /** Toggles full screen, or fills the browser window where full screen is unsupported. */
  full() {
    if (document.fullscreenElement) document.exitFullscreen();
    else if (this.parts.player.requestFullscreen) this.parts.player.requestFullscreen().catch(() => {});
    else this.parts.player.classList.toggle("full");
    this.resize();
  }

  /** @param {1 | -1} by */
  step(by) {
    this.play(false);
    this.seek(Math.min(Math.max((by > 0 ? Math.floor(this.time) : Math.ceil(this.time)) + by, 0), this.n));
  }

  /** @param {number} time in scenes */
  seek(time) {
    [this.time, this.after] = [time, 0];
    const at = Math.floor(time);
    this.parts.slider.value = String(at);
    const scene = this.episode.scenes[at];
    this.parts.slider.setAttribute("aria-valuetext", `step ${at} of ${this.n}`);
    const end = this.n === at ? `, ${this.episode.end}` : "";
    this.parts.text.textContent = `step ${at} of ${this.n}, ${scene.n_connected} ${scene.n_connected === 1 ? "connection" : "connections"}, reward ${scene.reward.toFixed(2)}${end}`;
    this.parts.terms.seek(time);
    this.parts.attention.seek(time);
    this.draw();
  }

  /** @param {boolean} on */
  play(on) {
    const was = this.playing;
    this.playing = on && Boolean(this.episode);
    this.parts.playButton.textContent = this.playing ? "Pause" : "Play";
    if (!this.playing || was) return;
    if (this.time >= this.n) this.time = 0;
    /** @type {number | null} */
    let before = null;
    const episode = this.episode;
    const frame = (/** @type {number} */ now) => {
      if (!this.playing || this.episode !== episode) return;
      const time = this.time + (before === null ? 0 : ((now - before) / 1000 / episode.step_s) * this.speed);
      before = now;
      this.seek(Math.min(time, this.n));
      if (this.time < this.n) {
        requestAnimationFrame(frame);
        return;
      }
      this.play(false);
      this.settle();
      if (this.ended) this.ended();
    };
    requestAnimationFrame(frame);
  }

  draw() {
    const { episode, space } = this;
    if (!episode || !space) return;
    const [low, high] = [Math.floor(this.time), Math.min(Math.floor(this.time) + 1, this.n)];
    const [from, to, share] = [episode.scenes[low], episode.scenes[high], this.time - low];
    const poses = from.blocks.map((pose, block) => between(pose, to.blocks[block], share));
    const attention = this.parts.attention.at(this.time);
    // The frame jumps when another piece becomes the largest. Interpolate only smaller movements.
    const frame = apart3(from.goal_frame, to.goal_frame) < 0.5 ? between(from.goal_frame, to.goal_frame, share) : from.goal_frame;
    const ghosts = episode.goal.map(([block, pose]) => {
      const there = placed(frame, pose);
      return this.parts.ghost.checked && apart3(poses[block], there) > 0.02 ? there : null;
    });
    if (this.follows) {
      const [lowest, highest] = this.view(this.time + this.after);
      space.fit(lowest, highest);
    }
    space.show(poses, from.held, attention && attention.map(shade), ghosts);
  }
}

/**
 * Shows the player with an episode.
 * @param {Replay} replay
 * @param {Episode} episode
 * @param {() => void} [ended] called when playback reaches its end
 */
export async function present(replay, episode, ended) {
  if (!(await replay.prepare())) return;
  replay.parts.player.hidden = false;
  replay.show(episode, ended);
}

/**
 * Plays the episode of a video clip.
 * @param {Replay} replay
 * @param {HTMLElement} note
 * @param {Video} video
 */
export async function openRecording(replay, note, video) {
  /** @type {Episode | null} */
  let episode = null;
  try {
    const answer = await fetch(answerAt(model.base, "recording", video.id));
    if (answer.ok) episode = await answer.json();
  } catch {
    note.textContent = NO_ANSWER;
    return;
  }
  if (!episode) {
    note.textContent = "That recording no longer exists.";
    return;
  }
  note.textContent = `${video.blueprint}, ${video.ending} in an evaluation of weights ${video.weights_version}`;
  await present(replay, episode);
  $("replay-title").scrollIntoView();
}

/**
 * Polls until the server has a new episode; the first request makes it record one.
 * @param {Replay} replay
 * @param {HTMLElement} note
 * @param {HTMLButtonElement} button
 */
export async function askReplay(replay, note, button) {
  button.disabled = true;
  note.textContent = "Recording an episode …";
  // The first response may be an old episode, recorded for an earlier request.
  /** @type {string | null} */
  let first = null;
  for (let i = 0; i < 40; i += 1) {
    /** @type {Response} */
    let answer;
    try {
      answer = await fetch(`${model.base}/api/replay`);
    } catch {
      break;
    }
    if (answer.status === 200) {
      const text = await answer.text();
      if (i === 0) first = text;
      else if (text !== first || i > 5) {
        /** @type {Episode} */
        const episode = JSON.parse(text);
        note.textContent = `${episode.blueprint} by actor ${episode.actor}, weights ${episode.weights_version}`;
        await present(replay, episode);
        button.textContent = "Record a newer episode";
        button.disabled = false;
        return;
      }
    } else if (answer.status !== 202) {
      break;
    }
    await new Promise((done) => setTimeout(done, 1500));
  }
  note.textContent = "No episode arrived. Is an actor running?";
  button.disabled = false;
}
