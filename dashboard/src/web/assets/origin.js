// What produced the runs: command, seed, commit and settings, and in which settings several runs differ.

import { sample } from "./chart.js";
import { element, fill, isNumber } from "./format.js";

/** @import { Origin } from "./types" */

/**
 * A run and what produced it.
 * @typedef {{ name: string, origin: Origin }} Made
 */

/**
 * Returns the words of a command for a shell.
 * @param {string[]} words
 */
const shell = (words) => words.map((word) => (/^[\w./:=,@%+-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`)).join(" ");

/**
 * What is known of a run besides its settings.
 * @type {[string, (origin: Origin) => string | undefined][]}
 */
const FACTS = [
  ["command", ({ command }) => (command ? shell(command) : undefined)],
  ["seed", ({ seed }) => (isNumber(seed) ? String(seed) : undefined)],
  ["commit", ({ commit }) => commit],
  ["version", ({ lodestone_version: version }) => version],
  ["started, UTC", ({ started_utc: started }) => started?.replace("T", " ")],
  ["resumed from", ({ resumed_from: from }) => from],
];

/**
 * Returns the settings by their paths, such as `learner.gamma`, as texts.
 * @param {any} settings
 * @param {string} [path]
 * @returns {[string, string][]}
 */
function flat(settings, path = "") {
  if (settings !== null && typeof settings === "object" && !Array.isArray(settings)) {
    return Object.entries(settings).flatMap(([key, value]) => flat(value, path ? `${path}.${key}` : key));
  }
  return [[path, typeof settings === "string" ? settings : JSON.stringify(settings)]];
}

/**
 * Returns rows of a name and each run's value.
 * @param {Map<string, string | undefined>[]} runs
 * @param {string[]} names
 */
const rowsOf = (runs, names) => names.map((name) => [element("code", {}, name), ...runs.map((run) => run.get(name) ?? "–")]);

/**
 * Shows what produced the runs. Of several, their table has the settings in which they differ, and all are below it.
 * @param {HTMLElement} section
 * @param {Made[]} runs
 */
export function drawOrigins(section, runs) {
  const known = runs.filter(({ origin }) => origin);
  section.hidden = known.length === 0;
  if (section.hidden) return;
  const settings = known.map(({ origin }) => new Map(flat(origin.settings)));
  const names = [...new Set(settings.flatMap((one) => [...one.keys()]))].sort();
  // The seed is among the facts.
  const differ = known.length > 1 ? names.filter((name) => name !== "seed" && new Set(settings.map((one) => one.get(name))).size > 1) : [];
  const facts = FACTS.map(([name, of]) => [name, ...known.map(({ origin }) => of(origin))]).filter(([, ...values]) => values.some((value) => value !== undefined && value !== null));
  const isOne = known.length === 1;
  const heads = () => ["", ...known.map(({ name }, i) => [sample(i), name])];
  const rows = facts.map(([name, ...values]) => [name, ...values.map((value) => (name === "command" && value ? element("code", {}, value) : value ?? "–"))]);
  const caption = isOne ? "" : `${differ.length} of ${names.length} settings differ`;
  const [table, all] = [element("table", { class: "origin" }), element("table", { class: "origin" })];
  fill(table, caption, isOne ? [] : heads(), [...rows, ...rowsOf(settings, differ)]);
  fill(all, "", isOne ? ["setting", "value"] : heads(), rowsOf(settings, names));
  const scroll = (/** @type {HTMLElement} */ inside, /** @type {string} */ label) =>
    element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": label }, inside);
  section.replaceChildren(
    element("h2", { id: "origin-title" }, isOne ? "What produced the run" : "What differs between the runs"),
    scroll(table, "Command, commit, and what differs"),
    element("details", {}, element("summary", {}, "All settings"), scroll(all, "All settings")),
  );
}
