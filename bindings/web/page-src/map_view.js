// Draws the map's points, the camera and its trajectory. The user rotates the view. The up direction is estimated from the poses,
// because cameras are usually held level.

const cross = ([a, b, c], [d, e, f]) => [b * f - c * e, c * d - a * f, a * e - b * d];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const unit = (v) => {
  const length = Math.hypot(...v) || 1;
  return v.map((x) => x / length);
};

/** Rows of the rotation of a quaternion `w x y z`: the camera's axes in the map. */
export function axes([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

export class MapView {
  #canvas;
  #points = new Float32Array();
  #trail = [];
  #down = [0, 1, 0];
  #center = [0, 0, 0];
  #radius = 1;
  #yaw = 0.6;
  #pitch = 0.85;
  #near = 1;
  #due = false;

  constructor(canvas) {
    this.#canvas = canvas;
    const turn = (x, y) => {
      this.#yaw += x;
      this.#pitch = Math.min(1.55, Math.max(-0.2, this.#pitch + y));
      this.#draw();
    };
    const zoom = (factor) => {
      this.#near = Math.min(8, Math.max(0.4, this.#near * factor));
      this.#draw();
    };
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) turn(event.movementX / 160, event.movementY / 200);
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(Math.exp(-event.deltaY / 500));
    }, { passive: false });
    const keys = {
      ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.08), ArrowDown: () => turn(0, -0.08),
      "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(1 / 1.15),
    };
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
    addEventListener("resize", () => this.#draw());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#draw());
  }

  /** Shows `[N, 3]` points of a map, and clears the trajectory. */
  show(points) {
    this.#points = points;
    this.#trail = [];
    this.#frame();
    this.#draw();
  }

  /** Adds the current pose. */
  add(answer) {
    const camera = axes(answer.cam_from_world.q);
    const weight = Math.min(this.#trail.length, 8);
    this.#down = unit(this.#down.map((x, i) => x * weight + camera[1][i]));
    this.#trail.push({ center: answer.center, ahead: camera[2], right: camera[0], down: camera[1], sd: answer.position_sd ?? 0, trusted: answer.state === "trusted" });
    if (this.#points.length === 0) this.#frame();
    this.#draw();
  }

  /** Centres the view: the median of the points, and the distance within which 96 % of them lie. */
  #frame() {
    const all = this.#points.length ? this.#points : new Float32Array(this.#trail.flatMap((pose) => pose.center));
    if (all.length === 0) return;
    const middle = (values) => values.sort()[values.length >> 1];
    const column = (k) => Float32Array.from({ length: all.length / 3 }, (_, i) => all[3 * i + k]);
    this.#center = [0, 1, 2].map((k) => middle(column(k)));
    const [x, y, z] = this.#center;
    const far = Float32Array.from({ length: all.length / 3 }, (_, i) => Math.hypot(all[3 * i] - x, all[3 * i + 1] - y, all[3 * i + 2] - z)).sort();
    this.#radius = far[Math.floor(far.length * 0.96)] || 1;
  }

  #draw() {
    if (this.#due) return;
    this.#due = true;
    requestAnimationFrame(() => {
      this.#due = false;
      this.#paint();
    });
  }

  #paint() {
    const canvas = this.#canvas;
    const ratio = devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth * ratio, canvas.clientHeight * ratio];
    if (!width || !height) return;
    Object.assign(canvas, { width, height });
    const context = canvas.getContext("2d");
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();

    const up = this.#down.map((x) => -x);
    const east = unit(cross(up, Math.abs(up[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
    const north = cross(up, east);
    const [cy, sy, cp, sp] = [Math.cos(this.#yaw), Math.sin(this.#yaw), Math.cos(this.#pitch), Math.sin(this.#pitch)];
    const distance = (3.6 * this.#radius) / this.#near;
    const focal = Math.min(width, height * 1.7) * 0.92;
    // From the map to the screen: right, up, and depth.
    const across = east.map((e, i) => cy * e + sy * north[i]);
    const away = east.map((e, i) => -sy * e + cy * north[i]);
    const rise = away.map((a, i) => sp * a + cp * up[i]);
    const depth = away.map((a, i) => cp * a - sp * up[i]);
    const project = (p) => {
      const q = [p[0] - this.#center[0], p[1] - this.#center[1], p[2] - this.#center[2]];
      const d = distance + dot(q, depth);
      return d < this.#radius * 0.05 ? null : [width / 2 + (focal * dot(q, across)) / d, height / 2 - (focal * dot(q, rise)) / d, d];
    };

    context.clearRect(0, 0, width, height);
    context.fillStyle = colour("--ink");
    const size = Math.max(1, Math.min(1.5 * ratio, width / 620));
    for (let i = 0; i < this.#points.length; i += 3) {
      const at = project([this.#points[i], this.#points[i + 1], this.#points[i + 2]]);
      if (!at || at[0] < 0 || at[0] > width || at[1] < 0 || at[1] > height) continue;
      context.globalAlpha = Math.min(0.85, Math.max(0.18, 1.25 - at[2] / (distance * 1.5)));
      context.fillRect(at[0], at[1], size, size);
    }
    context.globalAlpha = 1;

    const path = this.#trail.filter((pose) => pose.trusted).map((pose) => project(pose.center)).filter(Boolean);
    context.strokeStyle = colour("--accent");
    context.lineWidth = 2.5 * ratio;
    context.lineJoin = "round";
    context.beginPath();
    path.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.stroke();
    const now = this.#trail.at(-1);
    const at = now && project(now.center);
    if (!at) return;
    const main = colour(now.trusted ? "--good" : "--doubt");
    // The camera: a pyramid that opens in its viewing direction.
    const reach = this.#radius * 0.34;
    const corner = (x, y) => project(now.center.map((c, i) => c + reach * (now.ahead[i] + x * now.right[i] + y * now.down[i])));
    const corners = [corner(-0.6, -0.45), corner(0.6, -0.45), corner(0.6, 0.45), corner(-0.6, 0.45)];
    if (corners.every(Boolean)) {
      context.strokeStyle = main;
      context.fillStyle = main;
      context.lineWidth = 1.8 * ratio;
      context.globalAlpha = 0.16;
      context.beginPath();
      corners.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
      context.closePath();
      context.fill();
      context.globalAlpha = 1;
      context.stroke();
      context.beginPath();
      for (const [x, y] of corners) {
        context.moveTo(at[0], at[1]);
        context.lineTo(x, y);
      }
      context.stroke();
    }
    // A circle of two standard deviations.
    const spread = (2 * now.sd * focal) / at[2];
    context.fillStyle = main;
    context.globalAlpha = 0.22;
    context.beginPath();
    context.arc(at[0], at[1], Math.min(spread, width), 0, 7);
    context.fill();
    context.globalAlpha = 1;
    context.beginPath();
    context.arc(at[0], at[1], 6 * ratio, 0, 7);
    context.fill();
    context.lineWidth = 2 * ratio;
    context.strokeStyle = colour("--card");
    context.stroke();
  }
}
