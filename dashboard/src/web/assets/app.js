// State, the stream of events, and when to draw.

const model = {
  history: { blueprints: [], passes: [], n_left_out: 0 },
  points: [],
  learner: null,
  summary: null,
  actors: new Map(),
  roster: { actors: [], learners: [], evaluators: [] },
  acting: "mode",
};
const $ = (id) => document.getElementById(id);
const heat = new Heat($("heat"), $("heat-cell"));
const replay = new Replay({
  canvas: $("replay"), slider: $("replay-slider"), playButton: $("replay-play"),
  back: $("replay-back"), forth: $("replay-forth"), text: $("replay-text"),
  terms: new Terms($("replay-terms"), $("replay-values")), ghost: $("replay-ghost"),
  attention: new Attention({
    part: $("replay-attention"), choice: $("replay-eye"), strip: $("replay-strip"), note: $("replay-attention-note"),
  }, () => replay.draw()),
});
const openFilm = (film) => openRecording(replay, $("replay-note"), film);
$("replay-ask").addEventListener("click", () => askReplay(replay, $("replay-note"), $("replay-ask")));
const stale = new Set();

/** Draws the named parts in the next frame, however often it is asked for. */
function redraw(...parts) {
  if (stale.size === 0) requestAnimationFrame(draw);
  parts.forEach((part) => stale.add(part));
}

function draw() {
  const parts = new Set(stale);
  stale.clear();
  if (parts.has("history")) {
    heat.show(model.history, model.acting);
    drawCurves($("curves"), model.history, model.acting);
    drawGroups($("groups"), model.history);
  }
  if (parts.has("learner")) drawHealth($("health"), model.points);
  drawRoster($("roster"), model.roster, model.actors, model.learner);
  drawDrops($("drops"), model.actors, model.learner, model.summary);
  drawTiles();
}

function drawTiles() {
  const last = model.history.passes[model.history.passes.length - 1];
  const success = last && last.all[model.acting];
  const learner = model.learner || model.points[model.points.length - 1];
  const tiles = [
    ["success", success ? percent(success.rate) : "–", success ? `${interval(success)}, ${success.n_episodes} episodes` : "nothing judged yet"],
    ["environment steps", learner ? count(learner.n_env_steps) : "–", learner ? `in ${minutes(learner.elapsed_s)}` : ""],
    ["weights", learner ? `version ${learner.weights_version}` : "–", last ? `judged: ${last.weights_version}` : ""],
    ["steps per second", learner ? count(learner.env_steps_per_s) : "–", learner ? `lag ${decimal(learner.policy_lag_mean)} versions` : ""],
    ["actors", String(model.roster.actors.length), model.roster.learners.length ? "learner is there" : "no learner"],
  ];
  $("tiles").replaceChildren(...tiles.map(([name, value, more]) =>
    element("div", {}, element("dt", {}, name), element("dd", {}, value, element("small", {}, more)))));
}

function say(state, text) {
  if ($("state").textContent === text) return;
  $("state").dataset.state = state;
  $("state").textContent = text;
}

let asking = false;
let askAgain = false;

/** Asks for the history; while an answer is under way, once more after it. */
async function askHistory() {
  askAgain = asking;
  if (asking) return;
  asking = true;
  try {
    const answer = await fetch("/api/history");
    if (answer.ok) {
      model.history = await answer.json();
      const newest = model.points.slice(-1)[0];
      model.points = model.history.learner;
      if (newest && (model.points.length === 0 || newest.n_env_steps > model.points[model.points.length - 1].n_env_steps)) model.points.push(newest);
      redraw("history", "learner");
    }
  } catch {
    // The stream of events notices too, and asks again when it is back.
  }
  asking = false;
  if (askAgain) askHistory();
}

function measured({ key, payload }) {
  if (key === "learner" && payload && payload.ppo) {
    model.learner = payload;
    model.points = model.points.filter((point) => point.n_env_steps < payload.n_env_steps);
    model.points.push(toPoint(payload));
    // As many as the history keeps; the next pass brings those from before, thinned out.
    if (model.points.length > 1200) model.points.splice(0, 1);
    redraw("learner");
  } else if (key.startsWith("actor/")) {
    model.actors.set(key.slice("actor/".length), payload);
    redraw("roster");
  } else if (key === "eval/summary") {
    model.summary = payload;
    redraw("roster");
  }
}

function gathered(roster) {
  const [before, now] = [new Set(model.roster.actors), new Set(roster.actors)];
  const came = roster.actors.filter((name) => !before.has(name));
  const left = model.roster.actors.filter((name) => !now.has(name));
  left.forEach((name) => model.actors.delete(name));
  model.roster = roster;
  const news = [came.length ? `${came.join(", ")} came` : "", left.length ? `${left.join(", ")} left` : ""];
  if (came.length || left.length) $("roster-news").textContent = `Actors: ${news.filter(Boolean).join("; ")}`;
  redraw("roster");
}

function listen() {
  const source = new EventSource("/api/events");
  const on = (name, handle) => source.addEventListener(name, (event) => handle(JSON.parse(event.data)));
  on("metrics", measured);
  on("roster", gathered);
  on("pass", () => {
    askHistory();
    // Films are drawn after the evaluation, one after the other.
    [5, 20, 60].forEach((seconds) => setTimeout(() => askFilms($("films"), $("films-note"), openFilm), 1000 * seconds));
  });
  source.onopen = () => {
    say("live", "live");
    askHistory();
    askFilms($("films"), $("films-note"), openFilm);
  };
  source.onerror = () => {
    say("away", "reconnecting");
    if (model.history.passes.length === 0) askHistory();
    // An answer such as 503 closes it for good; the browser itself tries again after anything else.
    if (source.readyState === EventSource.CLOSED) setTimeout(listen, 3000);
  };
}

$("acting").addEventListener("change", (event) => {
  model.acting = event.target.value;
  redraw("history");
});
let width = 0;
new ResizeObserver(([entry]) => {
  if (Math.abs(entry.contentRect.width - width) > 1) redraw("history");
  width = entry.contentRect.width;
}).observe($("curves"));
redraw("history", "learner");
listen();
