// What an episode has come to: whether the goal is built, how long it took, and what is missing or wrong.

/** @import { Episode, Scene } from "./types" */

/** The most blocks and pairs that a verdict names. */
const MOST = 3;

/** @type {(n: number, noun: string) => string} */
const counted = (n, noun) => `${n} ${noun}${n === 1 ? "" : "s"}`;

/** @param {string[]} names */
function listed(names) {
  const more = names.length - MOST;
  const shown = more > 1 ? names.slice(0, MOST) : names;
  const last = more > 1 ? `${more} more` : shown.pop();
  return shown.length > 0 ? `${shown.join(", ")} and ${last}` : last;
}

/**
 * Returns the connections of a block.
 * @param {Scene} scene
 * @param {number} block
 */
export const joined = (scene, block) => scene.joints.filter(([a, b]) => a === block || b === block);

/**
 * Says what is missing or wrong in a scene.
 * @param {Episode} episode
 * @param {Scene} scene
 */
function faults({ goal, links, names }, scene) {
  // In a pair, the block with the lower number comes first.
  /** @type {(pairs: number[][], a: number, b: number) => boolean} */
  const has = (pairs, a, b) => pairs.some(([c, d]) => a === c && b === d);
  const isLoose = (/** @type {number} */ block) => !joined(scene, block).some(([, , isRight]) => isRight);
  const hangsWrong = (/** @type {number} */ block) => joined(scene, block).some(([a, b, isRight]) => !isRight && has(links, a, b));
  // A block that hangs by a wrong pole is named as such.
  const loose = goal.map(([block]) => block).filter((block) => isLoose(block) && !hangsWrong(block));
  const missing = links.filter(([a, b]) => !isLoose(a) && !isLoose(b) && !has(scene.joints.map(([c, d]) => [c, d]), a, b));
  const wrong = scene.joints.filter(([, , isRight]) => !isRight);
  const pairs = (/** @type {Scene["joints"]} */ those) => listed(those.map(([a, b]) => `${names[b]} on ${names[a]}`));
  const [turned, foreign] = [true, false].map((wanted) => wrong.filter(([a, b]) => has(links, a, b) === wanted));
  const all = [
    loose.length > 0 ? `${listed(loose.map((block) => names[block]))} ${loose.length === 1 ? "is" : "are"} not in place` : "",
    turned.length > 0 ? `${pairs(turned)} ${turned.length === 1 ? "hangs" : "hang"} by a wrong pole` : "",
    foreign.length > 0 ? `${pairs(foreign)} ${foreign.length === 1 ? "does" : "do"} not belong there` : "",
    missing.length > 0 ? `${listed(missing.map(([a, b]) => `${names[b]} to ${names[a]}`))} ${missing.length === 1 ? "is" : "are"} not connected` : "",
  ].filter(Boolean);
  return all.length > 0 ? all.join("; ") : "some blocks do not fit closely enough";
}

/**
 * Returns what an episode has come to at a scene, and whether that is `good`, `bad`, or still `open`.
 * @param {Episode} episode
 * @param {number} at the scene
 * @returns {{ kind: "good" | "bad" | "open", text: string }}
 */
export function verdict(episode, at) {
  const scene = episode.scenes[at];
  const made = `${scene.n_connected} of ${counted(episode.links.length, "connection")}`;
  const time = `${(at * episode.step_s).toFixed(1)} s`;
  if (at < episode.scenes.length - 1) return { kind: "open", text: `Building: ${made} after ${time}` };
  if (episode.end === "success") return { kind: "good", text: `Built: ${made} in ${time}` };
  const why = episode.end === "time limit" ? "time is up" : "the episode was cut short";
  return { kind: "bad", text: `Not built: ${made}, ${why}; ${faults(episode, scene)}` };
}
