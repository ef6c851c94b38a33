// Sharing of what is shown: its address, its picture, and its video.

import { address } from "./address.js";
import { element } from "./format.js";
import { NO_ANSWER } from "./model.js";

/** @import { Replay } from "./replay.js" */

/**
 * Offers a file to save.
 * @param {Blob} content
 * @param {string} name of the file
 */
export function save(content, name) {
  const url = URL.createObjectURL(content);
  element("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}

/**
 * Copies the page's address to the clipboard, or else says it.
 * @param {HTMLElement} say
 */
export async function copyLink(say) {
  const link = address.link();
  try {
    await navigator.clipboard.writeText(link);
    say.textContent = "Copied.";
  } catch {
    // Without encryption, a browser gives the clipboard to pages of its own machine only.
    say.replaceChildren(element("code", {}, link));
  }
}

/**
 * Saves the picture of the shown moment: that of both builders if there are two.
 * @param {Replay} replay
 */
export function savePicture({ episode, time, views }) {
  const canvases = views.map(({ parts }) => parts.canvas);
  const picture = element("canvas", {});
  picture.width = canvases.reduce((sum, { width }) => sum + width, 0);
  picture.height = Math.max(...canvases.map(({ height }) => height));
  const pen = picture.getContext("2d");
  canvases.reduce((x, canvas) => {
    pen.drawImage(canvas, x, 0);
    return x + canvas.width;
  }, 0);
  const actors = views.map((view) => view.episode.actor).join("-");
  picture.toBlob((content) => { if (content) save(content, `${episode.blueprint}-${actors}-step-${Math.floor(time)}.png`); });
}

/**
 * Saves a video that the server makes, which takes a moment.
 * @param {string} url
 * @param {string} name of the file
 * @param {string} which of the episodes it is, if there are two
 * @param {HTMLElement} say
 * @param {string} [file] the blueprint file of what is built, if the server does not have it
 */
export async function saveVideo(url, name, which, say, file) {
  say.textContent = `Making the video${which} …`;
  try {
    const answer = await fetch(url, file ? { method: "POST", body: file } : {});
    say.textContent = answer.ok ? which && `This is the video${which}.` : await answer.text();
    if (answer.ok) save(await answer.blob(), name);
  } catch {
    say.textContent = NO_ANSWER;
  }
}
