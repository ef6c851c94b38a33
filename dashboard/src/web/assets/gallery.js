// The gallery: pictures of all blueprints, to search and choose from.

import { address } from "./address.js";
import { element } from "./format.js";
import { answerAt } from "./model.js";

/** @import { Blueprint } from "./types" */

/**
 * Opens the gallery. Pictures load when they come into view.
 * @param {HTMLDialogElement} dialog
 * @param {Blueprint[]} blueprints
 * @param {string | null} chosen the one that is shown
 * @param {(id: string) => void} choose
 */
export function openGallery(dialog, blueprints, chosen, choose) {
  const find = element("input", { type: "search", placeholder: "Name or blocks", "aria-label": "Search the gallery" });
  const close = element("button", { type: "button" }, "Close");
  close.addEventListener("click", () => dialog.close());
  const list = element("div", { class: "gallery" });
  const caption = (/** @type {Blueprint} */ { id, n_blocks: n }) => `${id}, ${n} blocks`;
  const draw = () => {
    const words = find.value.trim().toLowerCase();
    const shown = blueprints.filter((one) => `${one.title} ${caption(one)}, ${one.group || "other"}`.toLowerCase().includes(words));
    /** @type {HTMLElement[]} */
    const parts = [];
    /** @type {string | null | undefined} */
    let group;
    for (const one of shown) {
      if (one.group !== group) {
        group = one.group;
        parts.push(element("h3", {}, group || "other"));
      }
      const picture = element("img", { src: answerAt("", "picture", one.id), alt: "", loading: "lazy", width: "200", height: "150" });
      const tile = element("button", { type: "button", "aria-pressed": String(one.id === chosen) }, picture,
        element("b", {}, one.title), element("span", { class: "quiet" }, caption(one)));
      tile.addEventListener("click", () => {
        dialog.close();
        choose(one.id);
      });
      parts.push(tile);
    }
    list.replaceChildren(...(parts.length > 0 ? parts : [element("p", { class: "empty" }, "No blueprint matches.")]));
  };
  find.addEventListener("input", draw);
  dialog.replaceChildren(element("div", { class: "bar" }, element("h2", {}, "Blueprints"), find, close), list);
  draw();
  dialog.showModal();
  address.set({ open: "gallery" }, address.get("open") === null);
}
