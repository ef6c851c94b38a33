// The player of an episode: drag to turn, play, scrub, step.

const GRIPPERS = ["#d6006e", "#7a4dff"];

class Replay {
  constructor(parts) {
    Object.assign(this, parts);
    [this.turnBy, this.tilt, this.zoom, this.time, this.playing] = [0.6, 0.5, 1, 0, false];
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.drag = [event.clientX, event.clientY];
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this.drag) return;
      this.look((event.clientX - this.drag[0]) * -0.008, (event.clientY - this.drag[1]) * 0.008);
      this.drag = [event.clientX, event.clientY];
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { this.drag = null; });
    canvas.addEventListener("keydown", (event) => {
      const keys = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
      if (keys[event.key]) {
        event.preventDefault();
        this.look(...keys[event.key]);
      } else if (event.key === "+" || event.key === "-") {
        this.zoom = Math.min(Math.max(this.zoom * (event.key === "+" ? 1.15 : 0.87), 0.3), 4);
        this.draw();
      } else if (event.key === " ") {
        event.preventDefault();
        this.play(!this.playing);
      }
    });
    this.playButton.addEventListener("click", () => this.play(!this.playing));
    this.back.addEventListener("click", () => this.step(-1));
    this.forth.addEventListener("click", () => this.step(1));
    this.ghost.addEventListener("change", () => this.draw());
    this.slider.addEventListener("input", () => {
      this.play(false);
      this.seek(Number(this.slider.value));
    });
    new ResizeObserver(() => this.draw()).observe(canvas.parentElement);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  show(episode) {
    this.episode = episode;
    this.n = episode.scenes.length - 1;
    this.slider.max = this.n;
    // Framed by where the blocks begin, most of them: some may lie far away, and a policy that learns throws some.
    const places = episode.scenes[0].blocks;
    const middle = (i) => places.map((place) => place[i]).sort((a, b) => a - b)[places.length >> 1];
    this.target = [middle(0), middle(1), 0.15];
    const away = places.map((place) => Math.hypot(place[0] - this.target[0], place[1] - this.target[1])).sort((a, b) => a - b);
    this.reach = Math.min(Math.max(away[Math.floor(away.length * 0.9)], 0.5), 1.5);
    this.terms.show(episode);
    this.attention.show(episode);
    this.seek(0);
    this.play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  }

  look(around, up) {
    this.turnBy += around;
    this.tilt = Math.min(Math.max(this.tilt + up, 0.05), 1.5);
    this.draw();
  }

  step(by) {
    this.play(false);
    this.seek(Math.min(Math.max((by > 0 ? Math.floor(this.time) : Math.ceil(this.time)) + by, 0), this.n));
  }

  seek(time) {
    this.time = time;
    this.slider.value = Math.floor(time);
    const scene = this.episode.scenes[Math.floor(time)];
    this.slider.setAttribute("aria-valuetext", `step ${Math.floor(time)} of ${this.n}`);
    const end = this.n === Math.floor(time) ? `, ${this.episode.end}` : "";
    this.text.textContent = `step ${Math.floor(time)} of ${this.n}, ${scene.n_connected} ${scene.n_connected === 1 ? "connection" : "connections"}, reward ${scene.reward.toFixed(2)}${end}`;
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
    const frame = (now) => {
      if (!this.playing) return;
      const time = this.time + (before === null ? 0 : (now - before) / 1000 / this.episode.step_s);
      before = now;
      this.seek(Math.min(time, this.n));
      if (this.time >= this.n) this.play(false);
      else requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  draw() {
    const [canvas, episode] = [this.canvas, this.episode];
    const width = canvas.clientWidth;
    if (!episode || width === 0) return;
    const height = Math.round(Math.min(width * 0.62, 480));
    const ratio = window.devicePixelRatio || 1;
    canvas.style.height = `${height}px`;
    [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const [low, high] = [Math.floor(this.time), Math.min(Math.floor(this.time) + 1, this.n)];
    const [from, to, share] = [episode.scenes[low], episode.scenes[high], this.time - low];
    const camera = new Camera(this.turnBy, this.tilt, this.target, this.reach / this.zoom, [width, height]);
    const style = getComputedStyle(document.documentElement);
    drawGround(pen, camera, this.target, style.getPropertyValue("--line"));
    const attention = this.attention.at(this.time);
    const boxes = from.blocks.map((pose, block) => ({
      pose: between(pose, to.blocks[block], share),
      half: episode.half_extents_m[block],
      color: attention ? shade(attention[block]) : episode.colors[block],
      frame: GRIPPERS[from.held.indexOf(block)],
    }));
    drawBoxes(pen, camera, boxes, episode.unit_m);
    if (this.ghost.checked) {
      // The frame jumps when another piece becomes the largest; between two scenes it moves with that.
      const apart = Math.hypot(...[0, 1, 2].map((i) => from.goal_frame[i] - to.goal_frame[i]));
      const frame = apart < 0.5 ? between(from.goal_frame, to.goal_frame, share) : from.goal_frame;
      const missing = episode.goal.map(([block, pose]) => ({ block, pose: placed(frame, pose) }))
        .filter(({ block, pose }) => Math.hypot(...[0, 1, 2].map((i) => boxes[block].pose[i] - pose[i])) > 0.02);
      drawGhosts(pen, camera, missing.map(({ block, pose }) => ({ pose, half: episode.half_extents_m[block], color: episode.colors[block] })));
    }
    // The goal, as large as a quarter of the picture, in the upper left corner.
    const side = Math.min(width, height) * 0.34;
    const places = episode.goal.map(([, pose]) => pose);
    const middle = [0, 1, 2].map((i) => places.reduce((total, pose) => total + pose[i], 0) / Math.max(places.length, 1));
    const reach = Math.max(...places.map((pose) => Math.hypot(...[0, 1, 2].map((i) => pose[i] - middle[i]))), 0.1) + 0.15;
    const small = new Camera(this.turnBy, this.tilt, middle, reach, [side, side]);
    const wanted = episode.goal.map(([block, pose]) => ({ pose, half: episode.half_extents_m[block], color: episode.colors[block] }));
    drawBoxes(pen, small, wanted, episode.unit_m);
    pen.font = "12px system-ui, sans-serif";
    pen.fillStyle = style.getPropertyValue("--quiet");
    pen.fillText("goal", 4, 14);
  }
}

/** Shows the episode of a film. */
async function openRecording(replay, note, film) {
  let episode = null;
  try {
    const answer = await fetch(`/api/recording?id=${film.id}`);
    if (answer.ok) episode = await answer.json();
  } catch {
    // Said below.
  }
  if (!episode) {
    note.textContent = "That recording is no longer there.";
    return;
  }
  note.textContent = `${film.blueprint}, ${film.ending} in an evaluation of weights ${film.weights_version}`;
  $("replay-player").hidden = false;
  replay.show(episode);
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
      answer = await fetch("/api/replay");
    } catch {
      break;
    }
    if (answer.status === 200) {
      const text = await answer.text();
      if (i === 0) first = text;
      else if (text !== first || i > 5) {
        const episode = JSON.parse(text);
        note.textContent = `${episode.blueprint} by actor ${episode.actor}, weights ${episode.weights_version}`;
        $("replay-player").hidden = false;
        replay.show(episode);
        button.textContent = "Show a newer episode";
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
