// WebXR: images and cameras of an AR session with `camera-access`, and the map in its world.

import { VeilocError } from "./core.js";

/**
 * The camera of a view's image, a COLMAP camera, from the view's projection: `view` is one of `frame.getViewerPose(space).views`, and its
 * image (`cameraImage`) shows the same part of the world as the view.
 */
export function cameraOfView(view) {
  const { width, height } = sizeOf(view);
  const p = view.projectionMatrix;
  // A perspective, without skew: the homogeneous coordinate is −z.
  const isPinhole = p[11] === -1 && [1, 2, 3, 4, 6, 7, 12, 13, 15].every((i) => Math.abs(p[i]) < 1e-6);
  const params = [(p[0] * width) / 2, (p[5] * height) / 2, ((1 - p[8]) * width) / 2, ((1 + p[9]) * height) / 2];
  if (!isPinhole || !params.every(Number.isFinite) || params[0] <= 0 || params[1] <= 0) {
    throw new VeilocError("camera", "the projection of the view is not that of a pinhole camera");
  }
  return ["PINHOLE", width, height, ...params].join(",");
}

/** The pose of the view's camera in the reference space, copied: keep it until the answer comes. */
export function poseOfView({ transform: { position, orientation } }) {
  return pose([position.x, position.y, position.z], [orientation.x, orientation.y, orientation.z, orientation.w]);
}

/**
 * The pixels of the view's camera image, first row first; call it in the callback of the animation frame that gave the view. `binding`:
 * an `XRWebGLBinding` of the session and `gl`. It waits for the GPU, some milliseconds.
 */
export function cameraImage(gl, binding, view) {
  const { width, height } = sizeOf(view);
  const texture = binding.getCameraImage(view.camera);
  if (!texture) throw new VeilocError("image", "the view has no camera image in this frame");
  const bound = gl.getParameter(gl.FRAMEBUFFER_BINDING);
  const buffer = gl.createFramebuffer();
  const data = new Uint8Array(4 * width * height);
  try {
    gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE) {
      throw new VeilocError("image", "this browser does not let the camera image be read");
    }
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, data);
  } finally {
    gl.bindFramebuffer(gl.FRAMEBUFFER, bound);
    gl.deleteFramebuffer(buffer);
  }
  // WebGL's first row is the lowest.
  for (let top = 0, below = height - 1; top < below; top += 1, below -= 1) {
    const rows = [top, below].map((row) => data.subarray(4 * width * row, 4 * width * (row + 1)));
    const kept = rows[0].slice();
    rows[0].set(rows[1]);
    rows[1].set(kept);
  }
  return { width, height, data };
}

function sizeOf({ camera }) {
  if (!camera) {
    const ask = 'request the session with { requiredFeatures: ["camera-access"] }, and do not seal a frame without an image';
    throw new VeilocError("camera", `the view has no camera: ${ask}`);
  }
  return camera;
}

function pose([x, y, z], [qx, qy, qz, qw]) {
  return { position: { x, y, z }, orientation: { x: qx, y: qy, z: qz, w: qw } };
}

const numbers = ({ position: p, orientation: o }) => ({ position: [p.x, p.y, p.z], orientation: [o.x, o.y, o.z, o.w] });
const given = (reply) => reply && pose(reply.position, reply.orientation);

/** Answers of one AR session, and the transform that most of them agree on: the code of the phones' `Alignment`. */
export class Alignment {
  #core;
  #handle;
  #options;

  constructor(core, options = {}) {
    this.#core = core;
    this.#options = options;
    this.reset();
  }

  #call(op, rest, ...bytes) {
    return this.#core.call({ op, alignment: this.#handle, ...rest }, ...bytes).head;
  }

  /** Takes an answer and the pose of the camera when it took the image that was sealed, not its pose now. */
  add(answer, cameraInWorld) {
    const { update, ...facts } = this.#call("alignmentAdd", { pose: numbers(cameraInWorld) }, new TextEncoder().encode(JSON.stringify(answer)));
    Object.assign(this, facts);
    return update;
  }

  /** Takes the pose of the camera between answers, once or twice a second: its path tells how far tracking may have drifted. */
  moved(cameraInWorld) {
    this.#call("alignmentMoved", { pose: numbers(cameraInWorld) });
  }

  /** Forgets all answers: for a new session, and on the `reset` event of its reference space. */
  reset() {
    if (this.#handle !== undefined) this.free();
    this.#handle = this.#core.call({ op: "alignment", ...this.#options }).head.alignment;
    Object.assign(this, { state: "searching", used: 0, contradicting: 0, distances: "unknown", distanceRatio: null });
  }

  /** The pose in the reference space of content whose pose in the map is known; `null` before the first trusted answer. */
  worldFromAnchor(mapFromAnchor) {
    return given(this.#call("worldFromAnchor", { pose: numbers(mapFromAnchor) }).pose);
  }

  /** Where the camera is in the map, by its pose in the reference space now; `null` before the first trusted answer. */
  cameraInMap(cameraInWorld) {
    const { pose: found, accuracy } = this.#call("cameraInMap", { pose: numbers(cameraInWorld) });
    return found && { pose: given(found), accuracy };
  }

  /** Frees it. */
  free() {
    this.#core.call({ op: "free", handle: this.#handle });
  }
}
