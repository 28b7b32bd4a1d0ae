// Private visual localization in the browser: the device seals an image, and only the sealed query leaves it.
//
//   import { Client, load } from "veiloc";
//   const client = new Client("https://places.example:8443", { token });
//   const device = await load(await client.profile("lobby"));
//   const sealer = await device.sealer();
//   const query = await sealer.seal(await sealer.extract(image, "SIMPLE_RADIAL,1296,1936,2435.4,648,968,-0.034"));
//   const { state, center, position_sd } = await client.localize("lobby", query);

import { Core, VeilocError } from "./core.js";
import { Alignment } from "./webxr.js";

export { Client } from "./client.js";
export { orientationOf, orientationOfPose, watchOrientation } from "./orientation.js";
export { cameraImage, cameraOfView, poseOfView } from "./webxr.js";
export { VeilocError };

/** A worker and its pending calls. `device.close()` ends it. */
class WorkerConnection {
  #worker;
  #waiting = new Map();
  #last = 0;

  constructor(worker) {
    this.#worker = worker;
    worker.onmessage = ({ data: { id, error, ...answer } }) => {
      const { done, fail } = this.#waiting.get(id) ?? {};
      this.#waiting.delete(id);
      if (error) fail?.(new VeilocError(error.kind, error.message));
      else done?.(answer);
    };
    worker.onerror = (event) => this.end(new VeilocError("worker", event.message || "the worker could not be started"));
  }

  request(job, rest = {}, transfer = []) {
    if (!this.#worker) return Promise.reject(new VeilocError("closed", "the device was closed"));
    this.#last += 1;
    const id = this.#last;
    return new Promise((done, fail) => {
      this.#waiting.set(id, { done, fail });
      this.#worker.postMessage({ id, job, ...rest }, transfer);
    });
  }

  end(reason) {
    this.#worker?.terminate();
    this.#worker = null;
    for (const { fail } of this.#waiting.values()) fail(reason);
    this.#waiting.clear();
  }
}

/**
 * Runs attacks one after the other in a worker of their own, because they take seconds and must not delay sealing. The first
 * attack starts the worker. To abort an attack the worker is terminated, because WebAssembly cannot be interrupted.
 */
class AttackQueue {
  #start;
  #module;
  #connection = null;
  #last = Promise.resolve();
  #closed = false;

  constructor(start, module) {
    this.#start = start;
    this.#module = module;
  }

  request(head, bytes, signal) {
    const own = this.#last.then(() => this.#run(head, bytes, signal));
    this.#last = own.catch(() => {});
    return own;
  }

  async #run(head, bytes, signal) {
    signal?.throwIfAborted();
    if (this.#closed) throw new VeilocError("closed", "the device was closed");
    const isNew = !this.#connection;
    this.#connection ??= new WorkerConnection(this.#start());
    const connection = this.#connection;
    const endWorker = (reason) => {
      connection.end(reason);
      if (this.#connection === connection) this.#connection = null;
    };
    const aborted = () => endWorker(signal.reason);
    signal?.addEventListener("abort", aborted, { once: true });
    try {
      if (isNew) await connection.request("load", { wasm: this.#module });
      return await connection.request("call", { head, bytes }, [bytes.buffer]);
    } catch (error) {
      // A worker that did not start, or whose library trapped, cannot be used any more.
      if (["worker", "broken"].includes(error.kind)) endWorker(error);
      throw error;
    } finally {
      signal?.removeEventListener("abort", aborted);
    }
  }

  end(reason) {
    this.#closed = true;
    this.#connection?.end(reason);
  }
}

/**
 * Prepares to seal for the map of a profile. Throws `VeilocError` `other-profile` when `profileId` is given and the profile has another
 * identifier.
 */
export async function load(profile, { profileId, worker, wasm = new URL("./veiloc.wasm", import.meta.url) } = {}) {
  const own = () => new Worker(new URL("./worker.js", import.meta.url), { type: "module", name: "veiloc" });
  const start = typeof worker === "function" ? worker : own;
  const connection = new WorkerConnection(worker instanceof Worker ? worker : start());
  try {
    const { module } = await connection.request("load", { wasm: wasm instanceof WebAssembly.Module ? wasm : String(wasm) });
    const { head } = await connection.request("call", { head: { op: "profile" }, bytes: profile });
    if (profileId && profileId.toLowerCase() !== head.id) {
      throw new VeilocError("other-profile", `the profile is ${head.id}, not ${profileId}; compare it with the id that the operator publishes`);
    }
    return new Device(connection, start, module, head);
  } catch (error) {
    connection.end(error);
    throw error;
  }
}

class Device {
  #connection;
  #attacks;
  #module;
  #core;
  #profile;

  constructor(connection, start, module, { profile, ...facts }) {
    this.#connection = connection;
    this.#attacks = new AttackQueue(start, module);
    this.#module = module;
    this.#profile = profile;
    Object.assign(this, facts);
  }

  /**
   * A sealer: it seals images with these options. Most apps need one. Throws `VeilocError` `other-pack` when `packId` is given and the
   * pack has another identifier.
   */
  async sealer(options = {}) {
    const { pack, packId, ...rest } = options;
    const given = pack === undefined ? {} : { pack: true };
    const { head } = await this.#connection.request("call", { head: { op: "sealer", profile: this.#profile, ...rest, ...given }, bytes: pack });
    const sealer = new Sealer(this.#connection, this.#attacks, head.sealer);
    if (packId && packId.toLowerCase() !== head.pack) {
      await sealer.free();
      throw new VeilocError("other-pack", `the pack is ${head.pack}, not ${packId}; compare it with the id that the operator publishes`);
    }
    return sealer;
  }

  /**
   * Starts or resumes a session. Seal several images of one scene in one session; otherwise their lines intersect at the keypoints
   * (rule L10).
   */
  async session({ anchors, bytes } = {}) {
    const { head } = bytes
      ? await this.#connection.request("call", { head: { op: "sessionFrom" }, bytes })
      : await this.#connection.request("session", { head: { op: "session", ...(anchors && { anchors }) } });
    return new Session(this.#connection, head.session);
  }

  /** Begins an alignment of an AR world with the map. It runs in this thread, so that each animation frame can ask it. */
  async alignment({ metresPerUnit } = {}) {
    this.#core ??= Core.load(this.#module);
    return new Alignment(await this.#core, { ...(metresPerUnit !== undefined && { metresPerUnit }) });
  }

  /** Reads selfie_segmentation.tflite of MediaPipe (Apache-2.0), for `people` of `extract`. */
  async segmenter(bytes) {
    return (await this.#connection.request("call", { head: { op: "segmenter" }, bytes })).head.segmenter;
  }

  /** Terminates the workers and discards their state. */
  close() {
    const reason = new VeilocError("closed", "the device was closed");
    this.#connection.end(reason);
    this.#attacks.end(reason);
  }
}

class Sealer {
  #connection;
  #attacks;
  #handle;
  #session;

  constructor(connection, attacks, handle, session) {
    this.#connection = connection;
    this.#attacks = attacks;
    this.#handle = handle;
    this.#session = session;
  }

  /** Extracts the features of an image. They stay in the worker. */
  async extract(image, camera = null, { attitude, mask, people, file = image } = {}) {
    const [rest, transfer] = await imageArguments({ op: "extract", sealer: this.#handle, camera, people, ...attitude }, image);
    if (mask) {
      const { width, height, data, kind = "marked", margin } = mask;
      rest.head.mask = { width, height, kind, ...(margin !== undefined && { margin }) };
      // Confidences of MediaPipe are numbers from 0 to 1.
      rest.mask = data instanceof Float32Array ? Uint8Array.from(data, (share) => Math.round(255 * share)) : data;
    }
    // For the focal length and the turn in its EXIF data; the bytes stay in the worker.
    if ((camera === null || people) && file instanceof Blob) rest.file = new Uint8Array(await file.arrayBuffer());
    const { head } = await this.#connection.request("extract", rest, transfer);
    return head;
  }

  /** Seals the features of an image, once. When the network fails, send the same bytes again. */
  async seal({ extracted, milliseconds }) {
    const head = { op: "seal", sealer: this.#handle, extracted, session: this.#session?.handle };
    const { head: reply, bytes } = await this.#connection.request("seal", { head });
    reply.milliseconds += milliseconds;
    return new Sealed(this.#connection, this.#attacks, reply, bytes);
  }

  /** The same sealer, for the images of a session. */
  inSession(session) {
    return new Sealer(this.#connection, this.#attacks, this.#handle, session);
  }

  /** Frees the sealer in the worker; queries that it sealed stay usable. */
  free() {
    return this.#connection.request("call", { head: { op: "free", handle: this.#handle } }).then(() => undefined);
  }
}

class Session {
  #connection;

  constructor(connection, handle) {
    this.#connection = connection;
    this.handle = handle;
  }

  /** The state of the session, to resume it later. Keep it secret: it holds keypoint positions. */
  async bytes() {
    return (await this.#connection.request("call", { head: { op: "sessionBytes", session: this.handle } })).bytes;
  }
}

class Sealed {
  #connection;
  #attacks;
  #query;

  constructor(connection, attacks, { query, ...facts }, bytes) {
    this.#connection = connection;
    this.#attacks = attacks;
    this.#query = query;
    Object.assign(this, facts, { bytes });
  }

  /** The bytes of the first `rows` rows; `rows` is one of `steps`. */
  async step(rows) {
    return (await this.#connection.request("call", { head: { op: "step", query: this.#query, rows } })).bytes;
  }

  /** The lines that the query holds and the keypoints that it hides; only for the screen of this device. */
  async show() {
    const { head, bytes } = await this.#connection.request("call", { head: { op: "show", query: this.#query } });
    const numbers = new Float32Array(bytes.buffer, bytes.byteOffset, bytes.byteLength / 4);
    const found = 4 * head.segments;
    const hidden = found + 2 * head.keypoints;
    return {
      width: head.width,
      height: head.height,
      anchors: head.anchors,
      segments: numbers.subarray(0, found),
      keypoints: numbers.subarray(found, hidden),
      hidden: numbers.subarray(hidden),
    };
  }

  /** Runs an attack of the audit on the query, in a worker of its own. `signal` aborts it. */
  async attack(attack = "closed-form", { signal } = {}) {
    const exhibit = await this.#connection.request("call", { head: { op: "exhibit", query: this.#query } });
    const { head, bytes } = await this.#attacks.request({ op: "attack", attack, ...exhibit.head }, exhibit.bytes, signal);
    const numbers = new Float32Array(bytes.buffer, bytes.byteOffset, bytes.byteLength / 4);
    return { ...head, answers: numbers.subarray(0, 2 * head.count), truth: numbers.subarray(2 * head.count) };
  }

  /** Frees the query in the worker. */
  free() {
    return this.#connection.request("call", { head: { op: "free", handle: this.#query } }).then(() => undefined);
  }
}

/**
 * The pixels of an image as they are stored, without colour conversion: the EXIF orientation is not applied, as in all of veiloc, so
 * that all photographs of a phone have one camera.
 */
export async function storedBitmap(image) {
  const stored = image instanceof Blob ? new Blob([asStored(new Uint8Array(await image.arrayBuffer()))], { type: image.type }) : image;
  return createImageBitmap(stored, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
}

/** The bytes of an image file whose EXIF says that it is displayed as it is stored: browsers apply the orientation, whatever `imageOrientation` is. */
function asStored(bytes) {
  const view = new DataView(bytes.buffer);
  const word = (at) => String.fromCharCode(...bytes.subarray(at, at + 4));
  try {
    if (bytes[0] === 0xff && bytes[1] === 0xd8) {
      // Segments of a JPEG, up to the coded samples.
      for (let at = 2; bytes[at] === 0xff && bytes[at + 1] !== 0xda; at += 2 + view.getUint16(at + 2)) {
        if (bytes[at + 1] === 0xe1 && word(at + 4) === "Exif") setUpright(view, at + 10);
      }
    } else if (word(0) === "RIFF" && word(8) === "WEBP") {
      for (let at = 12; at + 8 <= bytes.length; ) {
        const size = view.getUint32(at + 4, true);
        if (word(at) === "EXIF") setUpright(view, word(at + 8) === "Exif" ? at + 14 : at + 8);
        at += 8 + size + (size % 2);
      }
    }
  } catch (error) {
    // Damaged EXIF counts as absent.
    if (!(error instanceof RangeError)) throw error;
  }
  return bytes;
}

/** Sets the orientation of EXIF that begins with a TIFF header at `start`. */
function setUpright(view, start) {
  const little = view.getUint16(start) === 0x4949;
  const directory = start + view.getUint32(start + 4, little);
  for (let i = 0; i < view.getUint16(directory, little); i += 1) {
    const entry = directory + 2 + 12 * i;
    if (view.getUint16(entry, little) === 0x0112) view.setUint16(entry + 8, 1, little);
  }
}

/** Arguments of the worker's `extract`: pixels unchanged, every other image as a bitmap. */
async function imageArguments(head, image) {
  if (image?.data instanceof Uint8ClampedArray || image?.data instanceof Uint8Array) {
    const { width, height, data } = image;
    return [{ head, image: { width, height, data } }];
  }
  let bitmap;
  try {
    bitmap = await storedBitmap(image);
  } catch (error) {
    throw new VeilocError("image", `the browser cannot read this image: ${error.message}`);
  }
  return [{ head, image: bitmap }, [bitmap]];
}
