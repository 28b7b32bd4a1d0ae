// The essential part of the page in Firefox, driven by puppeteer-core over WebDriver BiDi, with Firefox's fake camera.
//
//     node scripts/web/firefox.mjs --veiloc target/release/veiloc --native target/release/native --tools DIR --out DIR
//
// Options are those of chromium.mjs; `--tools` holds puppeteer-core, `--browser` is Firefox (default /usr/bin/firefox-esr). What
// is held: the same seals as natively, to the bit; a hidden view and the package, localized; the fake camera, which shows no
// place, sealed live while an attack runs and sent to nobody; an image of it; every request to the page's own server alone.
import path from "node:path";
import { writeFileSync } from "node:fs";

import { account, between, check, closing, demo, given, onlySeals, out, run, sealsAreEqual, tool } from "./common.mjs";

const puppeteer = tool("puppeteer-core");

/** Until something is so in the page. Asked from here: the page's policy lets nobody make functions of text in it. */
async function until(page, what, isSo, argument, seconds = 60) {
  for (const end = Date.now() + 1000 * seconds; Date.now() < end; ) {
    if (await page.evaluate(isSo, argument)) return;
    await new Promise((done) => setTimeout(done, 100));
  }
  throw new Error(`${what} never came about: ${await page.evaluate(() => `${document.getElementById("answer").textContent} ${document.getElementById("detail").textContent}`)}`);
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
  const address = await between(served, seen);
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
  await until(page, "a page that is ready", () => document.getElementById("sent").children.length >= 3);
  if (await onlySeals(page, views.slice(0, 4), profile)) return;

  const ratio = await sealsAreEqual(page, views.slice(0, 4), profile);

  console.log("== a hidden view");
  const sent = () => seen.filter((request) => request.method === "POST").length;
  await page.evaluate(() => document.querySelector("#views button").click());
  await until(page, "an attack", () => document.getElementById("attack-text").textContent.includes("px"));
  check("nothing is sent before it is asked for", sent() === 0);
  await press(page, "find");
  await until(page, "a trusted pose", () => document.getElementById("answer").dataset.state === "trusted");
  console.log(`     ${await page.evaluate(() => document.getElementById("answer").textContent)}`);
  await page.screenshot({ path: path.join(out, "screens", "firefox-found.png"), fullPage: true });

  console.log("== the package");
  const told = await page.evaluate(async (view) => {
    const { Client, load } = await import("/page/index.js");
    const client = new Client(location.origin);
    const device = await load(await client.profile("demo"));
    const blob = await (await fetch(`/page/${view.file}`)).blob();
    const sealed = await device.sealed(blob, view.camera);
    const { answer, steps } = await client.localizeProgressive("demo", sealed);
    const { medianPx, guessMedianPx } = await sealed.attack("prior");
    device.close();
    const closed = await sealed.attack("prior").catch((error) => error.kind);
    return { trusted: answer.trusted, sd: answer.position_sd, steps: steps.length, medianPx, guessMedianPx, closed };
  }, views[1]);
  check("an image is localized, and attacked in a worker of its own", told.trusted && told.medianPx === told.guessMedianPx && told.closed === "closed", JSON.stringify(told));

  console.log("== the camera");
  const before = sent();
  await choose(page, "most", "512");
  await press(page, "camera");
  await until(page, "a camera", () => /^(Stop the camera)$/.test(document.getElementById("camera").textContent));
  await new Promise((done) => setTimeout(done, 2500));
  const live = await page.evaluate(() => document.getElementById("leaves-text").textContent);
  check("the camera is sealed live", /^[\d,]+ lines with descriptors/.test(live) && !live.startsWith("2,048"), live);
  await page.screenshot({ path: path.join(out, "screens", "firefox-camera.png"), fullPage: true });
  check("looking through the camera sends nothing", sent() === before);
  await press(page, "camera");

  const queries = account(seen, tried, [address], profile);
  writeFileSync(path.join(out, "web.json"), JSON.stringify({ ratio, requests: seen.length, queries }, null, 1));
}

await run(main);
