// The heat map: one row per blueprint, one column per evaluation.

import { $, count, percent } from "./format.js";

/** @import { Acting, Counts, History, Pass, Row } from "./types" */

/**
 * A row on the canvas, from `y` on, in pixels. `place` is its index in the counts of an evaluation.
 * @typedef {Row & { place: number, y?: number }} Placed
 */

/** @typedef {{ row: number, column: number }} Cell */

const FONT = "12px system-ui, sans-serif";

const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

/**
 * Returns the color of a rate from 0 to 1.
 * @param {number} rate
 */
function heatColor(rate) {
  const place = Math.min(Math.max(rate, 0), 1) * (STOPS.length - 1);
  const low = Math.min(Math.floor(place), STOPS.length - 2);
  const mix = STOPS[low].map((from, i) => Math.round(from + (STOPS[low + 1][i] - from) * (place - low)));
  return `rgb(${mix.join(",")})`;
}

export class Heat {
  /** @type {Cell | null} */
  cursor = null;
  words = "";
  /** @type {Placed[]} */
  all = [];
  /**
   * The rows that match the search text.
   * @type {Placed[]}
   */
  rows = [];
  /**
   * The evaluations with these actions; `undefined` until there is a history.
   * @type {Pass[]}
   */
  passes;
  /** @type {Acting} */
  acting = "greedy";

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {HTMLElement} cellText tells the cell under the pointer
   * @param {(row: Row, pass: Pass) => void} opened called when the user opens a cell
   */
  constructor(canvas, cellText, opened) {
    this.canvas = canvas;
    this.cellText = cellText;
    this.opened = opened;
    canvas.addEventListener("pointermove", (event) => this.point(event));
    canvas.addEventListener("pointerdown", (event) => this.point(event));
    canvas.addEventListener("pointerleave", () => this.move(null));
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("click", () => this.open());
    new ResizeObserver(() => this.draw()).observe(canvas.parentElement);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    const scale = $("heat-scale");
    [scale.width, scale.height] = [60, 1];
    const pen = scale.getContext("2d");
    for (let x = 0; x < 60; x += 1) {
      pen.fillStyle = heatColor(x / 59);
      pen.fillRect(x, 0, 1, 1);
    }
  }

  /**
   * @param {History} history
   * @param {Acting} acting
   */
  show(history, acting) {
    this.passes = history.passes.filter((pass) => pass[acting].some((cell) => cell !== null));
    this.acting = acting;
    // The server orders blueprints by split and size, which keeps groups together.
    this.all = history.blueprints.map((blueprint, place) => ({ ...blueprint, place, group: blueprint.group || "other" }));
    this.find(this.words);
  }

  /**
   * Shows only rows that match the search text.
   * @param {string} words
   */
  find(words) {
    this.words = words.trim().toLowerCase();
    const text = (/** @type {Placed} */ row) => `${row.id} ${row.split} ${row.group} ${row.n_blocks} blocks`.toLowerCase();
    this.rows = this.all.filter((row) => text(row).includes(this.words));
    if (this.cursor && !this.rows[this.cursor.row]) this.cursor = null;
    this.draw();
  }

  open() {
    if (this.cursor) this.opened(this.rows[this.cursor.row], this.passes[this.cursor.column]);
  }

  /**
   * Places the rows on a canvas of this width, in pixels.
   * @param {number} width
   */
  layout(width) {
    const pen = this.canvas.getContext("2d");
    pen.font = FONT;
    const longest = (/** @type {string[]} */ words) => Math.max(...words.map((word) => pen.measureText(word).width), 0);
    const n = Math.max(this.rows.length, 1);
    const height = Math.max(Math.min(420 / n, 26), 4);
    const names = height >= 12;
    // On a phone there is no room for both; the names of other splits begin with theirs.
    const hasGroups = !names || width >= 500;
    const left = (hasGroups ? longest(this.rows.map((row) => row.group)) : 0) + (names ? longest(this.rows.map((row) => row.id)) + 12 : 0) + 8;
    let y = 4;
    /** @type {string | null} */
    let group = null;
    /** @type {{ name: string, y: number, end?: number }[]} */
    const groups = [];
    for (const row of this.rows) {
      if (row.group !== group) {
        y += group === null ? 0 : 8;
        group = row.group;
        groups.push({ name: group, y });
      }
      row.y = y;
      y += height;
      groups[groups.length - 1].end = y;
    }
    // With few evaluations, limit the cell width. A single evaluation is drawn as bars across the full width.
    const isOne = this.passes.length === 1;
    const column = isOne ? width - left : Math.min((width - left) / Math.max(this.passes.length, 1), 180);
    return { height, names, hasGroups, left, groups, column, isOne, total: y };
  }

  draw() {
    if (!this.passes) return;
    const width = this.canvas.clientWidth;
    if (width === 0) return;
    const at = this.layout(width);
    this.at = at;
    const total = Math.max(at.total, 40) + 20;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.style.height = `${total}px`;
    [this.canvas.width, this.canvas.height] = [Math.round(width * ratio), Math.round(total * ratio)];
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const style = getComputedStyle(document.documentElement);
    const color = (/** @type {string} */ name) => style.getPropertyValue(name);
    pen.font = FONT;
    pen.fillStyle = color("--quiet");
    if (this.passes.length === 0) {
      pen.fillText("No evaluation with these actions yet.", 0, 20);
      return;
    }
    const gap = at.column > 6 ? 1 : 0;
    for (const row of this.rows) {
      this.passes.forEach((pass, i) => {
        const cell = pass[this.acting][row.place];
        const x = Math.round((at.left + i * at.column) * ratio) / ratio;
        const end = Math.round((at.left + (i + 1) * at.column) * ratio) / ratio;
        const height = at.height - (at.height > 8 ? 1 : 0);
        pen.fillStyle = cell && !at.isOne ? heatColor(cell[0] / cell[1]) : color("--none");
        pen.fillRect(x, row.y, end - x - gap, height);
        if (!cell || !at.isOne) return;
        pen.fillStyle = heatColor(cell[0] / cell[1]);
        // Draw a sliver even if all episodes failed.
        pen.fillRect(x, row.y, Math.max((end - x - gap) * (cell[0] / cell[1]), 2), height);
      });
    }
    pen.textBaseline = "middle";
    for (const group of at.groups) {
      pen.fillStyle = color("--quiet");
      if (at.hasGroups && (at.names || group.end - group.y >= 10)) pen.fillText(group.name, 0, at.names ? group.y + at.height / 2 : (group.y + group.end) / 2);
    }
    if (at.names) {
      pen.fillStyle = color("--text");
      pen.textAlign = "right";
      for (const row of this.rows) pen.fillText(row.id, at.left - 6, row.y + at.height / 2);
    }
    pen.fillStyle = color("--quiet");
    pen.textBaseline = "alphabetic";
    pen.textAlign = "left";
    pen.fillText(`${count(this.passes[0].n_env_steps)} steps`, at.left, at.total + 15);
    if (this.passes.length > 1 && at.column * this.passes.length > 160) {
      pen.textAlign = "right";
      const end = at.left + at.column * this.passes.length;
      pen.fillText(`${count(this.passes[this.passes.length - 1].n_env_steps)} steps`, end, at.total + 15);
    }
    if (this.cursor) {
      const row = this.rows[this.cursor.row];
      pen.strokeStyle = color("--text");
      pen.lineWidth = 2;
      pen.strokeRect(at.left + this.cursor.column * at.column, row.y, Math.max(at.column - gap, 2), at.height);
    }
  }

  /** @param {PointerEvent} event */
  point(event) {
    if (!this.at || this.rows.length === 0) return;
    const column = Math.floor((event.offsetX - this.at.left) / this.at.column);
    const row = this.rows.findIndex((one) => event.offsetY >= one.y && event.offsetY < one.y + this.at.height);
    this.move(row >= 0 && column >= 0 && column < this.passes.length ? { row, column } : null);
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    /** @type {Record<string, [number, number]>} */
    const steps = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] };
    const step = steps[event.key];
    if (event.key === "Escape") this.move(null);
    if (event.key === "Enter") this.open();
    if (!step || this.rows.length === 0 || !this.passes || this.passes.length === 0) return;
    event.preventDefault();
    const from = this.cursor || { row: 0, column: this.passes.length - 1 };
    const clamp = (/** @type {number} */ value, /** @type {number} */ n) => Math.min(Math.max(value, 0), n - 1);
    const move = this.cursor ? step : [0, 0];
    this.move({ row: clamp(from.row + move[0], this.rows.length), column: clamp(from.column + move[1], this.passes.length) });
  }

  /** @param {Cell | null} cursor */
  move(cursor) {
    this.cursor = cursor;
    this.draw();
    if (!cursor) {
      this.cellText.textContent = "\u00a0";
      return;
    }
    const [row, pass] = [this.rows[cursor.row], this.passes[cursor.column]];
    const cell = pass[this.acting][row.place];
    const found = cell ? `${cell[0]} of ${cell[1]} episodes (${percent(cell[0] / cell[1])})` : "not evaluated";
    this.cellText.textContent = `${row.id}, ${row.split}, ${row.n_blocks} blocks, after ${count(pass.n_env_steps)} steps: ${found}`;
  }
}
