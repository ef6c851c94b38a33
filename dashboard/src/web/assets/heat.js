// The heat map: one row per blueprint, one column per evaluation.

import { $, count, element, percent } from "./format.js";

/** @import { Acting, Counts, History, Evaluation, Row } from "./types" */

/**
 * A row on the canvas, from `y` on, in pixels. `place` is its index in the counts of an evaluation.
 * @typedef {Row & { place: number, y?: number }} Placed
 */

/** @typedef {{ row: number, column: number }} Cell */

const FONT = "12px system-ui, sans-serif";
/** The height of all rows if they fit, of a row with its name, and of the name of a group above its rows, pixels. */
const [TALL, NAMED, HEAD] = [480, 14, 18];
/** Largest mean width of a column, pixels: a few evaluations are no wall. */
const WIDEST = 48;

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
   * @type {Evaluation[]}
   */
  evaluations;
  /** @type {Acting} */
  acting = "greedy";

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {HTMLElement} axis tells the environment steps
   * @param {HTMLElement} cellText tells the cell under the pointer
   * @param {(row: Row, evaluation: Evaluation) => void} opened called when the user opens a cell
   */
  constructor(canvas, axis, cellText, opened) {
    this.canvas = canvas;
    this.axis = axis;
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
    this.evaluations = history.evaluations.filter((evaluation) => evaluation[acting].some((cell) => cell !== null));
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
    if (this.cursor) this.opened(this.rows[this.cursor.row], this.evaluations[this.cursor.column]);
  }

  /**
   * Places rows and columns on a canvas of this width, in pixels.
   * @param {number} width
   */
  layout(width) {
    const pen = this.canvas.getContext("2d");
    pen.font = FONT;
    const longest = (/** @type {string[]} */ words) => Math.max(...words.map((word) => pen.measureText(word).width), 0);
    const n = Math.max(this.rows.length, 1);
    $("heat-whole-label").hidden = n * NAMED <= TALL;
    const names = n * NAMED <= TALL || !$("heat-whole").checked;
    this.canvas.parentElement.classList.toggle("whole", !names);
    const height = names ? Math.min(Math.max(TALL / n, NAMED), 26) : Math.max(TALL / n, 3);
    const left = longest(this.rows.map((row) => (names ? row.id : row.group))) + 8;
    let y = 0;
    /** @type {string | null} */
    let group = null;
    /** @type {{ name: string, y: number, end?: number }[]} */
    const groups = [];
    for (const row of this.rows) {
      if (row.group !== group) {
        y += group === null ? 0 : 6;
        group = row.group;
        groups.push({ name: group, y });
        if (names) y += HEAD;
      }
      row.y = y;
      y += height;
      groups[groups.length - 1].end = y;
    }
    return { height, names, left, groups, edges: this.edges(left, width), isOne: this.evaluations.length === 1, total: Math.max(y, 20) };
  }

  /**
   * Returns where the columns begin and end, pixels: each reaches from the steps of the evaluation before to its own, so
   * that the last one ends with the last step.
   * @param {number} left
   * @param {number} width of the canvas
   */
  edges(left, width) {
    const room = this.evaluations.length === 1 ? width - left : Math.min(width - left, this.evaluations.length * WIDEST);
    const steps = this.evaluations.map((evaluation) => evaluation.n_env_steps);
    const last = Math.max(steps[steps.length - 1], 1);
    // An evaluation right after another one is still to be seen and clicked.
    const widths = steps.map((step, i) => Math.max(((step - (steps[i - 1] || 0)) / last) * room, Math.min(4, room / steps.length)));
    const sum = widths.reduce((total, one) => total + one, 0);
    let at = left;
    return [left, ...widths.map((one) => { at += (one / sum) * room; return at; })];
  }

  draw() {
    if (!this.evaluations) return;
    const width = this.canvas.clientWidth;
    if (width === 0) return;
    const at = this.layout(width);
    this.at = at;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.style.height = `${at.total}px`;
    [this.canvas.width, this.canvas.height] = [Math.round(width * ratio), Math.round(at.total * ratio)];
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const style = getComputedStyle(document.documentElement);
    const color = (/** @type {string} */ name) => style.getPropertyValue(name);
    pen.font = FONT;
    pen.textBaseline = "middle";
    pen.fillStyle = color("--quiet");
    this.drawAxis();
    $("heat-scale").parentElement.hidden = this.evaluations.length < 2;
    if (this.evaluations.length === 0) {
      pen.fillText("No evaluation with these actions yet.", 0, 10);
      return;
    }
    for (const group of at.groups) {
      if (at.names) pen.fillText(group.name || "", 0, group.y + HEAD / 2);
      else if (group.end - group.y >= 10) pen.fillText(group.name || "", 0, (group.y + group.end) / 2);
    }
    if (at.isOne) this.drawBars(pen, color);
    else this.drawCells(pen, ratio);
    if (at.names) {
      pen.fillStyle = color("--text");
      pen.textAlign = "right";
      for (const row of this.rows) pen.fillText(row.id, at.left - 8, row.y + at.height / 2);
    }
    if (this.cursor) {
      const [row, x, end] = [this.rows[this.cursor.row], at.edges[this.cursor.column], at.edges[this.cursor.column + 1]];
      pen.strokeStyle = color("--text");
      pen.lineWidth = 2;
      pen.strokeRect(x + 1, row.y + 0.5, Math.max(end - x - 2, 2), Math.max(at.height - 1, 2));
    }
  }

  /**
   * Draws a cell for every blueprint and evaluation; what was not evaluated stays empty.
   * @param {CanvasRenderingContext2D} pen
   * @param {number} ratio of the screen's pixels to the page's
   */
  drawCells(pen, ratio) {
    const { edges, height } = this.at;
    const gap = edges.length < 150 ? 1 : 0;
    const crisp = edges.map((x) => Math.round(x * ratio) / ratio);
    for (const row of this.rows) {
      this.evaluations.forEach((evaluation, i) => {
        const cell = evaluation[this.acting][row.place];
        if (!cell) return;
        pen.fillStyle = heatColor(cell[0] / cell[1]);
        pen.fillRect(crisp[i], row.y, Math.max(crisp[i + 1] - crisp[i] - gap, 1), height - (height > 8 ? 1 : 0));
      });
    }
  }

  /**
   * Draws the only evaluation as one bar for every blueprint, with its counts.
   * @param {CanvasRenderingContext2D} pen
   * @param {(name: string) => string} color
   */
  drawBars(pen, color) {
    const { left, height, names, edges } = this.at;
    const room = Math.min(edges[1] - left - 60, 240);
    for (const row of this.rows) {
      const cell = this.evaluations[0][this.acting][row.place];
      const middle = row.y + height / 2;
      pen.fillStyle = color("--line");
      pen.fillRect(left, middle - 0.5, room, 1);
      if (!cell) continue;
      pen.fillStyle = color("--accent");
      pen.fillRect(left, middle - Math.min(height / 4, 4), Math.max((cell[0] / cell[1]) * room, 2), Math.min(height / 2, 8));
      pen.fillStyle = color("--quiet");
      if (names) pen.fillText(`${cell[0]} of ${cell[1]}`, left + room + 8, middle);
    }
  }

  /** Writes the environment steps of the columns below them. */
  drawAxis() {
    const { edges, isOne } = this.at;
    /** @type {{ x: number, steps: number }[]} */
    const marks = [];
    // From the last one on, which always has its mark.
    for (let i = this.evaluations.length - 1; i >= 0 && !isOne; i -= 1) {
      const x = edges[i + 1];
      if (marks.length === 0 || marks[marks.length - 1].x - x > 90) marks.push({ x, steps: this.evaluations[i].n_env_steps });
    }
    const one = isOne ? [{ x: edges[0] + 80, steps: this.evaluations[0].n_env_steps }] : marks;
    this.axis.replaceChildren(...one.map(({ x, steps }, i) => {
      const mark = element("span", {}, i === 0 ? `${count(steps)} steps` : count(steps));
      mark.style.left = `${x}px`;
      return mark;
    }));
  }

  /** @param {PointerEvent} event */
  point(event) {
    if (!this.at || this.rows.length === 0) return;
    const column = this.at.edges.findIndex((x, i) => event.offsetX >= x && event.offsetX < this.at.edges[i + 1]);
    const row = this.rows.findIndex((one) => event.offsetY >= one.y && event.offsetY < one.y + this.at.height);
    this.move(row >= 0 && column >= 0 && column < this.evaluations.length ? { row, column } : null);
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    /** @type {Record<string, [number, number]>} */
    const steps = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] };
    const step = steps[event.key];
    if (event.key === "Escape") this.move(null);
    if (event.key === "Enter") this.open();
    if (!step || this.rows.length === 0 || !this.evaluations || this.evaluations.length === 0) return;
    event.preventDefault();
    const from = this.cursor || { row: 0, column: this.evaluations.length - 1 };
    const clamp = (/** @type {number} */ value, /** @type {number} */ n) => Math.min(Math.max(value, 0), n - 1);
    const move = this.cursor ? step : [0, 0];
    this.move({ row: clamp(from.row + move[0], this.rows.length), column: clamp(from.column + move[1], this.evaluations.length) });
    this.reveal();
  }

  /** @param {Cell | null} cursor */
  move(cursor) {
    this.cursor = cursor;
    this.draw();
    if (!cursor) {
      this.cellText.textContent = "\u00a0";
      return;
    }
    const [row, evaluation] = [this.rows[cursor.row], this.evaluations[cursor.column]];
    const cell = evaluation[this.acting][row.place];
    const found = cell ? `${cell[0]} of ${cell[1]} episodes (${percent(cell[0] / cell[1])})` : "not evaluated";
    this.cellText.textContent = `${row.id}, ${row.split}, ${row.n_blocks} blocks, after ${count(evaluation.n_env_steps)} steps: ${found}`;
  }

  /** Scrolls to the chosen row. */
  reveal() {
    if (!this.cursor) return;
    const box = this.canvas.parentElement;
    const { y } = this.rows[this.cursor.row];
    const first = y - (this.at.names ? HEAD : 0);
    if (first < box.scrollTop) box.scrollTop = first;
    else if (y + this.at.height > box.scrollTop + box.clientHeight) box.scrollTop = y + this.at.height - box.clientHeight;
  }
}
