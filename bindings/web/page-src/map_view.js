// Draws the map's points and anchors, the camera and its trajectory, with the axes of the map and a scale. The user rotates the view.
// Where the map does not know gravity, up is estimated from the poses, because cameras are usually held level.

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
  #map = { anchors: [] };
  #trail = [];
  #down = [0, 1, 0];
  #center = [0, 0, 0];
  #radius = 1;
  /** Distance from the centre at which everything is in the picture; null when it is to be found. */
  #away = null;
  /** Whether the user chose the view, which then stays. */
  #chosen = false;
  #yaw = 0.6;
  #pitch = 0.85;
  #near = 1;
  #due = false;

  constructor(canvas) {
    this.#canvas = canvas;
    const turn = (x, y) => {
      this.#chosen = true;
      this.#yaw += x;
      this.#pitch = Math.min(1.55, Math.max(-0.2, this.#pitch + y));
      this.#draw();
    };
    const zoom = (factor) => {
      this.#chosen = true;
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
    addEventListener("resize", () => this.#fit());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#draw());
  }

  /**
   * Shows `[N, 3]` points of a map, and clears the trajectory. Of the map: `down` and `north`, directions or null; whether its unit is
   * the metre; `anchors` with `name` and `at`.
   */
  show(points, map) {
    this.#points = points;
    this.#map = map;
    this.#trail = [];
    this.#chosen = false;
    this.#down = map.down ?? [0, 1, 0];
    this.#fit();
  }

  /** Adds the current pose. */
  add(answer) {
    const camera = axes(answer.cam_from_world.q);
    const weight = Math.min(this.#trail.length, 8);
    if (!this.#map.down) this.#down = unit(this.#down.map((x, i) => x * weight + camera[1][i]));
    this.#trail.push({ center: answer.center, ahead: camera[2], right: camera[0], down: camera[1], sd: answer.position_sd ?? 0, trusted: answer.state === "trusted" });
    this.#fit();
  }

  /** Everything that must be in the picture: cameras with their pyramids, and anchors. */
  #things() {
    const reach = this.#radius * 0.34;
    const ends = this.#trail.flatMap((pose) => [pose.center, pose.center.map((c, i) => c + reach * pose.ahead[i])]);
    return [...ends, ...this.#map.anchors.map((anchor) => anchor.at)];
  }

  /** Centres the view, unless the user chose it: the median of the points, and the distance within which 96 % of them lie. */
  #fit() {
    if (!this.#chosen) {
      this.#away = null;
      const things = [...this.#trail.map((pose) => pose.center), ...this.#map.anchors.map((anchor) => anchor.at)];
      const all = this.#points.length ? this.#points : new Float32Array(things.flat());
      if (all.length) {
        const middle = (values) => values.sort()[values.length >> 1];
        const column = (k) => Float32Array.from({ length: all.length / 3 }, (_, i) => all[3 * i + k]);
        this.#center = [0, 1, 2].map((k) => middle(column(k)));
        const [x, y, z] = this.#center;
        const far = Float32Array.from({ length: all.length / 3 }, (_, i) => Math.hypot(all[3 * i] - x, all[3 * i + 1] - y, all[3 * i + 2] - z)).sort();
        this.#radius = far[Math.floor((far.length - 1) * 0.96)];
      }
      // Cameras alone may all be at one place: then some metres around them are shown.
      const least = this.#points.length ? 1e-6 : Math.max(this.#map.metres ? 2 : 0, 20 * (this.#trail.at(-1)?.sd ?? 0));
      this.#radius = Math.max(this.#radius, least) || 1;
    }
    this.#draw();
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
    const focal = Math.min(width, height * 1.7) * 0.92;
    // From the map to the screen: right, up, and depth.
    const across = east.map((e, i) => cy * e + sy * north[i]);
    const away = east.map((e, i) => -sy * e + cy * north[i]);
    const rise = away.map((a, i) => sp * a + cp * up[i]);
    const depth = away.map((a, i) => cp * a - sp * up[i]);
    if (this.#away === null) {
      // From here a thing is within the margins of the picture. Few points, far from all others, may lie outside.
      const from = (x, y, z) => {
        const q = [x - this.#center[0], y - this.#center[1], z - this.#center[2]];
        return focal * Math.max(Math.abs(dot(q, across)) / (0.47 * width), Math.abs(dot(q, rise)) / (0.45 * height)) - dot(q, depth);
      };
      const ofPoints = Float32Array.from({ length: this.#points.length / 3 }, (_, i) => from(this.#points[3 * i], this.#points[3 * i + 1], this.#points[3 * i + 2])).sort();
      this.#away = Math.max(1.2 * this.#radius, ofPoints[Math.floor(0.99 * (ofPoints.length - 1))] ?? 0, ...this.#things().map((at) => from(...at)));
    }
    const distance = this.#away / this.#near;
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
    context.font = `${12 * ratio}px system-ui, sans-serif`;
    const segment = (a, b) => {
      if (!a || !b) return;
      context.beginPath();
      context.moveTo(a[0], a[1]);
      context.lineTo(b[0], b[1]);
      context.stroke();
    };
    // A scale, as it is at the centre of the view; without points, a level grid of its length.
    const wanted = (0.22 * width * distance) / focal;
    const power = 10 ** Math.floor(Math.log10(wanted));
    const step = [5, 2, 1].map((m) => m * power).find((m) => m <= wanted) ?? power;
    context.lineWidth = ratio;
    if (this.#points.length === 0) {
      context.strokeStyle = colour("--edge");
      const floor = (a, b) => project(this.#center.map((c, i) => c + step * (a * east[i] + b * north[i])));
      for (let k = -4; k <= 4; k += 1) {
        segment(floor(k, -4), floor(k, 4));
        segment(floor(-4, k), floor(4, k));
      }
    }
    context.strokeStyle = context.fillStyle = colour("--soft");
    const [right, top] = [width - 16 * ratio, 24 * ratio];
    const long = (step * focal) / distance;
    segment([right - long, top], [right, top]);
    context.textAlign = "right";
    context.fillText(`${Number(step.toPrecision(3))} ${this.#map.metres ? "m" : step === 1 ? "map unit" : "map units"}`, right, top - 6 * ratio);
    // The axes of the map, and north where it is known.
    context.textAlign = "center";
    const origin = [46 * ratio, 52 * ratio];
    const arrows = [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]], ...(this.#map.north ? [["N", this.#map.north]] : [])];
    for (const [name, axis] of arrows) {
      const end = (length) => [origin[0] + length * ratio * dot(axis, across), origin[1] - length * ratio * dot(axis, rise)];
      context.strokeStyle = context.fillStyle = colour(name === "N" ? "--accent" : "--soft");
      segment(origin, end(26));
      context.fillText(name, end(36)[0], end(36)[1] + 4 * ratio);
    }
    context.fillStyle = colour("--ink");
    for (const { name, at: place } of this.#map.anchors) {
      const at = project(place);
      if (!at) continue;
      context.fillRect(at[0] - 3 * ratio, at[1] - 3 * ratio, 6 * ratio, 6 * ratio);
      context.fillText(name, at[0], at[1] - 8 * ratio);
    }

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
