// The page and the npm package in a real browser, driven by playwright-core: Chromium, and its fake camera.
//
//     node scripts/web_browser.mjs --veiloc target/release/veiloc --native target/release/native --tools DIR --out DIR
//
// With `--demo ADDRESS --place DIR` a demo that runs already, and its folder, are used.
//
// `--tools`: a folder in which playwright-core is installed (`npm install --prefix DIR playwright-core`); `--chromium`: the browser
// (default /usr/bin/chromium). The page is `bindings/web/page`, as bindings/web/build.sh makes it. What is held:
//
// 1. A browser seals what a native program seals of the same image, camera and random bytes, to the bit; milliseconds of both.
// 2. Every request of a session, as the server's side got them and as the browser tells them: to its own server alone, and of
//    what is sent nothing but sealed queries of the map's profile (`native check`); no cookie, no referrer, no query string.
// 3. Hidden views, the camera, following, a session of held frames, an image of nowhere, a service that asks for a token:
//    each as a user meets it, with screenshots (light and dark, wide and narrow), by keyboard where that is the point.
import { spawn, execFileSync } from "node:child_process";
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import http from "node:http";
import { createRequire } from "node:module";
import path from "node:path";
import { parseArgs } from "node:util";

const { values: given } = parseArgs({
  options: {
    veiloc: { type: "string" }, native: { type: "string" }, tools: { type: "string" }, out: { type: "string" },
    chromium: { type: "string", default: "/usr/bin/chromium" }, place: { type: "string" }, demo: { type: "string" },
  },
});
const root = path.resolve(import.meta.dirname, "..");
const out = path.resolve(given.out ?? "out/web");
const { chromium } = createRequire(path.resolve(given.tools, "x.js"))("playwright-core");
rmSync(path.join(out, "sent"), { recursive: true, force: true });
for (const folder of ["sent", "screens"]) mkdirSync(path.join(out, folder), { recursive: true });

let wrong = 0;
const check = (what, holds, more = "") => {
  if (!holds) wrong += 1;
  console.log(`${holds ? "ok   " : "WRONG"} ${what}${more ? `: ${more}` : ""}`);
};
const closing = [];

/** A program that serves; resolves with the address it names. */
function serve(...args) {
  const child = spawn(path.resolve(given.veiloc), args, { cwd: root, stdio: ["ignore", "pipe", "pipe"] });
  closing.push(() => child.kill("SIGINT"));
  return new Promise((done, fail) => {
    let said = "";
    const listen = (data) => {
      said += data;
      const address = said.match(/(?:is|serving \S+) on (http:\/\/\S+)/);
      if (address) done(address[1]);
    };
    child.stdout.on("data", listen);
    child.stderr.on("data", listen);
    child.on("exit", (code) => fail(new Error(`veiloc ${args[0]} ended with ${code}: ${said.slice(-2000)}`)));
  });
}

/** What the browser talks to: passes everything on to the service, and keeps what it was sent. `files` it answers itself. */
async function between(service, seen, files = () => null) {
  const { hostname, port } = new URL(service);
  const proxy = http.createServer((request, response) => {
    const file = files(request.url);
    if (file) {
      const type = { html: "text/html", js: "text/javascript", wasm: "application/wasm" }[file.split(".").pop()];
      response.writeHead(200, { "content-type": type });
      return response.end(readFileSync(file));
    }
    const parts = [];
    request.on("data", (part) => parts.push(part));
    request.on("end", () => {
      const body = Buffer.concat(parts);
      seen.push({ method: request.method, url: request.url, headers: request.headers, body });
      const on = http.request({ hostname, port, method: request.method, path: request.url, headers: request.headers }, (reply) => {
        response.writeHead(reply.statusCode, reply.headers);
        reply.pipe(response);
      });
      on.on("error", () => response.destroy());
      on.end(body);
    });
  });
  await new Promise((done) => proxy.listen(0, "127.0.0.1", done));
  closing.push(() => { proxy.close(); proxy.closeAllConnections(); });
  return `http://127.0.0.1:${proxy.address().port}/`;
}

async function browse(extra = []) {
  const browser = await chromium.launch({
    executablePath: given.chromium,
    args: ["--no-sandbox", "--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream", ...extra],
  });
  closing.push(() => browser.close());
  return browser;
}

/** A page whose every request, console line and policy violation is kept. */
async function open(browser, address, tried, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 900 }, permissions: ["camera"], ...options });
  context.on("request", (request) => tried.push(request.url()));
  const page = await context.newPage();
  page.on("console", (line) => line.type() === "error" && console.log(`     console: ${line.text()}`));
  page.on("pageerror", (error) => check("no error in the page", false, error.message));
  await page.goto(address);
  return page;
}

/** Screenshots of a state: light and dark, wide and narrow. */
async function screens(page, state) {
  for (const colorScheme of ["light", "dark"]) {
    for (const [name, width, height] of [["wide", 1280, 900], ["narrow", 390, 844]]) {
      await page.emulateMedia({ colorScheme });
      await page.setViewportSize({ width, height });
      await page.waitForTimeout(150);
      const across = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      check(`${state}, ${name}: nothing sticks out`, across <= 0, across > 0 ? `${across} px` : "");
      await page.screenshot({ path: path.join(out, "screens", `${state}-${colorScheme}-${name}.png`), fullPage: true });
    }
  }
  await page.emulateMedia({ colorScheme: "light" });
  await page.setViewportSize({ width: 1280, height: 900 });
}

const answered = (page, state, timeout = 30_000) =>
  page.waitForFunction((state) => document.getElementById("answer").dataset.state === state, state, { timeout });

async function main() {
  const demo = given.demo ?? await serve("demo", "--page", "--page-folder", path.join(root, "bindings/web/page"), "--listen", "127.0.0.1:0", "--out", given.place ?? path.join(out, "demo"));
  const [seen, tried] = [[], []];
  const address = await between(demo, seen);
  const profile = path.join(out, "demo.vprofile");
  writeFileSync(profile, Buffer.from(await (await fetch(`${demo}/v1/maps/demo/profile`)).arrayBuffer()));
  const { views } = await (await fetch(`${demo}/page/page.json`)).json();

  const browser = await browse();
  const page = await open(browser, address, tried);
  await page.waitForFunction(() => document.getElementById("sent").children.length >= 3);
  await screens(page, "begin");

  console.log("== seals in the browser and natively");
  const ratios = [];
  for (const [index, view] of views.slice(0, 4).entries()) {
    const seed = createHash("sha256").update(view.file).digest();
    const file = path.join(out, `native-${index}.vquery`);
    const image = path.join(given.place ?? path.join(out, "demo"), "images", view.file);
    const native = (threads) => Number(execFileSync(given.native, ["seal", image, view.camera, profile, seed.toString("hex"), file, "5"], { encoding: "utf8", env: { ...process.env, ...(threads && { RAYON_NUM_THREADS: threads }) } }));
    const [all, one] = [native(""), native("1")];
    const own = await page.evaluate(async ({ view, seed }) => {
      const { Core } = await import("/page/core.js");
      const core = await Core.load(fetch("/page/veiloc.wasm"));
      const profile = new Uint8Array(await (await fetch("/v1/maps/demo/profile")).arrayBuffer());
      const { head: kept } = core.call({ op: "profile" }, profile);
      const blob = await (await fetch(`/page/${view.file}`)).blob();
      const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
      const { width, height } = bitmap;
      const context = new OffscreenCanvas(width, height).getContext("2d");
      context.drawImage(bitmap, 0, 0);
      const { data } = context.getImageData(0, 0, width, height);
      let best = Infinity;
      let sealed;
      for (let round = 0; round < 6; round += 1) {
        const began = performance.now();
        sealed = core.call({ op: "seal", profile: kept.profile, width, height, camera: view.camera }, Uint8Array.from(seed), data);
        best = Math.min(best, performance.now() - began);
      }
      const hash = await crypto.subtle.digest("SHA-256", sealed.bytes);
      return { best, rows: sealed.head.rows, hash: [...new Uint8Array(hash)] };
    }, { view, seed: [...seed] });
    const same = createHash("sha256").update(readFileSync(file)).digest().equals(Buffer.from(own.hash));
    ratios.push(own.best / all);
    check(`${view.file}: the same ${own.rows} rows`, same, `browser ${own.best.toFixed(0)} ms, native ${all.toFixed(0)} ms (one thread ${one.toFixed(0)} ms)`);
  }
  const ratio = ratios.sort((a, b) => a - b)[ratios.length >> 1];
  console.log(`     browser / native, median: ${ratio.toFixed(2)}`);

  console.log("== a hidden view, by keyboard");
  await page.locator("#views button").first().focus();
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => document.getElementById("attack-text").textContent.includes("px"), undefined, { timeout: 30_000 });
  check("nothing is sent before it is asked for", seen.every((request) => request.method === "GET"));
  await screens(page, "sealed");
  // The layout of the graph takes seconds; of fewer keypoints fewer.
  await page.locator("#settings summary").click();
  await page.locator("#most").selectOption("512");
  await page.waitForFunction(() => document.getElementById("leaves-text").textContent.startsWith("512"), undefined, { timeout: 30_000 });
  for (const attack of ["closed-form", "closed-form-informed", "graph", "prior"]) {
    const before = await page.locator("#attack-text").textContent();
    await page.locator("#attack").selectOption(attack);
    await page.waitForFunction((before) => document.getElementById("attack-text").textContent !== before && !document.getElementById("attack-text").textContent.includes("seconds"), before, { timeout: 240_000 });
    console.log(`     ${attack}: ${(await page.locator("#attack-text").textContent()).trim()}`);
    if (attack === "graph") await page.locator(".figures").screenshot({ path: path.join(out, "screens", "graph.png") });
  }
  await page.locator("#most").selectOption("");
  await page.waitForFunction(() => document.getElementById("leaves-text").textContent.startsWith("2,048") && !document.getElementById("find").disabled, undefined, { timeout: 60_000 });
  await page.locator("#settings summary").click();
  await page.locator("#find").focus();
  await page.keyboard.press("Enter");
  await answered(page, "trusted");
  console.log(`     ${await page.locator("#answer").textContent()}`);
  await page.locator("#map-view").focus();
  for (const key of ["ArrowLeft", "ArrowLeft", "ArrowDown", "+"]) await page.keyboard.press(key);
  await screens(page, "found");
  await page.locator("#settings summary").click();
  for (const scheme of ["random-lines", "coordinate-permutation", "dcl"]) {
    const before = await page.locator("#attack-text").textContent();
    await page.locator("#scheme").selectOption(scheme);
    await page.waitForFunction((before) => document.getElementById("attack-text").textContent !== before && !document.getElementById("find").disabled, before, { timeout: 30_000 });
    await page.locator(".figures").screenshot({ path: path.join(out, "screens", `scheme-${scheme}.png`) });
    await page.locator("#find").click();
    await page.waitForFunction(() => !document.getElementById("find").disabled, undefined, { timeout: 30_000 });
    const told = await page.locator("#answer").textContent();
    check(`sealed as ${scheme}`, /^You are at|not sure/i.test(told), told);
  }
  await page.locator("#settings summary").click();
  const names = await page.evaluate(() => [...document.querySelectorAll("button, input, select, canvas")].filter((e) => {
    const label = e.labels?.length || e.textContent.trim() || e.getAttribute("aria-label") || e.querySelector("img")?.alt;
    return !label;
  }).map((e) => e.id));
  check("everything to press or look at has a name", names.length === 0, names.join(" "));

  console.log("== an image of nowhere");
  const noise = await page.evaluate(async () => {
    const canvas = new OffscreenCanvas(640, 480);
    const context = canvas.getContext("2d");
    for (let i = 0; i < 4000; i += 1) {
      context.fillStyle = `hsl(${Math.random() * 360} 60% ${Math.random() * 100}%)`;
      context.fillRect(Math.random() * 640, Math.random() * 480, 4 + Math.random() * 20, 4 + Math.random() * 20);
    }
    const bytes = new Uint8Array(await (await canvas.convertToBlob()).arrayBuffer());
    return btoa(bytes.reduce((text, byte) => text + String.fromCharCode(byte), ""));
  });
  await page.locator("#file").setInputFiles({ name: "noise.png", mimeType: "image/png", buffer: Buffer.from(noise, "base64") });
  await page.waitForFunction(() => !document.getElementById("find").disabled, undefined, { timeout: 30_000 });
  await page.locator("#find").click();
  await page.waitForFunction(() => ["failed", "doubtful"].includes(document.getElementById("answer").dataset.state), undefined, { timeout: 30_000 });
  console.log(`     ${await page.locator("#answer").textContent()}`);
  await screens(page, "nowhere");

  console.log("== the package: a session of frames that know how they are held");
  const poses = Object.fromEntries(readFileSync(path.join(given.place ?? path.join(out, "demo"), "posed", "images.txt"), "utf8").split("\n").filter((line) => line && !line.startsWith("#")).map((line) => line.split(" ")).filter((words) => words.length >= 10).map((words) => [words[9], { q: words.slice(1, 5).map(Number), t: words.slice(5, 8).map(Number) }]));
  const walk = await page.evaluate(async ({ views, poses }) => {
    const { Client, load } = await import("/page/index.js");
    const client = new Client(location.origin);
    const device = await load(await client.profile("demo"));
    const session = await device.session();
    const found = [];
    for (const view of views) {
      const blob = await (await fetch(`/page/${view.file}`)).blob();
      const sealed = await device.sealed(blob, view.camera, { session, held: { orientation: poses[view.file].q } });
      const { answer, steps } = await client.localizeProgressive("demo", sealed);
      found.push({ name: view.file, trusted: answer.trusted, center: answer.center, sd: answer.position_sd, steps: steps.length, frames: sealed.frames, starts: sealed.starts });
    }
    const kept = await session.bytes();
    const again = await device.session({ bytes: kept });
    const same = await again.bytes();
    device.close();
    return { found, kept: kept.byteLength === same.byteLength };
  }, { views: views.slice(0, 4), poses });
  for (const { name, trusted, center, sd, steps, frames, starts } of walk.found) {
    const { q: [w, x, y, z], t } = poses[name];
    // −Rᵀ t
    const R = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]];
    const truth = [0, 1, 2].map((i) => -(R[0][i] * t[0] + R[1][i] * t[1] + R[2][i] * t[2]));
    const error = Math.hypot(...truth.map((c, i) => c - center[i]));
    check(`${name}: frame ${frames}, start ${starts}, ${steps} steps`, trusted && error < 0.05, `off by ${error.toFixed(4)} ± ${sd.toFixed(4)}`);
  }
  check("a session is kept and gone on with", walk.kept);

  console.log("== the camera");
  // Frames of a hidden view, as the fake camera reads them: JPEGs one after the other.
  const frame = await page.evaluate(async (file) => {
    const bitmap = await createImageBitmap(await (await fetch(`/page/${file}`)).blob());
    const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
    canvas.getContext("2d").drawImage(bitmap, 0, 0);
    const bytes = new Uint8Array(await (await canvas.convertToBlob({ type: "image/jpeg", quality: 0.97 })).arrayBuffer());
    return btoa(bytes.reduce((text, byte) => text + String.fromCharCode(byte), ""));
  }, views[2].file);
  const video = path.join(out, "camera.mjpeg");
  writeFileSync(video, Buffer.concat(Array(10).fill(Buffer.from(frame, "base64"))));
  await browser.close();
  const filming = await browse([`--use-file-for-fake-video-capture=${video}`]);
  const live = await open(filming, address, tried);
  await live.waitForFunction(() => document.getElementById("sent").children.length >= 3);
  await live.locator("#settings summary").click();
  await live.locator("#intrinsics").fill(views[2].camera);
  await live.locator("#camera").click();
  await live.waitForFunction(() => document.getElementById("attack-text").textContent.includes("px"), undefined, { timeout: 30_000 });
  const before = seen.filter((request) => request.method === "POST").length;
  await live.waitForTimeout(2500);
  check("looking through the camera sends nothing", seen.filter((request) => request.method === "POST").length === before);
  await screens(live, "camera");
  await live.locator("#find").click();
  await answered(live, "trusted");
  console.log(`     ${await live.locator("#answer").textContent()}`);
  await live.locator("#follow").click();
  const rows = await live.locator("#sent tr").count();
  await live.waitForFunction((rows) => document.querySelectorAll("#sent tr").length >= rows + 4, rows, { timeout: 60_000 });
  const state = await live.locator("#answer").getAttribute("data-state");
  check("following", state === "trusted" || state === "", await live.locator("#answer").textContent());
  await screens(live, "following");
  await live.locator("#follow").click();
  await live.waitForFunction(() => !document.getElementById("find").disabled, undefined, { timeout: 30_000 });
  await live.locator("#camera").click();

  console.log("== the example");
  const example = await between(demo, seen, (url) => {
    if (url === "/") return path.join(root, "examples/web/index.html");
    const name = url.match(/^\/veiloc\/([\w.-]+)$/)?.[1];
    return name ? path.join(root, "bindings/web/js", name) : null;
  });
  const small = await open(filming, example, tried);
  const choose = async (camera) => {
    await small.locator("#image").evaluate((input, camera) => Object.assign(input.dataset, { camera }), camera);
    await small.locator("#image").setInputFiles(path.join(given.place ?? path.join(out, "demo"), "images", views[1].file));
  };
  await small.waitForLoadState("networkidle");
  await choose(views[1].camera);
  await small.waitForFunction(() => document.getElementById("answer").value.startsWith("At "), undefined, { timeout: 30_000 });
  check("30 lines are enough", readFileSync(path.join(root, "examples/web/index.html"), "utf8").trim().split("\n").length <= 30, await small.locator("#answer").textContent());

  console.log("== a service that asks for a token");
  const tokens = path.join(out, "tokens");
  rmSync(tokens, { force: true });
  const token = execFileSync(path.resolve(given.veiloc), ["token", "new", "phone", "--tokens", tokens, "--maps", "place"], { encoding: "utf8" }).match(/\S{20,}/)[0];
  const map = path.join(given.place ?? path.join(out, "demo"), "place.vmap");
  const asking = await serve("serve", "--map", `place=${map}`, "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--tokens", tokens, "--page", "--page-folder", path.join(root, "bindings/web/page"), "--log", "off");
  const seenThere = [];
  const there = await between(asking, seenThere);
  const guest = await open(filming, there, tried);
  await answered(guest, "failed");
  await screens(guest, "token");
  await guest.locator("#token").fill(token);
  await guest.keyboard.press("Tab");
  await guest.waitForFunction(() => document.getElementById("answer").dataset.state === "" && document.getElementById("sent").children.length >= 2);
  check("with the token it is ready, and no points are shown", !seenThere.some((request) => request.url.includes("points")));
  const hidden = await fetch(`${asking}/page/points/place`);
  check("points are nobody's without a token", hidden.status === 401);
  await filming.close();

  console.log("== all that was sent");
  const all = [...seen, ...seenThere];
  const names2 = new Set(["host", "connection", "user-agent", "accept", "accept-encoding", "accept-language", "content-type", "content-length", "origin", "authorization", "cache-control", "pragma", "if-none-match", "upgrade-insecure-requests"]);
  const files = [];
  for (const { method, url, headers, body } of all) {
    const known = /^\/$|^\/page\/[\w.-]+$|^\/page\/points\/\w+$|^\/v1\/maps$|^\/v1\/maps\/\w+\/(profile|localize)$/.test(url);
    if (!known) check("an address of the service", false, `${method} ${url}`);
    const odd = Object.keys(headers).filter((name) => !names2.has(name) && !name.startsWith("sec-"));
    if (odd.length) check("no header of its own", false, `${url}: ${odd.join(" ")}`);
    if (method === "POST" && url.endsWith("/localize")) {
      const file = path.join(out, "sent", `${files.length}.vquery`);
      writeFileSync(file, body);
      files.push(file);
    } else if (method !== "GET" || body.length) check("a request without a body", false, `${method} ${url}`);
  }
  const queries = execFileSync(given.native, ["check", profile, ...files], { encoding: "utf8" }).trim().split("\n");
  check(`${all.length} requests, ${queries.length} of them with a body`, queries.length === files.length, `each a sealed query of the map: ${[...new Set(queries)].sort().join(", ")}`);
  const own = [address, there, example];
  const strange = [...new Set(tried)].filter((url) => !own.some((base) => url.startsWith(base)) && !url.startsWith("blob:"));
  check("the browser tried nobody else", strange.length === 0, strange.join(" "));
  writeFileSync(path.join(out, "requests.json"), JSON.stringify(all.map(({ method, url, headers, body }) => ({ method, url, headers: Object.keys(headers), bytes: body.length })), null, 1));
  writeFileSync(path.join(out, "web.json"), JSON.stringify({ ratio, requests: all.length, queries: queries.length }, null, 1));
}

try {
  await main();
} catch (error) {
  check("it ran to its end", false, error.stack);
}
for (const close of closing.reverse()) await close();
if (wrong) console.log(`${wrong} wrong`);
process.exit(wrong ? 1 : 0);
