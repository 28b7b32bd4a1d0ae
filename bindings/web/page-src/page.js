// The page: an image from the camera or a file, what would be sent of it, and where that says you are.
//
// Nothing is sent before somebody presses "Find me" or "Follow me"; until then images are sealed for the eye alone. What is sent is
// a frame of one session, so that what is seen again is told the same way again.

import { Client, VeilocError, load, watchOrientation } from "./index.js";
import { clear, drawAttacked, drawLeaves, drawStays } from "./figures.js";
import { Place } from "./place.js";

const el = (id) => document.getElementById(id);
const server = new URL(".", document.baseURI).href;
const place = new Place(el("map-view"));
const number = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });
const bytes = (count) => (count < 1e6 ? `${number.format(count / 1000)} kB` : `${(count / 1e6).toFixed(1)} MB`);

/** What the page works with now. */
const now = { about: { points: 0, views: [] }, client: null, map: null, device: null, session: null, sensors: null, source: null, shown: null, busy: false, following: false };
/** What is drawn; a later image makes it stale. */
let generation = 0;
/** The attack that runs, if one does: to give it up. */
let attacking = null;

// --- talk

let spoken = 0;

function say(text, state = "", detail = "") {
  // Whoever listens is not told every second what changes every second.
  if (!now.following || performance.now() - spoken > 5000) {
    spoken = performance.now();
    el("spoken").textContent = `${text} ${detail}`;
  }
  el("answer").textContent = text;
  el("answer").dataset.state = state;
  el("detail").textContent = detail;
}

/**
 * Why an image is not sealed though it could be: the third of a place that nobody can turn into the first one's axes. To send it
 * by itself would be easy, and two such images give away what both show (docs/reference/privacy-rules.md, rule L10), so it is not offered.
 */
function refused() {
  const why = el("oriented").checked
    ? "This device has no motion sensors, or keeps them from this page"
    : "The motion sensors are turned off in the settings";
  const then = now.following ? " Following goes on by itself then." : "";
  say(
    "Not sent: another image of this place would tell too much.",
    "waiting",
    `Two were taken here from different spots; lines of a third would cross theirs just where things are. ${why}, so the lines cannot be kept from crossing. ` +
      `Go back to where you stood and rest or turn on the spot, walk on to another part of the place, or use a phone that shares its motion sensors.${then}`,
  );
}

function complain(error) {
  if (error.kind === "too-many-starts") return refused();
  const words = {
    "turned-away": "Turn on, or back: the camera has left what it began with, and hardly sees anything new yet.",
    "not-localized": "This image shows too little of the map to say.",
    busy: "The service is busy; try again in a moment.",
    token: "This service asks who you are: give a token in the settings.",
    lopsided: "Turn or move a little: too little is seen on one side.",
  };
  const known = error instanceof VeilocError;
  say(words[error.kind] ?? (known ? "That did not work." : "Something broke."), "failed", error.message);
  if (error.kind === "token") {
    el("settings").open = true;
    el("token").focus();
  }
  if (!known) console.error(error);
}

function record(what, rows, size, became) {
  el("sent-none").hidden = true;
  el("sent-frame").hidden = false;
  const row = document.createElement("tr");
  const cells = [new Date().toLocaleTimeString(), what, rows === null ? "" : number.format(rows), size === null ? "" : number.format(size), became];
  cells.forEach((text, i) => {
    const cell = document.createElement("td");
    cell.textContent = text;
    if (i === 2 || i === 3) cell.className = "number";
    row.append(cell);
  });
  el("sent").prepend(row);
  while (el("sent").children.length > 200) el("sent").lastChild.remove();
}

function settle() {
  const ready = Boolean(now.source && now.device);
  el("find").disabled = !ready || now.busy || now.following;
  el("follow").disabled = !ready || now.source.kind !== "camera" || !sessions();
  el("follow").setAttribute("aria-pressed", String(now.following));
  el("follow").textContent = now.following ? "Stop following" : "Follow me";
  // Told before it is tried.
  const isUnheld = now.source?.kind === "camera" && !(el("oriented").checked && now.sensors?.now());
  el("unheld").hidden = !(isUnheld && sessions());
}

// --- service and map

async function connect() {
  now.client = new Client(server, { token: el("token").value });
  try {
    const maps = await now.client.maps();
    record("Which maps are there?", null, 0, `${maps.length}`);
    el("map").replaceChildren(...maps.map((map) => new Option(map.name, map.name)));
    el("map-field").hidden = maps.length < 2;
    if (maps.length === 0) return say("This service has no map yet.", "failed");
    await enter(maps[0].name);
  } catch (error) {
    complain(error);
  }
}

/** Makes ready for a map. */
async function enter(name) {
  now.map = name;
  now.device?.close();
  now.device = now.session = now.shown = null;
  settle();
  const profile = await now.client.profile(name);
  record("What does the map need?", null, 0, "profile");
  now.device = await load(profile);
  now.session = await now.device.session();
  say("Nothing about any image has been sent.");
  await points(name);
  settle();
  if (now.source) await refresh();
}

async function points(name) {
  el("place-frame").hidden = false;
  let all = new Float32Array();
  if (now.about.points > 0) {
    const token = el("token").value.trim();
    const reply = await fetch(new URL(`page/points/${encodeURIComponent(name)}`, server), {
      headers: token ? { authorization: `Bearer ${token}` } : {},
      credentials: "omit",
    });
    if (reply.ok) {
      all = new Float32Array(await reply.arrayBuffer());
      record("Points of the map", null, 0, number.format(all.length / 3));
    }
  }
  el("map-view").setAttribute("aria-label", all.length ? `${number.format(all.length / 3)} points of the map; where you are is said above` : "The operator shows no points of this map; where you are is said above");
  place.show(all);
}

// --- images

/** The camera as COLMAP writes it; null to guess. */
function camera(width, height) {
  const text = (now.source.camera ?? el("intrinsics").value).trim();
  if (text === "") return null;
  const focal = Number(text);
  return Number.isFinite(focal) ? `SIMPLE_PINHOLE,${width},${height},${focal},${width / 2},${height / 2}` : text;
}

function options() {
  const most = el("most").value;
  return { scheme: el("scheme").value, ...(most && { maxKeypoints: Number(most) }) };
}

/** Whether frames can share a session: only lines through anchors can be held in the world. */
const sessions = () => el("scheme").value.startsWith("dcl");

/** The image of this moment, and its pixels' size. */
async function grab() {
  const { source } = now;
  if (source.kind !== "camera") return source.bitmap;
  return createImageBitmap(el("video"), { colorSpaceConversion: "none", premultiplyAlpha: "none" });
}

/** Seals the image of this moment: to be sent as a frame of the session, else for the eye alone. */
async function prepare(inSession) {
  const image = await grab();
  const { width, height } = image;
  // The bitmap goes to the worker; a copy is drawn.
  const copy = await createImageBitmap(image);
  const held = inSession && el("oriented").checked ? now.sensors?.now() : null;
  const session = inSession && sessions() ? now.session : undefined;
  const sealed = await now.device.sealed(copy, camera(width, height), { ...options(), session, held });
  return { image, width, height, sealed };
}

async function draw({ image, width, height, sealed }) {
  generation += 1;
  const own = generation;
  // What was shown before is not asked about again.
  if (now.shown && now.shown !== sealed) now.shown.free().catch(() => {});
  now.shown = sealed;
  const shown = await sealed.show();
  if (own !== generation) return;
  drawStays(el("stays"), image, width, height, shown.keypoints);
  el("stays").setAttribute("aria-label", `Your image, ${width} by ${height} pixels, with ${sealed.keypoints} keypoints`);
  el("stays-text").textContent = `${number.format(sealed.keypoints)} keypoints, found in ${number.format(sealed.milliseconds)} ms. ${sealed.focal === "unknown" ? "The focal length is guessed." : ""}`;
  drawLeaves(el("leaves"), shown);
  const what = `${number.format(sealed.rows)} lines with descriptors, at most ${bytes(sealed.bytes.byteLength)}`;
  el("leaves").setAttribute("aria-label", what);
  el("leaves-text").textContent = `${what}, in a random order.${sealed.lopsided ? " Not worth sending: too little on one side." : ""}`;
  // Through the camera an attack is brought to its end, and what was seen meanwhile is not attacked; an image is, at once.
  if (!attacking || now.source?.kind !== "camera") attacked(sealed);
}

/** What an attack makes of it, beside all else: sealing does not wait for it. */
async function attacked(sealed) {
  attacking?.abort();
  const own = new AbortController();
  attacking = own;
  const { value } = el("attack");
  if (value === "graph") el("attack-text").textContent = "Laying out the graph; this takes some seconds.";
  try {
    const result = await sealed.attack(value, { signal: own.signal });
    if (attacking === own) showAttack(result, sealed === now.shown);
  } catch (error) {
    // Given up: for another image, or with its map.
    if (attacking === own && error.kind !== "closed") complain(error);
  } finally {
    if (attacking === own) attacking = null;
  }
}

function showAttack(result, isShown) {
  drawAttacked(el("attacked"), result);
  const px = (x) => (x === null ? "–" : `${number.format(x)} px`);
  const text =
    result.attack === "prior"
      ? `Off by ${px(result.medianPx)} (median), knowing nothing but the lines.`
      : `Off by ${px(result.medianPx)} (median); a guess from each line alone: ${px(result.guessMedianPx)}.`;
  const told = result.toldNeighbours ? "Told every true neighbour, which a query does not say and nobody knows." : "";
  el("attack-text").textContent = `${text} ${told} ${isShown ? "" : "Of an image a moment ago."}`;
  el("attacked").setAttribute("aria-label", `${result.words}: ${text} Yellow: true keypoints, red: answers.`);
}

/** A new image, or other settings: what would be sent of it. */
async function refresh() {
  if (!now.device || !now.source || now.busy) return;
  now.busy = true;
  settle();
  try {
    await draw(await prepare(false));
  } catch (error) {
    complain(error);
  } finally {
    now.busy = false;
    settle();
  }
}

/** Looks through the camera until it is turned off. */
async function watch(stream) {
  while (now.source?.stream === stream && stream.active) {
    if (!now.following && !document.hidden) await refresh();
    await new Promise((done) => setTimeout(done, 400));
  }
}

function stop() {
  now.source?.stream?.getTracks().forEach((track) => track.stop());
  now.following = false;
  now.source = null;
}

async function useCamera() {
  if (now.source?.kind === "camera") {
    stop();
    el("camera").textContent = "Use the camera";
    return settle();
  }
  if (!navigator.mediaDevices) return say("This browser gives no camera to this page.", "failed", "Cameras need https, or this very machine; choose an image instead.");
  try {
    const [stream, sensors] = await Promise.all([
      navigator.mediaDevices.getUserMedia({ video: { facingMode: "environment", width: { ideal: 640 }, height: { ideal: 480 } } }),
      now.sensors ?? watchOrientation(),
    ]);
    now.sensors = sensors;
    stop();
    el("video").srcObject = stream;
    el("video").hidden = false;
    await el("video").play();
    now.source = { kind: "camera", stream };
    el("camera").textContent = "Stop the camera";
    mark(null);
    settle();
    watch(stream);
  } catch (error) {
    say("The camera cannot be used.", "failed", `${error.message}. Allow it in the browser's settings, or choose an image.`);
  }
}

async function useImage(blob, view = null) {
  try {
    const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
    stop();
    el("camera").textContent = "Use the camera";
    now.source = { kind: "image", bitmap, camera: view?.camera };
    mark(view);
    await refresh();
  } catch (error) {
    say("This is no image that the browser reads.", "failed", error.message);
  }
}

function mark(view) {
  for (const button of el("views").children) button.setAttribute("aria-pressed", String(button.dataset.file === view?.file));
}

// --- where

async function locate(prepared) {
  const { sealed } = prepared;
  const began = performance.now();
  try {
    let answer;
    if (el("progressive").checked) {
      let result;
      try {
        result = await now.client.localizeProgressive(now.map, sealed);
      } catch (error) {
        for (const step of error.steps ?? []) record("Sealed query", step.rows, step.bytes, step.outcome);
        throw error;
      }
      for (const step of result.steps) record("Sealed query", step.rows, step.bytes, step.outcome);
      answer = result.answer;
    } else {
      try {
        answer = await now.client.localize(now.map, sealed);
      } catch (error) {
        if (error.kind === "not-localized") record("Sealed query", sealed.rows, sealed.bytes.byteLength, "not-found");
        throw error;
      }
      record("Sealed query", sealed.rows, sealed.bytes.byteLength, answer.state);
    }
    tell(answer, performance.now() - began);
  } catch (error) {
    complain(error);
  }
}

function tell(answer, took) {
  const digits = answer.position_sd > 0 ? Math.min(6, Math.max(1, 1 - Math.floor(Math.log10(answer.position_sd)))) : 3;
  const at = answer.center?.map((x) => x.toFixed(digits)).join(", ");
  const sd = answer.position_sd == null ? "unknown" : answer.position_sd.toPrecision(2);
  const detail = `${number.format(answer.inliers)} of ${number.format(answer.matches)} matches agree; asked and answered in ${number.format(took)} ms.`;
  if (answer.trusted) say(`You are at ${at} ± ${sd}`, "trusted", `Map units. ${detail}`);
  else say(at ? `Perhaps at ${at}; not sure` : "Not sure where this is", "doubtful", `${answer.doubts.map((doubt) => doubt.text).join("; ")}. ${detail}`);
  if (answer.center && answer.cam_from_world) {
    place.add(answer);
    el("map-view").setAttribute("aria-label", `The map's points; ${answer.trusted ? "you are" : "perhaps"} at ${at}`);
  }
}

async function find() {
  if (now.busy || !now.source) return;
  now.busy = true;
  settle();
  if (!now.following) say("Asking…");
  try {
    const prepared = await prepare(true);
    await draw(prepared);
    await locate(prepared);
  } catch (error) {
    complain(error);
  } finally {
    now.busy = false;
    settle();
  }
}

async function follow() {
  now.following = !now.following;
  settle();
  while (now.following && now.source?.kind === "camera") {
    const began = performance.now();
    if (!now.busy && !document.hidden) await find();
    await new Promise((done) => setTimeout(done, Math.max(100, 1000 - (performance.now() - began))));
  }
}

// --- begin

function showViews(views) {
  el("views").hidden = views.length === 0;
  for (const view of views) {
    const button = document.createElement("button");
    button.type = "button";
    button.dataset.file = view.file;
    button.setAttribute("aria-pressed", "false");
    const image = Object.assign(new Image(116, 87), { src: `page/${view.file}`, alt: view.name });
    button.append(image);
    button.addEventListener("click", async () => useImage(await (await fetch(image.src, { credentials: "omit" })).blob(), view));
    el("views").append(button);
  }
}

async function begin() {
  for (const canvas of ["stays", "leaves", "attacked"]) clear(el(canvas));
  if (typeof WebAssembly !== "object" || typeof OffscreenCanvas !== "function" || !AbortSignal.any) {
    return say("This browser is too old to seal images.", "failed", "Chrome 116, Firefox 124, Safari 17.4 or newer is needed.");
  }
  el("camera").addEventListener("click", useCamera);
  el("file").addEventListener("change", ({ target }) => target.files[0] && useImage(target.files[0]));
  el("map").addEventListener("change", ({ target }) => enter(target.value).catch(complain));
  el("token").addEventListener("change", connect);
  for (const id of ["intrinsics", "scheme", "most"]) el(id).addEventListener("change", refresh);
  el("oriented").addEventListener("change", settle);
  el("attack").addEventListener("change", () => now.shown && attacked(now.shown));
  el("find").addEventListener("click", find);
  el("follow").addEventListener("click", follow);
  const about = await fetch(new URL("page/page.json", server), { credentials: "omit" });
  if (about.ok) now.about = await about.json();
  showViews(now.about.views);
  await connect();
}

begin();
