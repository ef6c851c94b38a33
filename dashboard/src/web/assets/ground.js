// What the blocks stand on: a floor that fades into a horizon, a sky above it, and the shade right under each block.

import { BufferAttribute, BufferGeometry, Color, Fog, Mesh, MeshBasicMaterial, Vector3 } from "./three.js";

/** @import { BoxGeometry, PerspectiveCamera, Scene } from "./three.js" */

/** Degrees below the horizon at which the floor begins to fade; where the sky is, degrees above it. */
const [FADE, LOW_SKY, HIGH_SKY] = [-16, 0.2, 35];
/** Corners around the horizon. */
const N_AROUND = 24;
/** How far the horizon is, meters; less than the camera sees. */
const FAR_M = 50;

/** How far the shade reaches beyond a block and under it, and how high a block may be to have one, meters. */
const [BESIDE_M, UNDER_M, REACH_M] = [0.05, 0.03, 0.12];
/** How dark the shade under a block on the floor is. */
const DARKEST = 0.42;
/** Shades that there is room for. */
const N_SHADES = 64;

const DOUBLE_SIDE = 2;

/**
 * Creates a mesh of nets, whose corners have colors.
 * @param {number} nRows
 * @param {number} nColumns
 * @param {number} nSheets how many nets
 * @param {MeshBasicMaterial} material
 */
function net(nRows, nColumns, nSheets, material) {
  const geometry = new BufferGeometry();
  const n = nRows * nColumns;
  for (const [name, size] of /** @type {[string, number][]} */ ([["position", 3], ["color", 4]])) {
    geometry.setAttribute(name, new BufferAttribute(new Float32Array(size * n * nSheets), size));
  }
  /** @type {number[]} */
  const corners = [];
  for (let sheet = 0; sheet < nSheets; sheet += 1) {
    for (let row = 0; row + 1 < nRows; row += 1) {
      for (let column = 0; column + 1 < nColumns; column += 1) {
        const a = sheet * n + row * nColumns + column;
        corners.push(a, a + 1, a + nColumns, a + 1, a + nColumns + 1, a + nColumns);
      }
    }
  }
  geometry.setIndex(corners);
  const mesh = new Mesh(geometry, material);
  mesh.frustumCulled = false;
  return mesh;
}

export class Ground {
  /** @param {Scene} scene */
  constructor(scene) {
    this.scene = scene;
    const basic = { vertexColors: true, depthWrite: false, fog: false };
    // Drawn first. The floor itself is the background, which costs nothing.
    this.sky = net(4, N_AROUND + 1, 1, new MeshBasicMaterial({ ...basic, side: DOUBLE_SIDE, depthTest: false }));
    this.sky.renderOrder = -2;
    this.shades = net(4, 4, N_SHADES, new MeshBasicMaterial({ ...basic, transparent: true, side: DOUBLE_SIDE }));
    this.shades.renderOrder = -1;
    this.fog = new Fog(0, 1, 2);
    scene.fog = this.fog;
    scene.add(this.sky, this.shades);
  }

  /**
   * Applies colors.
   * @param {Color} floor
   * @param {Color} horizon
   * @param {Color} sky
   */
  paint(floor, horizon, sky) {
    this.scene.background = floor;
    this.fog.color.copy(horizon);
    const { position, color } = this.sky.geometry.attributes;
    const rows = /** @type {[number, Color][]} */ ([[FADE, floor], [0, horizon], [LOW_SKY, horizon.clone().lerp(sky, 0.45)], [HIGH_SKY, sky]]);
    rows.forEach(([degrees, { r, g, b }], row) => {
      const tilt = (degrees * Math.PI) / 180;
      for (let i = 0; i <= N_AROUND; i += 1) {
        const angle = (2 * Math.PI * i) / N_AROUND;
        const at = row * (N_AROUND + 1) + i;
        position.setXYZ(at, FAR_M * Math.cos(angle), FAR_M * Math.sin(angle), FAR_M * Math.tan(tilt));
        color.setXYZW(at, r, g, b, 1);
      }
    });
    position.needsUpdate = color.needsUpdate = true;
  }

  /**
   * Surrounds the camera, before a render.
   * @param {PerspectiveCamera} camera
   * @param {Vector3} target what it looks at
   */
  surround(camera, target) {
    this.sky.position.copy(camera.position);
    const distance = camera.position.distanceTo(target);
    [this.fog.near, this.fog.far] = [1.2 * distance, 5 * distance + 4];
  }

  /**
   * Lays a shade under every block that is near the floor.
   * @param {Mesh<BoxGeometry, any>[]} blocks
   */
  shade(blocks) {
    const { position, color } = this.shades.geometry.attributes;
    let n = 0;
    for (const block of blocks.slice(0, N_SHADES)) {
      const { width, height, depth } = block.geometry.parameters;
      const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis, i) =>
        new Vector3().fromArray(axis).applyQuaternion(block.quaternion).multiplyScalar([width, height, depth][i] / 2));
      const lowest = block.position.z - axes.reduce((sum, { z }) => sum + Math.abs(z), 0);
      const dark = DARKEST * Math.min(Math.max(1 - lowest / REACH_M, 0), 1) ** 2;
      if (dark === 0) continue;
      // The block's shape from above: along the axis that lies flattest, and across it.
      const [along] = [...axes].sort((a, b) => Math.hypot(b.x, b.y) - Math.hypot(a.x, a.y));
      const heading = Math.atan2(along.y, along.x);
      const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
      const reach = (/** @type {number} */ x, /** @type {number} */ y) => axes.reduce((sum, axis) => sum + Math.abs(axis.x * x + axis.y * y), 0);
      const [length, breadth] = [reach(cos, sin), reach(-sin, cos)].map((half) => [-half - BESIDE_M, -Math.max(half - UNDER_M, 0), Math.max(half - UNDER_M, 0), half + BESIDE_M]);
      for (let corner = 0; corner < 16; corner += 1) {
        const [row, column] = [Math.floor(corner / 4), corner % 4];
        const [u, v] = [length[row], breadth[column]];
        const isEdge = row % 3 === 0 || column % 3 === 0;
        position.setXYZ(16 * n + corner, block.position.x + u * cos - v * sin, block.position.y + u * sin + v * cos, 0.001);
        color.setXYZW(16 * n + corner, 0, 0, 0, isEdge ? 0 : dark);
      }
      n += 1;
    }
    this.shades.geometry.setDrawRange(0, n * 54);
    position.needsUpdate = color.needsUpdate = true;
  }
}
