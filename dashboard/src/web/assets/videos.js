// Video clips of evaluations: the newest success and failure of every group.

import { element } from "./format.js";
import { answerAt, model } from "./model.js";

/** @import { Video } from "./types" */

let shownVideos = "";

/**
 * Returns the clip of a blueprint from the evaluation of these weights, if it exists.
 * @param {string} blueprint
 * @param {number} version
 * @returns {Promise<Video | undefined>}
 */
export async function videoOf(blueprint, version) {
  try {
    const answer = await fetch(answerAt(model.base, "videos"));
    /** @type {Video[]} */
    const videos = answer.ok ? (await answer.json()).videos : [];
    return videos.find((video) => video.blueprint === blueprint && video.weights_version === version);
  } catch {
    return undefined;
  }
}

/**
 * Fetches the list of clips and updates the page if it changed.
 * @param {HTMLElement} list
 * @param {HTMLElement} note
 * @param {(video: Video) => void} open called when the user wants to turn and step a video
 */
export async function askVideos(list, note, open) {
  /** @type {Video[]} */
  let videos;
  try {
    const answer = await fetch(answerAt(model.base, "videos"));
    if (!answer.ok) return;
    videos = (await answer.json()).videos;
  } catch {
    return;
  }
  const ids = videos.map((video) => video.id).join(" ");
  // Replacing the elements would restart a video that the user is watching.
  if (ids === shownVideos) return;
  shownVideos = ids;
  note.textContent = videos.length ? "Newest first." : "No videos yet. An evaluator with a run folder makes some in every evaluation.";
  list.replaceChildren(...videos.slice(0, 12).map((video) => {
    const title = `${video.blueprint}, ${video.ending}, weights ${video.weights_version}`;
    const player = element("video", { controls: "", preload: "none", playsinline: "", "aria-label": title });
    player.src = answerAt(model.base, "video", video.id);
    // Until it plays, show its final frame.
    player.poster = answerAt(model.base, "poster", video.id);
    const turned = element("button", { type: "button", "aria-label": `Turn and step: ${title}` }, "Turn and step");
    turned.addEventListener("click", () => open(video));
    return element("figure", {}, player, element("figcaption", {}, title, " ", turned));
  }));
}
