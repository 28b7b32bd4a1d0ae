// A fresh vite project with the packed npm package and the configuration of docs/guide/phone-and-browser.md: an image is sealed in
// Chromium under `vite dev`, and from `vite build` under `vite preview`.
//
//     (cd bindings/web && npm pack --pack-destination TOOLS) && npm install --prefix TOOLS playwright-core@1
//     scripts/web/vite.mjs --tools TOOLS --profile PLACE.profile --image IMAGE.png --out OUT
import { execFileSync, spawn } from "node:child_process";
import { copyFileSync, mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import path from "node:path";
import { parseArgs } from "node:util";

const { values: given } = parseArgs({
  options: { tools: { type: "string" }, profile: { type: "string" }, image: { type: "string" }, out: { type: "string" } },
});
const root = path.resolve(import.meta.dirname, "../..");
const tools = path.resolve(given.tools);
const app = path.resolve(given.out, "app");
rmSync(app, { recursive: true, force: true });
mkdirSync(path.join(app, "public"), { recursive: true });
copyFileSync(given.profile, path.join(app, "public/place.profile"));
copyFileSync(given.image, path.join(app, "public/view.png"));
// The code of the guide.
const guide = readFileSync(path.join(root, "docs/guide/phone-and-browser.md"), "utf8");
writeFileSync(path.join(app, "vite.config.js"), /```js\n(\/\/ vite\.config\.js\n[^`]*)```/.exec(guide)[1]);
writeFileSync(path.join(app, "package.json"), JSON.stringify({ private: true, type: "module" }));
writeFileSync(path.join(app, "index.html"), '<!doctype html><title>waits</title><script type="module" src="/main.js"></script>');
writeFileSync(path.join(app, "main.js"), `import { load } from "veiloc";
const bytes = async (file) => new Uint8Array(await (await fetch(file)).arrayBuffer());
try {
  const device = await load(await bytes("/place.profile"));
  const sealed = await device.sealed(new Blob([await bytes("/view.png")]), null);
  document.title = \`sealed \${sealed.rows} rows for \${device.id}\`;
} catch (error) {
  document.title = \`failed: \${error.kind} \${error.message}\`;
}
`);
execFileSync("npm", ["install", "--silent", "--no-audit", "--no-fund", "--prefix", app, "vite@7", path.join(tools, "veiloc-0.1.0.tgz")],
  { stdio: "inherit" });

const { chromium } = createRequire(path.join(tools, "x.js"))("playwright-core");
const vite = path.join(app, "node_modules/.bin/vite");
let failed = false;

/** Serves the project and returns the title of its page once it has one. */
async function title(...command) {
  const server = spawn(vite, [...command, "--host", "127.0.0.1"], { cwd: app, env: { ...process.env, NO_COLOR: "1" } });
  const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox"] });
  try {
    const address = await new Promise((resolve, reject) => {
      let log = "";
      const read = (data) => {
        log += data;
        const found = /http:\/\/127\.0\.0\.1:\d+\//.exec(log);
        if (found) resolve(found[0]);
      };
      server.stdout.on("data", read);
      server.stderr.on("data", read);
      server.on("exit", () => reject(new Error(log)));
    });
    const page = await browser.newPage();
    await page.goto(address);
    await page.waitForFunction(() => document.title !== "waits", undefined, { timeout: 120_000 });
    return await page.title();
  } finally {
    await browser.close();
    server.kill();
  }
}

for (const [name, command] of [["vite dev", ["dev"]], ["vite build", ["preview"]]]) {
  if (name === "vite build") execFileSync(vite, ["build", "--logLevel", "error"], { cwd: app, stdio: "inherit" });
  const found = await title(...command);
  console.log(`${name}: ${found}`);
  failed ||= !found.startsWith("sealed ");
}
process.exitCode = failed ? 1 : 0;
