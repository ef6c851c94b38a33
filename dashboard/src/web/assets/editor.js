// Draw and build: the user places blocks on a grid. The server checks every state of the drawing, turns blocks until
// poles match, and writes it as a blueprint file, which the agent then builds.

import { address } from "./address.js";
import { imagesOf, quarter, quaternionOf } from "./axes.js";
import { readDraft, sizeOf, writeDraft } from "./draft.js";
import { encode } from "./drawing.js";
import { $, element, sentence } from "./format.js";
import { NO_ANSWER } from "./model.js";
import { Pointer } from "./pointer.js";
import { save } from "./share.js";
import { add3, cross3 } from "./solid.js";

/** @import { Desk } from "./draw.js" */
/** @import { Stage } from "./stage.js" */
/** @import { Agent, Block, Findings, Kind, Spot, Vector } from "./types" */

/** Extent of the drawing area: cells on each side of the center, and cells upward. */
const [WIDE, HIGH] = [12, 24];

/** Local storage key of the drawing, which survives reloads. */
const KEPT = "lodestone-drawing";

/**
 * @typedef {object} Parts
 * @property {HTMLElement} open opens and closes the board
 * @property {HTMLElement} board holds the parts below
 * @property {HTMLElement} palette
 * @property {HTMLCanvasElement} canvas
 * @property {HTMLInputElement} layer the height of the grid
 * @property {HTMLElement} layerText
 * @property {HTMLElement} tools
 * @property {HTMLElement} say
 * @property {HTMLElement} problems
 * @property {HTMLElement} list the blocks
 * @property {HTMLButtonElement} match turns blocks so that poles match
 * @property {HTMLInputElement} name
 * @property {HTMLButtonElement} policy
 * @property {HTMLButtonElement} expert
 * @property {HTMLButtonElement} save
 * @property {HTMLInputElement} file
 * @property {HTMLButtonElement} copy opens the blueprint that the gallery has chosen
 */

export class Editor {
  /** @type {Block[]} */
  blocks = [];
  /** The name of the drawing. */
  name = "";
  /**
   * The name of the file that it comes from, until the user gives it another one.
   * @type {string | null}
   */
  file = null;
  /** What there is to say about the file that was opened. */
  remark = "";
  /**
   * Earlier states as JSON, for undo.
   * @type {string[]}
   */
  past = [];
  /**
   * Undone states as JSON, for redo.
   * @type {string[]}
   */
  future = [];
  /**
   * Index of the selected block.
   * @type {number | null}
   */
  selected = null;
  /**
   * Type of the next block; `null` to select.
   * @type {string | null}
   */
  tool = null;
  /** How the next block lies. */
  axes = "+x +y";
  /** Of the grid, cells. */
  height = 0;
  /** Number of checks so far. */
  asked = 0;
  /** @type {Findings} */
  found = { problems: [], connections: [], toml: null };
  /**
   * The problems that are shown, as JSON.
   * @type {string | null}
   */
  lastProblems = null;
  /**
   * The view in 3D, once the board was opened.
   * @type {Desk}
   */
  desk;
  /** @type {Map<string, Kind>} */
  kinds;
  /** Edge of a cell, meters. */
  unit = 0;
  /**
   * @param {Stage} stage
   * @param {Parts} parts
   */
  constructor(stage, parts) {
    this.stage = stage;
    this.parts = parts;
    this.parts.open.addEventListener("click", async () => {
      await this.toggle();
      if (!this.parts.board.hidden) this.parts.open.scrollIntoView();
    });
    this.parts.tools.addEventListener("click", ({ target }) => { if (target instanceof HTMLElement && target.dataset.do) this.act(target.dataset.do); });
    this.parts.layer.addEventListener("input", () => this.lift(Number(this.parts.layer.value)));
    this.parts.match.addEventListener("click", () => this.change(() => { this.blocks.forEach((block) => { block.is_free = true; }); }));
    this.parts.name.addEventListener("input", () => this.ask(false));
    this.parts.name.addEventListener("change", () => {
      // No check, which would disable the button that the user is about to press.
      this.past.push(this.state());
      [this.name, this.file, this.future] = [this.parts.name.value, null, []];
      this.speak();
    });
    for (const agent of /** @type {Agent[]} */ (["policy", "expert"])) this.parts[agent].addEventListener("click", () => this.build(agent));
    this.parts.save.addEventListener("click", () => this.download());
    this.parts.file.addEventListener("change", () => this.upload());
    this.parts.copy.addEventListener("click", () => this.take());
    this.parts.canvas.addEventListener("keydown", (event) => this.key(event));
    new Pointer(this);
    new ResizeObserver(() => this.resize()).observe(this.parts.board);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      if (!this.desk) return;
      this.desk.theme();
      this.draw();
    });
  }

  /** Opens or closes the board. */
  async toggle(on = this.parts.board.hidden) {
    this.parts.board.hidden = !on;
    address.set({ draw: on ? "open" : null });
    this.parts.open.setAttribute("aria-expanded", String(on));
    this.parts.open.textContent = on ? "Close the drawing" : "Draw a structure";
    if (!on || this.desk) return;
    try {
      const [{ Desk }, answer] = await Promise.all([import("./draw.js"), fetch("/api/inventory")]);
      /** @type {{ types: Kind[], unit_m: number }} */
      const { types, unit_m: unit } = await answer.json();
      this.kinds = new Map(types.map((one) => [one.type, one]));
      this.unit = unit;
      this.desk ||= new Desk(this.parts.canvas, unit);
      // From here on, opening and closing needs no answer.
      delete this.parts.open.parentElement.dataset.served;
    } catch {
      this.parts.say.textContent = "This browser cannot draw in 3D, or the program does not answer.";
      return;
    }
    this.restore();
    this.resize();
    // Passes the blocks to the desk before fitting the view to them.
    this.change(() => {});
    this.desk.all();
    this.past = [];
  }

  resize() {
    const width = this.parts.canvas.clientWidth;
    if (!this.desk || width === 0) return;
    const height = Math.round(Math.min(Math.max(width * 0.5, 320), 520, window.innerHeight * 0.62));
    this.parts.canvas.style.height = `${height}px`;
    this.desk.resize(width, height);
    this.desk.render();
  }

  /**
   * Returns the size on the grid of a block that lies like this.
   * @param {string} type
   * @param {string} axes
   * @returns {Vector}
   */
  cells(type, axes) {
    return sizeOf(this.kinds.get(type).cells, axes);
  }

  /**
   * Returns how many blocks of a type are left.
   * @param {string} type
   */
  left(type) {
    return this.kinds.get(type).count - this.blocks.filter((block) => block.type === type).length;
  }

  /**
   * Returns the name of a block, as used in problem reports.
   * @param {number} i
   */
  called(i) {
    const same = this.blocks.filter(({ type }) => type === this.blocks[i].type);
    const { word } = this.kinds.get(this.blocks[i].type);
    return same.length === 1 ? word : `${word} ${same.indexOf(this.blocks[i]) + 1}`;
  }

  /** Returns the state to which undo can return. */
  state() {
    return JSON.stringify({ blocks: this.blocks, name: this.name, file: this.file });
  }

  /**
   * Changes the drawing and saves the previous state for undo.
   * @param {() => void} how
   */
  change(how) {
    const before = this.state();
    this.remark = "";
    how();
    if (this.parts.name.value !== this.name) this.parts.name.value = this.name;
    if (this.selected !== null && this.selected >= this.blocks.length) this.selected = null;
    if (this.past[this.past.length - 1] !== before) this.past.push(before);
    if (this.past.length > 200) this.past.shift();
    this.future = [];
    if (this.tool && this.left(this.tool) === 0) this.tool = null;
    this.draw();
    this.ask();
  }

  /** Has the server check the drawing, whose blocks may have `changed`. Ignores all but the newest response. */
  async ask(changed = true) {
    this.asked += 1;
    const mine = this.asked;
    if (changed) this.found.toml = null;
    this.speak();
    try {
      const blocks = this.blocks.map(({ type, at, axes, is_free }) => ({ type, at, axes, is_free }));
      const answer = await fetch("/api/check", { method: "POST", body: JSON.stringify({ title: this.parts.name.value, blocks }) });
      /** @type {Findings | null} */
      const found = answer.ok ? await answer.json() : null;
      if (mine !== this.asked) return;
      if (found) {
        this.blocks.forEach((block, i) => { block.axes = found.blocks[i].axes; });
        this.found = found;
      } else this.found = { problems: [{ check: "format", blocks: [], text: (await answer.text()).trim() }], connections: [], toml: null };
      this.keep();
    } catch {
      if (mine !== this.asked) return;
      this.found = { problems: [{ check: "format", blocks: [], text: "the program does not answer; is it still running?" }], connections: [], toml: null };
    }
    this.draw();
  }

  keep() {
    try {
      localStorage.setItem(KEPT, JSON.stringify({ title: this.parts.name.value, blocks: this.blocks }));
    } catch {
      // The browser may not allow storage.
    }
  }

  /** Restores the saved drawing, if it is readable. */
  restore() {
    try {
      /** @type {{ title: string, blocks: Block[] }} */
      const { title, blocks } = JSON.parse(localStorage.getItem(KEPT));
      if (!blocks.every(({ type, at, axes }) => this.kinds.has(type) && at.length === 3 && imagesOf(axes))) return;
      [this.blocks, this.name] = [blocks, title];
    } catch {
      // There is no saved drawing.
    }
  }

  /** Redraws the blocks, the palette with the remaining counts, and the problems. */
  draw() {
    if (!this.desk) return;
    const wrong = new Set(this.found.problems.flatMap(({ blocks }) => blocks));
    const drawn = this.blocks.map(({ type, at, axes }) => {
      const size = this.cells(type, axes);
      const { cells, color } = this.kinds.get(type);
      return { type, cells, color, at, size, pose: [...at.map((v, k) => (v + size[k] / 2) * this.unit), ...quaternionOf(axes)] };
    });
    this.desk.set(drawn, drawn.map((_, i) => (i === this.selected ? "selected" : wrong.has(i) ? "wrong" : null)));
    const tool = (/** @type {string | null} */ type, /** @type {(Node | string)[]} */ ...content) => {
      const button = element("button", { type: "button", "aria-pressed": String(this.tool === type), "data-type": type || "" }, ...content);
      button.disabled = type !== null && this.left(type) === 0;
      button.addEventListener("click", () => this.choose(type));
      return button;
    };
    this.parts.palette.replaceChildren(tool(null, "Select"), ...[...this.kinds.values()].map(({ type, word, cells, color }) => {
      const patch = element("i", {});
      patch.style.background = `rgb(${color.join(",")})`;
      return tool(type, patch, `${word} ${cells.join("×")}`, element("small", {}, `${this.left(type)} left`));
    }));
    this.parts.list.replaceChildren(...this.blocks.map((block, i) => {
      const button = element("button", { type: "button", "aria-pressed": String(i === this.selected) }, `${this.called(i)} at ${block.at.join(", ")}`);
      button.addEventListener("click", () => this.pick(i));
      return button;
    }));
    this.speak();
  }

  /** Updates the status text, the problem list and the buttons. */
  speak() {
    const { problems, connections, toml } = this.found;
    const n = this.blocks.length;
    const counted = `${n} ${n === 1 ? "block" : "blocks"}, ${connections.length} ${connections.length === 1 ? "connection" : "connections"}`;
    const hint = this.tool ? `Click on the grid, or on a side of a block, to place a ${this.kinds.get(this.tool).word}.` : "Choose a block to place.";
    const more = toml ? "It can be built." : problems.length > 0 ? "" : n < 2 ? hint : "Checking …";
    this.parts.say.textContent = n === 0 ? hint : [this.remark, `${counted}.`, more].filter(Boolean).join(" ");
    // Update only on changes, so that screen readers do not repeat the list.
    const lastProblems = JSON.stringify(problems);
    if (this.lastProblems !== lastProblems) this.parts.problems.replaceChildren(...problems.map(({ blocks, text }) => {
      const button = element("button", { type: "button" }, `${sentence(text)}.`);
      // Successive clicks step through the blocks of the problem.
      button.addEventListener("click", () => { if (blocks.length > 0) this.pick(blocks[(blocks.indexOf(this.selected) + 1) % blocks.length]); });
      return element("li", {}, button);
    }));
    this.lastProblems = lastProblems;
    for (const button of [this.parts.policy, this.parts.expert]) button.disabled = !toml;
    this.parts.save.disabled = n === 0;
    this.parts.match.disabled = !problems.some(({ check }) => check === "polarity");
    this.parts.copy.disabled = !this.stage.chosen;
    /** @type {Record<string, boolean>} */
    const needed = { undo: this.past.length > 0, redo: this.future.length > 0, clear: n > 0, fit: true };
    for (const button of this.parts.tools.querySelectorAll("button")) button.disabled = !(needed[button.dataset.do] ?? (this.selected !== null || this.tool !== null));
  }

  /**
   * Chooses the type of the next block; `null` to select.
   * @param {string | null} type
   */
  choose(type) {
    [this.tool, this.selected] = [type, null];
    this.desk.hint(null);
    this.draw();
    this.parts.canvas.focus({ preventScroll: true });
  }

  /**
   * Selects a block for the keys to turn and move.
   * @param {number} i
   */
  pick(i) {
    [this.selected, this.tool] = [i, null];
    this.draw();
    this.parts.canvas.focus({ preventScroll: true });
  }

  /**
   * Moves the grid to this height.
   * @param {number} height cells
   */
  lift(height) {
    this.height = height;
    this.parts.layerText.textContent = String(height);
    this.parts.layer.value = String(height);
    this.desk.lift(height);
    this.desk.render();
  }

  /**
   * Returns the best position of the next block that fills `cell` and lies on the side toward `normal`, or `null`.
   * @param {Vector} cell
   * @param {Vector} normal
   * @returns {Spot | null}
   */
  fitting(cell, normal) {
    const size = this.cells(this.tool, this.axes);
    const filled = this.blocks.map(({ type, at, axes }) => /** @type {const} */ ([at, this.cells(type, axes)]));
    const isFree = (/** @type {Vector} */ at) => filled.every(([low, of]) => at.some((v, k) => v >= low[k] + of[k] || low[k] >= v + size[k]));
    const isNear = (/** @type {Vector} */ at) => at[2] >= 0 && at[2] + size[2] <= HIGH && [0, 1].every((k) => at[k] >= -WIDE && at[k] + size[k] <= WIDE);
    const shifts = size.map((n, k) => (normal[k] !== 0 ? [normal[k] > 0 ? 0 : n - 1] : [...Array(n).keys()]));
    const away = (/** @type {Vector} */ shift) => shift.reduce((sum, s, k) => sum + (normal[k] !== 0 ? 0 : Math.abs(s - Math.floor((size[k] - 1) / 2))), 0);
    const all = shifts[0].flatMap((x) => shifts[1].flatMap((y) => shifts[2].map((z) => [x, y, z])));
    const fitting = all.sort((a, b) => away(a) - away(b)).map((shift) => cell.map((v, k) => v - shift[k])).filter((at) => isNear(at) && isFree(at));
    return fitting.length > 0 ? { at: fitting[0], size, color: this.kinds.get(this.tool).color } : null;
  }

  /** @param {Spot | null} spot */
  place(spot) {
    if (!spot) {
      this.parts.say.textContent = "There is no room for this block here.";
      return;
    }
    this.change(() => {
      this.blocks.push({ type: this.tool, at: spot.at, axes: this.axes, is_free: true });
      this.selected = this.blocks.length - 1;
    });
    if (!this.desk.sees(spot)) this.desk.all();
  }

  /** Places a block without a pointer: on top of the selected or last block, or at the center of the grid. */
  placeNext() {
    if (!this.tool) return;
    const below = this.blocks[this.selected ?? this.blocks.length - 1];
    const size = below && this.cells(below.type, below.axes);
    const top = below ? below.at.map((v, k) => (k === 2 ? v + size[2] : v + Math.floor((size[k] - 1) / 2))) : [0, 0, this.height];
    this.place(this.fitting(top, [0, 0, 1]));
  }

  /**
   * Returns the axis about which the block tips over: one that a long block that lies stands up by.
   * @param {Vector} right the direction that points right on the screen
   */
  tipping(right) {
    const block = this.blocks[this.selected];
    if (!block && !this.tool) return right;
    const size = this.cells(block ? block.type : this.tool, block ? block.axes : this.axes);
    const along = right.findIndex((v) => v !== 0);
    // Its longer side, if it has one, rises.
    return size[along] > size[1 - along] ? cross3(right, [0, 0, 1]) : right;
  }

  /**
   * Turns the selected block, or the next block to place, by a quarter.
   * @param {Vector} about
   */
  rotate(about) {
    const block = this.blocks[this.selected];
    if (!block) {
      if (this.tool) this.axes = quarter(this.axes, about);
      return;
    }
    this.change(() => {
      const before = this.cells(block.type, block.axes);
      block.axes = quarter(block.axes, about);
      const after = this.cells(block.type, block.axes);
      // Keep the middle cell and the bottom of the block in place.
      const middle = (/** @type {Vector} */ size, /** @type {number} */ k) => (k === 2 ? 0 : Math.floor((size[k] - 1) / 2));
      block.at = block.at.map((v, k) => v + middle(before, k) - middle(after, k));
      // The server must not turn the others. If the cells stay the same, the user is setting the poles of this one.
      this.blocks.forEach((one) => { one.is_free = one === block && after.join() !== before.join(); });
      this.axes = block.axes;
    });
  }

  /**
   * Turns the selected block, or the next one to place, so that its longest or shortest side is upright.
   * @param {(...sides: number[]) => number} pick
   */
  raise(pick) {
    const block = this.blocks[this.selected];
    if (!block && !this.tool) return;
    const [type, axes] = block ? [block.type, block.axes] : [this.tool, this.axes];
    const height = pick(...this.kinds.get(type).cells);
    if (this.cells(type, axes)[2] === height) return;
    const right = this.desk.right();
    const about = [right, cross3(right, [0, 0, 1])].find((one) => this.cells(type, quarter(axes, one))[2] === height);
    if (about) this.rotate(about);
  }

  /**
   * Moves the selected block.
   * @param {Vector} by cells
   */
  shift(by) {
    const block = this.blocks[this.selected];
    if (!block) return;
    const at = add3(block.at, by);
    if (at[2] < 0 || at[2] >= HIGH || Math.max(Math.abs(at[0]), Math.abs(at[1])) > WIDE) return;
    this.change(() => { block.at = at; });
  }

  /**
   * Does what a tool of the board is for.
   * @param {string} what
   */
  act(what) {
    if (!this.desk) return;
    const right = this.desk.right();
    const back = cross3([0, 0, 1], right);
    const minus = (/** @type {Vector} */ v) => v.map((x) => -x);
    /** @type {Record<string, Vector>} */
    const moves = { left: minus(right), right, back, front: minus(back), up: [0, 0, 1], down: [0, 0, -1] };
    if (moves[what]) this.shift(moves[what]);
    else if (what === "turn") this.rotate([0, 0, 1]);
    else if (what === "tip") this.rotate(this.tipping(right));
    else if (what === "stand") this.raise(Math.max);
    else if (what === "lie") this.raise(Math.min);
    else if (what === "fit") this.desk.all();
    else if (what === "clear") this.change(() => { [this.blocks, this.selected] = [[], null]; });
    else if (what === "remove" && this.selected !== null) {
      this.change(() => {
        this.blocks.splice(this.selected, 1);
        this.selected = null;
      });
    } else if (what === "undo") this.goBack(this.past, this.future);
    else if (what === "redo") this.goBack(this.future, this.past);
  }

  /**
   * Takes the newest of `from`, and keeps what was there in `to`.
   * @param {string[]} from
   * @param {string[]} to
   */
  goBack(from, to) {
    if (from.length === 0) return;
    to.push(this.state());
    ({ blocks: this.blocks, name: this.name, file: this.file } = JSON.parse(from.pop()));
    [this.parts.name.value, this.remark] = [this.name, ""];
    if (this.selected >= this.blocks.length) this.selected = null;
    this.draw();
    this.ask();
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    /** @type {Record<string, string>} */
    const moves = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "back", ArrowDown: "front", PageUp: "up", PageDown: "down" };
    /** @type {Record<string, [number, number]>} */
    const views = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    const { key } = event;
    if (!this.desk || event.altKey) return;
    if ((event.ctrlKey || event.metaKey) && key.toLowerCase() === "z") this.act(event.shiftKey ? "redo" : "undo");
    else if (event.ctrlKey && key === "y") this.act("redo");
    else if (event.ctrlKey || event.metaKey) return;
    else if (moves[key] && (event.shiftKey || key.startsWith("Page"))) this.act(moves[key]);
    else if (views[key] && this.selected === null) this.desk.turn(...views[key]);
    else if (key === "ArrowLeft") this.rotate([0, 0, -1]);
    else if (key === "r" || key === "R" || key === "ArrowRight") this.rotate([0, 0, 1]);
    else if (key === "t" || key === "T" || key === "ArrowUp") this.act("tip");
    else if (key === "s" || key === "S") this.act("stand");
    else if (key === "l" || key === "L") this.act("lie");
    else if (key === "ArrowDown") this.rotate(this.tipping(this.desk.right()).map((v) => -v));
    else if (key === "Delete" || key === "Backspace") this.act("remove");
    else if (key === "Enter" || key === " ") this.placeNext();
    else if (key === "+" || key === "-") this.desk.near(key === "+" ? 1.15 : 0.87);
    else if (key === "0") this.desk.all();
    else if (key === "Escape") this.choose(null);
    else return;
    event.preventDefault();
  }

  /**
   * Replaces the drawing with the contents of a blueprint file, also of one that cannot be built.
   * @param {string} text
   * @param {string} file its name without an ending
   */
  async load(text, file) {
    /** @type {Response} */
    let answer;
    try {
      answer = await fetch("/api/check", { method: "POST", body: text });
    } catch {
      this.parts.say.textContent = NO_ANSWER;
      return;
    }
    const reason = answer.ok ? "" : (await answer.text()).trim();
    const draft = readDraft(text, this.kinds);
    if (reason && draft.blocks.length === 0) {
      this.parts.say.textContent = `This file cannot be opened: ${reason}`;
      // The problems of the drawing would look like those of the file. They come back with its next change.
      this.parts.problems.replaceChildren();
      this.lastProblems = null;
      return;
    }
    /** @type {Findings} */
    const { blocks } = reason ? draft : await answer.json();
    // Center the structure on the grid.
    const low = [0, 1, 2].map((k) => Math.min(...blocks.map(({ at }) => at[k])));
    const middle = [0, 1].map((k) => Math.floor((Math.max(...blocks.map((b) => b.at[k] + this.cells(b.type, b.axes)[k])) - low[k]) / 2));
    const origin = [low[0] + middle[0], low[1] + middle[1], low[2]];
    this.change(() => {
      this.blocks = blocks.map((block) => ({ ...block, at: block.at.map((v, k) => v - origin[k]) }));
      [this.name, this.file] = [draft.title ?? file, file];
      [this.selected, this.tool] = [null, null];
      const leftOut = draft.nLeftOut > 0 ? ` ${draft.nLeftOut} ${draft.nLeftOut === 1 ? "block is" : "blocks are"} left out.` : "";
      this.remark = reason ? `This file is a draft: ${reason}.${leftOut}` : "";
    });
    this.desk.all();
  }

  async upload() {
    const [file] = this.parts.file.files;
    this.parts.file.value = "";
    if (file) await this.load(await file.text(), file.name.replace(/\.toml$/i, ""));
  }

  /** Opens the blueprint selected in the gallery for editing. */
  async take() {
    try {
      const answer = await fetch(`/api/blueprint?id=${encodeURIComponent(this.stage.chosen)}`);
      if (answer.ok) await this.load(await answer.text(), this.stage.chosen);
    } catch {
      this.parts.say.textContent = NO_ANSWER;
    }
  }

  download() {
    if (this.blocks.length === 0) return;
    const text = this.found.toml || writeDraft(this.name, this.blocks);
    // Some systems allow none of these in the name of a file.
    const name = (this.file ?? this.name).trim().replace(/[/\\:*?"<>|\p{Cc}]+/gu, "-");
    const [, id] = /^id = "([^"]+)"/m.exec(text) || [null, "draft"];
    save(new Blob([text], { type: "application/toml" }), `${name || id}.toml`);
  }

  /** @param {Agent} agent */
  build(agent) {
    if (!this.found.toml) return;
    const title = this.parts.name.value.trim() || "a drawing";
    this.stage.startDrawn({ file: this.found.toml, title, code: encode(this.blocks) }, agent);
    $("replay-title").scrollIntoView();
  }
}
