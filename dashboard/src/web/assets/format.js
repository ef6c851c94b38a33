// Formatting of numbers, and element construction. Untrusted text is inserted as text only, never as markup.

/** @import { ById, Rate } from "./types" */

/**
 * Returns the element of the page with this id.
 * @template {string} Id
 * @param {Id} id
 * @returns {ById<Id>}
 */
export const $ = (id) => /** @type {any} */ (document.getElementById(id));

/**
 * Returns a rate from 0 to 1 in percent.
 * @param {number} rate
 */
export const percent = (rate) => `${(100 * rate).toFixed(rate > 0 && rate < 1 ? 1 : 0)} %`;

/**
 * @param {unknown} value
 * @returns {value is number} whether it is a finite number
 */
export const isNumber = (value) => typeof value === "number" && Number.isFinite(value);

/**
 * Returns a count in at most six characters, such as `3.33 M`.
 * @param {unknown} value
 */
export function count(value) {
  if (!isNumber(value)) return "–";
  if (value >= 1e6) return `${(value / 1e6).toFixed(2).replace(/\.00$/, "")} M`;
  return value >= 1e4 ? `${(value / 1e3).toFixed(1).replace(/\.0$/, "")} k` : String(Math.round(value));
}

/**
 * Returns a number with a few digits.
 * @param {unknown} value
 */
export function decimal(value) {
  if (!isNumber(value)) return "–";
  const size = Math.abs(value);
  if (size === 0) return "0";
  if ((size < 1e-3 || size >= 1e5)) return value.toExponential(1);
  return size >= 100 ? value.toFixed(0) : size >= 1 ? value.toFixed(2) : value.toFixed(4);
}

/**
 * Returns a duration in hours and minutes, or in seconds below one minute.
 * @param {unknown} seconds
 */
export function minutes(seconds) {
  if (!isNumber(seconds)) return "–";
  const whole = seconds < 60 ? 0 : Math.round(seconds / 60);
  return whole >= 60 ? `${Math.floor(whole / 60)} h ${whole % 60} min` : whole ? `${whole} min` : `${Math.round(seconds)} s`;
}

/**
 * Returns the text with its first letter in upper case.
 * @param {string} text not empty
 */
export const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1)}`;

/**
 * Returns the 95 % confidence interval of a success rate.
 * @param {Rate} rate
 */
export const interval = (rate) => `${percent(rate.wilson_low)} to ${percent(rate.wilson_high)}`;

/** @typedef {Record<string, string | number>} Attributes */

/**
 * Creates an HTML element.
 * @template {keyof HTMLElementTagNameMap} Name
 * @param {Name} name
 * @param {Attributes} attributes
 * @param {...(Node | string)} children
 * @returns {HTMLElementTagNameMap[Name]}
 */
export function element(name, attributes, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  made.append(...children);
  return made;
}

/**
 * Creates an SVG element.
 * @template {keyof SVGElementTagNameMap} Name
 * @param {Name} name
 * @param {Attributes} attributes
 * @param {...(Node | string)} children
 * @returns {SVGElementTagNameMap[Name]}
 */
export function svg(name, attributes, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  made.append(...children);
  return made;
}

/**
 * Fills a table; the first cell of every row is its header, which may have several parts.
 * @param {HTMLTableElement} table
 * @param {string} caption
 * @param {(string | (Node | string)[])[]} heads
 * @param {(Node | string | (Node | string)[])[][]} rows
 */
export function fill(table, caption, heads, rows) {
  const head = element("tr", {}, ...heads.map((parts) => element(parts === "" ? "td" : "th", parts === "" ? {} : { scope: "col" }, ...[parts].flat())));
  const body = rows.map(([first, ...rest]) =>
    element("tr", {}, element("th", { scope: "row" }, ...[first].flat()), ...rest.map((parts) => element("td", {}, ...[parts].flat()))));
  table.replaceChildren(...(caption ? [element("caption", {}, caption)] : []), ...(heads.length ? [element("thead", {}, head)] : []), element("tbody", {}, ...body));
}
