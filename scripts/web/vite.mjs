// A fresh vite project, as the packed npm package makes it (bindings/web/create.mjs): an image is localized by a running service, in
// Chromium, under `vite dev` and from `vite build` under `vite preview`.
//
//     (cd bindings/web && npm pack --pack-destination TOOLS) && npm install --prefix TOOLS playwright-core@1
//     scripts/web/vite.mjs --veiloc target/release/veiloc --tools TOOLS --map PLACE.vmap --image IMAGE --out OUT
//
// IMAGE is a view of the place whose focal length need not be known.
import { execFileSync, spawn } from "node:child_process";
import { mkdirSync, readFileSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

const { values: given } = parseArgs({
  options: {
    veiloc: { type: "string" }, tools: { type: "string" }, map: { type: "string" }, image: { type: "string" }, out: { type: "string" },
  },
});
const root = fileURLToPath(new URL("../..", import.meta.url));
const tools = path.resolve(given.tools);
const app = path.resolve(given.out, "app");
rmSync(app, { recursive: true, force: true });
mkdirSync(path.dirname(app), { recursive: true });
execFileSync("npx", ["--yes", "--package", path.join(tools, "veiloc-0.1.0.tgz"), "veiloc", app], { stdio: "inherit", cwd: path.dirname(app) });
const guide = readFileSync(path.join(root, "docs/guide/phone-and-browser.md"), "utf8");
if (!guide.includes(readFileSync(path.join(app, "main.js"), "utf8"))) throw new Error("the guide shows another main.js");

const { chromium } = createRequire(path.join(tools, "x.js"))("playwright-core");
const vite = path.join(app, "node_modules/.bin/vite");
let failed = false;

/** Starts a program, and resolves with it and the address that it prints. */
function started(program, words) {
  const child = spawn(program, words, { cwd: app, env: { ...process.env, NO_COLOR: "1", VEILOC: service?.address ?? "" } });
  return new Promise((resolve, reject) => {
    let log = "";
    const read = (data) => {
      log += data;
      const found = /(?:serving \S+ on|Local:) +(http:\/\/[\w.]+:\d+)/.exec(log);
      if (found) resolve({ child, address: found[1] });
    };
    child.stdout.on("data", read);
    child.stderr.on("data", read);
    child.on("exit", () => reject(new Error(log)));
  });
}

/** What the page says of the image. */
async function answer(address) {
  const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox"] });
  const errors = [];
  try {
    const page = await browser.newPage();
    page.on("pageerror", (error) => errors.push(error.message));
    page.on("console", (line) => line.type() === "error" && errors.push(line.text()));
    await page.goto(address);
    await page.waitForSelector("#image:enabled", { timeout: 60_000 });
    await page.setInputFiles("#image", path.resolve(given.image));
    await page.waitForFunction(() => document.getElementById("answer").value !== "", undefined, { timeout: 120_000 });
    return await page.locator("#answer").evaluate((output) => output.value);
  } catch (error) {
    return [error.message, ...errors].join(" ");
  } finally {
    await browser.close();
  }
}

const PORT = 5173;
const map = `lobby=${path.resolve(given.map)}`;
let service;
service = await started(path.resolve(given.veiloc), ["serve", "--map", map, "--listen", "127.0.0.1:0", "--answer-quantum", "0", "--log", "off"]);
try {
  for (const [name, command] of [["vite dev", "dev"], ["vite build", "preview"]]) {
    if (name === "vite build") execFileSync(vite, ["build", "--logLevel", "error"], { cwd: app, stdio: "inherit" });
    const server = await started(vite, [command, "--port", PORT, "--strictPort"]);
    const found = await answer(server.address);
    server.child.kill();
    console.log(`${name}: ${found}`);
    failed ||= !/^(At|Perhaps at) [-\d.,e]+$/.test(found);
  }
} finally {
  service.child.kill();
}
process.exit(failed ? 1 : 0);
