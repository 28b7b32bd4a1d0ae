// Tests of the package that need no browser: the module's exports, the orientation, and the client against a faulty service.
//
//     node --test bindings/web/check.mjs        after bindings/web/build.sh
//
// With VEILOC_NATIVE (the program `native` of this crate) and VEILOC_DATA, EXIF cameras of photographs are compared with the program's.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { readFileSync, readdirSync } from "node:fs";
import http from "node:http";
import { test } from "node:test";

import { Client } from "./js/client.js";
import { Core, VeilocError } from "./js/core.js";
import { orientationOf, orientationOfPose } from "./js/orientation.js";
import { Alignment, cameraImage, cameraOfView, poseOfView } from "./js/webxr.js";
import { exifSegment } from "../../scripts/web/exif.mjs";

const wasm = new WebAssembly.Module(readFileSync(new URL("./js/veiloc.wasm", import.meta.url)));

test("the module has no imports and three exports", () => {
  assert.deepEqual(WebAssembly.Module.imports(wasm), []);
  const functions = WebAssembly.Module.exports(wasm).filter((item) => item.kind === "function").map((item) => item.name);
  assert.deepEqual(functions.sort(), ["veiloc_allocate", "veiloc_call", "veiloc_reply"]);
});

test("errors have a kind, and the library stays usable", async () => {
  const core = await Core.load(wasm);
  for (const [head, bytes, kind] of [
    [{ op: "profile" }, new Uint8Array(9), "profile"],
    [{ op: "no" }, new Uint8Array(), "call"],
    [{ op: "step", query: 1, rows: 256 }, new Uint8Array(), "gone"],
    [{ op: "sealer", profile: 1 }, new Uint8Array(), "gone"],
    [{ op: "extract", sealer: 1, width: 4, height: 4 }, new Uint8Array(64), "gone"],
    [{ op: "seal", sealer: 1, extracted: 2 }, new Uint8Array(32), "gone"],
  ]) {
    assert.throws(() => core.call(head, bytes), (error) => error instanceof VeilocError && error.kind === kind, kind);
  }
  const { head, bytes } = core.call({ op: "session" }, new Uint8Array(32).fill(5));
  assert.deepEqual(head, { session: 1, frames: 0, starts: 0 });
  assert.equal(bytes.byteLength, 0);
});

/** A JPEG file without an image. */
const exifFile = (film) => Uint8Array.from([0xff, 0xd8, ...exifSegment(film), 0xff, 0xd9]);

test("EXIF gives a camera for the decoded image", async () => {
  const core = await Core.load(wasm);
  const camera = (file, width, height) => core.call({ op: "exif", width, height }, file).head;
  for (const [width, height] of [[640, 480], [480, 640], [4000, 3000]]) {
    const { camera: text, exif } = camera(exifFile(28), width, height);
    const [model, ...numbers] = text.split(",");
    assert.equal(model, "SIMPLE_PINHOLE");
    assert.ok(exif && Math.abs(numbers[2] - (28 * Math.hypot(width, height)) / Math.hypot(36, 24)) < 1e-6, text);
    assert.deepEqual(numbers.map(Number).filter((_, i) => i !== 2), [width, height, width / 2, height / 2]);
  }
  for (const file of [exifFile(0), exifFile(60000), exifFile(28).subarray(0, 30), new Uint8Array(), new Uint8Array(500).fill(255)]) {
    assert.deepEqual(camera(file, 640, 480), { camera: null, exif: false, turn: 0 });
  }
});

/** The projection of a camera, as WebXR gives it: columns. */
const projection = ([w, h], [fx, fy, cx, cy]) => [(2 * fx) / w, 0, 0, 0, 0, (2 * fy) / h, 0, 0, 1 - (2 * cx) / w, (2 * cy) / h - 1, -1.002, -1, 0, 0, -0.2, 0];

test("the camera of a view projects as the view does", () => {
  const camera = { width: 1080, height: 1920 };
  const view = { camera, projectionMatrix: projection([1080, 1920], [1500, 1490, 530, 975]) };
  const [model, ...numbers] = cameraOfView(view).split(",");
  assert.equal(model, "PINHOLE");
  [1080, 1920, 1500, 1490, 530, 975].forEach((expected, i) => assert.ok(Math.abs(numbers[i] - expected) < 1e-9, numbers));
  // A point to the right, above and in front; pixels from the upper left corner.
  const [x, y, z] = [0.3, 0.4, -2];
  const p = view.projectionMatrix;
  const clip = [0, 1, 3].map((row) => p[row] * x + p[4 + row] * y + p[8 + row] * z + p[12 + row]);
  const pixel = [((1 + clip[0] / clip[2]) / 2) * 1080, ((1 - clip[1] / clip[2]) / 2) * 1920];
  assert.ok(Math.abs(pixel[0] - (1500 * 0.15 + 530)) < 1e-9 && Math.abs(pixel[1] - (975 - 1490 * 0.2)) < 1e-9, pixel);
  for (const wrong of [{ ...view, camera: null }, { ...view, projectionMatrix: p.with(4, 0.1) }, { ...view, projectionMatrix: p.with(11, 0) }, { ...view, projectionMatrix: p.with(0, NaN) }]) {
    assert.throws(() => cameraOfView(wrong), (error) => error.kind === "camera");
  }
  const nothing = { getParameter() {}, createFramebuffer() {} };
  assert.throws(() => cameraImage(nothing, { getCameraImage: () => null }, view), (error) => error.kind === "image");
});

test("an alignment places content after a trusted answer", async () => {
  const alignment = new Alignment(await Core.load(wasm));
  // The camera is 1 m right of where the session began and looks along −z; in the map it is at (2, 0, 0) and looks along z.
  const pose = poseOfView({ transform: { position: new DOMPointLike(1, 0, 0), orientation: new DOMPointLike(0, 0, 0, 1) } });
  const anchor = { position: { x: 2, y: 0, z: 3 }, orientation: { x: 0, y: 0, z: 0, w: 1 } };
  const covariance = Array.from({ length: 6 }, (_, i) => Array.from({ length: 6 }, (_, j) => (i === j ? 1e-6 : 0)));
  const answer = { state: "trusted", doubts: [], cam_from_world: { q: [1, 0, 0, 0], t: [-2, 0, 0] }, covariance, metres_per_unit: 1 };
  assert.deepEqual([alignment.worldFromAnchor(anchor), alignment.cameraInMap(pose), alignment.state], [null, null, "searching"]);
  assert.equal(alignment.add({ ...answer, metres_per_unit: null }, pose), "unknown-unit");
  assert.equal(alignment.add(answer, pose), "used");
  const { position: p } = alignment.worldFromAnchor(anchor);
  assert.ok(Math.hypot(p.x - 1, p.y, p.z + 3) < 1e-9 && alignment.state === "tentative" && alignment.used === 1, JSON.stringify(p));
  const { pose: { position: c } } = alignment.cameraInMap(pose);
  assert.ok(Math.hypot(c.x - 2, c.y, c.z) < 1e-9);
  assert.throws(() => alignment.moved({ ...pose, orientation: { x: 0, y: 0, z: 0, w: 0 } }), (error) => error.kind === "pose");
  assert.throws(() => alignment.add({}, pose), (error) => error.kind === "option");
  alignment.reset();
  assert.equal(alignment.worldFromAnchor(anchor), null);
});

/** As WebXR's points, whose fields are getters. */
class DOMPointLike {
  constructor(...values) {
    ["x", "y", "z", "w"].forEach((name, i) => Object.defineProperty(this, name, { get: () => values[i] }));
  }
}

const { VEILOC_NATIVE: native, VEILOC_DATA: data } = process.env;
test("EXIF cameras of photographs are those of the program", { skip: !(native && data) && "VEILOC_NATIVE or VEILOC_DATA is not set" }, async () => {
  const core = await Core.load(wasm);
  const photos = readdirSync(`${data}/photos`).filter((name) => name.endsWith(".jpg")).map((name) => `${data}/photos/${name}`);
  const cameras = execFileSync(native, ["exif", ...photos], { encoding: "utf8" }).trim().split("\n");
  let found = 0;
  for (const [i, photo] of photos.entries()) {
    const [model, width, height] = cameras[i].split(",");
    const { camera } = core.call({ op: "exif", width: Number(width), height: Number(height) }, readFileSync(photo)).head;
    assert.equal(camera, model === "none" ? null : cameras[i], photo);
    found += camera === null ? 0 : 1;
  }
  assert.ok(found >= 5 && found < photos.length, `${found} of ${photos.length}`);
});

const turn = ([w, x, y, z], v) => {
  const t = [2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])];
  return [v[0] + w * t[0] + y * t[2] - z * t[1], v[1] + w * t[1] + z * t[0] - x * t[2], v[2] + w * t[2] + x * t[1] - y * t[0]];
};

test("orientation of a WebXR pose: forward, right and down", () => {
  const half = Math.SQRT1_2;
  // World: x right at the start, y up, z back. Columns: quaternion x y z w, viewing direction, direction to the right.
  for (const [[x, y, z, w], ahead, right] of [
    [[0, 0, 0, 1], [0, 0, -1], [1, 0, 0]],
    [[0, half, 0, half], [-1, 0, 0], [0, 0, -1]], // to the left
    [[-half, 0, 0, half], [0, -1, 0], [1, 0, 0]], // down
    [[0, 0, 2 * half * 0.6, 2 * half * 0.6], [0, 0, -1], [0, 1, 0]], // on its side; not of unit length
  ]) {
    const { orientation, down } = orientationOfPose({ orientation: { x, y, z, w } });
    const close = (a, b, what) => a.forEach((x, i) => assert.ok(Math.abs(x - b[i]) < 1e-9, `${what} ${ahead}: ${a}`));
    close(turn(orientation, ahead), [0, 0, 1], "ahead");
    close(turn(orientation, right), [1, 0, 0], "right");
    close(turn(orientation, [0, -1, 0]), down, "down");
  }
  assert.equal(orientationOfPose({ orientation: { x: 0, y: NaN, z: 0, w: 1 } }), null);
  assert.equal(orientationOfPose({ orientation: { x: 0, y: 0, z: 0, w: 0 } }), null);
});

test("orientation of a device in known positions: forward, right and down", () => {
  // World: x east, y north, z up. Columns: sensor angles, screen angle, viewing direction, direction to the right.
  for (const [alpha, beta, gamma, screen, ahead, right] of [
    [0, 0, 0, 0, [0, 0, -1], [1, 0, 0]], // flat on a table
    [0, 90, 0, 0, [0, 1, 0], [1, 0, 0]], // upright, looking north
    [90, 90, 0, 0, [-1, 0, 0], [0, 1, 0]], // upright, looking west
    [0, 0, -90, 90, [1, 0, 0], [0, -1, 0]], // on its side, looking east
    [0, 0, 90, -90, [-1, 0, 0], [0, 1, 0]], // on its other side, looking west
    [0, 45, 0, 0, [0, Math.SQRT1_2, -Math.SQRT1_2], [1, 0, 0]],
  ]) {
    const { orientation, down } = orientationOf({ alpha, beta, gamma }, screen);
    const close = (a, b, what) => a.forEach((x, i) => assert.ok(Math.abs(x - b[i]) < 1e-9, `${what} ${alpha} ${beta} ${gamma}: ${a}`));
    close(turn(orientation, ahead), [0, 0, 1], "ahead");
    close(turn(orientation, right), [1, 0, 0], "right");
    close(turn(orientation, [0, 0, -1]), down, "down");
  }
  assert.equal(orientationOf({ alpha: null, beta: 1, gamma: 2 }), null);
});

/** Runs a service that gives the answers in order, and records its requests. */
async function withService(answers, run) {
  const requests = [];
  const server = http.createServer((request, response) => {
    const parts = [];
    request.on("data", (part) => parts.push(part));
    request.on("end", () => {
      requests.push({ url: request.url, headers: request.headers, body: Buffer.concat(parts).toString("hex") });
      const { status = 200, type = "application/json", headers = {}, body = {} } = answers.shift() ?? { status: 500 };
      response.writeHead(status, { "content-type": type, ...headers });
      response.end(typeof body === "string" ? body : JSON.stringify(body));
    });
  });
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  try {
    await run(`http://127.0.0.1:${server.address().port}`, requests);
  } finally {
    server.close();
    server.closeAllConnections();
  }
}

const query = new Uint8Array([1, 2, 3]);
const kind = (kind) => (error) => error instanceof VeilocError && error.kind === kind;
const answer = { version: 1, state: "doubtful", doubts: [{ kind: "other", text: "a\u001b[2Jb\u202e" }], center: [1, 2, 3], cam_from_world: {}, position_sd: 1 };

test("a retry sends the same bytes", async () => {
  const busy = { status: 503, headers: { "retry-after": "0" }, body: { type: "urn:veiloc:problem:queue-full", title: "Busy", detail: "later" } };
  await withService([busy, { ...busy, status: 429 }, { body: answer }], async (address, requests) => {
    const received = await new Client(address, { token: " abc " }).localize("lobby", query);
    assert.deepEqual(received.center, [1, 2, 3]);
    assert.equal(received.doubts[0].text, "a[2Jb");
    assert.deepEqual(requests.map(({ url, body }) => [url, body]), Array(3).fill(["/v1/maps/lobby/localize", "010203"]));
    assert.equal(requests[0].headers.authorization, "Bearer abc");
    assert.equal(requests[0].headers.cookie ?? requests[0].headers.referer, undefined);
  });
});

test("an answer is the document that every interface gives", async () => {
  const document = JSON.parse(readFileSync(new URL("../../crates/core/protocol/tests/data/doubtful.json", import.meta.url), "utf8"));
  await withService([{ body: document }], async (address) => assert.deepEqual(await new Client(address).localize("lobby", query), document));
});

test("refusals have a kind, and permanent ones are not retried", async () => {
  for (const [status, type, name] of [[422, "not-localized", "not-localized"], [401, "unauthorized", "token"], [409, "wrong-profile", "wrong-profile"], [404, "unknown-map", "refused"]]) {
    await withService([{ status, body: { type: `urn:veiloc:problem:${type}`, title: "T", detail: "D" } }], async (address, requests) => {
      await assert.rejects(new Client(address).localize("lobby", query), kind(name));
      assert.equal(requests.length, 1);
    });
  }
  const far = { status: 503, headers: { "retry-after": "3600" } };
  await withService([far, far], async (address, requests) => {
    await assert.rejects(new Client(address).localize("lobby", query), (error) => error.kind === "busy" && error.retryAfter === 3600 && error.retryable);
    assert.equal(requests.length, 1);
  });
});

test("a pack is fetched as its bytes", async () => {
  const none = { status: 404, body: { type: "urn:veiloc:problem:no-pack", title: "T", detail: "D" } };
  await withService([{ type: "application/x-protobuf", body: "pack" }, none, { type: "text/html" }], async (address, requests) => {
    const client = new Client(address, { token: "abc" });
    assert.deepEqual(await client.pack("lobby"), new TextEncoder().encode("pack"));
    assert.deepEqual([requests[0].url, requests[0].headers.authorization], ["/v1/maps/lobby/pack", "Bearer abc"]);
    await assert.rejects(client.pack("lobby"), (error) => error.kind === "refused" && error.problem === "no-pack");
    await assert.rejects(client.pack("lobby"), kind("bad-answer"));
    await assert.rejects(client.pack("a/b"), kind("map-name"));
  });
});

test("anchors are written, deleted, and sorted by distance on the device", async () => {
  const anchor = (name, t) => ({ name, map_from_anchor: { q: [1, 0, 0, 0], t }, content: { name } });
  const list = { body: { version: 1, anchors: [anchor("a", [9, 0, 0]), anchor("b", [1, 2, 2])] } };
  const hostile = [{ anchors: {} }, { anchors: [{ name: "a" }] }, { anchors: [anchor("<b>", [0, 0, 0])] }, { anchors: [anchor("a", [0, null, 0])] }];
  await withService([list, list, { status: 201 }, { status: 200 }, ...hostile.map((body) => ({ body }))], async (address, requests) => {
    const client = new Client(address, { token: "abc" });
    assert.deepEqual(await client.anchors("lobby"), list.body.anchors);
    const nearest = await client.anchors("lobby", { near: [1, 0, 0] });
    assert.deepEqual(nearest.map(({ name, distance }) => [name, distance]), [["b", Math.sqrt(8)], ["a", 8]]);
    assert.equal(requests[1].url, "/v1/maps/lobby/anchors", "the place is not sent");
    await client.putAnchor("lobby", "door.1", { map_from_anchor: { q: [1, 0, 0, 0], t: [1, 2, 3] }, content: "x" });
    await client.deleteAnchor("lobby", "door.1");
    assert.deepEqual(requests[2].url, "/v1/maps/lobby/anchors/door.1");
    assert.deepEqual(JSON.parse(Buffer.from(requests[2].body, "hex")), { map_from_anchor: { q: [1, 0, 0, 0], t: [1, 2, 3] }, content: "x" });
    await assert.rejects(client.deleteAnchor("lobby", "a/b"), kind("anchor"));
    for (const _ of hostile) await assert.rejects(client.anchors("lobby"), kind("bad-answer"));
  });
});

test("invalid answers of a service are refused", async () => {
  for (const invalid of [{ type: "text/html", body: "<h1>Hotel</h1>" }, { body: "{" }, { body: { state: "sure", doubts: [] } }, { body: { ...answer, state: "trusted" } }, { body: { ...answer, doubts: [] } }]) {
    await withService([invalid], (address) => assert.rejects(new Client(address).localize("lobby", query), kind("bad-answer")));
  }
  await withService([{ type: "text/html" }], (address) => assert.rejects(new Client(address).profile("lobby"), kind("bad-answer")));
  await withService([{ body: answer }], async (address) => {
    const received = await new Client(address).localize("lobby", query, { trustedOnly: true });
    assert.ok(!("center" in received) && !("position_sd" in received) && received.state === "doubtful");
  });
  // Redirects to another address are not followed.
  await withService([{ status: 302, headers: { location: "http://127.0.0.1:1/" } }], (address) =>
    assert.rejects(new Client(address, { retries: 0 }).localize("lobby", query), kind("network")));
});

test("plain HTTP and invalid addresses, tokens and map names are refused", () => {
  for (const bad of ["http://places.example", "ftp://127.0.0.1", "https://user:word@places.example", "https://places.example/?a=b"]) {
    assert.throws(() => new Client(bad), kind("address"), bad);
  }
  for (const good of ["http://localhost:8080", "http://127.0.0.1", "http://[::1]:80/", "https://places.example/veiloc/"]) new Client(good);
  new Client("http://places.example", { insecureHttp: true });
  assert.throws(() => new Client("https://a.example", { token: "two words" }), kind("token"));
  return Promise.all(["", "..", "a/b", "a?b", "ä", "x".repeat(65)].map((name) =>
    assert.rejects(new Client("https://a.example").profile(name), kind("map-name"), name)));
});

test("progressive localization stops at the first trusted pose", async () => {
  const sealed = { steps: [256, 512, 1024], step: async (rows) => new Uint8Array(rows), unbalanced: null };
  const none = { status: 422, body: { type: "urn:veiloc:problem:not-localized" } };
  await withService([none, { body: { ...answer, state: "trusted", doubts: [] } }], async (address) => {
    const { steps } = await new Client(address).localizeProgressive("lobby", sealed);
    assert.deepEqual(steps, [{ rows: 256, bytes: 256, outcome: "not-found" }, { rows: 512, bytes: 512, outcome: "trusted" }]);
  });
  await withService([none, none, none], (address) =>
    assert.rejects(new Client(address).localizeProgressive("lobby", sealed), (error) => error.kind === "not-localized" && error.steps.length === 3));
  await assert.rejects(new Client("https://a.example").localizeProgressive("lobby", { ...sealed, unbalanced: "too few" }), kind("unbalanced"));
});
