// The episode player: play, scrub and step; drag, pinch or press keys to move the camera.

import { address } from "./address.js";
import { shade } from "./attention.js";
import { $ } from "./format.js";
import { FOLLOW_STEPS } from "./follow.js";
import { NO_ANSWER, answerAt, model } from "./model.js";
import { add3 } from "./solid.js";
import { View } from "./view.js";

/** @import { Attention } from "./attention.js" */
/** @import { Terms } from "./terms.js" */
/** @import { Episode } from "./types" */

/**
 * @typedef {object} Parts
 * @property {HTMLElement} player holds the parts below, and is hidden until there is an episode
 * @property {import("./view.js").Parts} main
 * @property {import("./view.js").Parts} beside the second picture
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
  /** Steps of the longer episode. */
  n = 0;
  /**
   * The pictures that show something: none, one, or two in step.
   * @type {View[]}
   */
  views = [];
  /** @type {(() => void) | undefined} */
  ended;

  /** @param {Parts} parts */
  constructor(parts) {
    this.parts = parts;
    this.main = new View(parts.main);
    this.beside = new View(parts.beside);
    for (const { canvas } of [parts.main, parts.beside]) {
      canvas.addEventListener("keydown", (event) => this.key(event));
      canvas.addEventListener("dblclick", () => this.fit());
    }
    this.parts.playButton.addEventListener("click", () => this.play(!this.playing));
    this.parts.back.addEventListener("click", () => this.step(-1));
    this.parts.forth.addEventListener("click", () => this.step(1));
    this.parts.fitButton.addEventListener("click", () => this.fit());
    this.parts.fullButton.addEventListener("click", () => this.full());
    this.parts.speedChoice.addEventListener("change", () => { this.speed = Number(this.parts.speedChoice.value); });
    this.parts.ghost.addEventListener("change", () => {
      address.set({ goal: this.parts.ghost.checked ? null : "hidden" });
      this.draw();
    });
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
      for (const { space } of [this.main, this.beside]) if (space) space.theme();
      this.draw();
    });
  }

  /** The episode, if there is one. */
  get episode() {
    return this.main.episode;
  }

  /**
   * Creates the 3D scenes of so many pictures. If that fails, shows why and returns false.
   * @param {number} n
   */
  async prepare(n) {
    try {
      for (const view of [this.main, this.beside].slice(0, n)) await view.prepare(() => { this.follows = false; }, () => this.noteCamera(view));
      return true;
    } catch {
      const videos = $("stage-video") ? " Save video needs no WebGL." : document.querySelector("#videos figure") ? " The videos below need none." : "";
      this.parts.note.textContent = `This browser cannot draw in 3D (WebGL is off or missing), or the program does not answer.${videos}`;
      return false;
    }
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    /** @type {Record<string, [number, number]>} */
    const keys = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    const view = this.views.find(({ parts }) => parts.canvas === event.target);
    if (!view) return;
    if (keys[event.key]) {
      view.space.turn(...keys[event.key]);
      this.noteCamera(view);
    } else if (event.key === "+" || event.key === "-") {
      this.follows = false;
      view.space.near(event.key === "+" ? 1.15 : 0.87);
      this.noteCamera(view);
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
   * Puts the camera of a picture into the address: where it stands and looks, or only from where while it follows.
   * @param {View} view
   */
  noteCamera(view) {
    const { position, target } = view.space.stand();
    // Each picture has its structure at another place.
    const away = this.main.middle().map((v, k) => v - view.middle()[k]);
    const exact = this.follows
      ? position.sub(target).normalize().toArray()
      : [...add3(position.toArray(), away), ...add3(target.toArray(), away)];
    const camera = exact.map((x) => Number(x.toFixed(3)));
    address.set({ camera: camera.join(",") });
    // What the address says is what is shown, to the pixel.
    this.place(camera);
    this.draw();
  }

  /**
   * Places the cameras of all pictures.
   * @param {number[]} camera as in the address
   */
  place(camera) {
    const [position, target] = [camera.slice(0, 3), camera.slice(3)];
    for (const view of this.views) {
      const away = view.middle().map((v, k) => v - this.main.middle()[k]);
      if (target.length > 0) view.space.place(add3(position, away), add3(target, away));
      else view.space.place(position, []);
    }
  }

  /** Follows the construction with the camera again, as a new episode begins. */
  leave() {
    if (this.follows) return;
    this.follows = true;
    this.noteCamera(this.main);
  }

  /**
   * Shows an episode, from a step on or as the address says, and calls `ended` when playback reaches its end.
   * @param {Episode[]} episodes one, or two to show in step
   * @param {() => void} [ended]
   * @param {number} [from] the step
   */
  show(episodes, ended, from = 0) {
    const step = address.get("step");
    this.play(false);
    this.ended = ended;
    this.views = [this.main, this.beside].slice(0, episodes.length);
    this.beside.parts.figure.hidden = episodes.length < 2;
    this.views.forEach((view, i) => view.load(episodes[i]));
    this.n = Math.max(...this.views.map(({ n }) => n));
    this.parts.slider.max = String(this.n);
    this.parts.terms.show(this.episode);
    this.parts.attention.show(this.episode);
    this.size();
    this.follows = true;
    this.seek(Math.min(from, this.n));
    this.play(step === null && !matchMedia("(prefers-reduced-motion: reduce)").matches);
    address.set({ step });
    this.restore();
  }

  /** Shows the step and takes the camera that the address names. */
  restore() {
    const camera = (address.get("camera") || "").split(",").map(Number);
    if (camera.every(Number.isFinite) && [3, 6].includes(camera.length)) {
      this.follows = camera.length === 3;
      this.place(camera);
    }
    const step = address.get("step");
    if (step === null) {
      this.draw();
      return;
    }
    this.play(false);
    this.seek(Math.min(Math.max(Number(step) || 0, 0), this.n));
  }

  /** Makes the camera follow the construction again. */
  fit() {
    if (!this.episode) return;
    this.follows = true;
    this.noteCamera(this.main);
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
    const width = this.parts.player.clientWidth;
    if (width === 0) return;
    this.width = width;
    const isFull = this.parts.player.classList.contains("full") || document.fullscreenElement === this.parts.player;
    const each = this.main.parts.canvas.clientWidth;
    // On a phone, the goal needs room above the world.
    const [share, least] = each > 480 ? [0.56, 300] : [1.15, 340];
    const height = isFull ? "" : `${Math.round(Math.min(Math.max(each * share, least), 560, window.innerHeight * 0.66))}px`;
    for (const view of this.views) view.size(height);
  }

  resize() {
    if (this.views.length === 0) return;
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
    for (const view of this.views) view.tell(time);
    const { episode, n } = this.main;
    const shown = Math.min(at, n);
    const scene = episode.scenes[shown];
    this.parts.slider.setAttribute("aria-valuetext", `step ${at} of ${this.n}`);
    const end = n === shown ? `, ${episode.end}` : "";
    this.parts.text.textContent = `step ${shown} of ${n}, ${scene.n_connected} ${scene.n_connected === 1 ? "connection" : "connections"}, reward ${scene.reward.toFixed(2)}${end}`;
    this.parts.terms.seek(Math.min(time, n));
    this.parts.attention.seek(Math.min(time, n));
    if (!this.playing) this.noteStep();
    this.draw();
  }

  /** Puts the step into the address, unless the episode plays. */
  noteStep() {
    if (this.episode) address.set({ step: this.playing ? null : Number(this.time.toFixed(1)) });
  }

  /** @param {boolean} on */
  play(on) {
    const was = this.playing;
    this.playing = on && Boolean(this.episode);
    this.parts.playButton.textContent = this.playing ? "Pause" : "Play";
    if (this.playing !== was) this.noteStep();
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
    const { ghost, attention } = this.parts;
    for (const view of this.views) {
      [view.attention, view.most] = view === this.main ? [attention.at(view.time), attention.most(view.time)] : [null, null];
      view.draw(this.after, { follows: this.follows, hasGhosts: ghost.checked, shades: view.attention && view.attention.map(shade) });
    }
  }
}

/**
 * Shows the player with an episode, or two in step.
 * @param {Replay} replay
 * @param {Episode[]} episodes
 * @param {() => void} [ended] called when playback reaches its end
 * @param {number} [from] the step to begin with
 */
export async function present(replay, episodes, ended, from) {
  if (!(await replay.prepare(episodes.length))) return;
  replay.parts.player.hidden = false;
  replay.show(episodes, ended, from);
}

/**
 * Plays the recorded episode of a video.
 * @param {Replay} replay
 * @param {HTMLElement} note
 * @param {string} id of the video
 */
export async function openRecording(replay, note, id) {
  /** @type {Episode | null} */
  let episode = null;
  try {
    const answer = await fetch(answerAt(model.base, "recording", id));
    if (answer.ok) episode = await answer.json();
  } catch {
    note.textContent = NO_ANSWER;
    return;
  }
  if (!episode) {
    note.textContent = "That recording no longer exists.";
    return;
  }
  note.textContent = `${episode.title} (${episode.blueprint}), ${episode.end} in an evaluation of weights ${episode.weights_version}`;
  await present(replay, [episode]);
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
        await present(replay, [episode]);
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
