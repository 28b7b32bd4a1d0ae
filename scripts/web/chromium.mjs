// Tests the page and the npm package in Chromium with its fake camera, through playwright-core.
//
//     node scripts/web/chromium.mjs --veiloc target/release/veiloc --native target/release/native --tools DIR --out DIR
//
// `--demo ADDRESS --place DIR` uses a demo that is already running, and its folder. `--seals 5` only compares seals, five times.
//
// `--tools`: a folder in which playwright-core is installed (`npm install --prefix DIR playwright-core`); `--browser`: the browser
// (default /usr/bin/chromium). The page is `bindings/web/page`, which bindings/web/build.sh builds. Checks:
//
// 1. Browser and native program seal the same image, camera and random bytes to the same bytes; prints milliseconds of both.
// 2. All requests, as the server received them and as the browser reports them: they go to the page's own server only, and each
//    body is a sealed query of the map's profile (`native check`); no cookie, no referrer, no query string.
// 3. The user interface: example images, camera, following, a walk, a session with orientations, an out-of-map image, a service
//    that requires a token; with screenshots (light and dark, wide and narrow), partly by keyboard.
import { readFileSync, writeFileSync } from "node:fs";
import path from "node:path";

import { exifSegment } from "./exif.mjs";
import { checkRequests, recordingProxy, check, closing, demo, drawnWhileAttacking, given, serveWithToken, onlySeals, out, place, root, run, sealsAreEqual, tool } from "./common.mjs";

const { chromium } = tool("playwright-core");

async function browse(extra = []) {
  const browser = await chromium.launch({
    executablePath: given.browser ?? "/usr/bin/chromium",
    args: ["--no-sandbox", "--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream", ...extra],
  });
  closing.push(() => browser.close());
  return browser;
}

/** Opens a page, and records all requests, console errors and page errors. */
async function open(browser, address, tried, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 900 }, permissions: ["camera"], ...options });
  context.on("request", (request) => tried.push(request.url()));
  const page = await context.newPage();
  page.on("console", (line) => line.type() === "error" && console.log(`     console: ${line.text()}`));
  page.on("pageerror", (error) => check("no error in the page", false, error.message));
  await page.goto(address);
  return page;
}

/** Takes screenshots of a state: light and dark, wide and narrow. */
async function screens(page, state) {
  for (const colorScheme of ["light", "dark"]) {
    for (const [name, width, height] of [["wide", 1280, 900], ["narrow", 390, 844]]) {
      await page.emulateMedia({ colorScheme });
      await page.setViewportSize({ width, height });
      await page.waitForTimeout(150);
      const across = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      check(`${state}, ${name}: no horizontal scrolling`, across <= 0, across > 0 ? `${across} px` : "");
      await page.screenshot({ path: path.join(out, "screens", `${state}-${colorScheme}-${name}.png`), fullPage: true });
    }
  }
  await page.emulateMedia({ colorScheme: "light" });
  await page.setViewportSize({ width: 1280, height: 900 });
}

/** An example image as a JPEG in base64, for the fake camera. */
const jpeg = (page, file) =>
  page.evaluate(async (file) => {
    const bitmap = await createImageBitmap(await (await fetch(`/page/${file}`)).blob());
    const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
    canvas.getContext("2d").drawImage(bitmap, 0, 0);
    const bytes = new Uint8Array(await (await canvas.convertToBlob({ type: "image/jpeg", quality: 0.97 })).arrayBuffer());
    return btoa(bytes.reduce((text, byte) => text + String.fromCharCode(byte), ""));
  }, file);

const answered = (page, state, timeout = 30_000) =>
  page.waitForFunction((state) => document.getElementById("answer").dataset.state === state, state, { timeout });

async function main() {
  const { address: served, views, profile } = await demo();
  const [seen, tried] = [[], []];
  const address = await recordingProxy(served, seen);

  const browser = await browse();
  const page = await open(browser, address, tried);
  await page.waitForFunction(() => document.getElementById("sent").children.length >= 3);
  for (const [width, height] of [[390, 844], [1280, 900]]) {
    await page.setViewportSize({ width, height });
    const { y, height: tall } = await page.locator("#find").boundingBox();
    check(`Find me is in the first ${width}x${height}`, y + tall <= height, `down to ${y + tall}`);
  }
  if (await onlySeals(page, views.slice(0, 4), profile)) return;
  await screens(page, "begin");

  const ratio = await sealsAreEqual(page, views.slice(0, 4), profile);

  console.log("== an example image, by keyboard");
  await page.locator("#views button").first().focus();
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => document.getElementById("attack-text").textContent.includes("px"), undefined, { timeout: 30_000 });
  check("no query is sent before the user asks for it", seen.every((request) => request.method === "GET"));
  await screens(page, "sealed");
  // The graph attack takes seconds; fewer keypoints make it faster.
  await page.locator("#settings summary").click();
  await page.locator("#max-keypoints").selectOption("512");
  await page.waitForFunction(() => document.getElementById("leaves-text").textContent.startsWith("512"), undefined, { timeout: 30_000 });
  for (const attack of ["closed-form", "closed-form-informed", "graph", "prior"]) {
    const before = await page.locator("#attack-text").textContent();
    await page.locator("#attack").selectOption(attack);
    await page.waitForFunction((before) => document.getElementById("attack-text").textContent !== before && !document.getElementById("attack-text").textContent.includes("seconds"), before, { timeout: 240_000 });
    console.log(`     ${attack}: ${(await page.locator("#attack-text").textContent()).trim()}`);
    if (attack === "graph") await page.locator(".figures").screenshot({ path: path.join(out, "screens", "graph.png") });
  }
  await page.locator("#max-keypoints").selectOption("");
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
    const text = await page.locator("#answer").textContent();
    check(`sealed as ${scheme}`, /^You are at|not sure/i.test(text), text);
  }
  await page.locator("#settings summary").click();
  const names = await page.evaluate(() => [...document.querySelectorAll("button, input, select, canvas")].filter((e) => {
    const label = e.labels?.length || e.textContent.trim() || e.getAttribute("aria-label") || e.querySelector("img")?.alt;
    return !label;
  }).map((e) => e.id));
  check("all controls and images have an accessible name", names.length === 0, names.join(" "));

  console.log("== the first click after typing a camera");
  await page.locator("#file").setInputFiles(path.join(place, "images", views[1].file));
  await page.waitForFunction(() => document.getElementById("stays-text").textContent.includes("focal length is unknown"), undefined, { timeout: 30_000 });
  await page.locator("#settings summary").click();
  await page.locator("#intrinsics").fill(views[1].camera);
  const asked = () => seen.filter((request) => request.method === "POST").length;
  const postsBefore = asked();
  // The field loses the focus when the button is pressed, and the image is sealed anew.
  await page.locator("#find").click();
  await page.waitForFunction(() => ["trusted", "doubtful", "failed"].includes(document.getElementById("answer").dataset.state) && !document.getElementById("find").disabled, undefined, { timeout: 30_000 });
  check("the click counts, with the typed camera", asked() > postsBefore && !(await page.locator("#stays-text").textContent()).includes("unknown"), await page.locator("#answer").textContent());
  await page.locator("#intrinsics").fill("");
  await page.locator("#settings summary").click();

  console.log("== a file with an EXIF focal length");
  const [, width, height, focal] = views[1].camera.split(",").map(Number);
  const film = Math.round((focal * Math.hypot(36, 24)) / Math.hypot(width, height));
  const plain = Buffer.from(await jpeg(page, views[1].file), "base64");
  const buffer = Buffer.concat([plain.subarray(0, 2), Buffer.from(exifSegment(film)), plain.subarray(2)]);
  // Chosen while another image is sealed: the last one is shown.
  await page.locator("#file").setInputFiles(path.join(place, "images", views[0].file));
  await page.locator("#file").setInputFiles({ name: "exif.jpg", mimeType: "image/jpeg", buffer });
  await page.waitForFunction(() => document.getElementById("stays-text").textContent.includes("EXIF"), undefined, { timeout: 30_000 });
  await page.locator("#find").click();
  await page.waitForFunction(() => ["trusted", "doubtful", "failed"].includes(document.getElementById("answer").dataset.state) && !document.getElementById("find").disabled, undefined, { timeout: 30_000 });
  check("it is used", (await page.locator("#answer").getAttribute("data-state")) !== "failed", await page.locator("#answer").textContent());

  console.log("== an out-of-map image");
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
  const stays = await page.locator("#stays-text").textContent();
  await page.locator("#file").setInputFiles({ name: "noise.png", mimeType: "image/png", buffer: Buffer.from(noise, "base64") });
  await page.waitForFunction((stays) => document.getElementById("stays-text").textContent !== stays, stays, { timeout: 30_000 });
  await page.locator("#find").click();
  await page.waitForFunction(() => ["failed", "doubtful"].includes(document.getElementById("answer").dataset.state), undefined, { timeout: 30_000 });
  console.log(`     ${await page.locator("#answer").textContent()}`);
  await screens(page, "out-of-map");

  console.log("== the package: a session of frames with orientations");
  const poses = Object.fromEntries(readFileSync(path.join(place, "posed", "images.txt"), "utf8").split("\n").filter((line) => line && !line.startsWith("#")).map((line) => line.split(" ")).filter((words) => words.length >= 10).map((words) => [words[9], { q: words.slice(1, 5).map(Number), t: words.slice(5, 8).map(Number) }]));
  const walk = await page.evaluate(async ({ views, poses }) => {
    const { Client, load } = await import("/page/index.js");
    const client = new Client(location.origin);
    const device = await load(await client.profile("demo"));
    const session = await device.session();
    const sealer = (await device.sealer()).inSession(session);
    const found = [];
    for (const view of views) {
      const blob = await (await fetch(`/page/${view.file}`)).blob();
      const sealed = await sealer.seal(await sealer.extract(blob, view.camera, { attitude: { orientation: poses[view.file].q } }));
      const { answer, steps } = await client.localizeProgressive("demo", sealed);
      found.push({ name: view.file, trusted: answer.state === "trusted", center: answer.center, sd: answer.position_sd, steps: steps.length, frames: sealed.frames, starts: sealed.starts });
    }
    const bytes = await session.bytes();
    const resumed = await (await device.session({ bytes })).bytes();
    device.close();
    return { found, isResumed: bytes.byteLength === resumed.byteLength };
  }, { views: views.slice(0, 4), poses });
  for (const { name, trusted, center, sd, steps, frames, starts } of walk.found) {
    const { q: [w, x, y, z], t } = poses[name];
    // −Rᵀ t
    const R = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]];
    const truth = [0, 1, 2].map((i) => -(R[0][i] * t[0] + R[1][i] * t[1] + R[2][i] * t[2]));
    const error = Math.hypot(...truth.map((c, i) => c - center[i]));
    check(`${name}: frame ${frames}, start ${starts}, ${steps} steps`, trusted && error < 0.05, `off by ${error.toFixed(4)} ± ${sd.toFixed(4)}`);
  }
  check("a session resumes from its bytes", walk.isResumed);

  console.log("== the camera");
  // The fake camera reads concatenated JPEGs.
  const frame = await jpeg(page, views[2].file);
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
  check("the live camera view sends no query", seen.filter((request) => request.method === "POST").length === before);
  await screens(live, "camera");
  await live.locator("#max-keypoints").selectOption("512");
  await live.waitForFunction(() => document.getElementById("leaves-text").textContent.startsWith("512"), undefined, { timeout: 30_000 });
  await live.locator("#attack").selectOption("graph");
  const during = await live.evaluate(drawnWhileAttacking);
  check("the lines stay live while the graph attack runs", during.began && during.drawn >= 2 && during.text.includes("px"), `drawn ${during.drawn} times; then: ${during.text.trim()}`);
  await live.locator("#attack").selectOption("closed-form");
  await live.locator("#max-keypoints").selectOption("");
  await live.waitForFunction(() => document.getElementById("leaves-text").textContent.startsWith("2,048"), undefined, { timeout: 30_000 });
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

  console.log("== a walk without motion sensors");
  // Two seconds at each of six views, in a loop.
  const walked = path.join(out, "walk.mjpeg");
  const frames = [];
  for (const view of views.slice(0, 6)) frames.push(...Array(60).fill(Buffer.from(await jpeg(live, view.file), "base64")));
  writeFileSync(walked, Buffer.concat(frames));
  await live.close();
  await filming.close();
  const walking = await browse([`--use-file-for-fake-video-capture=${walked}`]);
  const away = await open(walking, address, tried);
  await away.waitForFunction(() => document.getElementById("sent").children.length >= 3);
  await away.locator("#settings summary").click();
  await away.locator("#intrinsics").fill(views[0].camera);
  await away.locator("#settings summary").click();
  await away.locator("#camera").click();
  await away.waitForFunction(() => !document.getElementById("follow").disabled && !document.getElementById("no-sensors").hidden, undefined, { timeout: 30_000 });
  await away.locator("#follow").click();
  await answered(away, "waiting", 120_000);
  const detail = await away.locator("#detail").textContent();
  check("the third start is refused with a reason and a remedy", /motion sensors/.test(detail) && /turn on the spot/.test(detail), await away.locator("#answer").textContent());
  await screens(away, "waiting");
  await away.waitForFunction(() => document.getElementById("answer").dataset.state === "trusted", undefined, { timeout: 120_000 });
  check("following continues when the camera is back", await away.locator("#follow").getAttribute("aria-pressed") === "true");
  await away.locator("#follow").click();
  await walking.close();

  console.log("== the example");
  const example = await recordingProxy(served, seen, (url) => {
    if (url === "/") return path.join(root, "examples/web/index.html");
    const name = url.match(/^\/veiloc\/([\w.-]+)$/)?.[1];
    return name ? path.join(root, "bindings/web/js", name) : null;
  });
  const last = await browse();
  const small = await open(last, example, tried);
  const choose = async (camera) => {
    await small.locator("#image").evaluate((input, camera) => Object.assign(input.dataset, { camera }), camera);
    await small.locator("#image").setInputFiles(path.join(place, "images", views[1].file));
  };
  await small.waitForLoadState("networkidle");
  await choose(views[1].camera);
  await small.waitForFunction(() => document.getElementById("answer").value.startsWith("At "), undefined, { timeout: 30_000 });
  check("30 lines are enough", readFileSync(path.join(root, "examples/web/index.html"), "utf8").trim().split("\n").length <= 30, await small.locator("#answer").textContent());

  console.log("== a service that requires a token");
  const { address: protectedService, token } = await serveWithToken();
  const seenThere = [];
  // A named anchor at the origin, as the service lists them.
  const anchors = path.join(out, "anchors.json");
  writeFileSync(anchors, JSON.stringify({ version: 1, anchors: [{ name: "entrance", map_from_anchor: { q: [1, 0, 0, 0], t: [0, 0, 0] } }] }));
  const there = await recordingProxy(protectedService, seenThere, (url) => (url.endsWith("/anchors") ? anchors : null));
  const guest = await open(last, there, tried);
  await answered(guest, "failed");
  await screens(guest, "token");
  await guest.locator("#token").fill("x".repeat(64));
  await guest.keyboard.press("Tab");
  await guest.waitForFunction(() => document.getElementById("answer").textContent.includes("does not accept"));
  const ready = () => guest.waitForFunction(() => document.getElementById("answer").dataset.state === "" && document.getElementById("sent").children.length >= 2);
  await guest.goto(`${there}#token=${token}`);
  await ready();
  check("a link with the token opens the map, and leaves the address bar", guest.url() === there, guest.url());
  await guest.reload();
  await ready();
  const kept = await guest.evaluate((token) => [sessionStorage, localStorage].map((store) => JSON.stringify({ ...store }).includes(token)), token);
  const visitor = await open(last, `${there}#token=${token}`, tried);
  await visitor.waitForFunction(() => document.getElementById("sent").children.length >= 2);
  check("a link in a new tab does the same", visitor.url() === there, visitor.url());
  check("the token is kept in this tab only", kept[0] && !kept[1], kept.join(" "));
  await guest.locator("#file").setInputFiles(path.join(place, "images", views[1].file));
  await guest.waitForFunction(() => !document.getElementById("find").disabled, undefined, { timeout: 30_000 });
  await guest.locator("#find").click();
  await answered(guest, "trusted");
  const [at, near] = [await guest.locator("#answer").textContent(), await guest.locator("#detail").textContent()];
  const far = Math.hypot(...at.match(/-?\d+\.\d+/g).slice(0, 3).map(Number));
  check("the distance to the nearest anchor", near.startsWith(`${Number(far.toPrecision(2))} map units from entrance.`), near);
  await screens(guest, "no-points");
  check("the token is accepted, and no points are requested", !seenThere.some((request) => request.url.includes("points")));
  const denied = await fetch(`${protectedService}/page/points/place`);
  check("points are refused without a token", denied.status === 401);
  await last.close();

  const all = [...seen, ...seenThere];
  const queries = checkRequests(all, tried, [address, there, example], profile);
  writeFileSync(path.join(out, "web.json"), JSON.stringify({ ratio, requests: all.length, queries }, null, 1));
}

await run(main);
