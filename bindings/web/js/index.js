// Private visual localization in the browser: an image is sealed here, and only the sealed query leaves the device.
//
//   import { Client, load } from "veiloc";
//   const client = new Client("https://places.example:8443", { token });
//   const device = await load(await client.profile("lobby"));
//   const query = await device.seal(image, "SIMPLE_RADIAL,1296,1936,2435.4,648,968,-0.034");
//   const { trusted, center, position_sd } = await client.localize("lobby", query);

import { VeilocError } from "./core.js";

export { Client } from "./client.js";
export { orientationOf, watchOrientation } from "./orientation.js";
export { VeilocError };

/** A worker and what it was asked. It is ended with `device.close()`. */
class Crew {
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

  ask(job, rest = {}, transfer = []) {
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
 * Attacks in a worker of their own, one after the other: they take seconds, and the worker that seals has none. It is started
 * with the first attack. An attack that is given up ends with its worker, for WebAssembly cannot be told to stop.
 */
class Attackers {
  #start;
  #module;
  #crew = null;
  #last = Promise.resolve();
  #closed = false;

  constructor(start, module) {
    this.#start = start;
    this.#module = module;
  }

  ask(head, bytes, signal) {
    const own = this.#last.then(() => this.#run(head, bytes, signal));
    this.#last = own.catch(() => {});
    return own;
  }

  async #run(head, bytes, signal) {
    signal?.throwIfAborted();
    if (this.#closed) throw new VeilocError("closed", "the device was closed");
    const isNew = !this.#crew;
    this.#crew ??= new Crew(this.#start());
    const crew = this.#crew;
    const giveUp = (reason) => {
      crew.end(reason);
      if (this.#crew === crew) this.#crew = null;
    };
    const aborted = () => giveUp(signal.reason);
    signal?.addEventListener("abort", aborted, { once: true });
    try {
      if (isNew) await crew.ask("load", { wasm: this.#module });
      return await crew.ask("call", { head, bytes }, [bytes.buffer]);
    } catch (error) {
      // A worker that did not start, or whose library trapped, is of no more use.
      if (["worker", "broken"].includes(error.kind)) giveUp(error);
      throw error;
    } finally {
      signal?.removeEventListener("abort", aborted);
    }
  }

  end(reason) {
    this.#closed = true;
    this.#crew?.end(reason);
  }
}

/** Makes ready to seal for the map of a profile. */
export async function load(profile, { worker, wasm = new URL("./veiloc.wasm", import.meta.url) } = {}) {
  const own = () => new Worker(new URL("./worker.js", import.meta.url), { type: "module", name: "veiloc" });
  const start = typeof worker === "function" ? worker : own;
  const crew = new Crew(worker instanceof Worker ? worker : start());
  try {
    const { module } = await crew.ask("load", { wasm: wasm instanceof WebAssembly.Module ? wasm : String(wasm) });
    const { head } = await crew.ask("call", { head: { op: "profile" }, bytes: profile });
    return new Device(crew, new Attackers(start, module), head);
  } catch (error) {
    crew.end(error);
    throw error;
  }
}

class Device {
  #crew;
  #attackers;
  #profile;

  constructor(crew, attackers, { profile, ...facts }) {
    this.#crew = crew;
    this.#attackers = attackers;
    this.#profile = profile;
    Object.assign(this, facts);
  }

  /** The bytes to send. Seal an image once; when the network fails, send the same bytes again. */
  async seal(image, camera = null, options = {}) {
    const sealed = await this.sealed(image, camera, options);
    if (sealed.lopsided) throw new VeilocError("lopsided", sealed.lopsided);
    return sealed.bytes;
  }

  /** The same with what is known of the query: its steps, and what it shows. */
  async sealed(image, camera = null, { session, held, ...options } = {}) {
    const head = { op: "seal", profile: this.#profile, camera, ...options };
    if (session) Object.assign(head, { session: session.handle }, held);
    const { head: told, bytes } = await this.#crew.ask("seal", ...(await given(head, image)));
    return new Sealed(this.#crew, this.#attackers, told, bytes);
  }

  /** Several images of one place belong in one session, so that their lines do not cross in what they show (rule L10). */
  async session({ anchors, bytes } = {}) {
    const { head } = bytes
      ? await this.#crew.ask("call", { head: { op: "sessionFrom" }, bytes })
      : await this.#crew.ask("session", { head: { op: "session", ...(anchors && { anchors }) } });
    return new Session(this.#crew, head.session);
  }

  /** Ends the workers, with everything they know. */
  close() {
    const reason = new VeilocError("closed", "the device was closed");
    this.#crew.end(reason);
    this.#attackers.end(reason);
  }
}

class Session {
  #crew;

  constructor(crew, handle) {
    this.#crew = crew;
    this.handle = handle;
  }

  /** What it remembers, to go on with it later. A secret: it holds where keypoints were. */
  async bytes() {
    return (await this.#crew.ask("call", { head: { op: "sessionBytes", session: this.handle } })).bytes;
  }
}

class Sealed {
  #crew;
  #attackers;
  #query;

  constructor(crew, attackers, { query, ...facts }, bytes) {
    this.#crew = crew;
    this.#attackers = attackers;
    this.#query = query;
    Object.assign(this, facts, { bytes });
  }

  /** The bytes of its first rows: one of `steps`. */
  async step(rows) {
    return (await this.#crew.ask("call", { head: { op: "step", query: this.#query, rows } })).bytes;
  }

  /** What it tells, and what it hides: for this screen only. */
  async show() {
    const { head, bytes } = await this.#crew.ask("call", { head: { op: "show", query: this.#query } });
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

  /** What an attack of the audit makes of it, in a worker of its own. A `signal` gives it up. */
  async attack(attack = "closed-form", { signal } = {}) {
    const exhibit = await this.#crew.ask("call", { head: { op: "exhibit", query: this.#query } });
    const { head, bytes } = await this.#attackers.ask({ op: "attack", attack, ...exhibit.head }, exhibit.bytes, signal);
    const numbers = new Float32Array(bytes.buffer, bytes.byteOffset, bytes.byteLength / 4);
    return { ...head, answers: numbers.subarray(0, 2 * head.count), truth: numbers.subarray(2 * head.count) };
  }

  /** Gives back what the worker keeps of it. */
  free() {
    return this.#crew.ask("call", { head: { op: "free", handle: this.#query } }).then(() => undefined);
  }
}

/** An image as the worker takes it: pixels as they are, everything else as a bitmap whose colours nobody converted. */
async function given(head, image) {
  if (image?.data instanceof Uint8ClampedArray || image?.data instanceof Uint8Array) {
    const { width, height, data } = image;
    return [{ head, image: { width, height, data } }];
  }
  let bitmap;
  try {
    bitmap = await createImageBitmap(image, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch (error) {
    throw new VeilocError("image", `this is no image that the browser reads: ${error.message}`);
  }
  return [{ head, image: bitmap }, [bitmap]];
}
