#!/usr/bin/env node
// Makes a vite project in which an image is chosen, sealed and localized.
//
//     npx --package ./veiloc-0.1.0.tgz veiloc FOLDER    with the package of a release
//     node bindings/web/create.mjs FOLDER               in the repository, after bindings/web/build.sh
import { execFileSync } from "node:child_process";
import { cpSync, existsSync } from "node:fs";
import path from "node:path";
import { fileURLToPath } from "node:url";

const own = path.dirname(fileURLToPath(import.meta.url));
const [folder] = process.argv.slice(2);
const refuse = (why) => {
  console.error(why);
  process.exit(2);
};
if (!folder) refuse("the name of a new folder is missing");
if (existsSync(folder)) refuse(`${folder}: exists already; give a new folder`);
if (!existsSync(path.join(own, "page/veiloc.wasm"))) refuse("the package is not built: run bindings/web/build.sh");

cpSync(path.join(own, "app"), folder, { recursive: true });
const npm = (...words) =>
  execFileSync("npm", [...words, "--silent"], { cwd: folder, encoding: "utf8", stdio: ["ignore", "pipe", "inherit"], shell: process.platform === "win32" });
const file = npm("pack", own).trim();
npm("install", "--no-audit", "--no-fund", "vite@7", `./${file}`);
console.log(`Now: veiloc serve --map lobby=place.vmap, and in ${folder}: npx vite`);
