"use strict";
// Formatting of numbers, and element construction. Untrusted text is inserted as text only, never as markup.

/** Whether this is a static copy of the page, where every response is a file and there is no server. */
const isCopy = document.documentElement.hasAttribute("data-copy");

/** Returns the URL of an endpoint of a run, optionally for one item. */
function answerAt(base, name, id) {
  if (!isCopy) return `${base}/api/${name}${id === undefined ? "" : `?id=${encodeURIComponent(id)}`}`;
  const ending = { film: "mp4", picture: "png", poster: "png" }[name] || "json";
  return `.${base}/api/${name}${id === undefined ? "" : `/${id}`}.${ending}`;
}

const percent = (rate) => `${(100 * rate).toFixed(rate > 0 && rate < 1 ? 1 : 0)} %`;
const isNumber = (value) => typeof value === "number" && Number.isFinite(value);

function count(value) {
  if (!isNumber(value)) return "–";
  if (value >= 1e6) return `${(value / 1e6).toFixed(2).replace(/\.00$/, "")} M`;
  return value >= 1e4 ? `${(value / 1e3).toFixed(1).replace(/\.0$/, "")} k` : String(Math.round(value));
}

function decimal(value) {
  if (!isNumber(value)) return "–";
  const size = Math.abs(value);
  if (size === 0) return "0";
  if ((size < 1e-3 || size >= 1e5)) return value.toExponential(1);
  return size >= 100 ? value.toFixed(0) : size >= 1 ? value.toFixed(2) : value.toFixed(4);
}

function minutes(seconds) {
  if (!isNumber(seconds)) return "–";
  const whole = seconds < 60 ? 0 : Math.round(seconds / 60);
  return whole >= 60 ? `${Math.floor(whole / 60)} h ${whole % 60} min` : whole ? `${whole} min` : `${Math.round(seconds)} s`;
}

/** Said when a request fails. */
const NO_ANSWER = "The program does not answer. Is it still running?";

/** Returns the text with its first letter in upper case. */
const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1)}`;

/** Returns the 95 % confidence interval of a success rate. */
const interval = (rate) => `${percent(rate.wilson_low)} to ${percent(rate.wilson_high)}`;

function element(name, attributes, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes || {})) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function svg(name, attributes, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes || {})) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** Fills a table; the first cell of every row is its header. */
function fill(table, caption, heads, rows) {
  const head = element("tr", {}, ...heads.map((text) => element("th", { scope: "col" }, text)));
  const body = rows.map(([first, ...rest]) =>
    element("tr", {}, element("th", { scope: "row" }, ...[first].flat()), ...rest.map((text) => element("td", {}, text))));
  table.replaceChildren(element("caption", {}, caption), element("thead", {}, head), element("tbody", {}, ...body));
}
