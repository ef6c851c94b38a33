// An episode in three dimensions: boxes in perspective, painted from far to near.

const add3 = (a, b) => a.map((x, i) => x + b[i]);
const dot3 = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross3 = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** `v` turned by the unit quaternion x, y, z, w. */
function turn(q, v) {
  const t = cross3(q, v).map((x) => 2 * x);
  return add3(add3(v, t.map((x) => x * q[3])), cross3(q, t));
}

/** The pose at `share` of the way from `a` to `b`. */
function between(a, b, share) {
  const sign = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6] < 0 ? -1 : 1;
  const mixed = a.map((x, i) => x + ((i < 3 ? b[i] : sign * b[i]) - x) * share);
  const length = Math.hypot(...mixed.slice(3)) || 1;
  return mixed.map((x, i) => (i < 3 ? x : x / length));
}

/** The six sides of a box: outward direction and corners in order. */
const SIDES = [0, 1, 2].flatMap((axis) => [-1, 1].map((side) => {
  const [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
  const corner = (a, b) => {
    const at = [0, 0, 0];
    [at[axis], at[u], at[v]] = [side, a, b];
    return at;
  };
  const out = [0, 0, 0];
  out[axis] = side;
  return { out, corners: [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)] };
}));

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
    this.text.textContent = `step ${Math.floor(time)} of ${this.n}, ${scene.n_connected} connections, reward ${scene.reward.toFixed(2)}${end}`;
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
    const boxes = from.blocks.map((pose, block) => ({
      pose: between(pose, to.blocks[block], share),
      half: episode.half_extents_m[block],
      color: episode.colors[block],
      frame: GRIPPERS[from.held.indexOf(block)],
    }));
    drawBoxes(pen, camera, boxes);
    // The goal, as large as a quarter of the picture, in the upper left corner.
    const side = Math.min(width, height) * 0.34;
    const places = episode.goal.map(([, pose]) => pose);
    const middle = [0, 1, 2].map((i) => places.reduce((total, pose) => total + pose[i], 0) / Math.max(places.length, 1));
    const reach = Math.max(...places.map((pose) => Math.hypot(...[0, 1, 2].map((i) => pose[i] - middle[i]))), 0.1) + 0.15;
    const small = new Camera(this.turnBy, this.tilt, middle, reach, [side, side]);
    drawBoxes(pen, small, episode.goal.map(([block, pose]) => ({ pose, half: episode.half_extents_m[block], color: episode.colors[block] })));
    pen.font = "12px system-ui, sans-serif";
    pen.fillStyle = style.getPropertyValue("--quiet");
    pen.fillText("goal", 4, 14);
  }
}

class Camera {
  constructor(around, tilt, target, reach, size) {
    const [c, s, ct, st] = [Math.cos(around), Math.sin(around), Math.cos(tilt), Math.sin(tilt)];
    this.right = [c, s, 0];
    this.back = [s * ct, -c * ct, st];
    this.up = cross3(this.back, this.right);
    this.distance = reach * 4;
    this.eye = add3(target, this.back.map((x) => x * this.distance));
    this.focal = (Math.min(...size) / 2 / reach) * this.distance * 0.92;
    this.size = size;
  }

  /** Pixels and distance, or `null` behind the eye. */
  project(point) {
    const at = point.map((x, i) => x - this.eye[i]);
    const depth = -dot3(at, this.back);
    if (depth < this.distance * 0.05) return null;
    const scale = this.focal / depth;
    return [this.size[0] / 2 + dot3(at, this.right) * scale, this.size[1] / 2 - dot3(at, this.up) * scale, depth];
  }
}

function drawGround(pen, camera, target, color) {
  pen.strokeStyle = color;
  pen.lineWidth = 1;
  pen.beginPath();
  for (let i = -6; i <= 6; i += 1) {
    const at = i * 0.5;
    const [x, y] = [Math.round(target[0] * 2) / 2, Math.round(target[1] * 2) / 2];
    for (const line of [[[x + at, y - 3, 0], [x + at, y + 3, 0]], [[x - 3, y + at, 0], [x + 3, y + at, 0]]]) {
      const [a, b] = line.map((point) => camera.project(point));
      if (!a || !b) continue;
      pen.moveTo(a[0], a[1]);
      pen.lineTo(b[0], b[1]);
    }
  }
  pen.stroke();
}

function drawBoxes(pen, camera, boxes) {
  const faces = [];
  for (const { pose, half, color, frame } of boxes) {
    const [place, q] = [pose.slice(0, 3), pose.slice(3)];
    for (const { out, corners } of SIDES) {
      const normal = turn(q, out);
      const center = add3(place, turn(q, out.map((x, i) => x * half[i])));
      if (dot3(normal, center.map((x, i) => camera.eye[i] - x)) <= 0) continue;
      const points = corners.map((corner) => camera.project(add3(place, turn(q, corner.map((x, i) => x * half[i])))));
      if (points.includes(null)) continue;
      const light = 0.62 + 0.38 * Math.max(dot3(normal, [0.36, -0.48, 0.8]), 0);
      const depth = Math.hypot(...center.map((x, i) => x - camera.eye[i]));
      faces.push({ points, depth, fill: `rgb(${color.map((x) => Math.round(x * light)).join(",")})`, frame });
    }
  }
  faces.sort((a, b) => b.depth - a.depth);
  pen.lineJoin = "round";
  for (const { points, fill: paint, frame } of faces) {
    pen.beginPath();
    points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.closePath();
    pen.fillStyle = paint;
    pen.fill();
    pen.strokeStyle = frame || "rgba(0,0,0,.45)";
    pen.lineWidth = frame ? 2.5 : 1;
    pen.stroke();
  }
}

/** Asks for an episode until there is one; the server records one when it is asked. */
async function askReplay(replay, note, button) {
  button.disabled = true;
  note.textContent = "Recording an episode …";
  for (let i = 0; i < 40; i += 1) {
    let answer = null;
    try {
      answer = await fetch("/api/replay");
    } catch {
      break;
    }
    if (answer.status === 200) {
      const text = await answer.text();
      // The first answer to a second wish is still the old one.
      if (text !== replay.shown || i > 5) {
        replay.shown = text;
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
