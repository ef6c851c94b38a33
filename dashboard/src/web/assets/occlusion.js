// Ambient occlusion: where blocks come close to others or to the floor, less light from all around reaches them.

/** @import { BoxGeometry, Mesh, MeshLambertMaterial } from "./three.js" */

/** Blocks that there is room for; others neither cast nor get this shade. */
const N_BLOCKS = 32;

const VERTEX = `
varying vec3 occlusionPoint;
varying vec3 occlusionNormal;
`;

const PLACE = `
occlusionPoint = (modelMatrix * vec4(transformed, 1.0)).xyz;
occlusionNormal = mat3(modelMatrix) * objectNormal;
`;

// Evans, Fast Approximations for Global Illumination on Dynamic Scenes (2006): points along the normal are nearer to
// other surfaces than to the one below them if something stands beside it.
const FRAGMENT = `
varying vec3 occlusionPoint;
varying vec3 occlusionNormal;
uniform mat4 occlusionFrames[${N_BLOCKS}];
uniform vec3 occlusionHalves[${N_BLOCKS}];
uniform int occlusionCount;

float distanceToBox(vec3 point, vec3 halves) {
  vec3 beyond = abs(point) - halves;
  return length(max(beyond, 0.0)) + min(max(beyond.x, max(beyond.y, beyond.z)), 0.0);
}

float ambientLight() {
  vec3 normal = normalize(occlusionNormal);
  vec4 heights = vec4(0.02, 0.04, 0.06, 0.08);
  vec4 nearest = min(heights, occlusionPoint.z + heights * normal.z);
  for (int i = 0; i < ${N_BLOCKS}; i++) {
    if (i >= occlusionCount) break;
    vec3 point = (occlusionFrames[i] * vec4(occlusionPoint, 1.0)).xyz;
    // A block that is farther from here than that is not nearer to any of the points than the surface below them.
    if (distanceToBox(point, occlusionHalves[i]) > 2.0 * heights.w) continue;
    vec3 up = mat3(occlusionFrames[i]) * normal;
    for (int k = 0; k < 4; k++) nearest[k] = min(nearest[k], distanceToBox(point + heights[k] * up, occlusionHalves[i]));
  }
  float hidden = dot((heights - max(nearest, 0.0)) / heights, vec4(1.0, 1.0 / 2.0, 1.0 / 3.0, 1.0 / 4.0));
  return 1.0 - 0.4 * min(hidden, 1.6);
}
`;

const SHADE = `
float occlusionLight = ambientLight();
reflectedLight.indirectDiffuse *= occlusionLight;
reflectedLight.directDiffuse *= 0.5 + 0.5 * occlusionLight;
`;

export class Occlusion {
  frames = new Float32Array(16 * N_BLOCKS);
  halves = new Float32Array(3 * N_BLOCKS);
  uniforms = { occlusionFrames: { value: this.frames }, occlusionHalves: { value: this.halves }, occlusionCount: { value: 0 } };

  /**
   * Lets a material be shaded by the blocks.
   * @param {MeshLambertMaterial} material before its first render
   */
  shade(material) {
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, this.uniforms);
      shader.vertexShader = VERTEX + shader.vertexShader.replace("#include <worldpos_vertex>", `#include <worldpos_vertex>${PLACE}`);
      shader.fragmentShader = FRAGMENT + shader.fragmentShader.replace("#include <aomap_fragment>", `#include <aomap_fragment>${SHADE}`);
    };
  }

  /**
   * Takes over where the blocks are, before a render.
   * @param {Mesh<BoxGeometry, any>[]} blocks
   */
  follow(blocks) {
    const visible = blocks.filter((block) => block.visible).slice(0, N_BLOCKS);
    visible.forEach((block, i) => {
      const { width, height, depth } = block.geometry.parameters;
      block.updateMatrixWorld();
      block.matrixWorld.clone().invert().toArray(this.frames, 16 * i);
      this.halves.set([width / 2, height / 2, depth / 2], 3 * i);
    });
    this.uniforms.occlusionCount.value = visible.length;
  }
}
