// The 3D view, rendered by three.js: blocks, and an episode's world with its goal in a corner. Loaded with the first
// episode or drawing.

import { Gripper } from "./grippers.js";
import { Ground } from "./ground.js";
import { Magnets, rgb } from "./magnets.js";
import { Occlusion } from "./occlusion.js";
import { entry } from "./solid.js";
import {
  AmbientLight, BoxGeometry, Color, DirectionalLight, EdgesGeometry, GridHelper,
  HemisphereLight, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial, MeshLambertMaterial, OrbitControls,
  PCFShadowMap, PerspectiveCamera, PlaneGeometry, Scene, ShadowMaterial, Vector3, WebGLRenderer,
} from "./three.js";

/** @import { BufferGeometry, Material, Object3D } from "./three.js" */
/** @import { Episode, Pose, Rgb, Vector } from "./types" */

/**
 * A block, with its frame and its magnets in `userData`.
 * @typedef {Mesh<BoxGeometry, MeshLambertMaterial>} BlockMesh
 */

/** Field of view in degrees, and width of the frame around a held block in meters. */
export const VIEW = 32;
const FRAME_M = 0.007;

/** Margin factor around the fitted box, and minimum distance of automatic camera moves in meters. */
const MARGIN = 1.06;
const MIN_DISTANCE_M = 0.9;

/** Width of a picture that has no room beside the goal's corner, pixels. */
const NARROW = 480;

const BACK_SIDE = 1;

/**
 * Creates a box that is larger by `margin` on every side, meters.
 * @param {Vector} half half its size without that, meters
 * @param {number} margin
 */
function boxOf(half, margin) {
  const [x, y, z] = half.map((length) => 2 * (length + margin));
  return new BoxGeometry(x, y, z);
}

/**
 * Creates a block with magnets, edges, and a frame that is hidden until a gripper holds the block.
 * @param {Vector} half half its size, meters
 * @param {Rgb} color
 * @param {number} unit edge of a cell, meters
 * @returns {BlockMesh}
 */
export function blockMesh(half, color, unit) {
  const box = boxOf(half, 0);
  const mesh = new Mesh(box, new MeshLambertMaterial({ color: rgb(color) }));
  mesh.castShadow = mesh.receiveShadow = true;
  const discs = new Magnets(half, unit);
  const edges = new LineSegments(new EdgesGeometry(box), new LineBasicMaterial({ color: 0x20262c, transparent: true, opacity: 0.55 }));
  const frame = new Mesh(boxOf(half, FRAME_M), new MeshBasicMaterial({ side: BACK_SIDE }));
  frame.visible = false;
  mesh.add(discs, edges, frame);
  mesh.userData.frame = frame;
  mesh.userData.magnets = discs;
  return mesh;
}

/**
 * Creates a translucent block that marks a target position.
 * @param {Vector} half half its size, meters
 * @param {Rgb} color
 */
export function ghostMesh(half, color) {
  const box = boxOf(half, 0);
  const paint = rgb(color);
  const mesh = new Mesh(box, new MeshBasicMaterial({ color: paint, transparent: true, opacity: 0.2, depthWrite: false }));
  mesh.add(new LineSegments(new EdgesGeometry(box), new LineBasicMaterial({ color: paint, transparent: true, opacity: 0.9 })));
  mesh.renderOrder = 1;
  return mesh;
}

/**
 * Moves an object to a pose.
 * @param {Object3D} mesh
 * @param {Pose} pose
 */
export function put(mesh, pose) {
  mesh.position.set(pose[0], pose[1], pose[2]);
  mesh.quaternion.set(pose[3], pose[4], pose[5], pose[6]);
  if (mesh.userData.magnets) mesh.userData.magnets.level(pose);
}

/**
 * Removes objects from a scene, and what the graphics card holds of them.
 * @param {Scene} scene
 * @param {Object3D[]} meshes
 */
export function dispose(scene, meshes) {
  for (const mesh of meshes) {
    scene.remove(mesh);
    mesh.traverse((part) => {
      const { geometry, material } = /** @type {Mesh<BufferGeometry, Material>} */ (part);
      geometry.dispose();
      material.dispose();
    });
  }
}

/**
 * Lights the scene from above and one side, so that edges and heights are visible. Returns the directional light.
 * @param {Scene} scene
 */
export function lit(scene) {
  scene.add(new HemisphereLight(0xffffff, 0xb9c0c8, 1.5), new AmbientLight(0xffffff, 0.35));
  const sun = new DirectionalLight(0xffffff, 2.1);
  scene.add(sun, sun.target);
  return sun;
}

export class Space {
  scene = new Scene();
  /** The goal, in a corner of the picture. */
  corner = new Scene();
  camera = new PerspectiveCamera(VIEW, 1, 0.02, 60);
  /** That of the corner. */
  small = new PerspectiveCamera(VIEW, 1, 0.02, 60);
  /** @type {BlockMesh[]} */
  blocks = [];
  /** @type {Mesh[]} */
  ghosts = [];
  /**
   * The blocks in the corner.
   * @type {Mesh[]}
   */
  goal = [];
  occlusion = new Occlusion();
  /** The middle of the goal in the corner, and the distance of its farthest point, meters. */
  middle = new Vector3();
  reach = 0;
  /** @type {Color[]} */
  colors = [];
  /** @type {Gripper[]} */
  grippers = [];
  /** @type {Episode} */
  episode;
  /**
   * Width and height of the canvas on the page, pixels.
   * @type {[number, number]}
   */
  size;
  /** @type {GridHelper} */
  grid;
  /** Whether a render follows anyway. */
  still = false;

  /**
   * Throws if WebGL is unavailable.
   * @param {HTMLCanvasElement} canvas
   * @param {() => void} moved called when the user begins to move the camera
   * @param {() => void} stopped called when the user has moved it
   */
  constructor(canvas, moved, stopped) {
    this.canvas = canvas;
    // Preserve the buffer so that the image can be read at any time.
    this.renderer = new WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.renderer.autoClear = false;
    this.sun = lit(this.scene);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    this.sun.shadow.bias = -0.0004;
    this.sun.shadow.normalBias = 0.004;
    this.sun.shadow.radius = 3;
    this.ground = new Ground(this.scene);
    lit(this.corner).position.set(1.2, -1.6, 2.4);
    this.shade = new Mesh(new PlaneGeometry(40, 40), new ShadowMaterial({ opacity: 0.28 }));
    this.shade.receiveShadow = true;
    this.scene.add(this.shade);
    this.camera.up.set(0, 0, 1);
    this.small.up.set(0, 0, 1);
    this.camera.position.set(1.2, -1.8, 1.4);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.maxPolarAngle = Math.PI / 2 - 0.03;
    [this.controls.minDistance, this.controls.maxDistance] = [0.2, 30];
    // Skip this during `settle`: a render follows anyway, and each one draws all blocks and shadows.
    this.controls.addEventListener("change", () => { if (!this.still) this.render(); });
    this.controls.addEventListener("start", moved);
    this.controls.addEventListener("end", stopped);
    this.theme();
  }

  /** Applies the page's current colors, light or dark. */
  theme() {
    const style = getComputedStyle(document.documentElement);
    const color = (/** @type {string} */ name) => new Color(style.getPropertyValue(name).trim());
    this.ground.paint(color("--ground"), color("--horizon"), color("--sky"));
    if (this.grid) dispose(this.scene, [this.grid]);
    this.grid = new GridHelper(12, 24, color("--line"), color("--line"));
    this.grid.rotation.x = Math.PI / 2;
    this.grid.position.z = 0.0005;
    this.scene.add(this.grid);
    this.backing = color("--card");
  }

  /**
   * Creates the blocks of an episode.
   * @param {Episode} episode
   */
  load(episode) {
    dispose(this.scene, [...this.blocks, ...this.ghosts, ...this.grippers.flatMap(({ parts }) => parts)]);
    dispose(this.corner, this.goal);
    const { half_extents_m: halves, colors, unit_m: unit, goal } = episode;
    this.colors = colors.map(rgb);
    this.episode = episode;
    this.grippers = episode.gripper_colors.map((color, i) => new Gripper(i, rgb(color)));
    this.blocks = halves.map((half, block) => blockMesh(half, colors[block], unit));
    for (const { material } of this.blocks) this.occlusion.shade(material);
    this.ghosts = goal.map(([block]) => ghostMesh(halves[block], colors[block]));
    this.goal = goal.map(([block, pose]) => {
      const mesh = blockMesh(halves[block], colors[block], unit);
      put(mesh, pose);
      return mesh;
    });
    this.scene.add(...this.blocks, ...this.ghosts, ...this.grippers.flatMap(({ parts }) => parts));
    if (this.goal.length > 0) this.corner.add(...this.goal);
    const places = goal.map(([, pose]) => new Vector3(pose[0], pose[1], pose[2]));
    this.middle = places.reduce((sum, place) => sum.add(place), new Vector3()).divideScalar(Math.max(places.length, 1));
    const ends = goal.map(([block], i) => places[i].distanceTo(this.middle) + Math.hypot(...halves[block]));
    this.reach = Math.max(...ends, 0.2);
  }

  /**
   * Moves every block to its pose, and the claws to their grips.
   * @param {Pose[]} poses
   * @param {number | null} time in scenes; `null` hides the claws
   * @param {(number | null)[]} held the block in each gripper
   * @param {Rgb[] | null} shades the blocks' colors instead of their own
   * @param {(Pose | null)[]} ghosts where the goal's blocks belong; `null` for blocks already in place
   */
  show(poses, time, held, shades, ghosts) {
    this.blocks.forEach((mesh, block) => {
      put(mesh, poses[block]);
      mesh.material.color.copy(shades ? rgb(shades[block]) : this.colors[block]);
      const gripper = held.indexOf(block);
      mesh.userData.frame.visible = gripper >= 0;
      if (gripper >= 0) mesh.userData.frame.material.color.copy(this.grippers[gripper].color);
    });
    this.grippers.forEach((gripper) => gripper.show(time === null ? null : gripper.at(this.episode, poses, time)));
    this.ghosts.forEach((mesh, i) => {
      mesh.visible = ghosts[i] !== null;
      if (mesh.visible) put(mesh, ghosts[i]);
    });
    this.render();
  }

  /**
   * Returns a point behind a canvas pixel, as seen from the camera.
   * @param {number} x
   * @param {number} y
   */
  beyond(x, y) {
    const [width, height] = this.size;
    this.camera.updateMatrixWorld();
    return new Vector3((2 * x) / width - 1, 1 - (2 * y) / height, 0.5).unproject(this.camera);
  }

  /**
   * Returns how far a point goes when the pointer drags it in the plane that faces the camera, meters.
   * @param {Vector} point
   * @param {[number, number]} from canvas pixel
   * @param {[number, number]} to
   * @returns {Vector}
   */
  dragged(point, from, to) {
    const eye = this.camera.position;
    const depth = new Vector3().fromArray(point).sub(eye);
    const normal = this.controls.target.clone().sub(eye);
    const [start, end] = [from, to].map(([x, y]) => {
      const ray = this.beyond(x, y).sub(eye);
      return ray.multiplyScalar(depth.dot(normal) / ray.dot(normal));
    });
    return end.sub(start).toArray();
  }

  /**
   * Returns the block at a canvas pixel, or `null`.
   * @param {number} x
   * @param {number} y
   * @returns {number | null}
   */
  blockAt(x, y) {
    const far = this.beyond(x, y);
    const hits = this.blocks.map((mesh, block) => {
      mesh.updateMatrixWorld();
      const [from, to] = [this.camera.position, far].map((point) => mesh.worldToLocal(point.clone()).toArray());
      const half = this.episode.half_extents_m[block];
      return { block, hit: entry(from, to.map((v, k) => v - from[k]), half.map((v) => -v), half) };
    }).filter(({ hit }) => hit !== null);
    return hits.length > 0 ? hits.reduce((a, b) => (b.hit.t < a.hit.t ? b : a)).block : null;
  }

  /**
   * Moves the camera as close as possible with the whole box in view, keeping its direction. Does not render.
   * @param {Vector} low the lowest corner, meters
   * @param {Vector} high the highest corner
   */
  fit(low, high) {
    const middle = new Vector3().fromArray(low).add(new Vector3().fromArray(high)).multiplyScalar(0.5);
    const back = this.camera.position.clone().sub(this.controls.target);
    if (back.lengthSq() === 0) back.set(1, -1.4, 1);
    back.normalize();
    const right = new Vector3(0, 0, 1).cross(back);
    // From straight above, any horizontal direction will do.
    if (right.lengthSq() < 1e-9) right.set(1, 0, 0);
    right.normalize();
    const up = back.clone().cross(right);
    const rise = Math.tan((VIEW * Math.PI) / 360) / MARGIN;
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) =>
      new Vector3().fromArray([0, 1, 2].map((i) => ((k >> i) & 1 ? high : low)[i])).sub(middle));
    // Nearer corners look larger, so the image center is not the center of the box. Each pair of opposite image edges
    // touches a corner, or would if the other pair did not require more distance.
    const between = (/** @type {Vector3} */ axis, /** @type {number} */ slope) => {
      const [above, below] = [1, -1].map((side) => Math.max(...corners.map((corner) => side * corner.dot(axis) + slope * corner.dot(back))));
      return { shift: (above - below) / 2, distance: (above + below) / (2 * slope) };
    };
    const [across, along] = [between(right, rise * this.camera.aspect), between(up, rise)];
    this.controls.target.copy(middle).addScaledVector(right, across.shift).addScaledVector(up, along.shift);
    this.camera.position.copy(this.controls.target).addScaledVector(back, Math.max(across.distance, along.distance, MIN_DISTANCE_M));
    this.settle();
  }

  /** Returns where the camera stands and what it looks at. */
  stand() {
    return { position: this.camera.position.clone(), target: this.controls.target.clone() };
  }

  /**
   * Places the camera without rendering.
   * @param {Vector} position or a direction, if the camera is to fit something
   * @param {Vector} target empty for the origin
   */
  place(position, target) {
    this.controls.target.fromArray(target.length > 0 ? target : [0, 0, 0]);
    this.camera.position.fromArray(position);
    this.settle();
  }

  /** Applies the camera's new position without rendering. */
  settle() {
    this.still = true;
    this.controls.update();
    this.still = false;
  }

  /**
   * Turns the camera around its target and tilts it, radians.
   * @param {number} around
   * @param {number} up
   */
  turn(around, up) {
    const from = this.camera.position.clone().sub(this.controls.target);
    const flat = Math.hypot(from.x, from.y);
    const [angle, tilt] = [Math.atan2(from.y, from.x) + around, Math.atan2(from.z, flat) + up];
    const kept = Math.min(Math.max(tilt, 0.03), 1.55);
    const length = from.length();
    from.set(Math.cos(angle) * Math.cos(kept), Math.sin(angle) * Math.cos(kept), Math.sin(kept)).multiplyScalar(length);
    this.camera.position.copy(this.controls.target).add(from);
    this.settle();
    this.render();
  }

  /**
   * Moves the camera closer by a factor.
   * @param {number} factor
   */
  near(factor) {
    const from = this.camera.position.clone().sub(this.controls.target);
    const length = Math.min(Math.max(from.length() / factor, this.controls.minDistance), this.controls.maxDistance);
    this.camera.position.copy(this.controls.target).add(from.setLength(length));
    this.settle();
    this.render();
  }

  /**
   * Matches the drawing buffer to the canvas size on the page, in pixels. Takes effect at the next render.
   * @param {number} width
   * @param {number} height
   */
  resize(width, height) {
    if (width === 0 || height === 0) return;
    this.size = [width, height];
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.renderer.setSize(width, height, false);
    // The world is beside the goal's corner, or below it on a phone.
    const taken = this.goal.length > 0 ? this.side() + 16 : 0;
    const [left, top] = width > NARROW ? [taken, 0] : [0, taken];
    this.camera.aspect = (width - left) / (height - top);
    this.camera.setViewOffset(width - left, height - top, -left, -top, width, height);
  }

  /** Returns the width and height of the goal's corner, pixels. */
  side() {
    const [width, height] = this.size;
    return Math.round(Math.min(width * 0.3, height * 0.36));
  }

  render() {
    if (!this.size) return;
    const [width, height] = this.size;
    const target = this.controls.target;
    // Move the light with the camera, or shadows would end at the edge of the shadow map.
    this.sun.position.set(target.x - 2.4, target.y - 1.2, target.z + 3.6);
    this.sun.target.position.copy(target);
    const spread = Math.min(this.camera.position.distanceTo(target) * 0.6, 4);
    const light = this.sun.shadow.camera;
    [light.left, light.right, light.bottom, light.top, light.near, light.far] = [-spread, spread, -spread, spread, 0.1, 12];
    light.updateProjectionMatrix();
    this.ground.surround(this.camera, target);
    this.ground.shade(this.blocks);
    this.occlusion.follow(this.blocks);
    this.renderer.setScissorTest(false);
    this.renderer.setViewport(0, 0, width, height);
    this.renderer.clear();
    this.renderer.render(this.scene, this.camera);
    if (this.goal.length === 0) return;
    const side = this.side();
    const from = this.camera.position.clone().sub(target).setLength((this.reach / Math.sin((VIEW * Math.PI) / 360)) * 1.02);
    this.small.position.copy(this.middle).add(from);
    this.small.lookAt(this.middle);
    this.renderer.setViewport(8, height - side - 8, side, side);
    this.renderer.setScissor(8, height - side - 8, side, side);
    this.renderer.setScissorTest(true);
    this.corner.background = this.backing;
    this.renderer.clearDepth();
    this.renderer.render(this.corner, this.small);
    this.renderer.setScissorTest(false);
  }
}
