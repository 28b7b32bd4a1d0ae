// Tests the essential parts of the page in Firefox with its fake camera, through puppeteer-core over WebDriver BiDi.
//
//     node scripts/web/firefox.mjs --veiloc target/release/veiloc --native target/release/native --tools DIR --out DIR
//
// Options are those of chromium.mjs; `--tools` holds puppeteer-core, `--browser` is Firefox (default /usr/bin/firefox-esr).
// Checks: seals equal those of the native program; an example image and the package localize; images of the fake camera are sealed
// live and not sent; all requests go to the page's own server.
import path from "node:path";
import { writeFileSync } from "node:fs";

import { checkRequests, recordingProxy, check, closing, demo, given, onlySeals, out, run, sealsAreEqual, tool } from "./common.mjs";

const puppeteer = tool("puppeteer-core");

/** Waits for a condition in the page. It polls from here, because the page's policy forbids `eval`, which `waitForFunction` needs. */
async function waitUntil(page, what, condition, argument, seconds = 60) {
  for (const end = Date.now() + 1000 * seconds; Date.now() < end; ) {
    if (await page.evaluate(condition, argument)) return;
    await new Promise((done) => setTimeout(done, 100));
  }
  throw new Error(`timeout: ${what}: ${await page.evaluate(() => `${document.getElementById("answer").textContent} ${document.getElementById("detail").textContent}`)}`);
}

const press = (page, id) => page.evaluate((id) => document.getElementById(id).click(), id);
const choose = (page, id, value) =>
  page.evaluate(({ id, value }) => {
    const field = document.getElementById(id);
    field.value = value;
    field.dispatchEvent(new Event("change", { bubbles: true }));
  }, { id, value });

async function main() {
  const { address: served, views, profile } = await demo();
  const [seen, tried] = [[], []];
  const address = await recordingProxy(served, seen);
  const browser = await puppeteer.launch({
    browser: "firefox",
    executablePath: given.browser ?? "/usr/bin/firefox-esr",
    protocol: "webDriverBiDi",
    headless: true,
    extraPrefsFirefox: { "media.navigator.streams.fake": true, "media.navigator.permission.disabled": true },
  });
  closing.push(() => browser.close());
  console.log(`     ${await browser.version()}`);
  const page = await browser.newPage();
  await page.setViewport({ width: 1280, height: 900 });
  page.on("request", (request) => tried.push(request.url()));
  page.on("console", (line) => line.type() === "error" && console.log(`     console: ${line.text()}`));
  page.on("pageerror", (error) => check("no error in the page", false, error.message));
  await page.goto(address);
  await waitUntil(page, "a page that is ready", () => document.getElementById("sent").children.length >= 3);
  if (await onlySeals(page, views.slice(0, 4), profile)) return;

  const ratio = await sealsAreEqual(page, views.slice(0, 4), profile);

  console.log("== an example image");
  const sent = () => seen.filter((request) => request.method === "POST").length;
  await page.evaluate(() => document.querySelector("#views button").click());
  await waitUntil(page, "an attack", () => document.getElementById("attack-text").textContent.includes("px"));
  check("no query is sent before the user asks for it", sent() === 0);
  await press(page, "find");
  await waitUntil(page, "a trusted pose", () => document.getElementById("answer").dataset.state === "trusted");
  console.log(`     ${await page.evaluate(() => document.getElementById("answer").textContent)}`);
  await page.screenshot({ path: path.join(out, "screens", "firefox-found.png"), fullPage: true });

  console.log("== the package");
  const result = await page.evaluate(async (view) => {
    const { Client, load } = await import("/page/index.js");
    const client = new Client(location.origin);
    const device = await load(await client.profile("demo"));
    const blob = await (await fetch(`/page/${view.file}`)).blob();
    const sealer = await device.sealer();
    const sealed = await sealer.seal(await sealer.extract(blob, view.camera));
    const { answer, steps } = await client.localizeProgressive("demo", sealed);
    const { medianPx, priorMedianPx } = await sealed.attack("prior");
    device.close();
    const closed = await sealed.attack("prior").catch((error) => error.kind);
    return { trusted: answer.state === "trusted", sd: answer.position_sd, steps: steps.length, medianPx, priorMedianPx, closed };
  }, views[1]);
  check("an image is localized, and attacked in its own worker", result.trusted && result.medianPx === result.priorMedianPx && result.closed === "closed", JSON.stringify(result));

  console.log("== the camera");
  const before = sent();
  await choose(page, "max-keypoints", "512");
  await press(page, "camera");
  await waitUntil(page, "a camera", () => /^(Stop the camera)$/.test(document.getElementById("camera").textContent));
  await new Promise((done) => setTimeout(done, 2500));
  const live = await page.evaluate(() => document.getElementById("leaves-text").textContent);
  check("the camera is sealed live", /^[\d,]+ lines with descriptors/.test(live) && !live.startsWith("2,048"), live);
  await page.screenshot({ path: path.join(out, "screens", "firefox-camera.png"), fullPage: true });
  check("the live camera view sends no query", sent() === before);
  await press(page, "camera");

  const queries = checkRequests(seen, tried, [address], profile);
  writeFileSync(path.join(out, "web.json"), JSON.stringify({ ratio, requests: seen.length, queries }, null, 1));
}

await run(main);
