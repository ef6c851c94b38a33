// The 3D drawing: blocks on a grid, and picking them with the pointer. Lengths are in unit cells, except in meshes and
// poses, which are in meters. Loaded when the user starts to draw.

import { rgb } from "./magnets.js";
import { entry } from "./solid.js";
import { Space, blockMesh, dispose, ghostMesh, put } from "./space.js";
import { Color, GridHelper, Vector3 } from "./three.js";

/** @import { Drawn, Hit, Spot, Vector } from "./types" */

/** Frame colors of selected blocks and of blocks with problems. */
const [SELECTED, WRONG] = [[31, 111, 199], [214, 60, 20]];

/** Cells per side of the grid. */
const GRID = 24;

export class Desk extends Space {
  /** Height of the grid, cells. */
  layer = 0;
  /** @type {Drawn[]} */
  drawn = [];

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {number} unit edge of a cell, meters
   */
  constructor(canvas, unit) {
    super(canvas, () => {}, () => {});
    this.unit = unit;
    this.theme();
    this.camera.position.set(0.7, -1.25, 0.95);
    this.settle();
  }

  /** Draws the grid of cells at the height of the current layer. */
  theme() {
    super.theme();
    // The base constructor calls this before the cell size is known.
    if (!this.unit) return;
    dispose(this.scene, [this.grid]);
    const color = () => new Color(getComputedStyle(document.documentElement).getPropertyValue("--line").trim());
    this.grid = new GridHelper(GRID * this.unit, GRID, color(), color());
    this.grid.rotation.x = Math.PI / 2;
    this.scene.add(this.grid);
    this.lift(this.layer);
  }

  /**
   * Moves the grid.
   * @param {number} layer its height, cells
   */
  lift(layer) {
    this.layer = layer;
    this.grid.position.z = layer * this.unit + 0.0005;
  }

  /**
   * Shows blocks.
   * @param {Drawn[]} drawn
   * @param {("selected" | "wrong" | null)[]} marks one per block
   */
  set(drawn, marks) {
    const fresh = drawn.map(({ type, cells, color }, i) => {
      if (this.drawn[i] && this.drawn[i].type === type) return this.blocks[i];
      return blockMesh(cells.map((n) => (n * this.unit) / 2), color, this.unit);
    });
    dispose(this.scene, this.blocks.filter((mesh) => !fresh.includes(mesh)));
    [this.blocks, this.drawn] = [fresh, drawn];
    drawn.forEach(({ pose }, i) => {
      const mesh = fresh[i];
      if (!mesh.parent) this.scene.add(mesh);
      put(mesh, pose);
      const mark = rgb(marks[i] === "wrong" ? WRONG : SELECTED);
      mesh.userData.frame.visible = Boolean(marks[i]);
      mesh.userData.frame.material.color.copy(mark);
      // Neighbors may hide the frame, so tint the block too, but faintly: its color must still identify its type.
      mesh.material.emissive.copy(mark).multiplyScalar(marks[i] ? 0.15 : 0);
    });
    this.render();
  }

  /**
   * Shows where a block would be placed; `null` hides the preview.
   * @param {Spot | null} place
   */
  hint(place) {
    dispose(this.scene, this.ghosts);
    this.ghosts = [];
    if (place) {
      const mesh = ghostMesh(place.size.map((n) => (n * this.unit) / 2), place.color);
      mesh.position.fromArray(place.at.map((x, k) => (x + place.size[k] / 2) * this.unit));
      this.scene.add(mesh);
      this.ghosts = [mesh];
    }
    this.render();
  }

  /**
   * Returns the object at a canvas pixel: a block and the cell next to the hit face, or a cell of the grid.
   * @param {number} x
   * @param {number} y
   * @returns {Hit | null}
   */
  pick(x, y) {
    const { from, way } = this.ray(x, y);
    const at = (/** @type {number} */ t) => from.map((v, k) => v + t * way[k]);
    /** @type {Hit | null} */
    let best = null;
    this.drawn.forEach(({ at: low, size }, block) => {
      const hit = entry(from, way, low, low.map((v, k) => v + size[k]));
      if (!hit || (best && best.t <= hit.t)) return;
      const { t, axis } = hit;
      const normal = [0, 0, 0];
      normal[axis] = way[axis] < 0 ? 1 : -1;
      const cell = at(t).map((v, k) => Math.min(Math.max(Math.floor(v), low[k]), low[k] + size[k] - 1) + normal[k]);
      best = { t, block, cell, normal };
    });
    const floor = this.cellAt(x, y, this.layer);
    return floor && (!best || floor.t < best.t) ? { ...floor, block: null, normal: [0, 0, 1] } : best;
  }

  /**
   * Returns the ray through a canvas pixel, in cells.
   * @param {number} x
   * @param {number} y
   */
  ray(x, y) {
    const far = this.beyond(x, y);
    const from = this.camera.position.toArray().map((v) => v / this.unit);
    return { from, way: far.toArray().map((v, k) => v / this.unit - from[k]) };
  }

  /**
   * Returns the cell of the grid at a canvas pixel, were the grid at this height; `null` outside.
   * @param {number} x
   * @param {number} y
   * @param {number} height cells
   */
  cellAt(x, y, height) {
    const { from, way } = this.ray(x, y);
    const t = (height - from[2]) / way[2];
    const cell = [...from.map((v, k) => Math.floor(v + t * way[k])).slice(0, 2), height];
    return t > 0 && Math.max(Math.abs(cell[0] + 0.5), Math.abs(cell[1] + 0.5)) < GRID / 2 ? { t, cell } : null;
  }

  /**
   * Returns the grid direction that points right on the screen.
   * @returns {Vector}
   */
  right() {
    const { x, y } = this.camera.position.clone().sub(this.controls.target);
    // A quarter turn from the direction to the camera.
    return Math.abs(y) >= Math.abs(x) ? [y < 0 ? 1 : -1, 0, 0] : [0, x > 0 ? 1 : -1, 0];
  }

  /**
   * Returns whether a place is in the picture.
   * @param {Spot} spot
   */
  sees({ at, size }) {
    this.camera.updateMatrixWorld();
    return [0, 1, 2, 3, 4, 5, 6, 7].every((corner) => {
      const { x, y } = new Vector3().fromArray(at.map((v, k) => (v + ((corner >> k) & 1) * size[k]) * this.unit)).project(this.camera);
      return Math.max(Math.abs(x), Math.abs(y)) < 1;
    });
  }

  /** Moves the camera to show all blocks. */
  all() {
    const ends = this.drawn.flatMap(({ at, size }) => [at, at.map((v, k) => v + size[k])]);
    if (ends.length === 0) ends.push([-2, -2, 0], [2, 2, 2]);
    const [low, high] = [Math.min, Math.max].map((pick) => [0, 1, 2].map((k) => pick(...ends.map((end) => end[k])) * this.unit));
    // One cell of margin on every side.
    this.fit(low.map((v) => v - this.unit), high.map((v) => v + this.unit));
    this.render();
  }
}
