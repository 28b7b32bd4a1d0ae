/**
 * Private visual localization in the browser: an image is sealed on the device, and only the sealed query leaves it.
 *
 * Lengths are in map units, pixels are COLMAP's (the centre of the first pixel is at 0.5, 0.5), quaternions are `w x y z`.
 */

/** Anything the browser can draw, or pixels: `[height, width, 4]` bytes of red, green, blue and alpha. */
export type ImageLike = ImageBitmapSource | { width: number; height: number; data: Uint8ClampedArray | Uint8Array };

/** A camera as COLMAP writes it, `MODEL,WIDTH,HEIGHT,PARAMS…`; `null` guesses the focal length, and the query says so. */
export type Camera = string | null;

export interface LoadOptions {
  /**
   * How a worker that runs `veiloc/worker.js` is started, where the bundler makes one: attacks have another than seals. A worker
   * by itself seals, and attacks are given one of the package's own. Default: the package's own.
   */
  worker?: Worker | (() => Worker);
  /** Where `veiloc.wasm` is, or the compiled module; default: beside the package's own files. */
  wasm?: string | URL | WebAssembly.Module;
}

/** How the device held its camera: what `orientationOf` gives. */
export interface Held {
  /** Rotation from a frame that stays in the world to the camera (x right, y down, z ahead). */
  orientation: [number, number, number, number];
  /** Where things fall, in the camera's axes. */
  down?: [number, number, number];
}

export interface SealOptions {
  /** How positions are hidden: `dcl` (default), `dcl:LAYOUT`, `random-lines` or `coordinate-permutation`. */
  scheme?: string;
  /** Bits of an angle; default 12. */
  angleBits?: number;
  /** Most keypoints that are sent; default: what the profile asks for, at most 2048. */
  maxKeypoints?: number;
  /** The session that the image is a frame of. */
  session?: Session;
  /** How the camera was held; read in a session only. */
  held?: Held | null;
}

/** Makes ready to seal for the map of a profile: starts a worker with the WebAssembly. */
export function load(profile: Uint8Array, options?: LoadOptions): Promise<Device>;

export interface Device {
  /** Name of the profile: 32 hexadecimal digits. */
  readonly id: string;
  /** Kind of descriptors. */
  readonly descriptor: string;
  readonly maxKeypoints: number;
  readonly maxImageSide: number;
  /**
   * The bytes to send. Seal an image once: when the network fails, send the same bytes again.
   * Throws `VeilocError`: `image`, `camera`, `option`, `seal` (too little texture), `lopsided` (not worth sending); in a session
   * `too-many-starts` (one more image of this place would tell too much, as nothing says how it is held) and `turned-away`.
   */
  seal(image: ImageLike, camera?: Camera, options?: SealOptions): Promise<Uint8Array>;
  /** The same with what is known of the query. */
  sealed(image: ImageLike, camera?: Camera, options?: SealOptions): Promise<Sealed>;
  /**
   * Begins a session, or goes on with one. Several images of one place belong in one.
   * `anchors`: what they are tied to, `world` (default), `gravity` or `image`.
   */
  session(options?: { anchors?: "world" | "gravity" | "image"; bytes?: Uint8Array }): Promise<Session>;
  /** Ends the workers, with everything they know. */
  close(): void;
}

export interface Session {
  /** What it remembers, to go on with it later. A secret: it holds where keypoints were. */
  bytes(): Promise<Uint8Array>;
}

export interface Sealed {
  /** What may be sent. */
  readonly bytes: Uint8Array;
  readonly rows: number;
  /** Keypoints that were found; the query may hold fewer. */
  readonly keypoints: number;
  readonly scheme: string;
  /** Width, height and focal length of the camera it is told in, pixels. */
  readonly camera: [number, number, number];
  /** How well the focal length is known. */
  readonly focal: "calibrated" | "exif" | "unknown";
  /** Rows of each step of a progressive query. */
  readonly steps: number[];
  /** Why it could not fix a pose and is not sent; `null` when it can. */
  readonly lopsided: string | null;
  /** Frames and starts of its session. */
  readonly frames: number | null;
  readonly starts: number | null;
  /** Extraction and sealing in the worker. */
  readonly milliseconds: number;
  /** The bytes of its first rows: one of `steps`. */
  step(rows: number): Promise<Uint8Array>;
  /** What it tells, and what it hides: for this screen only. */
  show(): Promise<Shown>;
  /** What an attack of the audit makes of it. It runs in a worker of its own, and holds up no seal; a `signal` gives it up. */
  attack(attack?: Attack, options?: { signal?: AbortSignal }): Promise<Attacked>;
  /** Gives back what the worker keeps of it. */
  free(): Promise<void>;
}

/** Attacks of the audit. All but `prior` are told every keypoint's true neighbours, which a query does not tell. */
export type Attack = "prior" | "closed-form" | "closed-form-informed" | "graph";

export interface Shown {
  /** The camera of the query, pixels. */
  width: number;
  height: number;
  /** Anchors that lie somewhere. */
  anchors: [number, number][];
  /** `[S, 4]`: where keypoints may be, u and v of both ends. */
  segments: Float32Array;
  /** `[K, 2]`: keypoints found, in the image that was given. */
  keypoints: Float32Array;
  /** `[R, 2]`: keypoints sent, in the camera of the query. */
  hidden: Float32Array;
}

export interface Attacked {
  attack: Attack;
  words: string;
  toldNeighbours: boolean;
  width: number;
  height: number;
  count: number;
  /** Median error, pixels of the query's camera. */
  medianPx: number | null;
  /** Share of answers nearer than 10 pixels. */
  under10px: number | null;
  /** Median error of the guess that uses no neighbours. */
  guessMedianPx: number | null;
  /** `[R, 2]` */
  answers: Float32Array;
  /** `[R, 2]` */
  truth: Float32Array;
}

export interface ClientOptions {
  /** Who asks. */
  token?: string;
  /** Speak plain HTTP beyond this machine. */
  insecureHttp?: boolean;
  /** How often the same bytes are sent again; default 4. */
  retries?: number;
  /** A service that asks for a longer pause is not waited for, milliseconds; default 20000. */
  longestPause?: number;
  /** For each attempt, milliseconds; default 60000. */
  timeout?: number;
}

export interface LocalizeOptions {
  /** A doubtful pose is withheld. */
  trustedOnly?: boolean;
  /** Where the camera roughly is: `X, Y, Z, SD`. It tells the service that much even when no pose is found. */
  near?: [number, number, number, number];
  signal?: AbortSignal;
}

/** A positioning service, and who asks it. It takes sealed queries and nothing else. */
export class Client {
  constructor(server: string | URL, options?: ClientOptions);
  maps(): Promise<MapEntry[]>;
  profile(map: string): Promise<Uint8Array>;
  localize(map: string, query: Uint8Array | Sealed, options?: LocalizeOptions): Promise<Answer>;
  /** In steps, no more of them than a trusted pose takes, or one as exact as `accurateTo` (map units). */
  localizeProgressive(
    map: string,
    query: Sealed,
    options?: LocalizeOptions & { accurateTo?: number },
  ): Promise<{ answer: Answer; steps: Step[] }>;
}

export interface MapEntry {
  name: string;
  images: number;
  points: number;
  profile_id: string;
}

export interface Step {
  rows: number;
  bytes: number;
  outcome: "trusted" | "doubtful" | "not-found";
}

/** Field by field what `docs/reference/http.md` lists. */
export interface Answer {
  version: 1;
  map: string;
  state: "trusted" | "doubtful";
  /** `x_camera = R x_map + t`. */
  cam_from_world?: { q: [number, number, number, number]; t: [number, number, number] };
  center?: [number, number, number];
  covariance?: (number | null)[][];
  center_covariance?: (number | null)[][];
  /** The ±; `null` when a direction is free. */
  position_sd?: number | null;
  noise_px?: number;
  focal_scale?: number;
  trusted: boolean;
  doubts: { kind: string; text: string }[];
  confidence: { log_evidence: number | null; margin: number | null };
  inliers: number;
  matches: number;
  hypotheses: number;
  ms: { queue: number; retrieve: number; match: number; pose: number };
}

/**
 * What went wrong. `kind`: `image`, `camera`, `option`, `profile`, `seal`, `lopsided`, `too-many-starts`, `turned-away`, `session`,
 * `query`, `gone`, `attack`, `worker`, `broken`, `closed` of the device; `address`, `token`, `map-name`, `network`, `busy`, `refused`, `not-localized`,
 * `wrong-profile`, `bad-answer` of the client.
 */
export class VeilocError extends Error {
  kind: string;
  status?: number;
  problem?: string;
  /** Seconds. */
  retryAfter?: number;
  /** Whether the same bytes may be sent again. */
  maySendAgain?: boolean;
}

/** From the angles of a `deviceorientation` event and that of the screen, degrees. */
export function orientationOf(
  event: { alpha: number | null; beta: number | null; gamma: number | null },
  screenAngle?: number,
): Required<Held> | null;

/** Listens to the sensors; call it from a click, for browsers that ask their user first. */
export function watchOrientation(): Promise<{ now(): Required<Held> | null; stop(): void }>;
