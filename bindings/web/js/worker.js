// A worker that seals or attacks outside the page's thread, so that the page stays responsive. Pixels never leave the worker that
// seals.

import { Core, VeilocError } from "./core.js";

let core;

const random = () => crypto.getRandomValues(new Uint8Array(32));

/** Red, green, blue and alpha of an image, without colour conversion. */
function pixels(image) {
  if (!(image instanceof ImageBitmap)) return image;
  const { width, height } = image;
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  image.close();
  return context.getImageData(0, 0, width, height);
}

function timed(call) {
  const began = performance.now();
  const reply = call();
  reply.head.milliseconds = performance.now() - began;
  return reply;
}

const jobs = {
  load: async ({ wasm }) => {
    core = await Core.load(wasm instanceof WebAssembly.Module ? wasm : fetch(wasm));
    return { head: {}, module: core.module };
  },
  call: ({ head, bytes }) => core.call(head, ...(bytes ? [bytes] : [])),
  session: ({ head }) => core.call(head, random()),
  extract: ({ head, image, file, mask }) => {
    const { width, height, data } = pixels(image);
    const { turn = 0, ...focal } = file ? core.call({ op: "exif", width, height }, file).head : {};
    const known = head.camera ? {} : focal;
    return timed(() => core.call({ ...head, ...known, turn, width, height }, data, ...(mask ? [mask] : [])));
  },
  seal: ({ head }) => timed(() => core.call(head, random())),
};

self.onmessage = async ({ data: { id, job, ...rest } }) => {
  try {
    const { head, bytes, module } = await jobs[job](rest);
    self.postMessage({ id, head, bytes, module }, bytes ? [bytes.buffer] : []);
  } catch (error) {
    const known = error instanceof VeilocError;
    // A trap leaves the library in an unknown state; the caller must start another worker.
    const kind = known ? error.kind : error instanceof WebAssembly.RuntimeError ? "broken" : "worker";
    self.postMessage({ id, error: { kind, message: String(error?.message ?? error) } });
  }
};
