// What the page knows, and where it asks for more.

/** @import { Run } from "./options.js" */
/** @import { About, Acting, Actor, History, Learner, Point, Roster, Summary } from "./types" */

/** Whether this is a static copy of the page, where every response is a file and there is no server. */
export const isCopy = document.documentElement.hasAttribute("data-copy");

/** Said when a request fails. */
export const NO_ANSWER = "The program does not answer. Is it still running?";

/** What the page shows. The events of the server change it. */
export const model = {
  /** @type {History} */
  history: { blueprints: [], evaluations: [], n_left_out: 0, learner: [] },
  /** @type {Point[]} */
  points: [],
  /**
   * All runs of a page of several, once they are fetched.
   * @type {Run[]}
   */
  beside: [],
  /** @type {Learner | null} */
  learner: null,
  /** @type {Summary | null} */
  summary: null,
  /** @type {Map<string, Actor>} */
  actors: new Map(),
  /** @type {Roster} */
  roster: { actors: [], learners: [], evaluators: [] },
  /** @type {Acting} */
  acting: "greedy",
  /** @type {About | null} */
  about: null,
  /**
   * The event stream.
   * @type {"waiting" | "live" | "away" | "ended"}
   */
  link: "waiting",
  /**
   * Why nothing answers any longer; `null` while something does.
   * @type {string | null}
   */
  gone: null,
  /** URL prefix of the shown run's endpoints. On a page of several runs, all but the first have one. */
  base: "",
};

/**
 * Returns the URL of an endpoint of a run, optionally for one item.
 * @param {string} base the run's URL prefix
 * @param {string} name the endpoint below `/api`
 * @param {string} [id] the item
 */
export function answerAt(base, name, id) {
  if (!isCopy) return `${base}/api/${name}${id === undefined ? "" : `?id=${encodeURIComponent(id)}`}`;
  const ending = { video: "mp4", picture: "png", poster: "png" }[name] || "json";
  return `.${base}/api/${name}${id === undefined ? "" : `/${id}`}.${ending}`;
}
