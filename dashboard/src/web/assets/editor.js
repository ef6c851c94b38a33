// Draw and build: blocks placed on a grid by hand. The program checks every state of the drawing, turns blocks until poles match,
// and writes it as a file, which is what is built.

/** Cells on each side of the middle, and upward, within which blocks are placed. */
const [WIDE, HIGH] = [12, 24];

/** Where the drawing is kept, so that it outlives the page. */
const KEPT = "lodestone-drawing";

const axisOf = (name) => [0, 1, 2].map((k) => ("xyz"[k] === name[1] ? (name[0] === "+" ? 1 : -1) : 0));
const nameOf = (axis) => `${axis.some((v) => v > 0) ? "+" : "-"}${"xyz"[axis.findIndex((v) => v !== 0)]}`;

/** Images of a block's own x, y and z axes. */
function imagesOf(axes) {
  const [x, y] = axes.split(" ").map(axisOf);
  return [x, y, cross3(x, y)];
}

/** The same axes after a quarter turn about the axis `about`. */
function quarter(axes, about) {
  const turned = (v) => add3(about.map((a) => a * dot3(about, v)), cross3(about, v));
  return axes.split(" ").map((name) => nameOf(turned(axisOf(name)).map(Math.round))).join(" ");
}

/** The turn as a quaternion x, y, z, w. */
function quaternionOf(axes) {
  const [x, y, z] = imagesOf(axes);
  const squares = [1 + x[0] - y[1] - z[2], 1 - x[0] + y[1] - z[2], 1 - x[0] - y[1] + z[2], 1 + x[0] + y[1] + z[2]];
  // The largest part is found first, and the others by dividing by it.
  const most = squares.indexOf(Math.max(...squares));
  const rows = [
    [squares[0], x[1] + y[0], x[2] + z[0], y[2] - z[1]],
    [x[1] + y[0], squares[1], y[2] + z[1], z[0] - x[2]],
    [x[2] + z[0], y[2] + z[1], squares[2], x[1] - y[0]],
    [y[2] - z[1], z[0] - x[2], x[1] - y[0], squares[3]],
  ];
  const length = 2 * Math.sqrt(squares[most]);
  return rows[most].map((v) => v / length);
}

class Editor {
  constructor(stage, parts) {
    Object.assign(this, parts, { stage });
    [this.blocks, this.past, this.selected, this.tool, this.height, this.asked] = [[], [], null, null, 0, 0];
    this.found = { problems: [], connections: [], toml: null };
    this.open.addEventListener("click", () => this.toggle());
    this.tools.addEventListener("click", (event) => { if (event.target.dataset.do) this.act(event.target.dataset.do); });
    this.layer.addEventListener("input", () => this.lift(Number(this.layer.value)));
    this.match.addEventListener("click", () => this.change(() => { this.blocks.forEach((block) => { block.is_free = true; }); }));
    this.name.addEventListener("input", () => this.ask(false));
    for (const agent of ["policy", "expert"]) this[agent].addEventListener("click", () => this.build(agent));
    this.save.addEventListener("click", () => this.download());
    this.file.addEventListener("change", () => this.upload());
    this.copy.addEventListener("click", () => this.take());
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    // A second finger, like another button, turns or shifts the view.
    this.canvas.addEventListener("pointerdown", (event) => { this.pressed = event.isPrimary && event.button === 0 ? [event.clientX, event.clientY] : null; });
    this.canvas.addEventListener("pointerup", (event) => this.release(event));
    this.canvas.addEventListener("pointermove", (event) => this.hover(event));
    this.canvas.addEventListener("pointerleave", () => this.desk && this.desk.hint(null));
    new ResizeObserver(() => this.resize()).observe(this.board);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      if (!this.desk) return;
      this.desk.theme();
      this.draw();
    });
  }

  /** Opens the board, and closes it. */
  async toggle(on = this.board.hidden) {
    this.board.hidden = !on;
    this.open.setAttribute("aria-expanded", String(on));
    this.open.textContent = on ? "Close the drawing" : "Draw a structure";
    if (!on || this.desk) return;
    try {
      const [{ Desk }, answer] = await Promise.all([import("./draw.js"), fetch("/api/inventory")]);
      const { types, unit_m: unit } = await answer.json();
      this.kinds = new Map(types.map((one) => [one.type, one]));
      this.unit = unit;
      this.desk ||= new Desk(this.canvas, unit);
    } catch {
      this.say.textContent = "This browser draws no three dimensions, or the program does not answer.";
      return;
    }
    this.restore();
    this.resize();
    // Hands over the blocks that the view is to fit.
    this.change(() => {});
    this.desk.all();
    this.past = [];
  }

  resize() {
    const width = this.canvas.clientWidth;
    if (!this.desk || width === 0) return;
    const height = Math.round(Math.min(Math.max(width * 0.5, 320), 520, window.innerHeight * 0.62));
    this.canvas.style.height = `${height}px`;
    this.desk.resize(width, height);
    this.desk.render();
  }

  cells(type, axes) {
    const own = this.kinds.get(type).cells;
    const images = imagesOf(axes);
    return [0, 1, 2].map((k) => Math.abs(own.reduce((sum, n, i) => sum + n * images[i][k], 0)));
  }

  left(type) {
    return this.kinds.get(type).count - this.blocks.filter((block) => block.type === type).length;
  }

  /** What a block is called, as in what is said about it. */
  called(i) {
    const same = this.blocks.filter(({ type }) => type === this.blocks[i].type);
    const { word } = this.kinds.get(this.blocks[i].type);
    return same.length === 1 ? word : `${word} ${same.indexOf(this.blocks[i]) + 1}`;
  }

  /** Changes the blocks; the state before can be had back. */
  change(how) {
    const before = JSON.stringify(this.blocks);
    how();
    if (this.selected !== null && this.selected >= this.blocks.length) this.selected = null;
    if (this.past[this.past.length - 1] !== before) this.past.push(before);
    if (this.past.length > 200) this.past.shift();
    if (this.tool && this.left(this.tool) === 0) this.tool = null;
    this.draw();
    this.ask();
  }

  /** Lets the program check the drawing, whose blocks may have changed; only the answer to the newest question counts. */
  async ask(changed = true) {
    this.asked += 1;
    const mine = this.asked;
    if (changed) this.found.toml = null;
    this.speak();
    try {
      const blocks = this.blocks.map(({ type, at, axes, is_free }) => ({ type, at, axes, is_free }));
      const answer = await fetch("/api/check", { method: "POST", body: JSON.stringify({ title: this.name.value, blocks }) });
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
      localStorage.setItem(KEPT, JSON.stringify({ title: this.name.value, blocks: this.blocks }));
    } catch {
      // A browser may keep nothing.
    }
  }

  /** Takes up the drawing that was left, if it can still be read. */
  restore() {
    try {
      const { title, blocks } = JSON.parse(localStorage.getItem(KEPT));
      if (!blocks.every(({ type, at, axes }) => this.kinds.has(type) && at.length === 3 && imagesOf(axes))) return;
      [this.blocks, this.name.value] = [blocks, title];
    } catch {
      // There is none.
    }
  }

  /** Shows the blocks, what is left of each type, and what was found. */
  draw() {
    if (!this.desk) return;
    const wrong = new Set(this.found.problems.flatMap(({ blocks }) => blocks));
    const drawn = this.blocks.map(({ type, at, axes }) => {
      const size = this.cells(type, axes);
      const { cells, color } = this.kinds.get(type);
      return { type, cells, color, at, size, pose: [...at.map((v, k) => (v + size[k] / 2) * this.unit), ...quaternionOf(axes)] };
    });
    this.desk.set(drawn, drawn.map((_, i) => (i === this.selected ? "selected" : wrong.has(i) ? "wrong" : null)));
    const tool = (type, ...content) => {
      const button = element("button", { type: "button", "aria-pressed": String(this.tool === type), "data-type": type || "" }, ...content);
      button.disabled = type !== null && this.left(type) === 0;
      button.addEventListener("click", () => this.choose(type));
      return button;
    };
    this.palette.replaceChildren(tool(null, "Select"), ...[...this.kinds.values()].map(({ type, word, cells, color }) => {
      const patch = element("i", {});
      patch.style.background = `rgb(${color.join(",")})`;
      return tool(type, patch, `${word} ${cells.join("×")}`, element("small", {}, `${this.left(type)} left`));
    }));
    this.list.replaceChildren(...this.blocks.map((block, i) => {
      const button = element("button", { type: "button", "aria-pressed": String(i === this.selected) }, `${this.called(i)} at ${block.at.join(", ")}`);
      button.addEventListener("click", () => this.pick(i));
      return button;
    }));
    this.speak();
  }

  /** Says how the drawing is. */
  speak() {
    const { problems, connections, toml } = this.found;
    const n = this.blocks.length;
    const counted = `${n} ${n === 1 ? "block" : "blocks"}, ${connections.length} ${connections.length === 1 ? "connection" : "connections"}`;
    const hint = this.tool ? `Click on the grid, or on a side of a block, to place a ${this.kinds.get(this.tool).word}.` : "Choose a block to place.";
    const more = toml ? "It can be built." : problems.length > 0 ? "" : n < 2 ? hint : "Checking …";
    this.say.textContent = n === 0 ? hint : `${counted}. ${more}`;
    // What is said again is not read out again.
    const told = JSON.stringify(problems);
    if (this.told !== told) this.problems.replaceChildren(...problems.map(({ blocks, text }) => {
      const button = element("button", { type: "button" }, `${text[0].toUpperCase()}${text.slice(1)}.`);
      // One click after the other leads to each of its blocks.
      button.addEventListener("click", () => { if (blocks.length > 0) this.pick(blocks[(blocks.indexOf(this.selected) + 1) % blocks.length]); });
      return element("li", {}, button);
    }));
    this.told = told;
    for (const button of [this.policy, this.expert, this.save]) button.disabled = !toml;
    this.match.disabled = !problems.some(({ check }) => check === "polarity");
    this.copy.disabled = !this.stage.chosen;
    const needed = { undo: this.past.length > 0, clear: n > 0, fit: true };
    for (const button of this.tools.querySelectorAll("button")) button.disabled = !(needed[button.dataset.do] ?? (this.selected !== null || this.tool !== null));
  }

  choose(type) {
    [this.tool, this.selected] = [type, null];
    this.axes ||= "+x +y";
    this.desk.hint(null);
    this.draw();
    this.canvas.focus({ preventScroll: true });
  }

  /** Selects a block, which keys then turn and move. */
  pick(i) {
    [this.selected, this.tool] = [i, null];
    this.draw();
    this.canvas.focus({ preventScroll: true });
  }

  lift(height) {
    this.height = height;
    this.layerText.textContent = String(height);
    this.layer.value = String(height);
    this.desk.lift(height);
    this.desk.render();
  }

  /** Where the block to be placed fits best so that it fills a cell and lies on the side toward `normal`; `null` for nowhere. */
  fitting(cell, normal) {
    const size = this.cells(this.tool, this.axes);
    const filled = this.blocks.map(({ type, at, axes }) => [at, this.cells(type, axes)]);
    const isFree = (at) => filled.every(([low, of]) => at.some((v, k) => v >= low[k] + of[k] || low[k] >= v + size[k]));
    const isNear = (at) => at[2] >= 0 && at[2] + size[2] <= HIGH && [0, 1].every((k) => at[k] >= -WIDE && at[k] + size[k] <= WIDE);
    const shifts = size.map((n, k) => (normal[k] !== 0 ? [normal[k] > 0 ? 0 : n - 1] : [...Array(n).keys()]));
    const away = (shift) => shift.reduce((sum, s, k) => sum + (normal[k] !== 0 ? 0 : Math.abs(s - Math.floor((size[k] - 1) / 2))), 0);
    const all = shifts[0].flatMap((x) => shifts[1].flatMap((y) => shifts[2].map((z) => [x, y, z])));
    const fitting = all.sort((a, b) => away(a) - away(b)).map((shift) => cell.map((v, k) => v - shift[k])).filter((at) => isNear(at) && isFree(at));
    return fitting.length > 0 ? { at: fitting[0], size, color: this.kinds.get(this.tool).color } : null;
  }

  place(spot) {
    if (!spot) {
      this.say.textContent = "There is no room for it here.";
      return;
    }
    this.change(() => {
      this.blocks.push({ type: this.tool, at: spot.at, axes: this.axes, is_free: true });
      this.selected = this.blocks.length - 1;
    });
  }

  /** The place that a pointer is over. */
  under(event) {
    const box = this.canvas.getBoundingClientRect();
    return this.desk.pick(event.clientX - box.left, event.clientY - box.top);
  }

  release(event) {
    // What moved turned the view.
    if (!this.desk || !event.isPrimary || !this.pressed || Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) > 5) return;
    const hit = this.under(event);
    this.desk.hint(null);
    if (this.tool) {
      if (hit) this.place(this.fitting(hit.cell, hit.normal));
    } else {
      this.selected = hit ? hit.block : null;
      this.draw();
    }
  }

  hover(event) {
    if (!this.desk || !this.tool || event.pointerType !== "mouse" || event.buttons !== 0) return;
    const hit = this.under(event);
    this.desk.hint(hit && this.fitting(hit.cell, hit.normal));
  }

  /** Without a pointer: onto the selected block, or onto the middle of the grid. */
  placeNext() {
    if (!this.tool) return;
    const below = this.blocks[this.selected ?? this.blocks.length - 1];
    const size = below && this.cells(below.type, below.axes);
    const top = below ? below.at.map((v, k) => (k === 2 ? v + size[2] : v + Math.floor((size[k] - 1) / 2))) : [0, 0, this.height];
    this.place(this.fitting(top, [0, 0, 1]));
  }

  /** Turns the selected block, or the one that is placed next. */
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
      // Its middle cell stays, and so does what it stands on.
      const middle = (size, k) => (k === 2 ? 0 : Math.floor((size[k] - 1) / 2));
      block.at = block.at.map((v, k) => v + middle(before, k) - middle(after, k));
      // Whoever turns a block that fills the same cells as before means its poles: then no other block gives way.
      if (after.join() === before.join()) this.blocks.forEach((one) => { one.is_free = false; });
      this.axes = block.axes;
    });
  }

  shift(by) {
    const block = this.blocks[this.selected];
    if (!block) return;
    const at = add3(block.at, by);
    if (at[2] < 0 || at[2] >= HIGH || Math.max(Math.abs(at[0]), Math.abs(at[1])) > WIDE) return;
    this.change(() => { block.at = at; });
  }

  act(what) {
    if (!this.desk) return;
    const right = this.desk.right();
    const back = cross3([0, 0, 1], right);
    const minus = (v) => v.map((x) => -x);
    const moves = { left: minus(right), right, back, front: minus(back), up: [0, 0, 1], down: [0, 0, -1] };
    if (moves[what]) this.shift(moves[what]);
    else if (what === "turn") this.rotate([0, 0, 1]);
    else if (what === "tip") this.rotate(right);
    else if (what === "fit") this.desk.all();
    else if (what === "clear") this.change(() => { [this.blocks, this.selected] = [[], null]; });
    else if (what === "remove" && this.selected !== null) {
      this.change(() => {
        this.blocks.splice(this.selected, 1);
        this.selected = null;
      });
    } else if (what === "undo" && this.past.length > 0) {
      this.blocks = JSON.parse(this.past.pop());
      if (this.selected >= this.blocks.length) this.selected = null;
      this.draw();
      this.ask();
    }
  }

  key(event) {
    const moves = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "back", ArrowDown: "front", PageUp: "up", PageDown: "down" };
    const views = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    const { key } = event;
    if (!this.desk || event.altKey) return;
    if ((event.ctrlKey || event.metaKey) && key === "z") this.act("undo");
    else if (event.ctrlKey || event.metaKey) return;
    else if (moves[key] && (event.shiftKey || key.startsWith("Page"))) this.act(moves[key]);
    else if (views[key] && this.selected === null) this.desk.turn(...views[key]);
    else if (key === "ArrowLeft") this.rotate([0, 0, -1]);
    else if (key === "r" || key === "R" || key === "ArrowRight") this.rotate([0, 0, 1]);
    else if (key === "t" || key === "T" || key === "ArrowUp") this.act("tip");
    else if (key === "ArrowDown") this.rotate(this.desk.right().map((v) => -v));
    else if (key === "Delete" || key === "Backspace") this.act("remove");
    else if (key === "Enter" || key === " ") this.placeNext();
    else if (key === "+" || key === "-") this.desk.near(key === "+" ? 1.15 : 0.87);
    else if (key === "0") this.desk.all();
    else if (key === "Escape") this.choose(null);
    else return;
    event.preventDefault();
  }

  /** Takes the place of the drawing with that of a blueprint file. */
  async load(text) {
    let answer;
    try {
      answer = await fetch("/api/check", { method: "POST", body: text });
    } catch {
      this.say.textContent = "The program does not answer. Is it still running?";
      return;
    }
    if (!answer.ok) {
      this.say.textContent = `This file cannot be drawn: ${(await answer.text()).trim()}`;
      return;
    }
    const { title, blocks } = await answer.json();
    // Its middle comes into that of the grid.
    const middle = [0, 1].map((k) => Math.floor(Math.max(...blocks.map((b) => b.at[k] + this.cells(b.type, b.axes)[k])) / 2));
    this.name.value = title;
    this.change(() => {
      this.blocks = blocks.map((block) => ({ ...block, at: [block.at[0] - middle[0], block.at[1] - middle[1], block.at[2]] }));
      [this.selected, this.tool] = [null, null];
    });
    this.desk.all();
  }

  async upload() {
    const [file] = this.file.files;
    this.file.value = "";
    if (file) await this.load(await file.text());
  }

  /** Draws on what is chosen in the gallery. */
  async take() {
    const answer = await fetch(`/api/blueprint?id=${encodeURIComponent(this.stage.chosen)}`);
    if (answer.ok) await this.load(await answer.text());
  }

  download() {
    if (!this.found.toml) return;
    const url = URL.createObjectURL(new Blob([this.found.toml], { type: "application/toml" }));
    const [, id] = /^id = "([^"]+)"/m.exec(this.found.toml);
    element("a", { href: url, download: `${id}.toml` }).click();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
  }

  build(agent) {
    if (!this.found.toml) return;
    this.stage.startDrawn(this.found.toml, this.name.value.trim() || "a drawing", agent);
    $("replay-title").scrollIntoView();
  }
}
