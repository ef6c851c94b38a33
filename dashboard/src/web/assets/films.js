// Video clips of evaluations: the newest success and failure of every group.

import { element } from "./format.js";
import { answerAt, model } from "./model.js";

/** @import { Film } from "./types" */

let shownFilms = "";

/**
 * Returns the clip of a blueprint from the evaluation of these weights, if it exists.
 * @param {string} blueprint
 * @param {number} version
 * @returns {Promise<Film | undefined>}
 */
export async function filmOf(blueprint, version) {
  try {
    const answer = await fetch(answerAt(model.base, "films"));
    /** @type {Film[]} */
    const films = answer.ok ? (await answer.json()).films : [];
    return films.find((film) => film.blueprint === blueprint && film.weights_version === version);
  } catch {
    return undefined;
  }
}

/**
 * Fetches the list of clips and updates the page if it changed.
 * @param {HTMLElement} list
 * @param {HTMLElement} note
 * @param {(film: Film) => void} open called when the user wants to turn and step a clip
 */
export async function askFilms(list, note, open) {
  /** @type {Film[]} */
  let films;
  try {
    const answer = await fetch(answerAt(model.base, "films"));
    if (!answer.ok) return;
    films = (await answer.json()).films;
  } catch {
    return;
  }
  const ids = films.map((film) => film.id).join(" ");
  // Replacing the elements would restart a clip that the user is watching.
  if (ids === shownFilms) return;
  shownFilms = ids;
  note.textContent = films.length ? "Newest first." : "No films yet. An evaluator with a run folder makes some in every evaluation.";
  list.replaceChildren(...films.slice(0, 12).map((film) => {
    const title = `${film.blueprint}, ${film.ending}, weights ${film.weights_version}`;
    const video = element("video", { controls: "", preload: "none", playsinline: "", "aria-label": title });
    video.src = answerAt(model.base, "film", film.id);
    // Until it plays, show its final frame.
    video.poster = answerAt(model.base, "poster", film.id);
    const turned = element("button", { type: "button", "aria-label": `Turn and step: ${title}` }, "Turn and step");
    turned.addEventListener("click", () => open(film));
    return element("figure", {}, video, element("figcaption", {}, title, " ", turned));
  }));
}
