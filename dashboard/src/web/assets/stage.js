// Episodes on demand: the choice of blueprint, agent, action mode and start.

import { address } from "./address.js";
import { $, percent } from "./format.js";
import { openGallery } from "./gallery.js";
import { NO_ANSWER, answerAt, isCopy, model } from "./model.js";
import { decode, tomlOf } from "./drawing.js";
import { present } from "./replay.js";
import { saveVideo } from "./share.js";

/** @import { Replay } from "./replay.js" */
/** @import { Snapshots, Weights } from "./snapshots.js" */
/** @import { Acting, Agent, Blueprint, Episode, Vector } from "./types" */

/** Pause before the next episode starts automatically, milliseconds. */
const REST_MS = 2500;

/** Maximum number of goals in a row without a reset, as in the evaluation; then blocks are scattered again. */
const IN_A_ROW = 10;

/**
 * Who builds an episode, and the weights of a policy.
 * @typedef {{ agent: string, weights: Weights }} Builder
 */

/**
 * A drawing: its blueprint file, its title, and its blocks as the address names them.
 * @typedef {{ file: string, title: string, code: string }} Drawn
 */

/**
 * @typedef {object} Parts
 * @property {HTMLElement} choose opens the gallery
 * @property {HTMLElement} previous
 * @property {HTMLElement} next
 * @property {HTMLElement} again
 * @property {HTMLElement} agent
 * @property {HTMLInputElement} both whether the other builder is shown beside
 * @property {HTMLElement} mode
 * @property {HTMLElement} success tells how often the policy builds structures of this size
 * @property {HTMLInputElement} onward whether the next blueprint follows by itself
 * @property {HTMLInputElement} keep whether it is built from what is left of the one before
 * @property {HTMLElement} video saves a video
 * @property {HTMLElement} shared tells what became of what was shared
 * @property {HTMLElement} note
 * @property {HTMLDialogElement} dialog the gallery
 */

/**
 * Returns the selected choice.
 * @param {HTMLElement} choices
 */
const picked = (choices) => /** @type {HTMLInputElement} */ (choices.querySelector("input:checked")).value;

/**
 * Selects a choice, if there is one with this value; `null` selects the first.
 * @param {HTMLElement} choices
 * @param {string | null} value
 */
function pick(choices, value) {
  const all = /** @type {HTMLInputElement[]} */ ([...choices.querySelectorAll("input")]);
  const one = value === null ? all[0] : all.find((input) => input.value === value);
  if (one) one.checked = true;
}

export class Stage {
  /** @type {Blueprint[]} */
  blueprints = [];
  /**
   * The blueprints to go through; empty for all.
   * @type {string[]}
   */
  only = [];
  /** @type {string | null} */
  chosen = null;
  /**
   * What is built instead of a blueprint.
   * @type {Drawn | null}
   */
  drawn = null;
  seed = 0;
  /** Whether the user has chosen the actions. */
  isModeChosen = false;
  /**
   * The goals since the last reset.
   * @type {string[]}
   */
  before = [];
  /**
   * What the user does to the blocks, as the address names it, in order of steps.
   * @type {string[]}
   */
  disturbances = [];
  /**
   * Called with what is about to be shown; nothing if it is not played here.
   * @type {(episodes: Episode[]) => void}
   */
  played = () => {};
  /**
   * The order of the episode that the stage has shown, unless something else took its place.
   * @type {string | null}
   */
  shown = null;
  /** Number of requests so far. */
  asked = 0;
  /**
   * Cancels the request before.
   * @type {AbortController | undefined}
   */
  gone;

  /**
   * @param {Replay} replay
   * @param {Snapshots} snapshots
   * @param {Parts} parts
   */
  constructor(replay, snapshots, parts) {
    this.replay = replay;
    this.snapshots = snapshots;
    this.parts = parts;
    this.parts.previous.addEventListener("click", () => this.go(-1));
    this.parts.next.addEventListener("click", () => this.go(1));
    this.parts.again.addEventListener("click", () => {
      this.seed += 1;
      [this.before, this.disturbances] = [[], []];
      if (this.chosen || this.drawn) this.build();
      else this.go(1);
    });
    this.parts.choose.addEventListener("click", () => this.open());
    this.parts.video.addEventListener("click", () => this.saveVideo());
    this.parts.mode.addEventListener("change", () => { this.isModeChosen = true; });
    for (const choices of [this.parts.agent, this.parts.mode]) choices.addEventListener("change", () => {
      // There is room for two.
      if (this.parts.both.checked) snapshots.parts.beside.checked = false;
      snapshots.draw();
      this.build();
    });
    this.parts.dialog.addEventListener("close", () => address.set({ open: null }));
    this.parts.dialog.addEventListener("click", (event) => { if (event.target === this.parts.dialog) this.parts.dialog.close(); });
  }

  /** Loads the list of blueprints. If that fails, says so and returns false. */
  async learn() {
    if (this.blueprints.length > 0) return true;
    try {
      const answer = await fetch(answerAt("", "blueprints"));
      if (answer.ok) this.blueprints = (await answer.json()).blueprints;
    } catch {
      // Reported below.
    }
    // A static copy contains only recorded episodes.
    if (isCopy) this.blueprints = this.blueprints.filter(({ id }) => this.only.includes(id));
    if (this.blueprints.length === 0) this.parts.note.textContent = NO_ANSWER;
    return this.blueprints.length > 0;
  }

  /**
   * Starts the blueprint `by` places after the current one, in gallery order.
   * @param {number} by
   * @param {boolean} [isNew] whether the user asked for it
   */
  async go(by, isNew = true) {
    if (!(await this.learn())) return;
    const all = this.only.length > 0 ? this.blueprints.filter(({ id }) => this.only.includes(id)) : this.blueprints;
    const at = all.findIndex(({ id }) => id === this.chosen);
    // Before the first one comes the last.
    this.start(all[at < 0 && by < 0 ? all.length - 1 : (at + by + all.length) % all.length].id, isNew);
  }

  /**
   * Builds a blueprint.
   * @param {string} id
   * @param {boolean} [isNew] whether the back button returns to the one before
   */
  start(id, isNew = true) {
    this.snapshots.isThrough = false;
    const stays = this.parts.keep.checked && this.chosen && this.before.length + 1 < IN_A_ROW;
    this.disturbances = [];
    this.before = stays ? [...this.before, this.chosen] : [];
    this.pickMode();
    [this.chosen, this.drawn] = [id, null];
    this.build(isNew);
  }

  /** Selects the actions that were evaluated, unless the user or the address has chosen some. */
  pickMode() {
    if (!this.isModeChosen && !address.get("mode")) pick(this.parts.mode, model.acting);
  }

  /** Makes room for what is not played here, such as a recording. */
  leave() {
    this.asked += 1;
    if (this.gone) this.gone.abort();
    [this.shown, this.disturbances] = [null, []];
    this.played([]);
  }

  /** Builds what the address names. Returns false if it names nothing. */
  restore() {
    const [id, code] = [address.get("blueprint"), isCopy ? null : address.get("drawing")];
    if (id === null && code === null) return false;
    pick(this.parts.agent, address.get("agent"));
    pick(this.parts.mode, address.get("mode"));
    this.parts.both.checked = address.get("both") === "1";
    this.snapshots.restore(address.get("snapshot"), address.get("beside"));
    this.seed = Math.max(Number.parseInt(address.get("seed"), 10) || 0, 0);
    this.before = (address.get("after") || "").split(",").filter(Boolean);
    this.parts.keep.checked = this.before.length > 0;
    this.disturbances = (address.get("disturb") || "").split("_").filter(Boolean);
    this.chosen = id;
    if (code === null) this.drawn = null;
    else if (this.drawn?.code !== code) {
      this.redraw(code, address.get("title") || "a drawing");
      return true;
    }
    if (this.order() === this.shown) this.replay.restore();
    else this.perform();
    return true;
  }

  /**
   * Builds the drawing that the address names.
   * @param {string} code
   * @param {string} title
   */
  async redraw(code, title) {
    this.parts.note.textContent = "Checking the drawing …";
    try {
      const file = await tomlOf(title, decode(code));
      if (address.get("drawing") !== code) return;
      this.drawn = { file, title, code };
      this.perform();
    } catch (error) {
      const isAnswer = error instanceof Error && !(error instanceof TypeError);
      this.parts.note.textContent = isAnswer ? `This drawing cannot be built: ${error.message}` : NO_ANSWER;
    }
  }

  /**
   * Builds a drawing.
   * @param {Drawn} drawn
   * @param {Agent} agent
   */
  startDrawn(drawn, agent) {
    [this.drawn, this.before, this.disturbances, this.seed] = [drawn, [], [], 0];
    pick(this.parts.agent, agent);
    this.build();
  }

  /** Builds the same with other weights. */
  again() {
    if (this.snapshots.parts.beside.checked) this.parts.both.checked = false;
    pick(this.parts.agent, null);
    this.pickMode();
    this.parts.onward.checked = false;
    if (this.chosen || this.drawn) this.build();
    else this.go(1);
  }

  /**
   * Moves a block by meters or pushes it by meters per second in a step, and goes on from there.
   * @param {number} step
   * @param {number} block
   * @param {Vector} by
   * @param {Vector} push
   */
  disturb(step, block, by, push) {
    const numbers = [...by, ...push].map((v) => Number(v.toFixed(3)));
    const before = this.disturbances.filter((one) => Number.parseInt(one, 10) < step);
    this.resume([...before, [step, block, ...numbers].join()], step);
  }

  /** Takes back the last disturbance. */
  calm() {
    const step = Number.parseInt(this.disturbances[this.disturbances.length - 1], 10);
    this.resume(this.disturbances.slice(0, -1), step || 0);
  }

  /**
   * Plays the episode with these disturbances, from a step on.
   * @param {string[]} disturbances
   * @param {number} step
   */
  resume(disturbances, step) {
    this.disturbances = disturbances;
    this.snapshots.isThrough = this.parts.onward.checked = false;
    address.set({ disturb: disturbances.join("_"), step: null, weights: null }, true);
    this.perform(step);
  }

  /**
   * Says how often the policy built structures of this size in the newest evaluation, or else when it was measured;
   * empty if neither is known.
   * @param {number} size in blocks
   */
  success(size) {
    const { blueprints } = model.history;
    const acting = /** @type {Acting} */ (picked(this.parts.mode));
    const known = this.snapshots.chosen === null ? model.about?.success?.[acting]?.[size] : null;
    const counts = this.snapshots.evaluation(this.snapshots.chosen)?.[acting].filter((cell, i) => cell && blueprints[i].n_blocks === size) || (known ? [known] : []);
    const [built, all] = [0, 1].map((k) => counts.reduce((sum, cell) => sum + cell[k], 0));
    return all > 0 ? `The policy builds ${percent(built / all)} of those with ${size} blocks.` : "";
  }

  /** Returns what is to be built, and how, as text. */
  order() {
    const { snapshot, beside } = this.snapshots.named();
    return [this.drawn ? this.drawn.code : this.chosen, picked(this.parts.agent), this.parts.both.checked, picked(this.parts.mode), this.seed, snapshot, beside, this.disturbances.join("_"), ...this.before].join();
  }

  /**
   * Returns who builds, one or two in step.
   * @returns {Builder[]}
   */
  builders() {
    const agent = picked(this.parts.agent);
    const [weights] = this.snapshots.pair();
    if (this.parts.both.checked) return [{ agent: "policy", weights }, { agent: "expert", weights: null }];
    if (agent !== "policy") return [{ agent, weights: null }];
    return this.snapshots.pair().map((one) => ({ agent, weights: one }));
  }

  /**
   * Requests the episode with the selected options.
   * @param {Builder} builder
   */
  request(builder) {
    const { signal } = this.gone;
    if (isCopy) {
      const weights = builder.weights === null ? "" : `-${builder.weights}`;
      return fetch(answerAt(model.base, "play", `${this.chosen}-${builder.agent}${weights}`), { signal });
    }
    if (this.drawn) return fetch(`${model.base}/api/play?${this.wishes(builder)}`, { method: "POST", body: this.drawn.file, signal });
    return fetch(`${model.base}/api/play?${this.wishes(builder)}`, { signal });
  }

  /**
   * Returns the query that asks for the episode.
   * @param {Builder} builder
   */
  wishes({ agent, weights }) {
    // The server takes commas as they are.
    const disturb = encodeURIComponent(this.disturbances.join("_")).replaceAll("%2C", ",");
    const how = `agent=${agent}&mode=${picked(this.parts.mode)}&seed=${this.seed}${weights === null ? "" : `&snapshot=${weights}`}${disturb && `&disturb=${disturb}`}`;
    if (this.drawn) return how;
    const after = this.before.length > 0 ? `&after=${this.before.map(encodeURIComponent).join(",")}` : "";
    return `blueprint=${encodeURIComponent(this.chosen)}&${how}${after}`;
  }

  /** Saves the video of what is shown. */
  async saveVideo() {
    const recording = address.get("recording");
    const [builder, other] = this.builders();
    const which = other && recording === null ? ` of the left episode (${this.replay.main.episode?.caption || builder.agent})` : "";
    if (recording !== null) await saveVideo(answerAt(model.base, "video", recording), `${recording}.mp4`, which, this.parts.shared);
    else if (this.drawn || this.chosen) {
      const url = `${model.base}/api/play.mp4?${this.wishes(builder)}`;
      await saveVideo(url, `${this.drawn ? "drawing" : this.chosen}-${builder.agent}.mp4`, which, this.parts.shared, this.drawn?.file);
    } else this.parts.shared.textContent = "There is no episode yet.";
  }

  /**
   * Builds what is chosen, from the start on, and puts it into the address.
   * @param {boolean} [isNew] whether the back button returns to the episode before
   */
  build(isNew = true) {
    if (!this.chosen && !this.drawn) return;
    const [agent, mode] = [picked(this.parts.agent), picked(this.parts.mode)];
    address.set({
      blueprint: this.drawn ? null : this.chosen, drawing: this.drawn && this.drawn.code, title: this.drawn && this.drawn.title, agent: agent === "policy" ? null : agent, mode: mode === "greedy" ? null : mode,
      both: this.parts.both.checked ? 1 : null, ...this.snapshots.named(),
      seed: this.seed || null, after: this.before.join(","), disturb: this.disturbances.join("_"), recording: null, step: null, weights: null,
    }, isNew);
    this.replay.leave();
    this.perform();
  }

  /**
   * Requests the episode and plays it, unless another one has been requested in the meantime.
   * @param {number} [from] the step to begin with
   */
  async perform(from) {
    if (model.gone) {
      this.parts.note.textContent = model.gone;
      return;
    }
    this.asked += 1;
    const mine = this.asked;
    this.shown = null;
    const isWanted = () => mine === this.asked;
    const builders = this.builders();
    const [{ agent }] = builders;
    const who = this.parts.both.checked ? "The policy and the expert build" : `The ${agent} builds`;
    this.parts.note.textContent = `${who} ${this.drawn ? this.drawn.title : this.chosen} …`;
    this.replay.prepare(builders.length);
    if (this.gone) this.gone.abort();
    this.gone = new AbortController();
    /** @type {Episode[]} */
    const episodes = [];
    for (const one of builders) {
      const episode = await this.episode(one, isWanted);
      if (!episode) return;
      if (one.agent === "policy" && (one.weights !== null || this.snapshots.all.length > 0)) episode.caption = this.snapshots.caption(one.weights);
      episodes.push(episode);
    }
    const [{ actor, weights_version: version, blueprint, title, goal }] = episodes;
    const weights = actor === "expert" ? "" : ` with weights ${version}`;
    const nth = this.before.length > 0 ? `, goal ${this.before.length + 1} of ${IN_A_ROW} without a reset` : "";
    // The user may have renamed the drawing since the file was checked.
    this.parts.note.textContent = `${who} ${this.drawn ? this.drawn.title : title} (${blueprint}), start ${this.seed + 1}${nth}${weights}`;
    if (model.about?.kind === "training" && actor !== "expert" && builders[0].weights === null) {
      const linked = address.get("weights");
      if (linked !== null && linked !== String(version)) this.parts.note.append(`. The link showed weights ${linked}; these are ${version}.`);
      address.set({ weights: version });
    }
    this.shown = this.order();
    this.played(episodes);
    this.parts.success.textContent = this.success(goal.length);
    await present(this.replay, episodes, () => setTimeout(() => {
      if (!isWanted() || this.replay.playing || this.replay.time < this.replay.n) return;
      if (this.snapshots.next()) this.build(false);
      else if (this.parts.onward.checked && !this.drawn) this.go(1, false);
    }, REST_MS), from);
    // Whoever watches it learn asked for motion.
    if (this.snapshots.isThrough) this.replay.play(true);
  }

  /**
   * Requests the episode of an agent until there is one. Returns `null` if it is no longer wanted or, with a note, if it
   * fails.
   * @param {Builder} builder
   * @param {() => boolean} isWanted
   * @returns {Promise<Episode | null>}
   */
  async episode(builder, isWanted) {
    for (;;) {
      /** @type {Response} */
      let answer;
      /** The episode, or what is wrong. */
      let said;
      try {
        answer = await this.request(builder);
        // A request that is no longer wanted can also be given up while this is read.
        said = await (answer.ok ? answer.json() : answer.text());
      } catch {
        if (isWanted()) this.parts.note.textContent = NO_ANSWER;
        return null;
      }
      if (!isWanted()) return null;
      if (answer.ok) return said;
      if (answer.status !== 503) {
        this.parts.note.textContent = said;
        return null;
      }
      this.parts.note.textContent = "Waiting for the first weights …";
      await new Promise((done) => setTimeout(done, 1000));
      if (!isWanted()) return null;
    }
  }

  /** Opens the gallery. */
  async open() {
    if (!(await this.learn()) || this.parts.dialog.open) return;
    openGallery(this.parts.dialog, this.blueprints, this.chosen, (id) => {
      if (!this.parts.keep.checked) this.seed = 0;
      this.start(id);
      $("replay-title").scrollIntoView();
    });
  }
}
