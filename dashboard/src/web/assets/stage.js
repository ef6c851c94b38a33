// Episodes on demand: the choice of blueprint, agent, action mode and start, and the gallery.

import { $, element } from "./format.js";
import { NO_ANSWER, answerAt, isCopy, model } from "./model.js";
import { present } from "./replay.js";

/** @import { Replay } from "./replay.js" */
/** @import { Agent, Blueprint, Episode } from "./types" */

/** Pause before the next episode starts automatically, milliseconds. */
const REST_MS = 2500;

/** Maximum number of goals in a row without a reset, as in the evaluation; then blocks are scattered again. */
const IN_A_ROW = 10;

/**
 * @typedef {object} Parts
 * @property {HTMLElement} choose opens the gallery
 * @property {HTMLElement} next
 * @property {HTMLElement} again
 * @property {HTMLElement} agent
 * @property {HTMLElement} mode
 * @property {HTMLInputElement} onward whether the next blueprint follows by itself
 * @property {HTMLInputElement} keep whether it is built from what is left of the one before
 * @property {HTMLElement} note
 * @property {HTMLDialogElement} dialog the gallery
 */

/**
 * Returns the selected choice.
 * @param {HTMLElement} choices
 */
const picked = (choices) => /** @type {HTMLInputElement} */ (choices.querySelector("input:checked")).value;

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
   * @type {{ file: string, title: string } | null}
   */
  drawn = null;
  seed = 0;
  /**
   * The goals since the last reset.
   * @type {string[]}
   */
  before = [];
  /** Number of requests so far. */
  asked = 0;
  /**
   * Cancels the request before.
   * @type {AbortController | undefined}
   */
  gone;

  /**
   * @param {Replay} replay
   * @param {Parts} parts
   */
  constructor(replay, parts) {
    this.replay = replay;
    this.parts = parts;
    this.parts.next.addEventListener("click", () => this.go(1));
    this.parts.again.addEventListener("click", () => {
      this.seed += 1;
      this.before = [];
      if (this.chosen || this.drawn) this.build();
      else this.go(1);
    });
    this.parts.choose.addEventListener("click", () => this.open());
    for (const choices of [this.parts.agent, this.parts.mode]) choices.addEventListener("change", () => this.build());
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
   */
  async go(by) {
    if (!(await this.learn())) return;
    const all = this.only.length > 0 ? this.blueprints.filter(({ id }) => this.only.includes(id)) : this.blueprints;
    const at = all.findIndex(({ id }) => id === this.chosen);
    this.start(all[(at + by + all.length) % all.length].id);
  }

  /**
   * Builds a blueprint.
   * @param {string} id
   */
  start(id) {
    const stays = this.parts.keep.checked && this.chosen && this.before.length + 1 < IN_A_ROW;
    this.before = stays ? [...this.before, this.chosen] : [];
    [this.chosen, this.drawn] = [id, null];
    this.build();
  }

  /**
   * Builds a drawing.
   * @param {string} file the text of a blueprint file
   * @param {string} title
   * @param {Agent} agent
   */
  startDrawn(file, title, agent) {
    [this.drawn, this.before, this.seed] = [{ file, title }, [], 0];
    const choice = this.parts.agent.querySelector(`input[value="${agent}"]`);
    /** @type {HTMLInputElement} */ (choice).checked = true;
    this.build();
  }

  /** Requests the episode with the selected options. */
  request() {
    const { signal } = this.gone;
    if (isCopy) return fetch(answerAt(model.base, "play", `${this.chosen}-${picked(this.parts.agent)}`), { signal });
    const wishes = `agent=${picked(this.parts.agent)}&mode=${picked(this.parts.mode)}&seed=${this.seed}`;
    if (this.drawn) return fetch(`${model.base}/api/play?${wishes}`, { method: "POST", body: this.drawn.file, signal });
    const after = this.before.length > 0 ? `&after=${this.before.map(encodeURIComponent).join(",")}` : "";
    return fetch(`${model.base}/api/play?blueprint=${encodeURIComponent(this.chosen)}&${wishes}${after}`, { signal });
  }

  /** Requests the episode and plays it, unless another one has been requested in the meantime. */
  async build() {
    if (!this.chosen && !this.drawn) return;
    if (model.gone) {
      this.parts.note.textContent = model.gone;
      return;
    }
    this.asked += 1;
    const mine = this.asked;
    const isWanted = () => mine === this.asked;
    const who = picked(this.parts.agent) === "expert" ? "The expert" : "The policy";
    this.parts.note.textContent = `${who} builds ${this.drawn ? this.drawn.title : this.chosen} …`;
    this.replay.prepare();
    if (this.gone) this.gone.abort();
    this.gone = new AbortController();
    for (;;) {
      /** @type {Response} */
      let answer;
      try {
        answer = await this.request();
      } catch {
        if (isWanted()) this.parts.note.textContent = NO_ANSWER;
        return;
      }
      if (!isWanted()) return;
      if (answer.status === 503) {
        this.parts.note.textContent = "Waiting for the first weights …";
        await new Promise((done) => setTimeout(done, 1000));
        if (!isWanted()) return;
        continue;
      }
      if (!answer.ok) {
        this.parts.note.textContent = await answer.text();
        return;
      }
      /** @type {Episode} */
      const episode = await answer.json();
      if (!isWanted()) return;
      const weights = episode.actor === "expert" ? "" : ` with weights ${episode.weights_version}`;
      // The user may have renamed the drawing since the file was checked.
      const title = this.drawn ? this.drawn.title : episode.title;
      const nth = this.before.length > 0 ? `, goal ${this.before.length + 1} of ${IN_A_ROW} without a reset` : "";
      this.parts.note.textContent = `${who} builds ${title} (${episode.blueprint}), start ${this.seed + 1}${nth}${weights}`;
      await present(this.replay, episode, () => {
        if (this.parts.onward.checked && !this.drawn) setTimeout(() => { if (isWanted() && !this.replay.playing && this.replay.time >= this.replay.n) this.go(1); }, REST_MS);
      });
      return;
    }
  }

  /** Opens the gallery. Pictures load when they come into view. */
  async open() {
    if (!(await this.learn())) return;
    const find = element("input", { type: "search", placeholder: "Name or number", "aria-label": "Search the gallery" });
    const close = element("button", { type: "button" }, "Close");
    close.addEventListener("click", () => this.parts.dialog.close());
    const list = element("div", { class: "gallery" });
    const draw = () => {
      const words = find.value.trim().toLowerCase();
      const shown = this.blueprints.filter(({ id, title }) => `${id} ${title}`.toLowerCase().includes(words));
      /** @type {HTMLElement[]} */
      const parts = [];
      /** @type {string | null | undefined} */
      let group;
      for (const one of shown) {
        if (one.group !== group) {
          group = one.group;
          parts.push(element("h3", {}, group || "other"));
        }
        const picture = element("img", { src: answerAt("", "picture", one.id), alt: "", loading: "lazy", width: "200", height: "150" });
        const tile = element("button", { type: "button", "aria-pressed": String(one.id === this.chosen) }, picture,
          element("b", {}, one.title), element("span", { class: "quiet" }, `${one.id}, ${one.n_blocks} blocks`));
        tile.addEventListener("click", () => {
          this.parts.dialog.close();
          if (!this.parts.keep.checked) this.seed = 0;
          this.start(one.id);
          $("replay-title").scrollIntoView();
        });
        parts.push(tile);
      }
      list.replaceChildren(...(parts.length > 0 ? parts : [element("p", { class: "empty" }, "No blueprint matches.")]));
    };
    find.addEventListener("input", draw);
    this.parts.dialog.replaceChildren(element("div", { class: "bar" }, element("h2", {}, "Blueprints"), find, close), list);
    draw();
    this.parts.dialog.showModal();
  }
}
