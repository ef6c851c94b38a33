// The network's attention over an episode: a strip of the goal's blocks over time, and shading of the blocks.

/** Color scale from 0 to 50 % or more attention, as in the video clips. */
const SHADES = [[240, 242, 246], [247, 164, 66], [140, 14, 84]];

function shade(percent) {
  const at = Math.min(percent / 50, 1) * (SHADES.length - 1);
  const low = Math.min(Math.floor(at), SHADES.length - 2);
  return SHADES[low].map((x, i) => Math.round(x + (SHADES[low + 1][i] - x) * (at - low)));
}

class Attention {
  /** Calls `changed` when the user selects another source. */
  constructor({ part, choice, strip, note }, changed) {
    Object.assign(this, { part, choice, strip, note });
    choice.addEventListener("change", () => {
      this.draw();
      changed();
    });
  }

  show(episode) {
    this.told = episode.attention;
    this.part.hidden = !this.told;
    if (!this.told) return;
    this.blocks = episode.goal.map(([block]) => block);
    this.colors = episode.colors;
    const before = this.choice.value;
    const options = ["off", ...this.told.sources].map((name, i) => element("option", { value: String(i - 1) }, name));
    this.choice.replaceChildren(...options);
    this.choice.value = options.some((option) => option.value === before) ? before : "-1";
    this.note.textContent = `Attention of weights ${this.told.weights_version}, no matter who acted. Each row is a block of the goal; the last row is all others.`;
    this.draw();
  }

  /** Returns the attention of the selected source in percent by block, or `null` if none is selected. */
  at(time) {
    const source = Number(this.choice.value);
    return this.told && source >= 0 ? this.told.percent[source][Math.floor(time)] : null;
  }

  draw() {
    const source = Number(this.choice.value);
    this.strip.hidden = source < 0;
    if (source < 0) return;
    const scenes = this.told.percent[source];
    const rest = (scene) => scene.reduce((sum, x, block) => sum + (this.blocks.includes(block) ? 0 : x), 0);
    const rows = [...this.blocks.map((block) => (scene) => scene[block]), rest];
    const label = `Attention of ${this.told.sources[source]} over ${scenes.length - 1} steps`;
    const drawing = svg("svg", { viewBox: `-3 0 ${scenes.length + 3} ${rows.length}`, preserveAspectRatio: "none", role: "img", "aria-label": label });
    rows.forEach((share, row) => {
      const color = this.blocks[row] === undefined ? [128, 128, 128] : this.colors[this.blocks[row]];
      drawing.append(svg("rect", { x: -3, y: row + 0.1, width: 2, height: 0.8, fill: `rgb(${color.join(",")})` }));
      scenes.forEach((scene, step) => {
        drawing.append(svg("rect", { x: step, y: row, width: 1.02, height: 1.02, fill: `rgb(${shade(share(scene)).join(",")})` }));
      });
    });
    this.now = svg("line", { class: "now", y1: 0, y2: rows.length });
    drawing.append(this.now);
    this.strip.style.height = `${Math.min(rows.length * 14, 160)}px`;
    this.strip.replaceChildren(drawing);
  }

  seek(time) {
    if (!this.told || Number(this.choice.value) < 0) return;
    this.now.setAttribute("x1", Math.floor(time) + 0.5);
    this.now.setAttribute("x2", Math.floor(time) + 0.5);
  }
}
