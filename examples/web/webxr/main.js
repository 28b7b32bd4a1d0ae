// An object at a fixed place of a map, in WebXR with three.js: an image is sealed once a second, and the answers keep the object in place.
//
//   npm install three veiloc        (veiloc: the package of bindings/web)
//   veiloc serve --map lobby=place.vmap --answer-quantum 0 --cors-origin https://your.page
//   https://your.page/?service=https://places.example:8443&map=lobby&anchor=1.2,0,3.5
//
// `anchor`: position in the map, map units. `unit`: metres of a unit, for a map that does not know them. `interval`: milliseconds between
// images, default 1000. The session needs `camera-access`: Chrome on Android with ARCore.
import * as THREE from "three";
import { Client, cameraImage, cameraOfView, load, orientationOfPose, poseOfView } from "veiloc";

const asked = new URLSearchParams(location.search);
const [map, interval] = [asked.get("map") ?? "lobby", Number(asked.get("interval") ?? 1000)];
const [x, y, z] = (asked.get("anchor") ?? "0,0,0").split(",").map(Number);
const mapFromAnchor = { position: { x, y, z }, orientation: { x: 0, y: 0, z: 0, w: 1 } };
const [start, output] = ["start", "state"].map((id) => document.getElementById(id));

const client = new Client(asked.get("service") ?? location.origin);
const device = await load(await client.profile(map));
const sealer = await device.sealer();
const alignment = await device.alignment(asked.has("unit") ? { metresPerUnit: Number(asked.get("unit")) } : {});

const renderer = new THREE.WebGLRenderer({ alpha: true, antialias: true });
renderer.xr.enabled = true;
const scene = new THREE.Scene();
const object = new THREE.Mesh(new THREE.BoxGeometry(0.2, 0.2, 0.2), new THREE.MeshNormalMaterial());
object.visible = false;
scene.add(object);

start.disabled = false;
output.value = "Ready";
start.addEventListener("click", async () => {
  const session = await navigator.xr.requestSession("immersive-ar", { requiredFeatures: ["local", "camera-access"] });
  renderer.xr.setReferenceSpaceType("local");
  await renderer.xr.setSession(session);
  const gl = renderer.getContext();
  const binding = new XRWebGLBinding(session, gl);
  // The images of one AR session share anchors, or their lines would intersect at the keypoints.
  const own = sealer.inSession(await device.session());
  const space = renderer.xr.getReferenceSpace();
  space.addEventListener("reset", () => alignment.reset());
  const near = new THREE.PerspectiveCamera();
  let busy = false;
  let next = 0;

  async function locate(image, camera, attitude, pose) {
    try {
      const query = await own.seal(await own.extract(image, camera, { attitude }));
      const update = alignment.add(await client.localize(map, query), pose);
      await query.free();
      output.value = `${alignment.state}: ${alignment.used} answers (${update})`;
    } catch (error) {
      // Too little texture, not found, no network: the object stays where the last answers put it.
      output.value = `${alignment.state}: ${error.message}`;
    }
    output.dataset.images = Number(output.dataset.images ?? 0) + 1;
    busy = false;
  }

  renderer.setAnimationLoop((time, frame) => {
    const view = frame?.getViewerPose(space)?.views[0];
    if (view?.camera && !busy && time >= next) {
      try {
        const pose = poseOfView(view);
        const image = cameraImage(gl, binding, view);
        [busy, next] = [true, time + interval];
        locate(image, cameraOfView(view), orientationOfPose(pose), pose);
      } catch (error) {
        output.value = error.message;
      }
    }
    const placed = alignment.worldFromAnchor(mapFromAnchor);
    object.visible = placed !== null;
    if (placed) {
      object.position.copy(placed.position);
      object.quaternion.copy(placed.orientation);
    }
    renderer.render(scene, near);
  });
});

// For the console.
Object.assign(globalThis, { alignment, object });
