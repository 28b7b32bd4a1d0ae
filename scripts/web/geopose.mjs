// Asks `veiloc serve` for GeoPoses with the client of Open AR Cloud, the npm package @oarc/gpp-access, which checks requests and
// answers against its own schemas.
//
//     npm install --prefix TOOLS @oarc/gpp-access@0.2.1 esbuild@0.25
//     scripts/web/geopose.mjs --veiloc target/release/veiloc --tools TOOLS --place DIR --out OUT [--within METRES]
//
// DIR is a place with known poses: `images`, `posed` (cameras.txt and images.txt of COLMAP, world to camera, metres), and the lists
// `map.txt` and `query.txt`. Builds its map in OUT, gives it a geographic reference, seals the query images, and compares the GeoPose of
// each trusted answer with the known pose of its image; an image in place of a query is refused. The axes of the place count as east,
// north, up. Exits with 1 when a pose is off by more than METRES (default 0.05) or 0.5 degrees, or a third is not found.
import { spawn, spawnSync } from "node:child_process";
import { existsSync, mkdirSync, readFileSync, rmSync } from "node:fs";
import { join, resolve as absolute } from "node:path";
import { pathToFileURL } from "node:url";
import { parseArgs } from "node:util";

const { values: given } = parseArgs({
  options: {
    veiloc: { type: "string" }, tools: { type: "string" }, place: { type: "string" }, out: { type: "string" },
    within: { type: "string", default: "0.05" },
  },
});
const ORIGIN = { lat: 47.3769, lon: 8.5417, h: 455 };

const fail = (message) => {
  console.error(message);
  process.exitCode = 1;
};
const run = (...words) => {
  const done = spawnSync(given.veiloc, words, { encoding: "utf8" });
  if (done.status !== 0) throw new Error(`veiloc ${words.join(" ")}: ${done.status}\n${done.stderr}`);
  return done.stdout;
};

/** Rotation by rows of a quaternion w x y z. */
function rotation([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}
const apply = (m, v) => m.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
const transposed = (m) => m[0].map((_, k) => m.map((row) => row[k]));
const distance = (a, b) => Math.hypot(...a.map((x, k) => x - b[k]));

/** East, north, up of a position near ORIGIN, metres: the radii of curvature of WGS 84 at its latitude. */
function offset({ lat, lon, h }) {
  const e2 = 0.00669437999014, sin = Math.sin((ORIGIN.lat * Math.PI) / 180), w = 1 - e2 * sin * sin;
  const across = 6378137 / Math.sqrt(w), along = (6378137 * (1 - e2)) / w ** 1.5;
  const degree = Math.PI / 180;
  return [
    (lon - ORIGIN.lon) * degree * (across + h) * Math.cos(ORIGIN.lat * degree),
    (lat - ORIGIN.lat) * degree * (along + h),
    h - ORIGIN.h,
  ];
}

// The package is written for bundlers: Node.js does not find its folders.
mkdirSync(given.out, { recursive: true });
const bundle = absolute(given.out, "gpp-access.mjs");
const bundled = spawnSync(join(given.tools, "node_modules/.bin/esbuild"), [
  join(given.tools, "node_modules/@oarc/gpp-access/dist/index.js"), "--bundle", "--platform=node", "--format=esm",
  `--outfile=${bundle}`, "--log-level=error"], { encoding: "utf8" });
if (bundled.status !== 0) throw new Error(`esbuild: ${bundled.stderr}`);
const gpp = await import(pathToFileURL(bundle));
const { place } = given;
const map = join(given.out, "place.vmap");
const profile = join(given.out, "place.profile");
if (!existsSync(map)) {
  run("map", "build", "--images", join(place, "images"), "--posed", join(place, "posed"), "--list", join(place, "map.txt"), "--out", map, "--quiet");
}
run("map", "profile", map, "--out", profile, "--quiet");

const lines = (file) => readFileSync(join(place, file), "utf8").split("\n").map((line) => line.trim()).filter((line) => line && !line.startsWith("#"));
const cameras = new Map(lines("posed/cameras.txt").map((line) => line.split(/\s+/)).map(([id, ...camera]) => [id, camera]));
/** Camera, and quaternion and translation from the world, of each image. */
const posed = new Map();
for (const line of lines("posed/images.txt")) {
  const words = line.split(/\s+/);
  if (words.length === 10) posed.set(words[9], { camera: cameras.get(words[8]), pose: words.slice(1, 8).map(Number) });
}

const images = lines("query.txt");
const queries = images.map((name) => {
  const query = join(given.out, "query.bin");
  rmSync(query, { force: true });
  run("seal", join(place, "images", name), "--camera", posed.get(name).camera.join(","), "--profile", profile, "--out", query, "--quiet");
  return [name, readFileSync(query)];
});

const reference = `place=${ORIGIN.lat},${ORIGIN.lon},${ORIGIN.h}`;
const service = spawn(given.veiloc, ["serve", "--answer-quantum", "0", "--map", `place=${map}`, "--geo-reference", reference,
  "--listen", "127.0.0.1:0", "--rate", "1000"]);
try {
  const address = await new Promise((resolve, reject) => {
    let log = "";
    const read = (data) => {
      log += data;
      const found = /serving place on (http:\/\/[\d.:]+)/.exec(log);
      if (found) resolve(found[1]);
    };
    service.stdout.on("data", read);
    service.stderr.on("data", read);
    service.on("exit", () => reject(new Error(log)));
  });
  const request = (format, size, bytes, applied) => {
    const made = new gpp.GeoPoseRequest("query")
      .addSensor(new gpp.Sensor("camera", gpp.SENSORTYPE.camera))
      .addCameraData(format, size, bytes.toString("base64"), 0, new gpp.ImageOrientation(false, 0), undefined, Date.now(), "camera", new gpp.Privacy());
    const json = JSON.parse(JSON.stringify(made));
    for (const reading of json.sensorReadings.cameraReadings) reading.privacy.dataSanitizationApplied = applied;
    return JSON.stringify(json);
  };

  let found = 0, farthest = 0, widest = 0;
  for (const [name, sealed] of queries) {
    const { camera, pose: [qw, qx, qy, qz, ...translation] } = posed.get(name);
    const size = camera.slice(1, 3).map(Number);
    let answer;
    try {
      answer = await gpp.sendRequest(`${address}/geopose`, request("VEILOC_SEALED_QUERY", size, sealed, ["dcl"]));
    } catch (error) {
      if (!String(error).includes("not-localized")) throw error;
      continue;
    }
    const worldFromCam = transposed(rotation([qw, qx, qy, qz]));
    const centre = apply(worldFromCam, translation).map((c) => -c);
    const off = distance(offset(answer.geopose.position), centre);
    const { x, y, z, w } = answer.geopose.quaternion;
    const forward = apply(rotation([w, x, y, z]), [0, 1, 0]), expected = apply(worldFromCam, [0, 0, 1]);
    const right = apply(rotation([w, x, y, z]), [1, 0, 0]), expectedRight = apply(worldFromCam, [1, 0, 0]);
    const turned = (Math.max(distance(forward, expected), distance(right, expectedRight)) * 180) / Math.PI;
    if (off > Number(given.within) || turned > 0.5) fail(`${name}: ${off} m and ${turned}° off`);
    [found, farthest, widest] = [found + 1, Math.max(farthest, off), Math.max(widest, turned)];
  }
  if (found < (images.length * 2) / 3) fail(`only ${found} of ${images.length} images have a GeoPose`);
  // The beginning, because a request has at most the length of the longest query.
  const image = readFileSync(join(place, "images", images[0])).subarray(0, 50_000);
  const refused = await gpp.sendRequest(`${address}/geopose`, request("JPG", [640, 480], image, [])).then(() => "answered", (error) => String(error));
  if (!refused.includes("malformed-query")) fail(`an image was not refused: ${refused}`);
  else console.log(`${found} of ${images.length} images: at most ${(farthest * 1000).toFixed(1)} mm and ${widest.toFixed(2)}° off; an image in place of a query is refused`);
} finally {
  service.kill();
}
