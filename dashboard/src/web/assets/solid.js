// Three dimensions: boxes with magnets in perspective, painted from far to near.

const add3 = (a, b) => a.map((x, i) => x + b[i]);
const dot3 = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross3 = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** `v` turned by the unit quaternion x, y, z, w. */
function turn(q, v) {
  const t = cross3(q, v).map((x) => 2 * x);
  return add3(add3(v, t.map((x) => x * q[3])), cross3(q, t));
}

/** The pose `b`, which is told in the frame of `a`. */
function placed(a, b) {
  const [p, q] = [a.slice(3), b.slice(3)];
  const vector = add3(add3(cross3(p, q), q.slice(0, 3).map((x) => x * p[3])), p.slice(0, 3).map((x) => x * q[3]));
  return [...add3(a.slice(0, 3), turn(p, b.slice(0, 3))), ...vector, p[3] * q[3] - dot3(p, q)];
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
  return { out, side, u, v, corners: [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)] };
}));

/** Colors of negative and positive magnets, as in films. */
const MAGNETS = [[32, 82, 196], [208, 40, 46]];

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

function drawBoxes(pen, camera, boxes, unit) {
  const faces = [];
  for (const { pose, half, color, frame } of boxes) {
    const [place, q] = [pose.slice(0, 3), pose.slice(3)];
    for (const { out, side, u, v, corners } of SIDES) {
      const normal = turn(q, out);
      const center = add3(place, turn(q, out.map((x, i) => x * half[i])));
      if (dot3(normal, center.map((x, i) => camera.eye[i] - x)) <= 0) continue;
      const points = corners.map((corner) => camera.project(add3(place, turn(q, corner.map((x, i) => x * half[i])))));
      if (points.includes(null)) continue;
      const light = 0.62 + 0.38 * Math.max(dot3(normal, [0.36, -0.48, 0.8]), 0);
      const depth = Math.hypot(...center.map((x, i) => x - camera.eye[i]));
      faces.push({ pose, half, out, side, u, v, points, depth, light, fill: `rgb(${color.map((x) => Math.round(x * light)).join(",")})`, frame });
    }
  }
  faces.sort((a, b) => b.depth - a.depth);
  pen.lineJoin = "round";
  for (const face of faces) {
    const { points, fill: paint, frame } = face;
    pen.beginPath();
    points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.closePath();
    pen.fillStyle = paint;
    pen.fill();
    pen.strokeStyle = frame || "rgba(0,0,0,.45)";
    pen.lineWidth = frame ? 2.5 : 1;
    pen.stroke();
    drawMagnets(pen, camera, face, unit);
  }
}

/** Boxes as if of glass, over everything else: where blocks are to be. */
function drawGhosts(pen, camera, boxes) {
  pen.save();
  pen.setLineDash([4, 3]);
  pen.lineWidth = 1.2;
  for (const { pose, half, color } of boxes) {
    const [place, q] = [pose.slice(0, 3), pose.slice(3)];
    for (const { out, corners } of SIDES) {
      const normal = turn(q, out);
      const center = add3(place, turn(q, out.map((x, i) => x * half[i])));
      if (dot3(normal, center.map((x, i) => camera.eye[i] - x)) <= 0) continue;
      const points = corners.map((corner) => camera.project(add3(place, turn(q, corner.map((x, i) => x * half[i])))));
      if (points.includes(null)) continue;
      pen.beginPath();
      points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      pen.closePath();
      pen.fillStyle = `rgba(${color.join(",")},.16)`;
      pen.fill();
      pen.strokeStyle = `rgba(${color.join(",")},.9)`;
      pen.stroke();
    }
  }
  pen.restore();
}

/** A disc in the middle of each unit cell, with its sign where there is room: red and blue are not apart for everyone. */
function drawMagnets(pen, camera, { pose, half, out, side, u, v, light }, unit) {
  const [place, q] = [pose.slice(0, 3), pose.slice(3)];
  const [nu, nv] = [u, v].map((axis) => Math.round((2 * half[axis]) / unit));
  const radius = 0.2 * unit;
  const color = MAGNETS[side > 0 ? 1 : 0].map((x) => Math.round(x * (0.4 + 0.6 * light)));
  const seen = (at) => camera.project(add3(place, turn(q, at)));
  for (let cell = 0; cell < nu * nv; cell += 1) {
    const at = out.map((x, i) => x * half[i]);
    at[u] = ((cell % nu) + 0.5) * unit - half[u];
    at[v] = (Math.floor(cell / nu) + 0.5) * unit - half[v];
    const along = (axis) => seen(at.map((x, i) => (i === axis ? x + radius : x)));
    const [center, first, second] = [seen(at), along(u), along(v)];
    if (!center || !first || !second) continue;
    const [a, b] = [first, second].map((point) => [point[0] - center[0], point[1] - center[1]]);
    pen.save();
    pen.transform(a[0], a[1], b[0], b[1], center[0], center[1]);
    pen.beginPath();
    pen.arc(0, 0, 1, 0, 2 * Math.PI);
    pen.fillStyle = `rgb(${color.join(",")})`;
    pen.fill();
    if (Math.max(Math.hypot(...a), Math.hypot(...b)) > 5) {
      pen.fillStyle = "#fff";
      pen.fillRect(-0.6, -0.15, 1.2, 0.3);
      if (side > 0) pen.fillRect(-0.15, -0.6, 0.3, 1.2);
    }
    pen.restore();
  }
}
