// Checks HTML reports in Chromium through playwright-core: light and dark, wide and narrow, with and without scripts.
//
//     node scripts/report_browser.mjs --tools DIR --out DIR PAGE.html…
//
// `--tools`: a folder in which playwright-core is installed (`npm install --prefix DIR playwright-core`); `--chromium`: the browser
// (default /usr/bin/chromium). Screenshots go to `--out`. Checks of each page:
//
// 1. No network request, no console output, no violation of the page's own policy.
// 2. The page is not wider than the window and at most 20 000 pixels high; headings are in order; images and controls have names;
//    the contrast of text is sufficient (WCAG AA).
// 3. A 3D scene is drawn, and changes when dragged, by keyboard and by touch; a selected query is described.
// 4. A heat map has a cell for each class that its legend gives a share to.
// 5. Without scripts a static top view of the scene and all sections are visible.
import { createRequire } from "node:module";
import { mkdirSync, readFileSync } from "node:fs";
import path from "node:path";
import { pathToFileURL } from "node:url";
import { parseArgs } from "node:util";

const { values: given, positionals: pages } = parseArgs({
  allowPositionals: true,
  options: { tools: { type: "string" }, out: { type: "string" }, chromium: { type: "string", default: "/usr/bin/chromium" } },
});
const { chromium } = createRequire(path.resolve(given.tools, "x.js"))("playwright-core");
const out = path.resolve(given.out);
mkdirSync(out, { recursive: true });

let wrong = 0;
const check = (what, holds, more = "") => {
  if (!holds) wrong += 1;
  console.log(`${holds ? "ok   " : "WRONG"} ${what}${more ? `: ${more}` : ""}`);
};

const VIEWS = [
  { name: "wide-light", colorScheme: "light", viewport: { width: 1280, height: 900 } },
  { name: "wide-dark", colorScheme: "dark", viewport: { width: 1280, height: 900 } },
  { name: "narrow-light", colorScheme: "light", viewport: { width: 390, height: 844 }, hasTouch: true },
  { name: "narrow-dark", colorScheme: "dark", viewport: { width: 390, height: 844 }, hasTouch: true },
];

/** In the page: a list of its faults as a document. */
function documentFaults() {
  const found = [];
  const wide = document.documentElement.scrollWidth - innerWidth;
  if (wide > 0) found.push(`${wide} px wider than the window`);
  let level = 0;
  for (const heading of document.querySelectorAll("h1,h2,h3,h4")) {
    const own = Number(heading.tagName[1]);
    if (own > level + 1) found.push(`h${own} below h${level}: ${heading.textContent}`);
    level = own;
  }
  if (document.querySelectorAll("h1").length !== 1) found.push("not one h1");
  const name = (e) => e.getAttribute("aria-label") || e.labels?.[0]?.textContent || e.textContent;
  for (const e of document.querySelectorAll("button,select,input,canvas,a")) if (!name(e)?.trim()) found.push(`no name: ${e.outerHTML.slice(0, 80)}`);
  for (const svg of document.querySelectorAll("figure svg")) if (!svg.getAttribute("aria-label") && !svg.closest("[aria-hidden]")) found.push(`no name: ${svg.outerHTML.slice(0, 80)}`);
  for (const table of document.querySelectorAll("table")) if (!table.querySelector("thead th[scope]") || !table.querySelector("tbody th[scope]")) found.push("a table without headers");
  // Contrast of text against the nearest opaque background.
  const rgba = (text) => { const n = text.match(/[\d.]+/g).map(Number); return [n[0], n[1], n[2], n[3] ?? 1]; };
  const light = (c) => { const [r, g, b] = c.map((v) => { const s = v / 255; return s <= 0.03928 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4; }); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const seen = new Set();
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const e = node.parentElement;
    if (!node.textContent.trim() || e.closest("script,style,option,defs") || !e.checkVisibility() || seen.has(e)) continue;
    seen.add(e);
    const style = getComputedStyle(e), inSvg = e.closest("svg");
    let behind = e;
    while (behind && rgba(getComputedStyle(behind).backgroundColor)[3] < 1) behind = behind.parentElement;
    const back = behind ? rgba(getComputedStyle(behind).backgroundColor) : [255, 255, 255];
    const [a, b] = [light(rgba(inSvg ? style.fill : style.color).slice(0, 3)), light(back.slice(0, 3))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) found.push(`contrast ${ratio.toFixed(2)}: ${node.textContent.trim().slice(0, 40)}`);
  }
  return found;
}

/** In the page: a hash of the canvas, and its number of colours. */
function canvasState(canvas) {
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
  const words = new Uint32Array(data.buffer), colors = new Set();
  let hash = 0;
  for (const word of words) { hash = (hash * 31 + word) | 0; if (colors.size < 1000) colors.add(word); }
  return { hash, colors: colors.size };
}

/** Checks that the scene is drawn, that each input rotates it, and that a selected query is described. */
async function checkScene(page, context, { at, file, touch }) {
  const canvas = page.locator(".space canvas").first();
  await canvas.scrollIntoViewIfNeeded();
  const first = await canvas.evaluate(canvasState);
  check(`${at}: the scene is drawn`, first.colors > 50, `${first.colors} colours`);
  const box = await canvas.boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  let last = first;
  const changed = async (what) => { const now = await canvas.evaluate(canvasState); check(`${at}: ${what} rotates it`, now.hash !== last.hash && now.colors > 50); last = now; };
  await page.mouse.move(x, y); await page.mouse.down(); await page.mouse.move(x + 90, y + 30, { steps: 4 }); await page.mouse.up();
  await changed("dragging");
  await canvas.focus();
  await page.keyboard.press("ArrowRight"); await page.keyboard.press("+");
  await changed("the keyboard");
  if (touch) {
    const cdp = await context.newCDPSession(page);
    const send = (type, touchPoints) => cdp.send("Input.dispatchTouchEvent", { type, touchPoints });
    await send("touchStart", [{ x, y }]); await send("touchMove", [{ x: x + 60, y: y + 10 }]); await send("touchEnd", []);
    await changed("touch");
  }
  await page.keyboard.press("0");
  const query = page.locator(".space select[data-part=query]").first();
  const names = await query.locator("option").allTextContents();
  await query.selectOption({ index: 1 });
  check(`${at}: a selected query is described`, (await page.locator(".status").first().textContent()).startsWith(`${names[1]} · `));
  await page.locator(".space").first().screenshot({ path: path.join(out, `${file}-query.png`) });
  await page.locator(".space button[data-part=reset]").first().click();
  await page.locator(".space").first().screenshot({ path: path.join(out, `${file}-scene.png`) });
}

const browser = await chromium.launch({ executablePath: given.chromium, args: ["--no-sandbox"] });
for (const file of pages) {
  const label = path.basename(file, ".html");
  const address = pathToFileURL(path.resolve(file)).href;
  const policy = readFileSync(file, "utf8").match(/Content-Security-Policy" content="([^"]*)"/)?.[1] ?? "";
  check(`${label}: its policy allows no network`, policy.startsWith("default-src 'none'; img-src data:;") && !policy.includes("unsafe"));
  for (const { name, ...view } of VIEWS) {
    const at = `${label} ${name}`;
    const context = await browser.newContext(view);
    const page = await context.newPage();
    const consoleLines = [], requests = [];
    page.on("console", (message) => consoleLines.push(message.text()));
    page.on("pageerror", (error) => consoleLines.push(String(error)));
    page.on("request", (request) => { if (request.url() !== address && !request.url().startsWith("data:")) requests.push(request.url()); });
    await page.goto(address);
    const high = await page.evaluate(() => document.documentElement.scrollHeight);
    check(`${at}: ${high} pixels high`, high < 20_000);
    for (const details of await page.locator("details").all()) await details.evaluate((e) => { e.open = true; });
    const found = await page.evaluate(documentFaults);
    check(`${at}: a valid document`, found.length === 0, found.slice(0, 6).join("; "));
    const images = await page.locator("img").evaluateAll((all) => all.map((e) => e.alt.trim() !== "" && e.complete && e.naturalWidth > 0));
    check(`${at}: ${images.length} images are loaded and have alternative text`, images.every(Boolean));
    if (await page.locator(".space canvas").count()) await checkScene(page, context, { at, file: `${label}-${name}`, touch: view.hasTouch });
    if (await page.locator("path.heat").count()) {
      const drawn = await page.locator("figure path.heat").evaluateAll((all) => all.map((e) => [e.classList[1], e.getBBox().width > 0]));
      const legend = await page.locator(".legend li:has(.heat)").evaluateAll((all) => all.map((e) => !e.textContent.includes("(0 %)")));
      check(`${at}: classes of the heat map are drawn`, drawn.length === legend.length && drawn.every(([, is], k) => is || !legend[k]), JSON.stringify([drawn, legend]));
      await page.locator("section#coverage").screenshot({ path: path.join(out, `${label}-${name}-heat.png`) });
    }
    for (const details of await page.locator("details").all()) await details.evaluate((e, open) => { e.open = open; }, false);
    const one = page.locator("details.fold").first();
    if (await one.count()) { await one.evaluate((e) => { e.open = true; }); await one.screenshot({ path: path.join(out, `${label}-${name}-details.png`) }); }
    await page.screenshot({ path: path.join(out, `${label}-${name}.png`), fullPage: true });
    check(`${at}: the console is empty`, consoleLines.length === 0, consoleLines.slice(0, 3).join("; "));
    check(`${at}: no network requests`, requests.length === 0, requests.slice(0, 3).join("; "));
    await context.close();
  }
  const context = await browser.newContext({ ...VIEWS[0], javaScriptEnabled: false });
  const page = await context.newPage();
  await page.goto(address);
  if (await page.locator(".space").count()) {
    check(`${label} without scripts: the top view of the scene is visible`, await page.locator(".flat svg[role=img]").first().isVisible());
    check(`${label} without scripts: controls are hidden`, !(await page.locator(".live").first().isVisible()));
  } else {
    check(`${label} without scripts: the tables are visible`, await page.locator("table").first().isVisible());
  }
  await context.close();
}
await browser.close();
console.log(wrong ? `${wrong} checks failed` : "all checks passed");
process.exit(wrong ? 1 : 0);
