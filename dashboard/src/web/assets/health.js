// The learner's metrics over time, live processes, and drop counts.

import { Charts } from "./chart.js";
import { count, decimal, fill, isNumber, percent } from "./format.js";

/** @import { Spec } from "./chart.js" */
/** @import { Options, Run } from "./options.js" */
/** @import { Actor, Draws, Learner, Point, Roster, Summary, Totals } from "./types" */

/**
 * Returns the mixture head's draws of one kind of proposal, if there are any.
 * @param {Learner} learner
 * @param {string} kind
 * @returns {Draws}
 */
const drawn = ({ proposals }, kind) => proposals?.kinds?.[kind] || {};

/** @param {Totals} counts */
const sum = (counts) => Object.values(counts || {}).reduce((total, n) => total + (isNumber(n) ? n : 0), 0);

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
  ["success", "success in training", ({ episodes }) => (episodes?.success.n_episodes ? episodes.success.rate : undefined)],
  ["return", "return in training", ({ episodes }) => (episodes?.success.n_episodes ? sum(episodes.mean_return) : undefined)],
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
  const point = {
    n_env_steps: learner.n_env_steps, n_episodes: learner.n_episodes, weights_version: learner.weights_version,
    elapsed_s: Math.max(learner.elapsed_s, learner.run_elapsed_s || 0),
  };
  for (const [name, , value] of HEALTH) point[name] = value(learner);
  return point;
}

export class Health {
  /**
   * @param {HTMLElement} place
   * @param {HTMLElement} note
   * @param {Options} options
   */
  constructor(place, note, options) {
    this.note = note;
    this.options = options;
    this.charts = new Charts(place, options);
  }

  /**
   * Draws the learner's charts.
   * @param {Run[]} runs
   */
  show(runs) {
    const points = runs.flatMap((run) => run.points);
    const tells = (/** @type {string} */ name, /** @type {number} */ value) => isNumber(value) && (value !== 0 || !OF_REWARDS.includes(name));
    const shown = HEALTH.filter(([name]) => points.some((point) => tells(name, point[name])));
    this.charts.show(shown.map(([name, title]) => this.spec(runs, name, title)));
    const last = Math.max(...points.map((point) => point.n_env_steps));
    this.note.textContent = points.length > 0 ? `Up to ${count(last)} environment steps.` : "No update yet.";
  }

  /**
   * Returns the chart of one metric.
   * @param {Run[]} runs
   * @param {string} name
   * @param {string} title
   * @returns {Spec}
   */
  spec(runs, name, title) {
    const { axis } = this.options;
    const isRate = name === "success";
    const text = isRate ? percent : decimal;
    const curves = runs.map((run, look) => ({
      name: run.name, look, places: run.points.filter((point) => isNumber(point[name])).map((point) => ({ x: point[axis.name], y: point[name] })),
    }));
    const words = curves.filter(({ places }) => places.length > 0).map(({ name: run, places }) => {
      const values = places.map(({ y }) => y);
      const range = `from ${text(Math.min(...values))} to ${text(Math.max(...values))}, now ${text(values[values.length - 1])}`;
      return curves.length > 1 ? `${run} ${range}` : range;
    });
    return { title, label: `${title}: ${words.join("; ")}`, curves, text, isRate, isTall: false };
  }
}

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
