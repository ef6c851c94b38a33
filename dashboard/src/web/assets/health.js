// The learner's metrics over time, live processes, and drop counts.

import { count, decimal, element, fill, isNumber, svg } from "./format.js";

/** @import { Actor, Draws, Learner, Point, Roster, Summary, Totals } from "./types" */

/**
 * Returns the mixture head's draws of one kind of proposal, if there are any.
 * @param {Learner} learner
 * @param {string} kind
 * @returns {Draws}
 */
const drawn = ({ proposals }, kind) => proposals?.kinds?.[kind] || {};

/** What `history` calls the entropies of the mixture head's choices. */
const CHOICES = [
  ["first_proposal_entropy", "entropy of the first proposal, nats"],
  ["second_block_entropy", "entropy of the second block, nats"],
  ["second_proposal_entropy", "entropy of the second proposal, nats"],
];

/**
 * The charts: a point's field, what it shows, and its value.
 * @typedef {[string, string, (learner: Learner) => number | undefined]} Chart
 * @type {Chart[]}
 */
const HEALTH = [
  ["env_steps_per_s", "steps per second", (learner) => learner.env_steps_per_s],
  ["policy_lag_mean", "lag, versions", (learner) => learner.policy_lag_mean],
  ["policy_loss", "policy loss", (learner) => learner.ppo.policy_loss],
  ["value_loss", "value loss", (learner) => learner.ppo.value_loss],
  ["entropy", "entropy, nats", (learner) => learner.ppo.entropy],
  ["approx_kl", "KL of an update, nats", (learner) => learner.ppo.approx_kl],
  ["explained_variance", "explained variance", (learner) => learner.ppo.explained_variance],
  ...["join", "detach", "hold"].map((kind) => /** @type {Chart} */ ([`share_${kind}`, `share of ${kind}`, (learner) => drawn(learner, kind).share])),
  ...["join", "detach"].map((kind) => /** @type {Chart} */ ([`success_${kind}`, `success of ${kind}`, (learner) => drawn(learner, kind).success])),
  ...CHOICES.map(([name, title]) => /** @type {Chart} */ ([name, title, ({ proposals }) => proposals?.[name]])),
];

/** All zero if training uses no rewards; such charts are omitted. */
const OF_REWARDS = ["policy_loss", "value_loss", "entropy", "approx_kl", "explained_variance"];

/**
 * Converts learner metrics to a point of `/api/history`.
 * @param {Learner} learner
 */
export function toPoint(learner) {
  /** @type {Point} */
  const point = { n_env_steps: learner.n_env_steps, elapsed_s: learner.elapsed_s, weights_version: learner.weights_version };
  for (const [name, , value] of HEALTH) point[name] = value(learner);
  return point;
}

/**
 * Draws a sparkline of one metric that shows the value under the pointer.
 * @param {Point[]} points
 * @param {string} name
 * @param {string} title
 */
function spark(points, name, title) {
  const [width, height] = [210, 46];
  const known = points.filter((point) => isNumber(point[name]));
  const values = known.map((point) => point[name]);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const [from, to] = [known[0].n_env_steps, known[known.length - 1].n_env_steps];
  const x = (/** @type {number} */ steps) => (to > from ? ((steps - from) / (to - from)) * width : width);
  const y = (/** @type {number} */ value) => (high > low ? 4 + (1 - (value - low) / (high - low)) * (height - 8) : height / 2);
  const line = known.map((point) => `${x(point.n_env_steps).toFixed(1)},${y(point[name]).toFixed(1)}`).join(" ");
  const now = decimal(values[values.length - 1]);
  const label = `${title}: from ${decimal(low)} to ${decimal(high)}, now ${now}`;
  const picture = svg("svg", { class: "spark", viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: "none", role: "img", "aria-label": label },
    svg("polyline", { class: "curve g0", points: line }));
  const value = element("b", {}, now);
  picture.addEventListener("pointermove", (event) => {
    const at = (event.offsetX / (picture.clientWidth || width)) * width;
    const near = known.reduce((best, point) => (Math.abs(x(point.n_env_steps) - at) < Math.abs(x(best.n_env_steps) - at) ? point : best));
    value.textContent = `${decimal(near[name])} at ${count(near.n_env_steps)} steps`;
  });
  picture.addEventListener("pointerleave", () => { value.textContent = now; });
  const range = known.length === 1 ? "one value so far" : high > low ? `${decimal(low)} to ${decimal(high)}` : "constant";
  return element("div", {}, element("h3", {}, title, value), picture, element("small", { class: "quiet" }, range));
}

/**
 * Draws the learner's charts.
 * @param {HTMLElement} place
 * @param {HTMLElement} note
 * @param {Point[]} points
 */
export function drawHealth(place, note, points) {
  if (points.length === 0) {
    place.replaceChildren();
    note.textContent = "No update yet.";
    return;
  }
  const tells = (/** @type {string} */ name, /** @type {number} */ value) => isNumber(value) && (value !== 0 || !OF_REWARDS.includes(name));
  const charts = HEALTH.filter(([name]) => points.some((point) => tells(name, point[name])));
  place.replaceChildren(...charts.map(([name, title]) => spark(points, name, title)));
  const [first, last] = [points[0], points[points.length - 1]];
  note.textContent = points.length === 1 ? `After ${count(last.n_env_steps)} environment steps.` : `From ${count(first.n_env_steps)} to ${count(last.n_env_steps)} environment steps. Point at a curve for its values.`;
}

/** @param {Totals} counts */
const sum = (counts) => Object.values(counts || {}).reduce((total, n) => total + (isNumber(n) ? n : 0), 0);

/**
 * Shows who is alive, and at what speed.
 * @param {HTMLTableElement} table
 * @param {Roster} roster
 * @param {Map<string, Actor>} actors
 * @param {Learner | null} learner
 * @param {boolean} isLive whether the roster is kept up to date
 */
export function drawRoster(table, roster, actors, learner, isLive) {
  const rows = [];
  for (const name of roster.learners) {
    rows.push([name === "learner" ? name : `learner ${name}`, learner ? count(learner.env_steps_per_s) : "–", learner ? String(learner.weights_version) : "–", "–", "–"]);
  }
  for (const name of roster.actors) {
    const actor = actors.get(name);
    rows.push(actor
      ? [`actor ${name}`, count(actor.env_steps_per_s), String(actor.weights_version), String(actor.policy_lag), String(sum(actor.dropped))]
      : [`actor ${name}`, "–", "–", "–", "–"]);
  }
  for (const name of roster.evaluators) rows.push([`evaluator ${name}`, "–", "–", "–", "–"]);
  const caption = !rows.length ? "No members." : isLive ? "Alive now" : "Alive when this page last heard of them";
  fill(table, caption, ["member", "steps/s", "weights", "lag", "dropped"], rows);
}

/**
 * Shows what was dropped, by whom and why.
 * @param {HTMLTableElement} table
 * @param {Map<string, Actor>} actors
 * @param {Learner | null} learner
 * @param {Summary | null} summary
 */
export function drawDrops(table, actors, learner, summary) {
  /** @type {Map<string, number>} */
  const totals = new Map();
  const add = (/** @type {string} */ who, /** @type {string} */ reason, /** @type {number} */ n) => {
    if (isNumber(n) && n > 0) totals.set(`${who}: ${reason}`, (totals.get(`${who}: ${reason}`) || 0) + n);
  };
  const words = (/** @type {string} */ name) => name.replace(/_total$/, "").replaceAll("_", " ");
  for (const actor of actors.values()) {
    for (const [reason, n] of Object.entries(actor.dropped || {})) add("actors", words(reason), n);
    for (const [reason, n] of Object.entries(actor.bus || {})) add("actors' bus", words(reason), n);
  }
  for (const [reason, n] of Object.entries((summary && summary.bus) || {})) add("evaluator's bus", words(reason), n);
  for (const [reason, n] of Object.entries((summary && summary.videos) || {})) {
    if (!["written_total", "n_waiting"].includes(reason)) add("videos", words(reason), n);
  }
  if (learner) {
    for (const [reason, n] of Object.entries(learner.ingest || {})) {
      // Segments refused because of a full mailbox are not lost: the actor sends them again.
      if (!["received_total", "accepted_total", "duplicates_total", "full_total"].includes(reason)) add("learner", words(reason), n);
    }
    add("learner", "expired", learner.expired_total);
    add("learner", "not usable", learner.unmade_total);
    add("learner", "updates taken back", learner.refused_total);
    for (const [reason, n] of Object.entries(learner.bus || {})) add("learner's bus", words(reason), n);
  }
  const rows = [...totals].sort().map(([reason, n]) => [reason, count(n)]);
  fill(table, rows.length ? "Since the start" : "Nothing was dropped.", rows.length ? ["who and why", "how many"] : [], rows);
}
