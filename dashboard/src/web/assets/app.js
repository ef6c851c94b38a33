// The page: makes its parts, follows the event stream, and schedules redraws.

import { address } from "./address.js";
import { Attention } from "./attention.js";
import { Curves, drawGroups } from "./curves.js";
import { Editor } from "./editor.js";
import { askVideos, videoOf } from "./videos.js";
import { $, count, decimal, element, interval, isNumber, minutes, percent, sentence } from "./format.js";
import { drawDrops, drawRoster, Health, toPoint } from "./health.js";
import { Hand } from "./hand.js";
import { Heat } from "./heat.js";
import { answerAt, isCopy, model } from "./model.js";
import { ChosenOptions } from "./options.js";
import { drawOrigins } from "./origin.js";
import { Replay, askReplay, openRecording } from "./replay.js";
import { copyLink, savePicture } from "./share.js";
import { Snapshots } from "./snapshots.js";
import { Stage } from "./stage.js";
import { Terms } from "./terms.js";

/** @import { Values } from "./address.js" */
/** @import { About, Acting, Video, History, Evaluation, Roster, Row } from "./types" */

/** @type {Acting[]} */
const ACTINGS = ["greedy", "sampled"];

const options = new ChosenOptions(() => redraw("history", "learner"));
const curves = new Curves($("curves"), options);
const health = new Health($("health"), $("health-note"), options);
const heat = new Heat($("heat"), $("heat-axis"), $("heat-cell"), openCell);
/** @type {(name: "replay" | "beside") => import("./view.js").Parts} */
const partsOf = (name) => ({
  figure: $(`${name}-figure`), caption: $(`${name}-caption`), canvas: $(name), label: $(`${name}-label`), verdict: $(`${name}-verdict`),
});
const replay = new Replay({
  main: partsOf("replay"), beside: partsOf("beside"), slider: $("replay-slider"), playButton: $("replay-play"),
  back: $("replay-back"), forth: $("replay-forth"), text: $("replay-text"),
  player: $("replay-player"), note: $("replay-note"), fitButton: $("replay-fit"), fullButton: $("replay-full"),
  speedChoice: $("replay-speed"),
  terms: new Terms($("replay-terms"), $("replay-values"), (step) => {
    replay.play(false);
    replay.seek(step);
  }),
  ghost: $("replay-ghost"),
  attention: new Attention({
    part: $("replay-attention"), choice: $("replay-eye"), strip: $("replay-strip"), note: $("replay-attention-note"),
  }, () => replay.draw()),
});
const snapshots = new Snapshots({
  bar: $("snapshot-bar"), slider: $("snapshot"), text: $("snapshot-text"), through: $("snapshot-through"),
  beside: $("snapshot-beside"), others: $("snapshot-others"), other: $("snapshot-other"), otherText: $("snapshot-other-text"),
}, () => stage.again());
const stage = new Stage(replay, snapshots, {
  choose: $("stage-choose"), previous: $("stage-previous"), next: $("stage-next"), again: $("stage-again"), agent: $("stage-agent"), both: $("stage-both"), mode: $("stage-mode"), success: $("stage-success"),
  onward: $("stage-onward"), keep: $("stage-keep"), video: $("stage-video"), shared: $("stage-shared"), note: $("replay-note"), dialog: $("gallery"),
});
new Hand(replay, stage, {
  modes: $("hand"), block: $("hand-block"), push: /** @type {HTMLButtonElement} */ ($("hand-push")), undo: $("hand-undo"), text: $("hand-text"),
});
const editor = new Editor(stage, {
  open: $("draw-open"), board: $("draw-board"), palette: $("draw-palette"), canvas: $("draw-canvas"), layer: $("draw-layer"),
  layerText: $("draw-layer-text"), tools: $("draw-tools"), say: $("draw-say"), problems: $("draw-problems"), list: $("draw-list"),
  match: $("draw-match"), name: $("draw-name"), policy: $("draw-policy"), expert: $("draw-expert"), save: $("draw-save"),
  file: $("draw-file"), copy: $("draw-copy"),
});
/**
 * The address of nothing on the stage.
 * @type {Values}
 */
const NOTHING = { blueprint: null, drawing: null, title: null, agent: null, both: null, mode: null, seed: null, after: null, snapshot: null, beside: null, disturb: null, recording: null, step: null, weights: null };
const openVideo = (/** @type {Video} */ { id }) => {
  address.set({ ...NOTHING, recording: id }, true);
  stage.leave();
  replay.leave();
  openRecording(replay, $("replay-note"), id);
};
$("replay-ask").addEventListener("click", () => {
  // Nobody can see the next one of a training again.
  address.set(NOTHING, true);
  stage.leave();
  askReplay(replay, $("replay-note"), $("replay-ask"));
});
$("replay-link").addEventListener("click", () => copyLink($("stage-shared")));
$("replay-save").addEventListener("click", () => savePicture(replay));

/** Shows the success of the actions that the address names, or else of those that are evaluated. */
function chooseActing() {
  const named = address.get("actions");
  const last = model.history.evaluations.at(-1);
  /** @type {Acting[]} */
  const planned = last ? ACTINGS.filter((acting) => last.all[acting]) : model.about?.origin?.settings.evaluator?.episodes?.acting || ACTINGS;
  const isSampled = named ? named === "sampled" : !planned.includes("greedy");
  model.acting = isSampled ? "sampled" : "greedy";
  /** @type {NodeListOf<HTMLInputElement>} */ ($("acting").querySelectorAll("input")).forEach((one) => { one.checked = one.value === model.acting; });
}

/** Shows what the address names. Returns false if it names no episode. */
function restore() {
  options.restore();
  chooseActing();
  $("heat-whole").checked = address.get("whole") === "1";
  $("heat-find").value = address.get("find") || "";
  heat.find($("heat-find").value);
  $("replay-ghost").checked = address.get("goal") !== "hidden";
  replay.parts.attention.restore();
  if (address.get("open") === "gallery") stage.open();
  else if ($("gallery").open) $("gallery").close();
  if ($("draw")) editor.toggle(address.get("draw") === "open");
  const recording = address.get("recording");
  if (recording !== null) {
    stage.leave();
    openRecording(replay, $("replay-note"), recording);
  }
  return recording !== null || stage.restore();
}
address.follow(restore);

/**
 * Opens the clip that an evaluation recorded, or else plays the same blueprint with the newest weights.
 * @param {Row} row
 * @param {Evaluation} evaluation
 */
async function openCell({ id }, evaluation) {
  const recorded = await videoOf(id, evaluation.weights_version);
  if (recorded) {
    openVideo(recorded);
    return;
  }
  if (!model.about || !model.about.can_play || (isCopy && !stage.only.includes(id))) return;
  if (!stage.parts.keep.checked) stage.seed = 0;
  stage.start(id);
  $("replay-title").scrollIntoView();
}

$("heat-find").addEventListener("input", () => {
  address.set({ find: $("heat-find").value });
  heat.find($("heat-find").value);
});
$("heat-whole").addEventListener("change", () => {
  address.set({ whole: $("heat-whole").checked ? 1 : null });
  heat.draw();
});
/** @type {Set<string>} */
const stale = new Set();

/**
 * Redraws the named parts in the next frame, once per frame at most.
 * @param {...("history" | "learner" | "roster")} parts
 */
function redraw(...parts) {
  if (stale.size === 0) requestAnimationFrame(draw);
  parts.forEach((part) => stale.add(part));
}

function draw() {
  const parts = new Set(stale);
  stale.clear();
  chooseActing();
  // Where nothing is evaluated unasked, nothing would ever fill these parts.
  document.body.classList.toggle("unmeasured", model.about?.kind === "play" && model.history.evaluations.length === 0 && model.summary === null);
  if (parts.has("history")) {
    heat.show(model.history, model.acting);
    curves.show(runs(), model.acting, underWay());
    drawGroups($("groups"), model.history, model.beside.length < 2);
    snapshots.draw();
  }
  if (parts.has("learner") && $("learner")) {
    $("learner").hidden = model.points.length === 0 && model.about !== null && model.about.kind === "finished";
    health.show(runs());
    options.offer(runs());
  }
  if ($("roster")) drawRoster($("roster"), model.roster, model.actors, model.learner, model.link === "live");
  if ($("drops")) drawDrops($("drops"), model.actors, model.learner, model.summary);
  drawTiles();
}

/** Returns the runs that the charts show: the page's own, or all of several. */
function runs() {
  const own = { name: model.about ? model.about.run : "", evaluations: model.history.evaluations, points: model.points };
  return model.beside.length > 1 ? model.beside : [own];
}

/** Returns the success so far and a progress text of the evaluation that has not ended; `null` if there is none. */
function underWay() {
  const summary = model.summary;
  if (!summary || summary.is_complete) return null;
  const { success } = summary.all[model.acting];
  if (success.n_episodes === 0) return null;
  const doing = model.link === "live" ? "evaluating" : "unfinished evaluation of";
  return { success, text: `${doing} version ${summary.weights_version}: ${success.n_episodes} of ${summary.n_planned} episodes` };
}

function drawTiles() {
  const last = model.history.evaluations[model.history.evaluations.length - 1];
  const now = underWay();
  // Before the first evaluation ends, show its preliminary numbers.
  const success = last ? last.all[model.acting] : now && now.success;
  const learner = model.learner || model.points[model.points.length - 1];
  const { kind, n_env_steps: target } = model.about || /** @type {Partial<About>} */ ({});
  const trained = model.points.findLast((point) => isNumber(point.success));
  const soFar = success ? `${interval(success)}, ${success.n_episodes} episodes` : `${trained ? "in training, " : ""}nothing evaluated yet`;
  const episodes = now ? `${success ? `${interval(success)}; ` : ""}${now.text}` : soFar;
  const isLive = model.link === "live";
  // What does not run has no speed and will not arrive.
  const isLearning = kind === "training" && isLive && model.roster.learners.length > 0;
  const left = learner && target ? (target - learner.n_env_steps) / learner.env_steps_per_s : NaN;
  const soon = isLearning && left > 0 ? `, ${minutes(left)} to go` : "";
  const tiles = [["success", success ? percent(success.rate) : trained ? percent(trained.success) : "–", episodes]];
  // Without a learner, as when only playing a policy, these tiles have no data.
  if (kind !== "play" && (kind !== "finished" || learner)) {
    tiles.push(
      ["environment steps", learner ? count(learner.n_env_steps) : "–", learner ? `${target ? `of ${count(target)}, ` : ""}in ${minutes(Math.max(learner.elapsed_s, learner.run_elapsed_s || 0))}${soon}` : ""],
      ["weights", learner ? `version ${learner.weights_version}` : "–", last ? `evaluated: version ${last.weights_version}` : ""],
      kind !== "training" || isLearning || !learner
        ? ["steps per second", learner ? count(learner.env_steps_per_s) : "–", learner ? `lag ${decimal(learner.policy_lag_mean)} versions` : ""]
        : ["steps per second", "–", `${count(learner.env_steps_per_s)} in the last update`],
    );
  }
  const { not_saved: waits } = model.learner || {};
  if (waits && isLive) tiles.unshift(["not saved since", new Date(waits.since_unix_ms).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" }), `training waits: ${waits.reason}`]);
  if (kind === "training" && isLive) tiles.push(["actors", String(model.roster.actors.length), model.roster.learners.length ? "learner is there" : "no learner"]);
  else if (kind === "training") tiles.push(["actors", "–", "not connected"]);
  $("tiles").replaceChildren(...tiles.map(([name, value, more]) =>
    element("div", {}, element("dt", {}, name), element("dd", {}, value, element("small", {}, more)))));
}

/**
 * Sets up the page for its kind: a run in progress, a finished run, or a playing policy.
 * @param {About} about
 */
function introduce(about) {
  model.about = about;
  const name = about.preset && about.preset !== about.run ? `${about.run}, preset ${about.preset}` : about.run;
  $("run-name").textContent = name;
  document.title = `${about.run} · Lodestone`;
  about.gripper_colors.forEach((color, i) => document.documentElement.style.setProperty(`--gripper${i}`, `rgb(${color.join(",")})`));
  if (about.kind !== "training") ["members", "dropped", "replay-ask"].forEach((id) => $(id).remove());
  if (!about.can_play) {
    ["stage-bar", "snapshot-bar", "hand-bar", "draw"].forEach((id) => $(id).remove());
    $("replay-note").textContent = "This run has no policy to play. You can still rotate and step through its videos.";
  }
  else if (isCopy) ["stage-again", "stage-mode", "stage-keep-label", "stage-video", "hand-bar", "draw"].forEach((id) => $(id).remove());
  if (about.is_of_sweep) import("./sweep.js").then(({ showSweep }) => showSweep($("tiles"), choiceOf(about.runs), about.runs.length));
  else if (about.runs.length > 1) chooseRun(about.runs);
  if (about.is_of_sweep || about.runs.length === 1) drawOrigins($("origin"), [{ name: about.run, origin: about.origin }]);
  snapshots.learn();
  const isRestored = restore();
  if (about.kind === "play") {
    $("learner").remove();
    $("tiles").before($("stage"), $("draw"));
    stage.only = about.blueprints;
  } else if (isCopy && about.recorded.length > 0) {
    $("tiles").before($("stage"));
    stage.only = about.recorded;
  } else {
    if (isRestored || isCopy || !about.can_play) return;
    waitsForWeights = about.kind === "training";
    if (waitsForWeights) $("replay-note").textContent = "An episode comes with the first weights. Or choose a blueprint to see it built.";
    else startTrained();
    return;
  }
  $("replay-more").open = false;
  $("stage-onward").checked = !matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (isRestored) return;
  if (isCopy) startTrained();
  else stage.start(about.first, false);
}

/** Whether the first episode of a training comes with the first weights. */
let waitsForWeights = false;

/**
 * Starts a goal that the run trains on, or else the last one that was evaluated, unless the user was faster. Goals are in
 * order of size, and a training learns the first ones first.
 */
async function startTrained() {
  if (!(await stage.learn())) return;
  await askHistory();
  chooseActing();
  if (stage.asked > 0) return;
  const among = (/** @type {string[]} */ ids) => stage.blueprints.filter(({ id }) => ids.includes(id));
  const [trained, evaluated] = [among(model.about.trained), among(model.history.blueprints.map(({ id }) => id))];
  const [goal] = [...trained.slice(...(model.about.kind === "training" ? [0] : [-1])), ...evaluated.slice(-1), ...stage.blueprints.slice(-1)];
  stage.start(goal.id, false);
}

/**
 * Creates a selector for the shown run.
 * @param {About["runs"]} all
 */
function choiceOf(all) {
  const choice = element("select", { "aria-label": "Run", "data-served": "" }, ...all.map(({ name }, i) => element("option", { value: String(i) }, name)));
  choice.value = String(Math.max(all.findIndex(({ base }) => base === model.base), 0));
  choice.addEventListener("change", () => { location.search = `?run=${choice.value}`; });
  return choice;
}

/**
 * Adds a run selector, and fetches the curves of all runs and what produced them.
 * @param {About["runs"]} all
 */
async function chooseRun(all) {
  $("run-name").replaceChildren(choiceOf(all));
  const ask = async (/** @type {string} */ base, /** @type {string} */ what) => (await fetch(answerAt(base, what))).json();
  const asked = Promise.all(all.map(async ({ name, base }) => ({ name, origin: (await ask(base, "about")).origin })));
  model.beside = await Promise.all(all.map(async ({ name, base }) => {
    const { evaluations, learner } = await ask(base, "history");
    return { name, evaluations, points: learner };
  }));
  redraw("history", "learner");
  $("tiles").after($("origin"));
  drawOrigins($("origin"), await asked);
}

/**
 * Shows the state of the event stream.
 * @param {typeof model.link} state
 * @param {string} text
 */
function say(state, text) {
  model.link = state;
  redraw("roster");
  if ($("state").textContent === text) return;
  $("state").dataset.state = state;
  $("state").textContent = text;
}

/**
 * Says why nothing answers any longer and disables what needs an answer; `null` reverts that.
 * @param {string | null} reason
 * @param {string | null} [command] shows the same again
 */
function part(reason, command) {
  if (model.gone === reason) return;
  model.gone = reason;
  for (const served of /** @type {NodeListOf<HTMLFieldSetElement>} */ (document.querySelectorAll("[data-served]"))) {
    served.disabled = reason !== null;
    served.title = reason || "";
  }
  // Videos that have not been loaded cannot be.
  const videos = /** @type {NodeListOf<HTMLVideoElement>} */ (document.querySelectorAll("#videos video"));
  for (const video of videos) video.controls = reason === null || video.readyState > 0;
  document.querySelector("footer").hidden = reason !== null;
  $("farewell").hidden = reason === null;
  if (reason === null) return;
  if ($("gallery").open) $("gallery").close();
  if ($("replay-player").hidden) $("replay-note").textContent = reason;
  const again = command ? [" To see it again, run ", element("code", {}, command)] : [];
  $("farewell").replaceChildren(`${reason} The page keeps what it has until you reload it.`, ...again);
}

/** @type {Promise<void> | null} */
let asking = null;
let askAgain = false;

/** Fetches the history. If a request is already in flight, repeats it once that completes. */
function askHistory() {
  askAgain = true;
  asking ||= loadHistory();
  return asking;
}

async function loadHistory() {
  while (askAgain) {
    askAgain = false;
    try {
      const answer = await fetch(answerAt(model.base, "history"));
      if (answer.ok) {
        model.history = await answer.json();
        const newest = model.points.slice(-1)[0];
        model.points = model.history.learner;
        if (newest && (model.points.length === 0 || newest.n_env_steps > model.points[model.points.length - 1].n_env_steps)) model.points.push(newest);
        redraw("history", "learner");
      }
    } catch {
      // The event stream fails too, and fetches again after reconnecting.
    }
  }
  asking = null;
}

/**
 * Takes in new metrics.
 * @param {{ key: string, payload: any }} sample
 */
function measured({ key, payload }) {
  if (key === "learner" && payload && payload.ppo) {
    model.learner = payload;
    model.points = model.points.filter((point) => point.n_env_steps < payload.n_env_steps);
    model.points.push(toPoint(payload));
    // The history's limit. The next evaluation reloads the earlier points, thinned out.
    if (model.points.length > 1200) model.points.splice(0, 1);
    redraw("learner");
    snapshots.follow(payload.n_env_steps);
    // With the second ones, the server has the first ones.
    if (waitsForWeights && payload.weights_version > 1) {
      waitsForWeights = false;
      startTrained();
    }
  } else if (key.startsWith("actor/")) {
    model.actors.set(key.slice("actor/".length), payload);
    redraw("roster");
  } else if (key === "eval/summary") {
    model.summary = payload;
    redraw(model.history.evaluations.length === 0 ? "history" : "roster");
  }
}

/**
 * Takes in who is alive.
 * @param {Roster} roster
 */
function gathered(roster) {
  const [before, now] = [new Set(model.roster.actors), new Set(roster.actors)];
  const came = roster.actors.filter((name) => !before.has(name));
  const left = model.roster.actors.filter((name) => !now.has(name));
  left.forEach((name) => model.actors.delete(name));
  model.roster = roster;
  const news = [came.length ? `${came.join(", ")} came` : "", left.length ? `${left.join(", ")} left` : ""];
  if ((came.length || left.length) && $("roster-news")) $("roster-news").textContent = `Actors: ${news.filter(Boolean).join("; ")}`;
  redraw("roster");
}

/** How often in a row the event stream could not be opened, or broke. */
let nMisses = 0;

function listen() {
  const source = new EventSource(`${model.base}/api/events`);
  /** @type {(name: string, handle: (data: any) => void) => void} */
  const on = (name, handle) => source.addEventListener(name, (event) => handle(JSON.parse(event.data)));
  on("metrics", measured);
  on("roster", gathered);
  on("evaluation", () => {
    askHistory();
    snapshots.learn();
    // Clips are rendered one by one after the evaluation.
    [5, 20, 60].forEach((seconds) => setTimeout(() => askVideos($("videos"), $("videos-note"), openVideo), 1000 * seconds));
  });
  on("ended", async ({ ended, command }) => {
    // The page closes once it has what came last, for which the server waits a moment.
    source.onerror = null;
    await Promise.all([askHistory(), askVideos($("videos"), $("videos-note"), openVideo)]);
    source.close();
    say("ended", "ended");
    part(`${sentence(ended)} has ended.`, command);
  });
  source.onopen = () => {
    nMisses = 0;
    part(null);
    say("live", model.about && model.about.kind === "finished" ? "finished" : "live");
    askHistory();
    askVideos($("videos"), $("videos-note"), openVideo);
  };
  source.onerror = () => {
    nMisses += 1;
    // The first miss may be a short break. After it, nothing listens there.
    say("away", nMisses > 1 ? "no answer" : "reconnecting");
    if (nMisses > 1) {
      const { ended, command } = (model.about && model.about.farewell) || { ended: "the program" };
      part(`${sentence(ended)} may have ended: nothing answers.`, command);
    }
    if (model.history.evaluations.length === 0) askHistory();
    // A response such as 503 closes the source for good; after other failures the browser reconnects by itself.
    if (source.readyState === EventSource.CLOSED) setTimeout(listen, 3000);
  };
}

$("acting").addEventListener("change", ({ target }) => {
  address.set({ actions: /** @type {HTMLInputElement} */ (target).value });
  redraw("history");
});
/** Fetches the page's summary first. If that fails, treats the page as a training run. */
async function begin() {
  const place = new URLSearchParams(location.search).get("run");
  model.base = place && place !== "0" ? `/runs/${Number(place)}` : "";
  try {
    const answer = await fetch(answerAt(model.base, "about"));
    if (answer.ok) introduce(await answer.json());
  } catch {
    // The event stream reports that the server is unreachable.
  }
  redraw("history", "learner");
  if (!isCopy) {
    listen();
    return;
  }
  document.querySelector("footer").remove();
  say("live", "a copy");
  askHistory();
  askVideos($("videos"), $("videos-note"), openVideo);
}
begin();

// For tests in a browser.
export { curves, editor, health, heat, replay, snapshots };
