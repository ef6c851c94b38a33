// A drawing as the address names it: `TYPE,X,Y,Z,AXES` of each block, joined by `_`. Its axes are two letters, capital
// where the block's axis points to minus.

/** @import { Block, Findings } from "./types" */

/** How an address names a block. */
const BLOCK = /^([0-9x]+),(-?\d+),(-?\d+),(-?\d+),([xyzXYZ])([xyzXYZ])$/;

/**
 * Returns the code of blocks.
 * @param {Block[]} blocks
 */
export function encode(blocks) {
  const letter = (/** @type {string} */ axis) => (axis[0] === "-" ? axis[1].toUpperCase() : axis[1]);
  return blocks.map(({ type, at, axes }) => [type, ...at, axes.split(" ").map(letter).join("")].join(",")).join("_");
}

/**
 * Returns the blocks of a code, or throws an error that says what is wrong with it.
 * @param {string} code
 * @returns {Block[]}
 */
export function decode(code) {
  const axis = (/** @type {string} */ letter) => `${letter === letter.toLowerCase() ? "+" : "-"}${letter.toLowerCase()}`;
  return code.split("_").map((text) => {
    const parts = BLOCK.exec(text);
    if (!parts) throw new Error(`the address names a block as "${text}"`);
    const [, type, x, y, z, first, second] = parts;
    return { type, at: [x, y, z].map(Number), axes: `${axis(first)} ${axis(second)}`, is_free: false };
  });
}

/**
 * Returns the blueprint file of a drawing, or throws an error that says what is wrong with it.
 * @param {string} title
 * @param {Block[]} blocks
 * @returns {Promise<string>}
 */
export async function tomlOf(title, blocks) {
  const answer = await fetch("/api/check", { method: "POST", body: JSON.stringify({ title, blocks }) });
  if (!answer.ok) throw new Error((await answer.text()).trim());
  /** @type {Findings} */
  const { problems, toml } = await answer.json();
  if (!toml) throw new Error(problems.map(({ text }) => text).join("; ") || "it has too few blocks");
  return toml;
}
