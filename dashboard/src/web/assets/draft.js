// Drafts: blueprint files that cannot be built yet. The server reads and writes only those that can.

import { imagesOf } from "./axes.js";

/** @import { Block, Kind, Vector } from "./types" */

/** The directions of a block's x and y axes, if its file says nothing about them. */
const AXES = ["+x +y", "+y -x", "+z +x", "+x +z", "+y +z", "+z +y"];

/** How files name axes. */
const NAMED = /^([+-][xyz]) ([+-][xyz])$/;

/**
 * Returns the size on the grid of a block whose axes point like this, cells.
 * @param {Vector} cells its size along its own axes
 * @param {string} axes
 * @returns {Vector}
 */
export function sizeOf(cells, axes) {
  const images = imagesOf(axes);
  return [0, 1, 2].map((k) => Math.abs(cells.reduce((sum, n, i) => sum + n * images[i][k], 0)));
}

/**
 * Writes a drawing as a blueprint file, whatever is wrong with it.
 * @param {string} title
 * @param {Block[]} blocks
 */
export function writeDraft(title, blocks) {
  const lines = blocks.map(({ type, at, axes }) => `    { type = "${type}", at = [${at.join(", ")}], axes = "${axes}" },\n`);
  return `# A draft, drawn on the page of lodestone.\ntitle = ${JSON.stringify(title)}\n\nblocks = [\n${lines.join("")}]\n`;
}

/**
 * Reads the blocks of a file, whatever else is wrong with it. Returns them with the title and the number of blocks that
 * are left out, of a type that does not exist or that is used up, or at no place.
 * @param {string} text
 * @param {Map<string, Kind>} kinds
 * @returns {{ title: string | null, blocks: Block[], nLeftOut: number }}
 */
export function readDraft(text, kinds) {
  const plain = text.replace(/^\s*#.*$/gm, "");
  /** @type {Block[]} */
  const blocks = [];
  let nLeftOut = 0;
  for (const [entry] of plain.matchAll(/\{[^{}]*\btype\s*=[^{}]*\}/g)) {
    const value = (/** @type {string} */ key) => new RegExp(`\\b${key}\\s*=\\s*(?:"([^"]*)"|\\[([^\\]]*)\\])`).exec(entry);
    const numbers = (/** @type {string} */ key) => (value(key)?.[2] ?? "").split(",").filter((part) => part.trim()).map(Number);
    const [type, at, size] = [value("type")?.[1] ?? "", numbers("at"), numbers("size")];
    const kind = kinds.get(type);
    const isAtPlace = at.length === 3 && at.every((v) => Number.isInteger(v) && Math.abs(v) <= 64);
    if (!kind || !isAtPlace || blocks.filter((block) => block.type === type).length >= kind.count) {
      nLeftOut += 1;
      continue;
    }
    const named = NAMED.exec(value("axes")?.[1] ?? "");
    const isTurned = named !== null && named[1][1] !== named[2][1];
    const fits = (/** @type {string} */ axes) => sizeOf(kind.cells, axes).join() === size.join();
    blocks.push({ type, at, axes: isTurned ? named[0] : AXES.find(fits) || AXES[0], is_free: !isTurned });
  }
  const title = /^\s*title\s*=\s*"([^"]*)"/m.exec(plain);
  return { title: title && title[1], blocks, nLeftOut };
}
