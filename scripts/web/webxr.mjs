// The sample examples/web/webxr in Chromium, with an emulated AR device (npm's iwer) that shows recorded frames: how far the placed object is
// from its true place, at each frame before its own answer.
//
//     npm install --prefix TOOLS playwright-core@1 iwer@2 three@0.170
//     node scripts/web/webxr.mjs --veiloc target/release/veiloc --tools TOOLS --map PLACE.vmap --images DIR --posed DIR --out DIR
//
// `--posed`: COLMAP text model with the true poses. `--tracked`: one with the poses of the device's own tracking, which the AR world is made of
// (default: the true ones). `--list`: names of the frames, in the order of the walk. `--down X,Y,Z`: gravity in these poses (default: what is
// down in the images on average). `--anchor X,Y,Z`: place of the object (default: 2 m in front of the first frame). `--unit`: metres of a unit
// of the map, where it does not know them. `--csv FILE` writes a row for each frame. The emulator has no camera, so the script adds
// `view.camera` and its image; the projection is that of the frame's camera. Images with OPENCV's distortion are undistorted.
import { spawn } from "node:child_process";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import http from "node:http";
import { createRequire } from "node:module";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

const { values: given } = parseArgs({
  options: Object.fromEntries(["veiloc", "tools", "map", "images", "posed", "tracked", "list", "down", "anchor", "unit", "out", "csv"].map((name) => [name, { type: "string" }])),
});
const root = fileURLToPath(new URL("../..", import.meta.url));
const tools = path.resolve(given.tools);
const { chromium } = createRequire(path.join(tools, "x.js"))("playwright-core");

// Poses: `x_cam = R x + t`.
const times = ([a, b, c, d], [e, f, g, h]) => [a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g, a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e];
const conjugate = ([w, x, y, z]) => [w, -x, -y, -z];
const rotate = (q, v) => times(times(q, [0, ...v]), conjugate(q)).slice(1);
const plus = (a, b) => a.map((x, i) => x + b[i]);
const minus = (a, b) => a.map((x, i) => x - b[i]);
const scaled = (a, s) => a.map((x) => x * s);
const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const unit = (v) => scaled(v, 1 / Math.hypot(...v));
const center = ({ q, t }) => scaled(rotate(conjugate(q), t), -1);

function model(folder) {
  const lines = (file) => readFileSync(path.join(folder, file), "utf8").split("\n").filter((line) => line && !line.startsWith("#")).map((line) => line.split(" "));
  const cameras = new Map(lines("cameras.txt").map(([id, name, ...numbers]) => [id, [name, ...numbers.map(Number)]]));
  const images = lines("images.txt").filter((words) => words.length === 10 && !Number.isFinite(Number(words[9])));
  return new Map(images.map((words) => [words[9], { q: words.slice(1, 5).map(Number), t: words.slice(5, 8).map(Number), camera: cameras.get(words[8]) }]));
}

const truth = model(given.posed);
const tracked = given.tracked ? model(given.tracked) : truth;
const names = given.list ? readFileSync(given.list, "utf8").split("\n").map((line) => line.trim()).filter(Boolean) : [...truth.keys()].sort();
// The AR world: y up, rotated and shifted against the poses.
const down = unit(given.down ? given.down.split(",").map(Number) : names.map((name) => rotate(conjugate(truth.get(name).q), [0, 1, 0])).reduce(plus));
const half = unit(plus(scaled(down, -1), [0, 1, 0]));
const up = Math.abs(half[1]) > 1e-6 ? [dot(half, scaled(down, -1)), ...[[1, 2], [2, 0], [0, 1]].map(([i, j]) => -down[i] * half[j] + down[j] * half[i])] : [0, 1, 0, 0];
const world = { q: times([Math.cos(0.5), 0, Math.sin(0.5), 0], up), t: [1.5, 0.2, -3] };
const toWorld = (p) => plus(rotate(world.q, p), world.t);
const frames = names.map((name) => {
  const { q, t } = tracked.get(name);
  const [kind, width, height, ...params] = truth.get(name).camera;
  if (!["SIMPLE_PINHOLE", "PINHOLE", "OPENCV"].includes(kind)) throw new Error(`${name}: the camera is ${kind}; known are PINHOLE and OPENCV`);
  const [fx, fy, cx, cy, ...distortion] = kind === "SIMPLE_PINHOLE" ? [params[0], ...params] : params;
  // From COLMAP's axes of a camera to OpenGL's: half a turn about x.
  const orientation = times(times(world.q, conjugate(q)), [0, 1, 0, 0]);
  return { name, width, height, fx, fy, cx, cy, distortion, position: toWorld(center({ q, t })), orientation };
});
const first = truth.get(names[0]);
const anchor = given.anchor ? given.anchor.split(",").map(Number) : plus(center(first), rotate(conjugate(first.q), [0, 0, 2]));

/** In the page before its scripts: an AR device whose frames are recorded. */
function emulate() {
  const config = {
    name: "recorded frames", controllerConfig: undefined, supportedSessionModes: ["inline", "immersive-ar"], supportedFeatures: ["viewer", "local", "camera-access"],
    supportedFrameRates: [60], isSystemKeyboardSupported: false, internalNominalFrameRate: 60, environmentBlendModes: { "immersive-ar": "alpha-blend" },
    interactionMode: "screen-space", userAgent: navigator.userAgent,
  };
  const device = new IWER.XRDevice(config, { ipd: 0, stereoEnabled: false });
  device.installRuntime({ forceInstall: true });
  let shown = null;
  let isTaken = false;
  /** The image without distortion, as WebXR gives it: of the nearest pixels. */
  function undistorted(image, { width, height, fx, fy, cx, cy, distortion: [k1, k2, p1, p2] }) {
    const canvas = new OffscreenCanvas(width, height);
    const context = canvas.getContext("2d");
    context.drawImage(image, 0, 0);
    if (!k1) return canvas;
    const [from, to] = [0, 1].map(() => context.getImageData(0, 0, width, height));
    const [source, target] = [from, to].map(({ data }) => new Uint32Array(data.buffer));
    for (let i = 0; i < target.length; i += 1) {
      const [x, y] = [((i % width) + 0.5 - cx) / fx, (Math.floor(i / width) + 0.5 - cy) / fy];
      const [r, xy] = [x * x + y * y, x * y];
      const radial = 1 + k1 * r + k2 * r * r;
      const u = Math.floor(fx * (x * radial + 2 * p1 * xy + p2 * (r + 2 * x * x)) + cx);
      const v = Math.floor(fy * (y * radial + 2 * p2 * xy + p1 * (r + 2 * y * y)) + cy);
      target[i] = u >= 0 && v >= 0 && u < width && v < height ? source[v * width + u] : 0xff000000;
    }
    context.putImageData(to, 0, 0);
    return canvas;
  }
  globalThis.show = async (frame, url) => {
    const options = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
    const stored = await createImageBitmap(await (await fetch(url)).blob(), options);
    const bitmap = await createImageBitmap(undistorted(stored, frame), { ...options, imageOrientation: "flipY" });
    device.position.set(...frame.position);
    const [w, x, y, z] = frame.orientation;
    device.quaternion.set(x, y, z, w);
    [shown, isTaken] = [{ ...frame, bitmap }, false];
    device.canvasContainer.style.background = `url(${url}) 0 0 / 100% 100%`;
  };
  Object.defineProperty(XRView.prototype, "camera", {
    get() {
      // The page's space is not the emulator's: it begins at the height of a head.
      const { x, y, z } = this.transform.position;
      globalThis.believed = [x, y, z];
      if (this.ofFrame === undefined) this.ofFrame = shown && !isTaken ? { width: shown.width, height: shown.height } : null;
      return this.ofFrame;
    },
  });
  Object.defineProperty(XRView.prototype, "projectionMatrix", {
    get() {
      const { width: w = 2, height: h = 2, fx = 1, fy = 1, cx = 1, cy = 1 } = shown ?? {};
      const [near, far] = [0.1, 100];
      return new Float32Array([(2 * fx) / w, 0, 0, 0, 0, (2 * fy) / h, 0, 0, 1 - (2 * cx) / w, (2 * cy) / h - 1, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0]);
    },
  });
  const constructor = XRWebGLBinding;
  globalThis.XRWebGLBinding = class extends constructor {
    constructor(session, gl) {
      super(session, gl);
      this.gl = gl;
    }
    getCameraImage() {
      const { gl } = this;
      this.texture ??= gl.createTexture();
      const bound = gl.getParameter(gl.TEXTURE_BINDING_2D);
      gl.bindTexture(gl.TEXTURE_2D, this.texture);
      // The bitmap is upside down already: WebGL's first row is the lowest.
      gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, shown.bitmap);
      gl.bindTexture(gl.TEXTURE_2D, bound);
      isTaken = true;
      return this.texture;
    }
  };
}

const serve = (folder) => (name) => path.join(folder, path.normalize(`/${name}`));
const mounts = [["/node_modules/three/", serve(path.join(tools, "node_modules/three"))], ["/node_modules/veiloc/", serve(path.join(root, "bindings/web"))],
  ["/frames/", serve(path.resolve(given.images))], ["/", serve(path.join(root, "examples/web/webxr"))]];
const types = { ".html": "text/html", ".js": "text/javascript", ".wasm": "application/wasm" };
const pages = http.createServer((request, response) => {
  const name = decodeURIComponent(new URL(request.url, "http://here").pathname);
  const [mount, file] = mounts.find(([mount]) => name.startsWith(mount));
  const asked = file(name.slice(mount.length) || "index.html");
  try {
    const bytes = readFileSync(asked);
    response.writeHead(200, { "content-type": types[path.extname(asked)] ?? "application/octet-stream" }).end(bytes);
  } catch {
    response.writeHead(404).end();
  }
});
await new Promise((ready) => pages.listen(0, "127.0.0.1", ready));
const origin = `http://127.0.0.1:${pages.address().port}`;

const service = spawn(path.resolve(given.veiloc), ["serve", "--map", `place=${path.resolve(given.map)}`, "--listen", "127.0.0.1:0", "--answer-quantum", "0", "--log", "off", "--cors-origin", origin], { env: { ...process.env, NO_COLOR: "1" } });
const address = await new Promise((resolve, reject) => {
  let log = "";
  const read = (data) => {
    log += data;
    const found = /serving \S+ on +(http:\/\/[\w.]+:\d+)/.exec(log);
    if (found) resolve(found[1]);
  };
  service.stdout.on("data", read);
  service.stderr.on("data", read);
  service.on("exit", () => reject(new Error(log)));
});

const rows = [["frame", "state", "used", "object off by (m)", "by the first answer alone (m)", "what happened"]];
const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
let failed = false;
try {
  const page = await browser.newPage({ viewport: { width: 2 * frames[0].width, height: 2 * frames[0].height } });
  page.on("pageerror", (error) => { console.log(`FAIL error in the page: ${error.message}`); failed = true; });
  await page.addInitScript({ path: path.join(tools, "node_modules/iwer/build/iwer.min.js") });
  await page.addInitScript(emulate);
  await page.goto(`${origin}/?service=${address}&map=place&interval=0&anchor=${anchor.join(",")}${given.unit ? `&unit=${given.unit}` : ""}`);
  await page.waitForSelector("#start:enabled", { timeout: 60_000 });
  await page.locator("#start").click();
  mkdirSync(given.out, { recursive: true });
  let alone = null;
  for (const [i, frame] of frames.entries()) {
    // What the user sees of a frame comes from the answers before it.
    const placed = await page.evaluate(() => (object.visible ? object.position.toArray() : null));
    alone ??= placed;
    await page.evaluate(([frame, url]) => show(frame, url), [frame, `/frames/${frame.name}`]);
    const { q, t } = truth.get(frame.name);
    await page.waitForFunction((count) => Number(document.getElementById("state").dataset.images ?? 0) >= count, i + 1, { timeout: 60_000 });
    const [state, used, text, believed] = await page.evaluate(() => [alignment.state, alignment.used, document.getElementById("state").value, believed]);
    // Where it should be: its true place relative to this camera, by the pose that the device believes.
    const seen = plus(rotate(q, anchor), t);
    const expected = plus(rotate(times(frame.orientation, [0, 1, 0, 0]), seen), believed);
    const off = (at) => (at ? Math.hypot(...minus(at, expected)).toFixed(4) : "");
    if (i % 10 === 9 || i + 1 === frames.length) {
      await page.waitForTimeout(100);
      await page.screenshot({ path: path.join(given.out, `${path.parse(frame.name).name}.png`) });
    }
    rows.push([frame.name, state, used, off(placed), off(alone), text.replaceAll(/[,\n]/g, ";")]);
    console.log(rows.at(-1).join("  "));
  }
} finally {
  await browser.close();
  service.kill();
  pages.close();
}
const quantile = (column, share) => {
  const values = rows.slice(1).map((row) => row[column]).filter((text) => text !== "").map(Number).sort((a, b) => a - b);
  return values.length ? values[Math.min(values.length - 1, Math.floor(share * values.length))] : Number.NaN;
};
console.log(`${frames.length} frames; object off by ${quantile(3, 0.5)} m in the median, ${quantile(3, 0.9)} at 90 %, ${quantile(3, 1)} at most; by the first answer alone ${quantile(4, 0.5)}, ${quantile(4, 0.9)}, ${quantile(4, 1)}`);
if (given.csv) writeFileSync(given.csv, `${rows.map((row) => row.join(",")).join("\n")}\n`);
// The object must have been placed for most of the walk, and near.
const seen = rows.slice(1).filter((row) => row[3] !== "").length;
if (failed || seen < 0.7 * frames.length || quantile(3, 0.5) > 0.1) {
  console.log(`FAIL the object was placed in ${seen} of ${frames.length} frames`);
  process.exit(1);
}
