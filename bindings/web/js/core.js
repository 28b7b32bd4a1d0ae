// The WebAssembly and how it is talked to: one message in, one reply out (bindings/web/src/message.rs).

/** An error with a name for programs. */
export class VeilocError extends Error {
  constructor(kind, message, more = {}) {
    super(message);
    this.name = "VeilocError";
    this.kind = kind;
    Object.assign(this, more);
  }
}

/** The library of one worker. */
export class Core {
  #exports;

  /** What it was compiled to, for other workers. */
  module;

  /** From the bytes, or what `fetch` gives, or a compiled module. It imports nothing: what it cannot be given it cannot reach. */
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

  /** Does what `head` asks for with the bytes behind it, given in parts; throws `VeilocError`. */
  call(head, ...parts) {
    const { memory, veiloc_room, veiloc_call, veiloc_reply } = this.#exports;
    const text = new TextEncoder().encode(JSON.stringify(head));
    const length = parts.reduce((sum, part) => sum + part.byteLength, 4 + text.byteLength);
    let at = veiloc_room(length) >>> 0;
    if (at === 0) throw new VeilocError("image", "the image is larger than any that is read");
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
