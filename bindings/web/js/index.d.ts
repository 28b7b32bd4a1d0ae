/**
 * Private visual localization in the browser: the device seals an image, and only the sealed query leaves it.
 *
 * Lengths are in map units, pixels are COLMAP's (the centre of the first pixel is at 0.5, 0.5), quaternions are `w x y z`.
 */

/** Any image that the browser can draw, or pixels: `[height, width, 4]` bytes of red, green, blue and alpha. */
export type ImageLike = ImageBitmapSource | { width: number; height: number; data: Uint8ClampedArray | Uint8Array };

/**
 * A COLMAP camera, `MODEL,WIDTH,HEIGHT,PARAMS…`, of the image as it is displayed. With `null` the focal length is that of the EXIF data
 * of `ImageFacts.file`, with the rule of `veiloc seal`; without one it is guessed. The query says which.
 */
export type Camera = string | null;

export interface LoadOptions {
  /** Identifier of the profile as the operator publishes it; another profile is refused (`other-profile`). Default: any. */
  profileId?: string;
  /**
   * A function that starts a worker with `veiloc/worker.js`, for bundlers; it is called again for attacks. If you give a worker
   * instead, it seals, and attacks use a worker of the package. Default: workers of the package.
   */
  worker?: Worker | (() => Worker);
  /** Address of `veiloc.wasm`, or the compiled module. Default: the file of the package. */
  wasm?: string | URL | WebAssembly.Module;
}

/** Orientation of the camera, as `orientationOf` returns it. */
export interface Attitude {
  /** Rotation from a fixed world frame to the camera (x right, y down, z forward). */
  orientation: [number, number, number, number];
  /** Down direction in the camera frame. */
  down?: [number, number, number];
  /** Its standard deviation, degrees; default 0.5. */
  downSdDeg?: number;
}

export interface SealOptions {
  /** How keypoint positions are obfuscated: `dcl` (default), `dcl:LAYOUT`, `random-lines` or `coordinate-permutation`. */
  scheme?: string;
  /** Bits of each quantized angle; default 12. */
  angleBits?: number;
  /** Most keypoints to send; default: the number that the profile requests, at most 2048. */
  maxKeypoints?: number;
  /** Longest side to which images are scaled down, pixels, whatever the profile requests; default 2048. */
  maxImageSide?: number;
  /** Whether `down` of an attitude is sent; default true. */
  sendGravity?: boolean;
  /**
   * The pack of the map (`Client.pack`): nothing is sent that the place does not know. Default: all descriptors are sent. It is prepared
   * for each sealer, about a millisecond per thousand rows.
   */
  pack?: Uint8Array;
  /** Identifier of the pack as the operator publishes it; another pack is refused (`other-pack`). Default: any. */
  packId?: string;
  /** What is sent with a pack: `matches`, the points that keypoints match in it, and no descriptor (default), or `explained`, the descriptors that it explains. */
  send?: "matches" | "explained";
}

/**
 * Pixels of an image of which nothing is sent, for any resolution of the same view: people, screens. A mask that hides nothing is none;
 * one that hides all is refused (`image`).
 */
export interface Mask {
  width: number;
  height: number;
  /** A byte for each pixel, or MediaPipe's confidences from 0 to 1 with the kind `confidence`. */
  data: Uint8Array | Uint8ClampedArray | Float32Array;
  /**
   * Which values hide: `marked`, all but 0 (default; categories of MediaPipe's multiclass segmenter); `confidence`, a fifth and more;
   * `arcore-semantics`, person and vehicle; `dark-hides`, below 128.
   */
  kind?: "marked" | "confidence" | "arcore-semantics" | "dark-hides";
  /** How far beyond what is marked is hidden, too, as a share of the longer side; default 0.02. */
  margin?: number;
}

/** What is known about an image beside its camera. */
export interface ImageFacts {
  /**
   * The JPEG or PNG file of the image, for the focal length in its EXIF data when the camera is `null`. Nothing else of it is used.
   * Default: the image, if it is a `Blob` or `File`.
   */
  file?: Blob;
  /** People and what else must not be sent. */
  mask?: Mask;
  /** A network whose people are hidden, too. What it misses is sent; `Extracted.hidden` is 0 when it found nobody. */
  people?: Segmenter;
  /**
   * Orientation of the camera when it took the image. Its `down` is sent, rounded to about a degree; the rest, which only a session
   * uses, is not.
   */
  attitude?: Attitude | null;
}

/** Prepares to seal for the map of a profile: starts a worker with the WebAssembly module. */
export function load(profile: Uint8Array, options?: LoadOptions): Promise<Device>;

/** A network that finds people, in the worker of its device. */
export type Segmenter = number & { readonly segmenter: unique symbol };

export interface Device {
  /** Identifier of the profile: 32 hexadecimal digits. */
  readonly id: string;
  /** Name of the descriptor type. */
  readonly descriptor: string;
  readonly maxKeypoints: number;
  readonly maxImageSide: number;
  /** A sealer: it seals images with these options, which the device decides. Most apps need one. Throws `VeilocError` `option`, `pack`, `other-pack`, `seal`. */
  sealer(options?: SealOptions): Promise<Sealer>;
  /**
   * Starts a session, or resumes one from its bytes. Use one session for several images of one scene.
   * `anchors`: the frame in which the anchors are fixed, `world` (default), `gravity` or `image`.
   */
  session(options?: { anchors?: "world" | "gravity" | "image"; bytes?: Uint8Array }): Promise<Session>;
  /**
   * Begins an alignment of an AR world with the map; it runs in the calling thread. `metresPerUnit`: of the map; default: as the answers
   * state it.
   */
  alignment(options?: { metresPerUnit?: number }): Promise<Alignment>;
  /**
   * Reads a network that finds people: the bytes of `selfie_segmentation.tflite` of MediaPipe (Apache-2.0; in the npm package
   * `@mediapipe/selfie_segmentation`). Throws `VeilocError` `image` for another file.
   */
  segmenter(bytes: Uint8Array): Promise<Segmenter>;
  /** Terminates the workers and discards their state. */
  close(): void;
}

/** A pose as WebXR states it, also an `XRRigidTransform`: y up, cameras look along −z, metres. */
export interface Pose {
  readonly position: { readonly x: number; readonly y: number; readonly z: number };
  readonly orientation: { readonly x: number; readonly y: number; readonly z: number; readonly w: number };
}

/** Answers of one AR session, and the transform from the map to its world that most of them agree on. */
export interface Alignment {
  /** `tentative`: no two answers agree; content may be shown, and may move. */
  readonly state: "searching" | "tentative" | "aligned";
  /** Answers that the transform is the average of. */
  readonly used: number;
  /** Trusted answers that contradict it. */
  readonly contradicting: number;
  /** Whether distances between answers are those of the AR world; `differs`: check the unit of the map and the focal length. */
  readonly distances: "unknown" | "agrees" | "differs";
  /** Distances in the map divided by those of the AR world. */
  readonly distanceRatio: number | null;
  /** Takes an answer and the pose of the camera when it took the image that was sealed, not its pose now. Throws `VeilocError` `pose`, `option`. */
  add(answer: Answer, cameraInWorld: Pose): "used" | "contradicts" | "doubtful-agrees" | "doubtful" | "no-pose" | "unknown-unit";
  /** Takes the pose of the camera between answers, once or twice a second: its path tells how far tracking may have drifted. */
  moved(cameraInWorld: Pose): void;
  /** Forgets all answers: for a new session, and on the `reset` event of its reference space. */
  reset(): void;
  /** The pose in the AR world of content whose pose in the map is known (map units, axes of the map); `null` before the first trusted answer. */
  worldFromAnchor(mapFromAnchor: Pose): Pose | null;
  /** Where the camera is in the map now: map units, and the rotation from the camera's axes (COLMAP's) to the map's. The accuracy is the radius of 68 % confidence. */
  cameraInMap(cameraInWorld: Pose): { pose: Pose; accuracy: { horizontal: number; vertical: number; yawDeg: number } } | null;
  /** Frees it. */
  free(): void;
}

/**
 * The pixels of an image as they are stored, without colour conversion: the EXIF orientation is not applied, and the pose is that of the
 * stored image.
 */
export function storedBitmap(image: ImageBitmapSource): Promise<ImageBitmap>;

/** Seals images for the map: `extract`, then `seal`. */
export interface Sealer {
  /** Extracts the features of an image; they stay in the worker. Throws `VeilocError`: `image`, `camera`, `option`. */
  extract(image: ImageLike, camera?: Camera, facts?: ImageFacts): Promise<Extracted>;
  /**
   * Seals the features of an image, once: a second call throws `gone`. When the network fails, send the same bytes again.
   *
   * Throws `VeilocError`: `texture`; with a pack `not-this-place` (the image does not show the place); in a session `too-many-starts` (without an orientation, another image of this scene would reveal
   * too much) and `turned-away` (the camera has turned away from the session's anchors).
   */
  seal(extracted: Extracted): Promise<Sealed>;
  /** The same sealer, for the images of a session. */
  inSession(session: Session): Sealer;
  /** Frees the sealer in the worker; queries that it sealed stay usable. */
  free(): Promise<void>;
}

/** The features of an image in the worker, until they are sealed. */
export interface Extracted {
  /** Number of keypoints. */
  readonly keypoints: number;
  /** Share of the image that is hidden, by the mask and people. */
  readonly hidden: number;
  /** Time of the extraction. */
  readonly milliseconds: number;
}

export interface Session {
  /** The state of the session, to resume it later. Keep it secret: it holds keypoint positions. */
  bytes(): Promise<Uint8Array>;
}

export interface Sealed {
  /** The bytes to send. */
  readonly bytes: Uint8Array;
  readonly rows: number;
  /** Number of keypoints found; the query may hold fewer. */
  readonly keypoints: number;
  readonly scheme: string;
  /** Width, height and focal length of the query's camera, pixels. */
  readonly camera: [number, number, number];
  /** How well the focal length is known. */
  readonly focal: "calibrated" | "exif" | "unknown";
  /** Rows of each step of a progressive query. */
  readonly steps: number[];
  /** Why the query cannot determine a pose and must not be sent (`Client` refuses it, `unbalanced`); `null` when it can. */
  readonly unbalanced: string | null;
  /** Number of frames in the session, and how often it chose new anchors; `null` without a session. */
  readonly frames: number | null;
  readonly starts: number | null;
  /** Time of extraction and sealing in the worker. */
  readonly milliseconds: number;
  /** The bytes of the first `rows` rows; `rows` is one of `steps`. */
  step(rows: number): Promise<Uint8Array>;
  /** The lines that the query holds and the keypoints that it hides; only for the screen of this device. */
  show(): Promise<QueryView>;
  /** Runs an attack of the audit on the query, in a worker of its own, so sealing does not wait. `signal` aborts it. */
  attack(attack?: Attack, options?: { signal?: AbortSignal }): Promise<AttackResult>;
  /** Frees the query in the worker. */
  free(): Promise<void>;
}

/** Attacks of the audit. All but `prior` get the true neighbours of each keypoint, which a query does not hold. */
export type Attack = "prior" | "closed-form" | "closed-form-informed" | "graph";

export interface QueryView {
  /** The camera of the query, pixels. */
  width: number;
  height: number;
  /** Anchors at a finite position, pixels. */
  anchors: [number, number][];
  /** `[S, 4]`: segments on which the keypoints lie, u and v of both ends. */
  segments: Float32Array;
  /** `[K, 2]`: keypoints found, in the original image. */
  keypoints: Float32Array;
  /** `[R, 2]`: keypoints sent, in the camera of the query. Empty for a query that sends matches: its rows do not tell their keypoints. */
  hidden: Float32Array;
}

export interface AttackResult {
  attack: Attack;
  /** Description of the attack. */
  words: string;
  /** Whether the attack got the true neighbours. */
  trueNeighbours: boolean;
  width: number;
  height: number;
  /** Keypoints attacked; 0 for a query that sends matches, whose rows do not tell their keypoints. */
  count: number;
  /** Median error, pixels of the query's camera. */
  medianPx: number | null;
  /** Share of keypoints recovered within 10 pixels. */
  under10px: number | null;
  /** Median error of the prior-only baseline, which uses each line alone. */
  priorMedianPx: number | null;
  /** `[R, 2]`: keypoints that the attack recovered. */
  answers: Float32Array;
  /** `[R, 2]`: true keypoints. */
  truth: Float32Array;
}

export interface ClientOptions {
  /** Bearer token. */
  token?: string;
  /** Allow plain HTTP to other machines. */
  insecureHttp?: boolean;
  /** How many times to send the same bytes again; default 4. */
  retries?: number;
  /** Maximum `Retry-After` to wait for, milliseconds; default 20000. */
  maxRetryDelay?: number;
  /** Timeout of each attempt, milliseconds; default 60000. */
  timeout?: number;
}

export interface LocalizeOptions {
  /** Return no pose when it is doubtful. */
  trustedOnly?: boolean;
  /** Approximate position of the camera and its standard deviation, `X, Y, Z, SD`. The service learns it even if it finds no pose. */
  near?: [number, number, number, number];
  signal?: AbortSignal;
}

/** Client of a localization service. It sends sealed queries only. */
export class Client {
  constructor(server: string | URL, options?: ClientOptions);
  maps(): Promise<MapEntry[]>;
  profile(map: string): Promise<Uint8Array>;
  /** The pack of a map, for `SealOptions.pack`. Throws `VeilocError` `refused` where the operator gives no packs. */
  pack(map: string): Promise<Uint8Array>;
  /** All content anchors of a map; with `near`, a place in the map, the nearest first. The service does not learn the place. */
  anchors(map: string, options?: { near?: [number, number, number] }): Promise<ContentAnchor[]>;
  /** Writes a content anchor: a new one, or one that the token owns. The last writer wins. */
  putAnchor(map: string, name: string, anchor: Pick<ContentAnchor, "map_from_anchor"> & { content?: unknown }): Promise<void>;
  deleteAnchor(map: string, name: string): Promise<void>;
  localize(map: string, query: Uint8Array | Sealed, options?: LocalizeOptions): Promise<Answer>;
  /** Localizes in steps, and stops at the first trusted pose whose `position_sd` is at most `accurateTo` (map units). */
  localizeProgressive(
    map: string,
    query: Sealed,
    options?: LocalizeOptions & { accurateTo?: number },
  ): Promise<{ answer: Answer; steps: Step[] }>;
}

/** Content at a place of a map. */
export interface ContentAnchor {
  name: string;
  /** `x_map = R x_anchor + t`: quaternion `w x y z` and position, map units. */
  map_from_anchor: { q: [number, number, number, number]; t: [number, number, number] };
  /** Any JSON, at most 4096 bytes. */
  content: unknown;
  /** Name of the token that wrote it; of own anchors only. */
  owner?: string;
  /** From `near`, map units. */
  distance?: number;
}

export interface MapEntry {
  name: string;
  images: number;
  points: number;
  profile_id: string;
  /** Metres of a unit of the map, 1; null when the unit is not known. */
  metres_per_unit: number | null;
  /** Direction of gravity in the map, a unit vector; null when the map does not know it. */
  down: [number, number, number] | null;
}

export interface Step {
  rows: number;
  bytes: number;
  outcome: "trusted" | "doubtful" | "not-found";
}

/** The answer: the document that every interface of veiloc gives; `docs/reference/http.md` describes each field. */
export interface Answer {
  version: 1;
  /** A pose that is not trusted should not be shown to a user. */
  state: "trusted" | "doubtful";
  /** `x_camera = R x_map + t`. */
  cam_from_world?: { q: [number, number, number, number]; t: [number, number, number] };
  center?: [number, number, number];
  covariance?: (number | null)[][];
  center_covariance?: (number | null)[][];
  /** Standard deviation of the position; `null` when it is undetermined in some direction. */
  position_sd?: number | null;
  /** Standard deviation of the orientation, degrees; `null` as above. */
  rotation_sd_deg?: number | null;
  /** What these deviations include: not where the map is on earth. */
  sd_includes: "map";
  /** Metres of a unit of the map, 1; null when the unit is not known. */
  metres_per_unit: number | null;
  /** Direction of gravity in the map, a unit vector; null when the map does not know it. */
  down: [number, number, number] | null;
  /** Use of the query's gravity; absent when it has none. */
  gravity?: "used" | "unused";
  noise_px?: number;
  focal_scale?: number;
  /** Estimated principal point minus that of the query, pixels; 0 when it was not estimated. */
  principal_shift_px?: [number, number];
  /** None when the pose is trusted. */
  doubts: { kind: string; text: string }[];
  confidence: { log_evidence: number | null; margin: number | null };
  inliers: number;
  matches: number;
  hypotheses: number;
  ms: { queue: number; retrieve: number; match: number; pose: number };
}

/**
 * An error. `kind`: `image`, `texture` (too little of it: take another image), `not-this-place` (the image does not show the place of
 * the pack), `camera`, `option`, `profile`, `pack`, `other-profile`, `other-pack`, `seal`, `unbalanced`, `too-many-starts`, `pose`,
 * `turned-away`, `session`, `query`, `gone`, `attack`, `worker`, `broken`, `closed` from the device; `address`, `token`, `map-name`,
 * `network`, `busy`, `refused`, `not-localized`, `wrong-profile`, `bad-answer` from the client.
 */
export class VeilocError extends Error {
  kind: string;
  status?: number;
  problem?: string;
  /** Seconds to wait before a retry. */
  retryAfter?: number;
  /** Whether the same bytes may be sent again. */
  retryable?: boolean;
}

/** Orientation of the camera from the angles of a `deviceorientation` event and the angle of the screen, degrees. */
export function orientationOf(
  event: { alpha: number | null; beta: number | null; gamma: number | null },
  screenAngle?: number,
): Required<Attitude> | null;

/**
 * Orientation of the camera from its pose in WebXR: `view.transform` of the view whose `view.camera` gave the image. More exact than the
 * motion sensors; use one kind of orientation in a session.
 */
export function orientationOfPose(transform: {
  readonly orientation: { readonly x: number; readonly y: number; readonly z: number; readonly w: number };
}): Required<Attitude> | null;

/** A view of WebXR's module "Raw Camera Access" (`XRView` with `camera`). */
export interface CameraView {
  readonly projectionMatrix: ArrayLike<number>;
  readonly transform: Pose;
  readonly camera?: { readonly width: number; readonly height: number } | null;
}

/** The camera of a view's image, from the view's projection. Throws `VeilocError` `camera`: no camera, or no pinhole camera. */
export function cameraOfView(view: CameraView): string;

/** The pose of the view's camera in the reference space, copied: keep it until the answer comes. */
export function poseOfView(view: CameraView): Pose;

/**
 * The pixels of the view's camera image; call it in the callback of the animation frame that gave the view. `binding`: an
 * `XRWebGLBinding` of the session and `gl`. It waits for the GPU, some milliseconds. Throws `VeilocError` `camera`, `image`.
 */
export function cameraImage(
  gl: WebGLRenderingContext | WebGL2RenderingContext,
  binding: { getCameraImage(camera: any): WebGLTexture | null },
  view: CameraView,
): { width: number; height: number; data: Uint8Array };

/** Starts to read the motion sensors. Call it from a click handler: some browsers ask the user for permission. */
export function watchOrientation(): Promise<{ now(): Required<Attitude> | null; stop(): void }>;
