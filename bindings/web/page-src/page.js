// The page: takes an image from the camera or a file, shows what would be sent of it, and localizes it.
//
// Nothing of an image is sent before the user presses "Find me" or "Follow me"; until then images are sealed for display only. All
// sent queries belong to one session, so that a keypoint seen again is sent with the same anchor.

import { Client, VeilocError, load, storedBitmap, watchOrientation } from "./index.js";
import { clear, drawAttackResult, drawLeaves, drawStays } from "./figures.js";
import { MapView } from "./map_view.js";

const el = (id) => document.getElementById(id);
const server = new URL(".", document.baseURI).href;
const mapView = new MapView(el("map-view"));
const number = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });
const bytes = (count) => (count < 1e6 ? `${number.format(count / 1000)} kB` : `${(count / 1e6).toFixed(1)} MB`);

/** The state of the page. */
const now = { about: { points: 0, people: false, views: [], north: {} }, client: null, map: null, facts: {}, anchors: [], answer: null, device: null, network: null, people: null, sealer: null, options: "", session: null, sensors: null, source: null, shown: null, busy: false, stale: false, finding: false, refreshed: Promise.resolve(), following: false };
/** Number of the displayed image; a later image makes a pending drawing stale. */
let generation = 0;
/** `AbortController` of the running attack, or null. */
let attacking = null;

// --- messages

let lastAnnouncement = 0;

function showStatus(text, state = "", detail = "") {
  // While following, the status changes every second: screen readers announce it at most every 5 s.
  if (!now.following || performance.now() - lastAnnouncement > 5000) {
    lastAnnouncement = performance.now();
    el("announcement").textContent = `${text} ${detail}`;
  }
  el("answer").textContent = text;
  el("answer").dataset.state = state;
  el("detail").textContent = detail;
}

/**
 * Explains why a third image of a scene is not sealed: without the camera's orientation its anchors cannot be aligned with those of
 * the session. The page does not offer to seal it without a session, because the lines of two such images reveal the keypoints that
 * both show (docs/reference/privacy-rules.md, rule L10).
 */
function showTooManyStarts() {
  const isLive = now.source?.kind === "camera";
  const why = el("oriented").checked
    ? "The motion sensors, which prevent this, are not available on this device or in this browser."
    : "The motion sensors, which prevent this, are switched off in the settings.";
  const then = now.following ? " Then following continues automatically." : "";
  showStatus(
    "Not sent: another image of this place would reveal too much.",
    "waiting",
    "Two images were already taken from different spots. The lines of a third image would cross theirs exactly at the keypoints. " +
      (isLive
        ? `${why} Go back to your earlier spot and stand still or turn on the spot, walk to a different area, or use a phone with motion sensors.${then}`
        : "Choose an image of another area, or one from the spot where the last one was taken, turned on the spot. To ask more often at one place, use the camera of a phone with motion sensors from the start."),
  );
}

/** What happened, and what the user can do. Without a remedy here, the message of the library or the service is shown. */
const ERRORS = {
  "turned-away": ["Turn further, or turn back.", "The camera sees too little of the first view, and not enough of a new one."],
  "not-localized": ["Position not found.", "This image shows too little of the map, or the place has changed. Point the camera at something with more detail, or walk a few steps, and try again."],
  busy: ["The service is busy.", "Try again in a moment."],
  token: ["This service needs an access token.", "Open the link that you were given or scan its code, or enter the token in the settings."],
  "token-refused": ["This service does not accept your access token.", "It may have expired: ask for a new link."],
  "wrong-profile": ["The map was replaced.", "Reload this page, and take another image from a few steps away."],
  network: ["The service cannot be reached.", "Check your connection, and try again."],
  unbalanced: ["One side of the image has too little detail.", "Turn or move a little, and try again."],
};

function showError(error) {
  if (error.kind === "too-many-starts") return showTooManyStarts();
  const known = error instanceof VeilocError;
  const name = error.kind === "token" && el("token").value.trim() ? "token-refused" : error.kind;
  const [what, remedy = error.message] = ERRORS[name] ?? [known ? "This did not work." : "An unexpected error occurred."];
  showStatus(what, "failed", remedy);
  if (error.kind === "token") {
    el("settings").open = true;
    el("token").focus();
  }
  if (!known) console.error(error);
}

/** Adds a row to the table of requests. */
function record(what, rows, size, result) {
  el("sent-none").hidden = true;
  el("sent-frame").hidden = false;
  const row = document.createElement("tr");
  const cells = [new Date().toLocaleTimeString(), what, rows === null ? "" : number.format(rows), size === null ? "" : number.format(size), result];
  cells.forEach((text, i) => {
    const cell = document.createElement("td");
    cell.textContent = text;
    if (i === 2 || i === 3) cell.className = "number";
    row.append(cell);
  });
  el("sent").prepend(row);
  while (el("sent").children.length > 200) el("sent").lastChild.remove();
}

/** What schemes for comparison do not protect. */
const WEAK = {
  "random-lines": "This protects less: anyone who reads such a query finds most keypoints.",
  "coordinate-permutation": "This protects less: anyone who reads such a query finds a part of the keypoints.",
};

function updateButtons() {
  const ready = Boolean(now.source && now.device);
  // Sealing for display does not disable it: that would take the click that ends the typing of a setting.
  el("find").disabled = !ready || now.finding || now.following;
  el("follow").disabled = !ready || now.source.kind !== "camera" || !sessions();
  el("follow").setAttribute("aria-pressed", String(now.following));
  el("follow").textContent = now.following ? "Stop following" : "Follow me";
  el("weak").textContent = WEAK[el("scheme").value] ?? "";
  el("weak").hidden = el("weak").textContent === "";
  // Shown before the user tries to walk.
  const hasNoOrientation = now.source?.kind === "camera" && !(el("oriented").checked && now.sensors?.now());
  el("no-sensors").hidden = !(hasNoOrientation && sessions());
}

// --- service and map

/** The token of a link `#token=…`, which leaves the address bar at once, or of this tab. A fragment is never sent to a server. */
function givenToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) history.replaceState(null, "", location.pathname + location.search);
  return given ?? inTab();
}

/** Reads the token of this tab, or replaces it. */
function inTab(token) {
  try {
    if (token !== undefined) sessionStorage.setItem("veiloc token", token);
    return sessionStorage.getItem("veiloc token") ?? "";
  } catch {
    return token ?? ""; // The browser stores nothing.
  }
}

async function connect() {
  inTab(el("token").value.trim());
  try {
    now.client = new Client(server, { token: el("token").value });
    const maps = await now.client.maps();
    now.facts = Object.fromEntries(maps.map((map) => [map.name, map]));
    record("List of maps", null, 0, `${maps.length} ${maps.length === 1 ? "map" : "maps"}`);
    el("map").replaceChildren(...maps.map((map) => new Option(map.name, map.name)));
    el("map-field").hidden = maps.length < 2;
    if (maps.length === 0) return showStatus("This service has no map.", "failed");
    await selectMap(maps[0].name);
  } catch (error) {
    showError(error);
  }
}

/** The identifier of a profile, and the one of the last visit when it is another one. */
function seenProfile(name, id) {
  const key = `veiloc profile ${name}`;
  try {
    const before = localStorage.getItem(key);
    localStorage.setItem(key, id);
    return before && before !== id ? `${id}, before ${before}` : id;
  } catch {
    return id; // The browser stores nothing.
  }
}

/** Prepares to seal for a map. */
async function selectMap(name) {
  now.map = name;
  now.device?.close();
  now.device = now.sealer = now.session = now.shown = null;
  updateButtons();
  const profile = await now.client.profile(name);
  now.device = await load(profile);
  record("Profile of the map", null, 0, seenProfile(name, now.device.id));
  now.people = now.network && (await now.device.segmenter(now.network));
  now.session = await now.device.session();
  showStatus("Ready. Nothing about an image has been sent.");
  await points(name);
  updateButtons();
  if (now.source) await refresh();
}

/** Fetches something of the service that it may not have; null then. */
async function optional(path) {
  const token = el("token").value.trim();
  const reply = await fetch(new URL(path, server), { headers: token ? { authorization: `Bearer ${token}` } : {}, credentials: "omit" }).catch(() => null);
  return reply?.ok ? reply : null;
}

/** Shows the map: its points if the service publishes some, and its named anchors. */
async function points(name) {
  el("position-frame").hidden = false;
  let all = new Float32Array();
  const reply = now.about.points > 0 ? await optional(`page/points/${encodeURIComponent(name)}`) : null;
  if (reply) {
    all = new Float32Array(await reply.arrayBuffer());
    record("Points of the map", null, 0, number.format(all.length / 3));
  }
  now.anchors = await anchors(name);
  const hint = all.length ? `${number.format(all.length / 3)} points of the map.` : "This service publishes no points of the map. Your camera appears beside the map's axes.";
  el("map-hint").textContent = hint;
  el("map-view").setAttribute("aria-label", `${hint} The text above gives your position.`);
  const { down, metres_per_unit: metres } = now.facts[name] ?? {};
  const turn = (now.about.north?.[name] * Math.PI) / 180;
  const isLevel = !down || down[2] < -0.9999;
  const north = Number.isFinite(turn) && isLevel ? [Math.sin(turn), Math.cos(turn), 0] : null;
  mapView.show(all, { down, north, metres: metres === 1, anchors: now.anchors });
}

/** The named anchors of the map, with their positions; none where the service has none. */
async function anchors(name) {
  const list = await (await optional(`v1/maps/${encodeURIComponent(name)}/anchors`))?.json().catch(() => null);
  const known = (list?.anchors ?? []).filter(({ name, map_from_anchor: pose }) => typeof name === "string" && pose?.t?.length === 3 && pose.t.every(Number.isFinite));
  if (known.length) record("Anchors of the map", null, 0, number.format(known.length));
  return known.map(({ name, map_from_anchor: pose }) => ({ name, at: pose.t }));
}

// --- images

/** The camera as a COLMAP string; null when it is unknown. */
function camera(width, height) {
  const text = (now.source.camera ?? el("intrinsics").value).trim();
  if (text === "") return null;
  const focal = Number(text);
  return Number.isFinite(focal) ? `SIMPLE_PINHOLE,${width},${height},${focal},${width / 2},${height / 2}` : text;
}

/** The sealer with the options of the settings. */
async function sealer() {
  const maxKeypoints = el("max-keypoints").value;
  const options = { scheme: el("scheme").value, ...(maxKeypoints && { maxKeypoints: Number(maxKeypoints) }) };
  const text = JSON.stringify(options);
  if (!now.sealer || now.options !== text) {
    now.sealer?.free().catch(() => {});
    now.sealer = await now.device.sealer(options);
    now.options = text;
  }
  return now.sealer;
}

/** Whether the scheme supports sessions: only anchored lines have anchors that can be fixed in the world. */
const sessions = () => el("scheme").value.startsWith("dcl");

/** The current image. */
async function grab() {
  const { source } = now;
  if (source.kind !== "camera") return source.bitmap;
  return storedBitmap(el("video"));
}

/** Seals the current image: in the session, to be sent; or without it, for display only. */
async function prepare(inSession) {
  const { file } = now.source;
  const image = await grab();
  const { width, height } = image;
  // The bitmap goes to the worker; a copy is drawn.
  const copy = await createImageBitmap(image);
  // Not for the image of a file, which the device took earlier, or another one.
  const measured = inSession && now.source.kind === "camera" && el("oriented").checked;
  const attitude = measured ? now.sensors?.now() : null;
  const own = await sealer();
  const people = el("people").checked ? now.people : null;
  const extracted = await own.extract(copy, camera(width, height), { attitude, file, people });
  const sealed = await (inSession && sessions() ? own.inSession(now.session) : own).seal(extracted);
  return { image, width, height, sealed, hidden: people && extracted.hidden };
}

/** What is known of the focal length. */
const FOCAL = { calibrated: "", exif: "The focal length is that of the file's EXIF data.", unknown: "The focal length is unknown." };

async function draw({ image, width, height, sealed, hidden }) {
  generation += 1;
  const own = generation;
  // The query displayed before is not needed any more.
  if (now.shown && now.shown !== sealed) now.shown.free().catch(() => {});
  now.shown = sealed;
  const shown = await sealed.show();
  if (own !== generation) return;
  drawStays(el("stays"), image, width, height, shown.keypoints);
  el("stays").setAttribute("aria-label", `Your image, ${width} by ${height} pixels, with ${sealed.keypoints} keypoints`);
  el("stays-text").textContent = `${number.format(sealed.keypoints)} keypoints, found in ${number.format(sealed.milliseconds)} ms. ${hidden === null ? "" : hidden > 0 ? `People hidden, ${number.format(100 * hidden)} % of the image.` : "No people found: nothing is hidden."} ${FOCAL[sealed.focal]}`;
  drawLeaves(el("leaves"), shown);
  const what = `${number.format(sealed.rows)} lines with descriptors, at most ${bytes(sealed.bytes.byteLength)}`;
  el("leaves").setAttribute("aria-label", what);
  el("leaves-text").textContent = `${what}, in a random order.${sealed.unbalanced ? " It cannot be localized: one side of the image has too little detail." : ""} ${WEAK[el("scheme").value] ?? ""}`;
  // With a live camera a running attack is finished first, and images meanwhile are skipped; a chosen image is attacked at once.
  if (!attacking || now.source?.kind !== "camera") runAttack(sealed);
}

/** Attacks a query in the background; sealing does not wait for it. */
async function runAttack(sealed) {
  attacking?.abort();
  attacking = null;
  if (el("attack").value === "operator") return showOperator(sealed).catch(() => {}); // It was replaced meanwhile.
  const own = new AbortController();
  attacking = own;
  const { value } = el("attack");
  if (value === "graph") el("attack-text").textContent = "The attack is running; this takes some seconds.";
  try {
    const result = await sealed.attack(value, { signal: own.signal });
    if (attacking === own) showAttack(result, sealed === now.shown);
  } catch (error) {
    // An aborted attack, after another image or map was chosen, is no error.
    if (attacking === own && error.kind !== "closed") showError(error);
  } finally {
    if (attacking === own) attacking = null;
  }
}

/**
 * The attacker that matters: it has the map's images, and the pose as soon as it has found one. This page has neither, so it draws the
 * worst case, every keypoint, and says how far the service got with this image, or with those of the tests.
 */
async function showOperator(sealed) {
  const { width, height, hidden } = await sealed.show();
  if (sealed !== now.shown) return;
  drawAttackResult(el("attacked"), { width, height, answers: hidden, truth: [] });
  const found = now.answer?.sealed === sealed ? now.answer.inliers : null;
  const matched = found
    ? `The service found you, so it knows ${number.format(found)} of these keypoints to about 2 px.`
    : "When the service has found you, it knows the keypoints that match its map to about 2 px.";
  el("attack-text").textContent = `${matched} Of the others it may know those that its own images show. Drawn is the worst case, all of them.`;
  el("attacked").setAttribute("aria-label", `The keypoints that were sent. ${matched}`);
}

function showAttack(result, isShown) {
  drawAttackResult(el("attacked"), result);
  const px = (x) => (x === null ? "–" : `${number.format(x)} px`);
  const text =
    result.attack === "prior"
      ? `Median error ${px(result.medianPx)}, from each line alone.`
      : `Median error ${px(result.medianPx)}; from each line alone: ${px(result.priorMedianPx)}.`;
  const neighbours = result.trueNeighbours ? "This attack uses the true neighbours of each keypoint, which no attacker has." : "";
  el("attack-text").textContent = `${text} ${neighbours} ${isShown ? "" : "For an earlier image."}`;
  el("attacked").setAttribute("aria-label", `${result.words}: ${text} Yellow: true keypoints, red: recovered keypoints.`);
}

/** Shows what would be sent after a new image or a changed setting. While another image is sealed, this one follows it. */
function refresh() {
  now.stale = true;
  if (!now.busy && !now.finding) now.refreshed = sealForDisplay();
  return now.refreshed;
}

async function sealForDisplay() {
  now.busy = true;
  updateButtons();
  while (now.stale && now.device && now.source) {
    now.stale = false;
    try {
      await draw(await prepare(false));
    } catch (error) {
      showError(error);
    }
  }
  now.busy = false;
  updateButtons();
}

/** Shows what would be sent of the camera's images until it is turned off. */
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
    return updateButtons();
  }
  if (!navigator.mediaDevices) return showStatus("This page cannot use the camera.", "failed", "Browsers allow the camera only on https pages and on localhost. Choose an image instead.");
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
    updateButtons();
    watch(stream);
  } catch (error) {
    showStatus("The camera cannot be used.", "failed", `${error.message}. Allow it in the browser's settings, or choose an image.`);
  }
}

async function useImage(blob, view = null) {
  try {
    const bitmap = await storedBitmap(blob);
    stop();
    el("camera").textContent = "Use the camera";
    now.source = { kind: "image", bitmap, file: blob, camera: view?.camera };
    mark(view);
    await refresh();
  } catch (error) {
    showStatus("The browser cannot read this image.", "failed", error.message);
  }
}

function mark(view) {
  for (const button of el("views").children) button.setAttribute("aria-pressed", String(button.dataset.file === view?.file));
}

// --- localization

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
    now.answer = { sealed, inliers: answer.inliers };
    if (el("attack").value === "operator") showOperator(sealed).catch(() => {});
    showAnswer(answer, performance.now() - began);
  } catch (error) {
    showError(error);
  }
}

function showAnswer(answer, milliseconds) {
  const digits = answer.position_sd > 0 ? Math.min(6, Math.max(1, 1 - Math.floor(Math.log10(answer.position_sd)))) : 3;
  // The service knows no other unit than the metre.
  const unit = answer.metres_per_unit === 1 ? "m" : "map units";
  const at = answer.center?.map((x) => x.toFixed(digits)).join(", ");
  const sd = answer.position_sd == null ? "" : ` ± ${answer.position_sd.toPrecision(2)}`;
  const near = answer.center ? nearest(answer.center, unit) : "";
  const detail = `${near}${number.format(answer.inliers)} of ${number.format(answer.matches)} matches agree; the answer took ${number.format(milliseconds)} ms.`;
  const isTrusted = answer.state === "trusted";
  if (isTrusted) showStatus(`You are at ${at}${sd} ${unit}`, "trusted", detail);
  else showStatus(at ? `Not sure: perhaps at ${at} ${unit}` : "Not sure where this is", "doubtful", `${answer.doubts.map((doubt) => doubt.text).join("; ")}. ${detail}`);
  if (answer.center && answer.cam_from_world) {
    mapView.add(answer);
    el("map-view").setAttribute("aria-label", `The map's points; ${isTrusted ? "you are" : "perhaps you are"} at ${at}`);
  }
}

/** How far it is to the nearest named anchor, as a sentence; empty without one. */
function nearest(center, unit) {
  const all = now.anchors.map(({ name, at }) => ({ name, far: Math.hypot(...at.map((x, i) => x - center[i])) }));
  const best = all.sort((a, b) => a.far - b.far)[0];
  return best ? `${Number(best.far.toPrecision(2))} ${unit} from ${best.name}. ` : "";
}

async function find() {
  if (now.finding || !now.source) return;
  now.finding = true;
  updateButtons();
  if (!now.following) showStatus("Finding your position…");
  // The image may be sealed for display with a setting that was just changed.
  await now.refreshed;
  now.busy = true;
  now.stale = false;
  try {
    const prepared = await prepare(true);
    await draw(prepared);
    await locate(prepared);
  } catch (error) {
    showError(error);
  } finally {
    now.busy = false;
    now.finding = false;
    updateButtons();
  }
  if (now.stale) refresh();
}

async function follow() {
  now.following = !now.following;
  updateButtons();
  while (now.following && now.source?.kind === "camera") {
    const began = performance.now();
    if (!now.busy && !document.hidden) await find();
    await new Promise((done) => setTimeout(done, Math.max(100, 1000 - (performance.now() - began))));
  }
}

// --- start

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
  el("token").value = givenToken();
  if (typeof WebAssembly !== "object" || typeof OffscreenCanvas !== "function" || !AbortSignal.any) {
    return showStatus("This browser is too old for this page.", "failed", "Use Chrome 116, Firefox 124, Safari 17.4, or newer.");
  }
  el("camera").addEventListener("click", useCamera);
  el("file").addEventListener("change", ({ target }) => target.files[0] && useImage(target.files[0]));
  el("map").addEventListener("change", ({ target }) => selectMap(target.value).catch(showError));
  el("token").addEventListener("change", connect);
  addEventListener("hashchange", () => {
    const given = givenToken();
    if (given === el("token").value) return;
    el("token").value = given;
    connect();
  });
  for (const id of ["intrinsics", "scheme", "max-keypoints", "people"]) el(id).addEventListener("change", refresh);
  el("scheme").addEventListener("change", updateButtons);
  el("oriented").addEventListener("change", updateButtons);
  el("attack").addEventListener("change", () => now.shown && runAttack(now.shown));
  el("find").addEventListener("click", find);
  el("follow").addEventListener("click", follow);
  const about = await fetch(new URL("page/page.json", server), { credentials: "omit" });
  if (about.ok) now.about = await about.json();
  if (now.about.people) {
    now.network = new Uint8Array(await (await fetch(new URL("page/selfie_segmentation.tflite", server), { credentials: "omit" })).arrayBuffer());
    el("people-field").hidden = false;
  }
  showViews(now.about.views);
  await connect();
}

begin();
