// Orientation of the camera from the device's motion sensors. It stays on the device, except for the direction of gravity: a query
// holds that, rounded to about a degree, and the rotation of its session's layout.

const times = ([a, b, c, d], [e, f, g, h]) => [
  a * e - b * f - c * g - d * h,
  a * f + b * e + c * h - d * g,
  a * g - b * h + c * e + d * f,
  a * h + b * g - c * f + d * e,
];

const about = (axis, degrees) => {
  const half = (degrees * Math.PI) / 360;
  const q = [Math.cos(half), 0, 0, 0];
  q[axis] = Math.sin(half);
  return q;
};

/**
 * Orientation of the rear camera from the angles of a `deviceorientation` event and the angle of the screen, degrees: the
 * quaternion `w x y z` from the sensors' world (z up) to the camera (x right, y down, z forward, in the displayed frame), and
 * the down direction in the camera frame with its standard deviation, degrees. `null` when an angle is missing.
 */
export function orientationOf({ alpha, beta, gamma }, screenAngle = 0) {
  if (![alpha, beta, gamma, screenAngle].every(Number.isFinite)) return null;
  // Intrinsic rotations about z, x and y; then screen against device; then the camera's axes, 180° about x.
  const device = times(times(about(3, alpha), about(1, beta)), about(2, gamma));
  const [w, x, y, z] = times(times(device, about(3, -screenAngle)), [0, 1, 0, 0]);
  const orientation = [w, -x, -y, -z];
  // The world's (0, 0, -1), rotated into the camera frame.
  const down = times(times(orientation, [0, 0, 0, -1]), [w, x, y, z]).slice(1);
  return { orientation, down, downSdDeg: 2 };
}

/**
 * Orientation of the camera from its pose in WebXR, an `XRRigidTransform` (`view.transform` of the view whose `view.camera` gave the
 * image): as `orientationOf`, with the world of the reference space, whose y is up. `null` when a number is missing.
 */
export function orientationOfPose({ orientation: { x, y, z, w } }) {
  const length = Math.hypot(x, y, z, w);
  if (!(length > 0.5 && length < 2)) return null;
  // A view looks along its -z with y up: 180° about x from the camera's axes.
  const [a, b, c, d] = times([w, x, y, z].map((q) => q / length), [0, 1, 0, 0]);
  const orientation = [a, -b, -c, -d];
  const down = times(times(orientation, [0, 0, -1, 0]), [a, b, c, d]).slice(1);
  return { orientation, down, downSdDeg: 0.5 };
}

/**
 * Starts to read the sensors. Call it from a click handler: some browsers (Safari) ask the user for permission. `now()` is `null`
 * before the first event, and on devices without sensors.
 */
export async function watchOrientation() {
  const ask = globalThis.DeviceOrientationEvent?.requestPermission;
  if (ask && (await ask.call(DeviceOrientationEvent).catch(() => "denied")) !== "granted") {
    return { now: () => null, stop: () => {} };
  }
  let last = null;
  const listen = (event) => {
    last = event;
  };
  globalThis.addEventListener("deviceorientation", listen);
  return {
    now: () => (last ? orientationOf(last, globalThis.screen?.orientation?.angle ?? 0) : null),
    stop: () => globalThis.removeEventListener("deviceorientation", listen),
  };
}
