// The scene in 3D on a canvas: points, cameras, poses with their deviations; turned by mouse, touch and keyboard. It requests
// nothing: its data is in the page.
"use strict";
(() => {
  const NEAR = 1e-3;
  const KINDS = ["lost", "doubtful", "trusted"];

  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const n = Math.hypot(...a) || 1; return a.map((x) => x / n); };
  const along = (p, d, s) => [p[0] + s * d[0], p[1] + s * d[1], p[2] + s * d[2]];

  /** A length for people, as the tables write it: three significant digits. */
  const digits = (x) => String(Number(x.toPrecision(3)));
  const length = (x, metres) => !metres ? `${digits(x)} map unit${x === 1 ? "" : "s"}` : x < 0.01 ? `${digits(1e3 * x)} mm` : x < 1 ? `${digits(100 * x)} cm` : `${digits(x)} m`;

  /** Points, [n][3], of 16 bits an axis. */
  function points(data) {
    const raw = atob(data.points), n = raw.length / 6, out = new Float32Array(3 * n);
    for (let i = 0; i < 3 * n; i++) {
      out[i] = data.low[i % 3] + data.step * (raw.charCodeAt(2 * i) + 256 * raw.charCodeAt(2 * i + 1));
    }
    return out;
  }

  /** Centre and axes of a camera: [x, y, z, qw, qx, qy, qz], centre and world-to-camera rotation. */
  function camera(c) {
    const [x, y, z, w, i, j, k] = c;
    return {
      center: [x, y, z],
      right: [1 - 2 * (j * j + k * k), 2 * (i * j - k * w), 2 * (i * k + j * w)],
      down: [2 * (i * j + k * w), 1 - 2 * (i * i + k * k), 2 * (j * k - i * w)],
      front: [2 * (i * k - j * w), 2 * (j * k + i * w), 1 - 2 * (i * i + j * j)],
    };
  }

  function corners(cam, size) {
    const middle = along(cam.center, cam.front, size);
    return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => along(along(middle, cam.right, a * 0.6 * size), cam.down, b * 0.45 * size));
  }

  class Space {
    constructor(root) {
      const find = (name) => root.querySelector(`[data-part="${name}"]`);
      this.data = JSON.parse(find("data").textContent);
      this.canvas = find("canvas");
      this.status = find("status");
      this.pen = this.canvas.getContext("2d");
      this.cloud = points(this.data);
      this.mapped = this.data.map.map(camera);
      this.queries = this.data.queries.map((q) => ({
        ...q, truth: q.t && camera(q.t), found: q.e.map((e) => ({ row: e[0], at: e[1] && camera(e[1]), sd: e[2], kind: e[3], off: e[4], turn: e[5] })),
      }));
      this.row = find("row"); this.query = find("query"); this.times = find("times");
      this.shown = { points: find("points"), map: find("map"), sd: find("sd") };
      this.chosen = -1;
      this.frame();
      root.querySelector(".flat").hidden = true;
      root.querySelector(".live").hidden = false;
      this.listen(find);
      this.resize();
    }

    /** Axes of the scene, its middle and its size. */
    frame() {
      const up = unit(this.data.up);
      const side = Math.abs(up[0]) < 0.8 ? [1, 0, 0] : [0, 1, 0];
      this.axes = [unit(cross(side, up)), null, up];
      this.axes[1] = cross(up, this.axes[0]);
      const cams = [...this.mapped, ...this.queries.map((q) => q.truth).filter(Boolean)].map((c) => c.center);
      const middle = [0, 1, 2].map((a) => {
        const all = [];
        for (let i = a; i < this.cloud.length; i += 3) all.push(this.cloud[i]);
        for (const c of cams) all.push(c[a]);
        all.sort((x, y) => x - y);
        return all.length ? 0.5 * (all[Math.floor(0.04 * all.length)] + all[Math.ceil(0.96 * (all.length - 1))]) : 0;
      });
      const far = [];
      for (let i = 0; i < this.cloud.length; i += 3) far.push(Math.hypot(this.cloud[i] - middle[0], this.cloud[i + 1] - middle[1], this.cloud[i + 2] - middle[2]));
      for (const c of cams) far.push(Math.hypot(...sub(c, middle)));
      far.sort((x, y) => x - y);
      this.middle = middle;
      this.size = Math.max(far[Math.floor(0.93 * (far.length - 1))] || 1, 1e-6);
      const heights = [];
      for (let i = 0; i < this.cloud.length; i += 3) heights.push(dot(up, [this.cloud[i], this.cloud[i + 1], this.cloud[i + 2]]));
      const sorted = [...heights].sort((x, y) => x - y);
      const low = sorted[Math.floor(0.03 * sorted.length)] || 0, high = sorted[Math.floor(0.97 * sorted.length)] || 1;
      this.height = Uint8Array.from(heights, (h) => Math.max(0, Math.min(15, Math.floor(16 * (h - low) / (high - low || 1)))));
      // Looked at from behind the cameras, where they look one way, and a little from the side.
      const front = [0, 0, 0];
      for (const c of this.mapped) for (let a = 0; a < 3; a++) front[a] += c.front[a] / this.mapped.length;
      const flat = [dot(front, this.axes[0]), dot(front, this.axes[1])];
      this.first = Math.hypot(...flat) > 0.3 ? Math.atan2(flat[0], flat[1]) + 0.45 : 0.7;
      this.reset();
    }

    reset() { this.yaw = this.first; this.pitch = 0.62; this.fit(); }

    above() { this.yaw = 0; this.pitch = Math.PI / 2 - 1e-3; this.fit(); }

    /** Steps back until all cameras are in the picture, and of the points all but the farthest hundredth. */
    fit() {
      this.whole = true;
      this.target = [...this.middle];
      this.away = this.size;
      this.look();
      const [right, down, front] = this.view, { width, height } = this.canvas;
      const from = (p) => {
        const d = sub(p, this.middle);
        return this.focal * Math.max(Math.abs(dot(right, d)) / (0.46 * width), Math.abs(dot(down, d)) / (0.44 * height)) - dot(front, d);
      };
      const far = [];
      for (let i = 0; i < this.cloud.length; i += 3) far.push(from(this.cloud.subarray(i, i + 3)));
      far.sort((x, y) => x - y);
      const found = this.queries.flatMap((q) => q.found.filter((f) => f.at && KINDS[f.kind] === "trusted").map((f) => f.at));
      const cams = [...this.mapped, ...this.queries.map((q) => q.truth).filter(Boolean), ...found];
      const ends = cams.flatMap((c) => [c.center, ...corners(c, 0.055 * this.size)]);
      this.away = ends.reduce((most, p) => Math.max(most, from(p)), Math.max(1.2 * this.size, far[Math.floor(0.99 * (far.length - 1))] || 0));
    }

    listen(find) {
      const again = () => this.draw();
      const canvas = this.canvas;
      const pointers = new Map();
      let pinch = 0, moved = 0;
      canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); pointers.set(e.pointerId, [e.clientX, e.clientY]); moved = 0; pinch = 0; canvas.focus({ preventScroll: true }); });
      canvas.addEventListener("pointermove", (e) => {
        const last = pointers.get(e.pointerId);
        if (!last) return;
        const [dx, dy] = [e.clientX - last[0], e.clientY - last[1]];
        pointers.set(e.pointerId, [e.clientX, e.clientY]);
        moved += Math.abs(dx) + Math.abs(dy);
        if (pointers.size === 2) {
          const [a, b] = [...pointers.values()], apart = Math.hypot(a[0] - b[0], a[1] - b[1]);
          if (pinch > 0) this.zoom(pinch / apart);
          pinch = apart;
          this.pan(dx / 2, dy / 2);
        } else if (e.shiftKey || e.buttons & 6) this.pan(dx, dy);
        else this.turn(-dx * 0.008, dy * 0.008);
        again();
      });
      const free = (e) => { if (pointers.delete(e.pointerId) && e.type === "pointerup" && moved < 5) this.pick(e); };
      canvas.addEventListener("pointerup", free);
      canvas.addEventListener("pointercancel", free);
      canvas.addEventListener("contextmenu", (e) => e.preventDefault());
      // The wheel scrolls the page until the drawing was clicked.
      canvas.addEventListener("wheel", (e) => { if (document.activeElement === canvas) { e.preventDefault(); this.zoom(Math.exp(0.0012 * e.deltaY)); again(); } }, { passive: false });
      canvas.addEventListener("keydown", (e) => {
        const [x, y] = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[e.key] || [0, 0];
        if (x || y) { if (e.shiftKey) this.pan(24 * x, 24 * y); else this.turn(0.09 * x, 0.09 * y); }
        else if (e.key === "+" || e.key === "=") this.zoom(0.88);
        else if (e.key === "-") this.zoom(1.14);
        else if (e.key === "0") this.reset();
        else return;
        e.preventDefault(); again();
      });
      const click = (name, does) => find(name).addEventListener("click", () => { does(); again(); });
      click("in", () => this.zoom(0.8)); click("out", () => this.zoom(1.25));
      click("left", () => this.turn(0.26, 0)); click("right", () => this.turn(-0.26, 0));
      click("reset", () => { this.choose(-1); this.reset(); }); click("above", () => this.above());
      for (const part of [this.row, this.times, ...Object.values(this.shown)]) part.addEventListener("change", () => { this.describe(); again(); });
      this.query.addEventListener("change", () => { this.choose(Number(this.query.value)); again(); });
      new ResizeObserver(() => this.resize()).observe(canvas);
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.resize());
    }

    turn(yaw, pitch) { this.whole = false; this.yaw += yaw; this.pitch = Math.max(-1.5, Math.min(1.57, this.pitch + pitch)); }
    zoom(by) { this.whole = false; this.away = Math.max(0.02 * this.size, Math.min(12 * this.size, this.away * by)); }
    pan(dx, dy) {
      this.whole = false;
      const step = this.away / this.focal * this.ratio;
      this.target = along(along(this.target, this.view[0], -dx * step), this.view[1], -dy * step);
    }

    /** Chooses a query, and looks at it. */
    choose(index) {
      this.chosen = index;
      this.query.value = String(index);
      const q = this.queries[index];
      const cam = q && (q.truth || (this.found(q) || {}).at);
      if (cam) { this.whole = false; this.target = along(cam.center, cam.front, 0.12 * this.size); this.away = Math.min(this.away, 0.9 * this.size); }
      this.describe();
    }

    found(q) { const row = Number(this.row.value); return q.found.find((f) => f.row === row); }

    describe() {
      const q = this.queries[this.chosen];
      this.status.textContent = "";
      if (!q) return;
      const f = this.found(q), name = this.data.rows[Number(this.row.value)];
      const sd = f && f.sd !== null ? ` ± ${length(f.sd, this.data.metres)}` : "";
      const off = f && f.off !== null ? ` ${length(f.off, this.data.metres)}${f.turn === null ? "" : ` and ${digits(f.turn)}°`} from the true pose,` : "";
      const words = !f ? "not asked" : !f.at ? "no pose" : `${KINDS[f.kind]},${off}${sd ? ` position${sd}` : ""}`.replace(/,$/, "");
      this.status.append(`${q.n} · ${name}: ${words}. `);
      if (q.id) { const a = document.createElement("a"); a.href = `#${q.id}`; a.textContent = "Its lines"; a.addEventListener("click", () => { document.getElementById(q.id).open = true; }); this.status.append(a); }
    }

    /** The camera nearest to a click, if one is near. */
    pick(e) {
      const box = this.canvas.getBoundingClientRect(), x = (e.clientX - box.left) * this.ratio, y = (e.clientY - box.top) * this.ratio;
      let best = -1, least = 18 * this.ratio;
      this.queries.forEach((q, i) => {
        for (const cam of [q.truth, (this.found(q) || {}).at]) {
          const p = cam && this.project(cam.center);
          const d = p ? Math.hypot(p[0] - x, p[1] - y) : Infinity;
          if (d < least) { least = d; best = i; }
        }
      });
      if (best >= 0) { const { target, away } = this; this.choose(best); Object.assign(this, { target, away }); this.draw(); }
    }

    resize() {
      const { clientWidth: w, clientHeight: h } = this.canvas;
      if (!w || !h) return;
      this.ratio = Math.min(window.devicePixelRatio || 1, 2);
      this.canvas.width = Math.round(w * this.ratio);
      this.canvas.height = Math.round(h * this.ratio);
      this.colors();
      if (this.whole) this.fit();
      this.draw();
    }

    /** Colours as the page has them, light or dark. */
    colors() {
      const style = getComputedStyle(this.canvas);
      const rgb = (name) => { this.pen.fillStyle = style.getPropertyValue(name).trim(); const v = parseInt(this.pen.fillStyle.slice(1), 16); return [v >> 16, (v >> 8) & 255, v & 255]; };
      const text = (name) => `rgb(${rgb(name)})`;
      this.ink = { map: text("--map"), truth: text("--ink"), chosen: text("--accent"), lost: text("--bad"), doubtful: text("--fair"), trusted: text("--good") };
      const [stage, low, high] = [rgb("--stage"), rgb("--cloud-low"), rgb("--cloud-high")];
      this.stage = stage;
      this.table = new Uint32Array(256);
      for (let h = 0; h < 16; h++) for (let f = 0; f < 16; f++) {
        const c = [0, 1, 2].map((i) => { const own = low[i] + (high[i] - low[i]) * h / 15; return Math.round(own + (stage[i] - own) * 0.72 * f / 15); });
        this.table[16 * h + f] = (255 << 24) | (c[2] << 16) | (c[1] << 8) | c[0];
      }
    }

    look() {
      const [a, b, up] = this.axes, cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), cp = Math.cos(this.pitch), sp = Math.sin(this.pitch);
      const flat = [0, 1, 2].map((i) => sy * a[i] + cy * b[i]);
      const front = [0, 1, 2].map((i) => cp * flat[i] - sp * up[i]);
      const right = [0, 1, 2].map((i) => cy * a[i] - sy * b[i]);
      this.view = [right, cross(front, right), front];
      this.eye = along(this.target, front, -this.away);
      this.focal = Math.min(this.canvas.width, 1.2 * this.canvas.height);
    }

    project(p) {
      const d = sub(p, this.eye), z = dot(this.view[2], d);
      if (!(z > NEAR * this.size)) return null;
      const s = this.focal / z;
      return [this.canvas.width / 2 + s * dot(this.view[0], d), this.canvas.height / 2 + s * dot(this.view[1], d), z];
    }

    draw() {
      this.look();
      this.drawPoints();
      if (this.shown.map.checked) for (const cam of this.mapped) this.frustum(cam, 0.03 * this.size, this.ink.map, 1, 0);
      this.queries.forEach((q, i) => this.drawQuery(q, i === this.chosen));
      const q = this.queries[this.chosen];
      if (q) this.drawQuery(q, true);
      this.bar();
    }

    drawPoints() {
      const { width: w, height: h } = this.canvas;
      const image = this.pen.createImageData(w, h), out = new Uint32Array(image.data.buffer), depth = new Float32Array(w * h);
      const [r, g, b] = this.stage;
      out.fill((255 << 24) | (b << 16) | (g << 8) | r);
      const [[rx, ry, rz], [dx, dy, dz], [fx, fy, fz]] = this.view, [ex, ey, ez] = this.eye, { cloud, height, table, focal } = this;
      const first = Math.max(this.away - this.size, 0), span = 2.2 * this.size, near = 0.01 * this.size;
      const count = this.shown.points.checked ? height.length : 0;
      for (let i = 0; i < count; i++) {
        const x = cloud[3 * i] - ex, y = cloud[3 * i + 1] - ey, z = cloud[3 * i + 2] - ez;
        const away = fx * x + fy * y + fz * z;
        if (!(away > near)) continue;
        const s = focal / away;
        const px = Math.floor(w / 2 + s * (rx * x + ry * y + rz * z)), py = Math.floor(h / 2 + s * (dx * x + dy * y + dz * z));
        const half = Math.max(1, Math.min(3, Math.round(this.ratio * 0.75 * this.size * 1.9 / away)));
        if (px < 0 || py < 0 || px + half >= w || py + half >= h) continue;
        const color = table[16 * height[i] + Math.max(0, Math.min(15, Math.floor(16 * (away - first) / span)))], closeness = 1 / away;
        for (let v = py; v <= py + half; v++) for (let u = px; u <= px + half; u++) {
          const at = v * w + u;
          if (closeness > depth[at]) { depth[at] = closeness; out[at] = color; }
        }
      }
      this.pen.putImageData(image, 0, 0);
    }

    drawQuery(q, chosen) {
      const f = this.found(q), size = 0.055 * this.size, dim = this.chosen >= 0 && !chosen;
      this.pen.globalAlpha = dim ? 0.35 : 1;
      if (q.truth) this.frustum(q.truth, size, chosen ? this.ink.chosen : this.ink.truth, chosen ? 2.4 : 1.2, 0);
      if (f && f.at) {
        const color = this.ink[KINDS[f.kind]];
        if (q.truth) this.line(q.truth.center, f.at.center, this.ink.lost, 1.6);
        this.frustum(f.at, 0.8 * size, color, 1.6, 0.28);
        const p = this.project(f.at.center);
        if (p && this.shown.sd.checked && f.sd !== null) {
          const radius = Math.min(Number(this.times.value) * f.sd * this.focal / p[2], this.canvas.width);
          this.ring(p, radius, color);
        }
        if (p) this.disc(p, 2.6 * this.ratio, color);
      } else if (q.truth) {
        const p = this.project(q.truth.center), arm = 5 * this.ratio;
        if (p) { this.stroke([[p[0] - arm, p[1] - arm], [p[0] + arm, p[1] + arm]], this.ink.lost, 2); this.stroke([[p[0] - arm, p[1] + arm], [p[0] + arm, p[1] - arm]], this.ink.lost, 2); }
      }
      this.pen.globalAlpha = 1;
    }

    frustum(cam, size, color, width, fill) {
      const tip = this.project(cam.center), ends = corners(cam, size).map((c) => this.project(c));
      if (!tip || ends.some((c) => !c)) return;
      if (fill) { this.pen.beginPath(); ends.forEach((c) => this.pen.lineTo(c[0], c[1])); this.pen.closePath(); this.pen.save(); this.pen.globalAlpha *= fill; this.pen.fillStyle = color; this.pen.fill(); this.pen.restore(); }
      this.stroke([...ends, ends[0]], color, width);
      for (const c of ends) this.stroke([tip, c], color, width);
    }

    line(a, b, color, width) { const p = this.project(a), q = this.project(b); if (p && q) this.stroke([p, q], color, width); }

    stroke(path, color, width) {
      this.pen.beginPath();
      for (const c of path) this.pen.lineTo(c[0], c[1]);
      this.pen.strokeStyle = color; this.pen.lineWidth = width * this.ratio; this.pen.lineJoin = "round"; this.pen.stroke();
    }

    disc(p, radius, color) { this.pen.beginPath(); this.pen.arc(p[0], p[1], radius, 0, 7); this.pen.fillStyle = color; this.pen.fill(); }

    ring(p, radius, color) {
      this.pen.save();
      this.pen.beginPath(); this.pen.arc(p[0], p[1], radius, 0, 7);
      this.pen.globalAlpha *= 0.2; this.pen.fillStyle = color; this.pen.fill();
      this.pen.globalAlpha *= 4; this.pen.strokeStyle = color; this.pen.lineWidth = this.ratio; this.pen.stroke();
      this.pen.restore();
    }

    /** A bar of a round length, as it is at the middle of the drawing. */
    bar() {
      const wanted = 110 * this.ratio * this.away / this.focal, power = 10 ** Math.floor(Math.log10(wanted));
      const long = [5, 2, 1].map((m) => m * power).find((m) => m <= wanted) || power;
      const wide = long * this.focal / this.away, x = 16 * this.ratio, y = this.canvas.height - 16 * this.ratio, end = 4 * this.ratio;
      this.stroke([[x, y - end], [x, y + end]], this.ink.truth, 1.2);
      this.stroke([[x, y], [x + wide, y]], this.ink.truth, 1.2);
      this.stroke([[x + wide, y - end], [x + wide, y + end]], this.ink.truth, 1.2);
      this.pen.font = `${12 * this.ratio}px system-ui, sans-serif`;
      this.pen.fillStyle = this.ink.truth;
      this.pen.fillText(length(long, this.data.metres), x + wide + 7 * this.ratio, y + 4 * this.ratio);
    }
  }

  for (const root of document.querySelectorAll(".space")) new Space(root);
  // A link to a query opens it.
  const open = () => { const at = document.getElementById(location.hash.slice(1)); if (at && at.tagName === "DETAILS") at.open = true; };
  addEventListener("hashchange", open);
  open();
})();
