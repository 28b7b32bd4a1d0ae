// How the device holds its camera, from what the browser says of its sensors. It stays on the device: a query tells only how
// the layout of its session is turned.

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
 * Orientation of the camera at the back from the angles of a `deviceorientation` event and the angle of the screen, degrees:
 * the quaternion `w x y z` from the sensors' world (z up) to the camera (x right, y down, z ahead, of the frame as it is
 * shown), and where things fall in the camera's axes. `null` when a sensor says nothing.
 */
export function orientationOf({ alpha, beta, gamma }, screenAngle = 0) {
  if (![alpha, beta, gamma, screenAngle].every(Number.isFinite)) return null;
  // Intrinsic turns about z, x and y; then the screen against the device; then the camera's axes, half a turn about x.
  const device = times(times(about(3, alpha), about(1, beta)), about(2, gamma));
  const [w, x, y, z] = times(times(device, about(3, -screenAngle)), [0, 1, 0, 0]);
  const orientation = [w, -x, -y, -z];
  // The world's (0, 0, -1), turned into the camera.
  const down = times(times(orientation, [0, 0, 0, -1]), [w, x, y, z]).slice(1);
  return { orientation, down };
}

/**
 * Listens to the sensors. To be called from a click where the browser asks its user first (Safari). `now()` is `null` until a
 * sensor has spoken, and where there is none.
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
