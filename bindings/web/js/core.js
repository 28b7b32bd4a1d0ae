// Calls the WebAssembly module: one message in, one reply out (bindings/web/src/message.rs).

/** An error; `kind` is its name for programs. */
export class VeilocError extends Error {
  constructor(kind, message, more = {}) {
    super(message);
    this.name = "VeilocError";
    this.kind = kind;
    Object.assign(this, more);
  }
}

/** The WebAssembly instance of one worker. */
export class Core {
  #exports;

  /** The compiled module, for other workers. */
  module;

  /** From bytes, a response of `fetch`, or a compiled module. The module has no imports, so it cannot use any browser API. */
  static async load(source) {
    const core = new Core();
    let instance;
    if (source instanceof WebAssembly.Module) {
      core.module = source;
      instance = await WebAssembly.instantiate(source, {});
    } else if (source instanceof Uint8Array || source instanceof ArrayBuffer) {
      ({ module: core.module, instance } = await WebAssembly.instantiate(source, {}));
    } else {
      ({ module: core.module, instance } = await WebAssembly.instantiateStreaming(source, {}));
    }
    core.#exports = instance.exports;
    return core;
  }

  /** Runs the call `head` with a payload, given in parts; throws `VeilocError`. */
  call(head, ...parts) {
    const { memory, veiloc_allocate, veiloc_call, veiloc_reply } = this.#exports;
    const text = new TextEncoder().encode(JSON.stringify(head));
    const length = parts.reduce((sum, part) => sum + part.byteLength, 4 + text.byteLength);
    let at = veiloc_allocate(length) >>> 0;
    if (at === 0) throw new VeilocError("image", "the image is too large");
    new DataView(memory.buffer).setUint32(at, text.byteLength, true);
    at += 4;
    for (const part of [text, ...parts]) {
      const bytes = new Uint8Array(part.buffer ?? part, part.byteOffset ?? 0, part.byteLength);
      new Uint8Array(memory.buffer).set(bytes, at);
      at += part.byteLength;
    }
    const size = veiloc_call() >>> 0;
    const begin = veiloc_reply() >>> 0;
    const reply = new Uint8Array(memory.buffer).slice(begin, begin + size);
    const words = new DataView(reply.buffer).getUint32(0, true);
    const answer = JSON.parse(new TextDecoder().decode(reply.subarray(4, 4 + words)));
    if (answer.error !== undefined) throw new VeilocError(answer.kind, answer.error);
    return { head: answer, bytes: reply.slice(4 + words) };
  }
}
