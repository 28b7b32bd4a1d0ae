// Shared code of the browser tests: starts services, records requests in a proxy, compares seals of browser and native program, and
// checks all requests.
import { execFileSync, spawn } from "node:child_process";
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import http from "node:http";
import { createRequire } from "node:module";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

import { exifSegment } from "./exif.mjs";

export const root = fileURLToPath(new URL("../..", import.meta.url));

const { values: given } = parseArgs({
  options: {
    veiloc: { type: "string" }, native: { type: "string" }, tools: { type: "string" }, out: { type: "string" },
    browser: { type: "string" }, place: { type: "string" }, demo: { type: "string" }, seals: { type: "string" },
  },
});
export { given };
export const out = path.resolve(given.out ?? "out/web");
/** The demo's folder. */
export const place = given.place ?? path.join(out, "demo");
rmSync(path.join(out, "sent"), { recursive: true, force: true });
for (const folder of ["sent", "screens"]) mkdirSync(path.join(out, folder), { recursive: true });

/** A package of `--tools`. */
export const tool = createRequire(path.resolve(given.tools, "x.js"));
const veiloc = path.resolve(given.veiloc);
const pageFolder = path.join(root, "bindings/web/page");

let wrong = 0;
export const check = (what, holds, more = "") => {
  if (!holds) wrong += 1;
  console.log(`${holds ? "ok   " : "WRONG"} ${what}${more ? `: ${more}` : ""}`);
};

export const closing = [];

/** Runs a script, closes its resources, and exits with 1 if a check failed. */
export async function run(main) {
  try {
    await main();
  } catch (error) {
    check("the script ended without an exception", false, error.stack);
  }
  for (const close of closing.reverse()) await close();
  if (wrong) console.log(`${wrong} checks failed`);
  process.exit(wrong ? 1 : 0);
}

/** Starts a service; resolves with the address that it prints. */
export function serve(...args) {
  const child = spawn(veiloc, args, { cwd: root, stdio: ["ignore", "pipe", "pipe"] });
  closing.push(() => child.kill("SIGINT"));
  return new Promise((done, fail) => {
    let output = "";
    const listen = (data) => {
      output += data;
      const address = output.match(/(?:is|serving \S+) on (http:\/\/\S+)/);
      if (address) done(address[1]);
    };
    child.stdout.on("data", listen);
    child.stderr.on("data", listen);
    child.on("exit", (code) => fail(new Error(`veiloc ${args[0]} ended with ${code}: ${output.slice(-2000)}`)));
  });
}

/** Starts the demo with its page: its address, its example images, and the file of its map's profile. */
export async function demo() {
  const address = given.demo ?? await serve("demo", "--page", "--page-folder", pageFolder, "--listen", "127.0.0.1:0", "--out", place);
  const profile = path.join(out, "demo.vprofile");
  writeFileSync(profile, Buffer.from(await (await fetch(`${address}/v1/maps/demo/profile`)).arrayBuffer()));
  const { views } = await (await fetch(`${address}/page/page.json`)).json();
  return { address, views, profile };
}

/** Starts a service that requires a token, with the demo's map; returns its address and the token. */
export async function serveWithToken() {
  const tokens = path.join(out, "tokens");
  rmSync(tokens, { force: true });
  const token = execFileSync(veiloc, ["token", "new", "phone", "--tokens", tokens, "--maps", "place", "--link", "http://localhost"], { encoding: "utf8" }).match(/#token=(\S+)/)[1];
  const map = path.join(place, "place.vmap");
  const address = await serve("serve", "--map", `place=${map}`, "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--tokens", tokens, "--page", "--page-folder", pageFolder, "--answer-quantum", "0", "--log", "off");
  return { address, token };
}

/** A proxy between browser and service that records all requests in `seen`. It answers requests for `files` itself. */
export async function recordingProxy(service, seen, files = () => null) {
  const { hostname, port } = new URL(service);
  const proxy = http.createServer((request, response) => {
    const file = files(request.url);
    if (file) {
      const type = { html: "text/html", js: "text/javascript", wasm: "application/wasm", json: "application/json" }[file.split(".").pop()];
      response.writeHead(200, { "content-type": type });
      return response.end(readFileSync(file));
    }
    const parts = [];
    request.on("data", (part) => parts.push(part));
    request.on("end", () => {
      const body = Buffer.concat(parts);
      const entry = { method: request.method, url: request.url, headers: request.headers, body };
      seen.push(entry);
      const forwarded = http.request({ hostname, port, method: request.method, path: request.url, headers: request.headers }, (reply) => {
        Object.assign(entry, { status: reply.statusCode, encoding: reply.headers["content-encoding"], length: Number(reply.headers["content-length"] ?? 0) });
        response.writeHead(reply.statusCode, reply.headers);
        reply.pipe(response);
      });
      forwarded.on("error", () => response.destroy());
      forwarded.end(body);
    });
  });
  await new Promise((done) => proxy.listen(0, "127.0.0.1", done));
  closing.push(() => { proxy.close(); proxy.closeAllConnections(); });
  return `http://127.0.0.1:${proxy.address().port}/`;
}

/** In the page: the size of the bitmap of a JPEG of 64 x 48 pixels with this segment. */
async function storedSize(segment) {
  const { storedBitmap } = await import("/page/index.js");
  const canvas = new OffscreenCanvas(64, 48);
  canvas.getContext("2d").fillRect(8, 8, 20, 10);
  const jpeg = new Uint8Array(await (await canvas.convertToBlob({ type: "image/jpeg" })).arrayBuffer());
  const { width, height } = await storedBitmap(new Blob([jpeg.subarray(0, 2), Uint8Array.from(segment), jpeg.subarray(2)], { type: "image/jpeg" }));
  return { width, height };
}

/** In the page: keypoints of a view, of the view under a mask, and of another view under it that differs only there. */
async function maskedInPage(view) {
  const { Client, load, storedBitmap } = await import("/page/index.js");
  const bitmap = await storedBitmap(await (await fetch(`/page/${view.file}`)).blob());
  const { width, height } = bitmap;
  const context = new OffscreenCanvas(width, height).getContext("2d");
  context.drawImage(bitmap, 0, 0);
  const image = context.getImageData(0, 0, width, height);
  const other = new ImageData(image.data.slice(), width, height);
  // MediaPipe's confidences, at a twentieth of the size: the middle of the view.
  const mask = { width: 20, height: 15, data: new Float32Array(300), kind: "confidence" };
  for (let y = 5; y < 12; y += 1) for (let x = 6; x < 14; x += 1) mask.data[20 * y + x] = 0.9;
  for (let y = 0; y < height; y += 1) {
    for (let x = 0; x < width; x += 1) {
      if (!mask.data[20 * Math.floor((15 * y) / height) + Math.floor((20 * x) / width)]) continue;
      for (let c = 0; c < 3; c += 1) other.data[4 * (width * y + x) + c] ^= 255;
    }
  }
  const device = await load(await new Client(location.origin).profile("demo"));
  const sealer = await device.sealer();
  const count = async (pixels, facts) => (await sealer.extract(pixels, view.camera, facts)).keypoints;
  const counts = [await count(image), await count(image, { mask }), await count(other, { mask })];
  const refused = await sealer.extract(image, view.camera, { mask: { ...mask, kind: "unknown" } }).catch((error) => error.kind);
  device.close();
  return { counts, refused };
}

/** In the page: seals a view six times with given random bytes; returns the hash of the bytes, and milliseconds of the fastest run. */
async function sealInPage({ view, seed }) {
  const { Core } = await import("/page/core.js");
  const core = await Core.load(fetch("/page/veiloc.wasm"));
  const profile = new Uint8Array(await (await fetch("/v1/maps/demo/profile")).arrayBuffer());
  const { head: stored } = core.call({ op: "profile" }, profile);
  const { sealer } = core.call({ op: "sealer", profile: stored.profile }, new Uint8Array()).head;
  const blob = await (await fetch(`/page/${view.file}`)).blob();
  const { storedBitmap } = await import("/page/index.js");
  const bitmap = await storedBitmap(blob);
  const { width, height } = bitmap;
  const context = new OffscreenCanvas(width, height).getContext("2d");
  context.drawImage(bitmap, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  let best = Infinity;
  let sealed;
  for (let round = 0; round < 6; round += 1) {
    const began = performance.now();
    const { extracted } = core.call({ op: "extract", sealer, width, height, camera: view.camera }, data).head;
    sealed = core.call({ op: "seal", sealer, extracted }, Uint8Array.from(seed));
    best = Math.min(best, performance.now() - began);
  }
  const hash = await crypto.subtle.digest("SHA-256", sealed.bytes);
  return { best, rows: sealed.head.rows, hash: [...new Uint8Array(hash)] };
}

/** With `--seals N`, compares seals N times; returns whether the option is given. */
export async function onlySeals(page, views, profile) {
  const medians = [];
  for (let run = 0; run < Number(given.seals ?? 0); run += 1) medians.push(await sealsAreEqual(page, views, profile));
  if (medians.length) console.log(`     medians: ${medians.map((each) => each.toFixed(2)).join(", ")}`);
  return medians.length > 0;
}

/** Checks that browser and native program seal views to the same bytes; returns the median ratio of their times. */
export async function sealsAreEqual(page, views, profile) {
  console.log("== a photograph that is stored rotated");
  const size = await page.evaluate(storedSize, exifSegment(26, 6));
  check("the EXIF orientation is not applied", size.width === 64 && size.height === 48, `${size.width} x ${size.height}`);
  console.log("== a mask of people");
  const { counts: [whole, masked, changed], refused } = await page.evaluate(maskedInPage, views[0]);
  check("nothing under a mask is used", masked === changed && masked < whole && masked > 0, `${whole} keypoints, ${masked} and ${changed} under it`);
  check("an unknown kind of mask is refused", refused === "option", refused);
  console.log("== seals of the browser and of the native program");
  const ratios = [];
  for (const [index, view] of views.entries()) {
    const seed = createHash("sha256").update(view.file).digest();
    const file = path.join(out, `native-${index}.vquery`);
    const image = path.join(place, "images", view.file);
    const native = (threads) => Number(execFileSync(given.native, ["seal", image, view.camera, profile, seed.toString("hex"), file, "5"], { encoding: "utf8", env: { ...process.env, ...(threads && { RAYON_NUM_THREADS: threads }) } }));
    const [all, one] = [native(""), native("1")];
    const own = await page.evaluate(sealInPage, { view, seed: [...seed] });
    const same = createHash("sha256").update(readFileSync(file)).digest().equals(Buffer.from(own.hash));
    ratios.push(own.best / all);
    check(`${view.file}: the same ${own.rows} rows`, same, `browser ${own.best.toFixed(0)} ms, native ${all.toFixed(0)} ms (one thread ${one.toFixed(0)} ms)`);
  }
  const ratio = ratios.sort((a, b) => a - b)[ratios.length >> 1];
  console.log(`     browser / native, median: ${ratio.toFixed(2)} of ${ratios.map((each) => each.toFixed(2)).join(", ")}`);
  return ratio;
}

/** In the page, while the graph attack runs on a camera image: counts how often "Leaves this device" is drawn meanwhile. */
export function drawnWhileAttacking() {
  return new Promise((done) => {
    const attack = document.getElementById("attack-text");
    const isAttacking = () => attack.textContent.startsWith("The attack is running");
    let drawn = 0;
    const leaves = new MutationObserver(() => {
      if (isAttacking()) drawn += 1;
    });
    leaves.observe(document.getElementById("leaves-text"), { childList: true });
    const began = isAttacking();
    const end = new MutationObserver(() => {
      if (isAttacking()) return;
      for (const observer of [leaves, end]) observer.disconnect();
      done({ began, drawn, text: attack.textContent });
    });
    end.observe(attack, { childList: true });
  });
}

// Headers that browsers send by default or that HTTP needs.
const HEADERS = new Set(["host", "connection", "user-agent", "accept", "accept-encoding", "accept-language", "content-type", "content-length", "origin", "authorization", "cache-control", "pragma", "priority", "if-none-match", "upgrade-insecure-requests"]);

/**
 * Checks all requests, as the server received them (`all`) and as the browser reports them (`tried`): they go to `own` addresses
 * only, and each body is a sealed query of the profile.
 */
export function checkRequests(all, tried, own, profile) {
  console.log("== all requests");
  const files = [];
  for (const { method, url, headers, body } of all) {
    const known = /^\/$|^\/page\/[\w.-]+$|^\/page\/points\/\w+$|^\/v1\/maps$|^\/v1\/maps\/\w+\/(profile|localize|anchors)$/.test(url);
    if (!known) check("only resources of the service are requested", false, `${method} ${url}`);
    const odd = Object.keys(headers).filter((name) => !HEADERS.has(name) && !name.startsWith("sec-"));
    if (odd.length) check("no additional headers", false, `${url}: ${odd.join(" ")}`);
    if (method === "POST" && url.endsWith("/localize")) {
      const file = path.join(out, "sent", `${files.length}.vquery`);
      writeFileSync(file, body);
      files.push(file);
    } else if (method !== "GET" || body.length) check("requests other than queries have no body", false, `${method} ${url}`);
  }
  const queries = execFileSync(given.native, ["check", profile, ...files], { encoding: "utf8" }).trim().split("\n");
  check(`${all.length} requests, ${queries.length} of them with a body`, queries.length === files.length, `each a sealed query of the map: ${[...new Set(queries)].sort().join(", ")}`);
  const strange = [...new Set(tried)].filter((url) => !own.some((base) => url.startsWith(base)) && !/^(blob|data):/.test(url));
  check("the browser contacts no other server", strange.length === 0, strange.join(" "));
  const pageFiles = all.filter(({ url, method }) => method === "GET" && (url === "/" || url.startsWith("/page/")) && !url.startsWith("/page/points"));
  const cached = pageFiles.filter(({ status }) => status === 304).length;
  console.log(`     files of the page: ${pageFiles.length} requests, ${cached} of them from the cache (304)`);
  writeFileSync(path.join(out, "requests.json"), JSON.stringify(all.map(({ headers, body, ...rest }) => ({ ...rest, headers: Object.keys(headers), bytes: body.length })), null, 1));
  return queries.length;
}
