// The player of an episode: play, scrub, step; drag, pinch or press keys to look from elsewhere.

let spaceModule = null;

/** The part that draws three dimensions; asked for once, with the first episode. */
const loadSpace = () => (spaceModule ||= import("./space.js"));

class Replay {
  constructor(parts) {
    Object.assign(this, parts);
    [this.time, this.playing, this.speed, this.width] = [0, false, 1, 0];
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    this.canvas.addEventListener("dblclick", () => this.fit());
    this.playButton.addEventListener("click", () => this.play(!this.playing));
    this.back.addEventListener("click", () => this.step(-1));
    this.forth.addEventListener("click", () => this.step(1));
    this.fitButton.addEventListener("click", () => this.fit());
    this.fullButton.addEventListener("click", () => this.full());
    this.speedChoice.addEventListener("change", () => { this.speed = Number(this.speedChoice.value); });
    this.ghost.addEventListener("change", () => this.draw());
    this.slider.addEventListener("input", () => {
      this.play(false);
      this.seek(Number(this.slider.value));
    });
    document.addEventListener("fullscreenchange", () => this.resize());
    new ResizeObserver(([entry]) => {
      // The height is our own doing.
      if (Math.abs(entry.contentRect.width - this.width) < 1) return;
      this.width = entry.contentRect.width;
      this.resize();
    }).observe(this.player);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      if (!this.space) return;
      this.space.theme();
      this.draw();
    });
  }

  /** Makes ready to draw; says why if that cannot be. */
  async prepare() {
    if (this.space) return true;
    try {
      const { Space } = await loadSpace();
      this.space ||= new Space(this.canvas, () => { this.follows = false; });
      return true;
    } catch {
      this.note.textContent = "This browser draws no three dimensions: WebGL is off or missing. The films below need none.";
      return false;
    }
  }

  key(event) {
    const keys = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (!this.space) return;
    if (keys[event.key]) this.space.turn(...keys[event.key]);
    else if (event.key === "+" || event.key === "-") {
      this.follows = false;
      this.space.near(event.key === "+" ? 1.15 : 0.87);
    }
    else if (event.key === " ") this.play(!this.playing);
    else if (event.key === "f") this.full();
    else if (event.key === "0") this.fit();
    else if (event.key === ",") this.step(-1);
    else if (event.key === ".") this.step(1);
    else return;
    event.preventDefault();
  }

  /** Shows an episode from its start; `ended` is called when it has played to its end. */
  show(episode, ended) {
    this.play(false);
    [this.episode, this.ended] = [episode, ended];
    this.n = episode.scenes.length - 1;
    this.slider.max = this.n;
    this.space.load(episode);
    this.terms.show(episode);
    this.attention.show(episode);
    this.plan();
    this.size();
    this.follows = true;
    this.seek(0);
    this.play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  }

  /** Follows again what is being built. */
  fit() {
    if (!this.episode) return;
    this.follows = true;
    this.draw();
  }

  /** How much is to be seen at each scene: the goal's blocks where they begin, and less the more of them are in place. */
  plan() {
    const { goal, scenes } = this.episode;
    const whole = goal.map(([, pose]) => placed(scenes[this.n].goal_frame, pose));
    this.middle = [0, 1, 2].map((i) => whole.reduce((sum, pose) => sum + pose[i], 0) / Math.max(whole.length, 1));
    const radius = Math.max(...whole.map((pose) => apart3(pose, this.middle)), 0.1) + 0.12;
    const needed = scenes.map((scene) => {
      // Some blocks may lie far away, and a policy that learns throws some: nine of ten are enough.
      const away = goal.map(([block]) => apart3(scene.blocks[block], this.middle)).sort((a, b) => a - b);
      const most = away[Math.floor((away.length - 1) * 0.9)] || radius;
      return Math.min(Math.max(radius * 1.1, most + 0.05, 0.3), 1.3);
    });
    // Slowly, over two seconds.
    this.reach = needed.map((_, i) => {
      const near = needed.slice(Math.max(i - 10, 0), i + 11);
      return near.reduce((sum, one) => sum + one, 0) / near.length;
    });
  }

  /** As large as there is room, with the next picture. */
  size() {
    const width = this.canvas.clientWidth;
    if (width === 0) return;
    this.width = width;
    const isFull = this.player.classList.contains("full") || document.fullscreenElement === this.player;
    if (isFull) this.canvas.style.height = "";
    else this.canvas.style.height = `${Math.round(Math.min(Math.max(width * 0.56, 300), 560, window.innerHeight * 0.66))}px`;
    this.space.resize(width, this.canvas.clientHeight);
  }

  resize() {
    if (!this.space || !this.episode) return;
    this.size();
    this.draw();
  }

  /** To the whole screen and back; where a browser gives none away, to its whole window. */
  full() {
    if (document.fullscreenElement) document.exitFullscreen();
    else if (this.player.requestFullscreen) this.player.requestFullscreen().catch(() => {});
    else this.player.classList.toggle("full");
    this.resize();
  }

  step(by) {
    this.play(false);
    this.seek(Math.min(Math.max((by > 0 ? Math.floor(this.time) : Math.ceil(this.time)) + by, 0), this.n));
  }

  seek(time) {
    this.time = time;
    const at = Math.floor(time);
    this.slider.value = at;
    const scene = this.episode.scenes[at];
    this.slider.setAttribute("aria-valuetext", `step ${at} of ${this.n}`);
    const end = this.n === at ? `, ${this.episode.end}` : "";
    this.text.textContent = `step ${at} of ${this.n}, ${scene.n_connected} ${scene.n_connected === 1 ? "connection" : "connections"}, reward ${scene.reward.toFixed(2)}${end}`;
    this.terms.seek(time);
    this.attention.seek(time);
    this.draw();
  }

  play(on) {
    const was = this.playing;
    this.playing = on && Boolean(this.episode);
    this.playButton.textContent = this.playing ? "Pause" : "Play";
    if (!this.playing || was) return;
    if (this.time >= this.n) this.time = 0;
    let before = null;
    const episode = this.episode;
    const frame = (now) => {
      if (!this.playing || this.episode !== episode) return;
      const time = this.time + (before === null ? 0 : ((now - before) / 1000 / episode.step_s) * this.speed);
      before = now;
      this.seek(Math.min(time, this.n));
      if (this.time < this.n) {
        requestAnimationFrame(frame);
        return;
      }
      this.play(false);
      if (this.ended) this.ended();
    };
    requestAnimationFrame(frame);
  }

  draw() {
    const { episode, space } = this;
    if (!episode || !space) return;
    const [low, high] = [Math.floor(this.time), Math.min(Math.floor(this.time) + 1, this.n)];
    const [from, to, share] = [episode.scenes[low], episode.scenes[high], this.time - low];
    const poses = from.blocks.map((pose, block) => between(pose, to.blocks[block], share));
    const attention = this.attention.at(this.time);
    // The frame jumps when another piece becomes the largest; between two scenes it moves with that.
    const frame = apart3(from.goal_frame, to.goal_frame) < 0.5 ? between(from.goal_frame, to.goal_frame, share) : from.goal_frame;
    const ghosts = episode.goal.map(([block, pose]) => {
      const there = placed(frame, pose);
      return this.ghost.checked && apart3(poses[block], there) > 0.02 ? there : null;
    });
    if (this.follows) space.fit(this.middle, this.reach[low] + (this.reach[high] - this.reach[low]) * share);
    space.show(poses, from.held, attention && attention.map(shade), ghosts);
  }
}

/** Shows an episode in the player, which appears with it. */
async function present(replay, episode, ended) {
  if (!(await replay.prepare())) return;
  replay.player.hidden = false;
  replay.show(episode, ended);
}

/** Shows the episode of a film. */
async function openRecording(replay, note, film) {
  let episode = null;
  try {
    const answer = await fetch(answerAt(model.base, "recording", film.id));
    if (answer.ok) episode = await answer.json();
  } catch {
    // Said below.
  }
  if (!episode) {
    note.textContent = "That recording is no longer there.";
    return;
  }
  note.textContent = `${film.blueprint}, ${film.ending} in an evaluation of weights ${film.weights_version}`;
  await present(replay, episode);
  $("replay-title").scrollIntoView();
}

/** Asks for an episode until there is one; the server records one when it is asked. */
async function askReplay(replay, note, button) {
  button.disabled = true;
  note.textContent = "Recording an episode …";
  // What there is at first may be of any age: it was recorded after somebody asked before.
  let first = null;
  for (let i = 0; i < 40; i += 1) {
    let answer = null;
    try {
      answer = await fetch(`${model.base}/api/replay`);
    } catch {
      break;
    }
    if (answer.status === 200) {
      const text = await answer.text();
      if (i === 0) first = text;
      else if (text !== first || i > 5) {
        const episode = JSON.parse(text);
        note.textContent = `${episode.blueprint} by actor ${episode.actor}, weights ${episode.weights_version}`;
        await present(replay, episode);
        button.textContent = "Record a newer episode";
        button.disabled = false;
        return;
      }
    } else if (answer.status !== 202) {
      break;
    }
    await new Promise((done) => setTimeout(done, 1500));
  }
  note.textContent = "No episode came: is an actor there?";
  button.disabled = false;
}
