#!/usr/bin/env python3
"""Writes posed images in the formats of other programs, to test the readers of `--posed`.

    python -m venv venv && venv/bin/pip install numpy
    venv/bin/python research/oracles/pose_formats.py fixtures     writes crates/tools/mapping/tests/data/importers/poses
    venv/bin/python research/oracles/pose_formats.py write MODEL DIR
                                                 writes every format of a COLMAP text model with one camera without distortion
                                                 (data/redkitchen/posed) to DIR/FORMAT

Each writer follows the documentation of its program, which the reader of the format names (crates/tools/mapping/src/importers/
poses). `fixtures` writes four images of a camera with all parameters that a format can hold, and beside them the COLMAP model that
a reader must return, to 1e-9. `study mapping formats` measures maps of each format.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.geometry import quaternion, read_posed  # noqa: E402

DATA = Path(__file__).resolve().parents[2] / "crates/tools/mapping/tests/data/importers/poses"
FLIP = np.diag([1.0, -1.0, -1.0])


@dataclass
class Camera:
    """Brown's distortion as OpenCV has it, pixels from the corner."""

    w: int
    h: int
    fx: float
    fy: float
    cx: float
    cy: float
    k: tuple = (0.0, 0.0, 0.0)
    p: tuple = (0.0, 0.0)

    def colmap(self):
        k1, k2, k3 = self.k
        return "FULL_OPENCV", [self.fx, self.fy, self.cx, self.cy, k1, k2, *self.p, k3, 0, 0, 0]


@dataclass
class Image:
    name: str
    r: np.ndarray  # camera from world
    t: np.ndarray

    @property
    def center(self):
        return -self.r.T @ self.t

    def c2w(self, flip=False):
        matrix = np.eye(4)
        matrix[:3, :3] = self.r.T @ (FLIP if flip else np.eye(3))
        matrix[:3, 3] = self.center
        return matrix


@dataclass
class Scene:
    camera: Camera
    images: list
    files: dict = field(default_factory=dict)


def rotation(axis, angle):
    """Rodrigues' formula; degrees."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    c = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = np.radians(angle)
    return np.eye(3) + np.sin(a) * c + (1 - np.cos(a)) * c @ c


def row(numbers):
    return " ".join(repr(float(n)) for n in numbers)


def save(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def save_json(path, value):
    save(path, json.dumps(value, indent=1) + "\n")


def write_colmap(folder, scene):
    c = scene.camera
    model, params = c.colmap()
    save(folder / "cameras.txt", f"1 {model} {c.w} {c.h} {row(params)}\n")
    lines = [
        f"{i} {row(quaternion(im.r))} {row(im.t)} 1 {im.name}\n\n" for i, im in enumerate(scene.images, 1)
    ]
    save(folder / "images.txt", "".join(lines))


def nerfstudio(folder, scene):
    """As `colmap_to_json` of nerfstudio: OpenGL's axes, and the world turned, with `applied_transform`."""
    c = scene.camera
    applied = np.eye(4)[[0, 2, 1], :]
    applied[2, :] *= -1
    applied[:, 3] = [0.5, -0.25, 2.0]
    frames = []
    for im in scene.images:
        matrix = np.vstack([applied, [0, 0, 0, 1]]) @ im.c2w(flip=True)
        frames.append({"file_path": f"images/{im.name}", "transform_matrix": matrix.tolist()})
    # The last frame has intrinsics of its own, which are the same.
    own = {"fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy}
    frames[-1].update(own)
    shared = {"w": c.w, "h": c.h, **own, "k1": c.k[0], "k2": c.k[1], "k3": c.k[2], "p1": c.p[0], "p2": c.p[1]}
    document = {"camera_model": "OPENCV", **shared, "applied_transform": applied.tolist(), "frames": frames}
    save_json(folder / "transforms.json", document)


def bundler(folder, scene):
    c = scene.camera
    lines = ["# Bundle file v0.3", f"{len(scene.images) + 1} 1"]
    for im in scene.images:
        lines.append(row([c.fx, c.k[0], c.k[1]]))
        lines += [row(r) for r in FLIP @ im.r] + [row(FLIP @ im.t)]
    # A camera that was not registered.
    lines += ["0 0 0"] + ["0 0 0"] * 4
    lines += ["0.5 0.25 4.0", "10 20 30", "2 0 17 1.5 -2.5 1 9 0.5 0.25"]
    save(folder / "bundle.out", "\n".join(lines) + "\n")
    save(folder / "list.txt", "".join(f"images/{im.name} 0 {c.fx}\n" for im in scene.images) + "missing.jpg\n")


def nvm(folder, scene):
    c = scene.camera
    lines = ["NVM_V3 ", "", str(len(scene.images))]
    for im in scene.images:
        lines.append(f"images/{im.name} {row([c.fx, *quaternion(im.r), *im.center])} 0 0")
    lines += ["", "1", "0.5 0.25 4.0 10 20 30 2 0 17 1.5 -2.5 1 9 0.5 0.25", "", "0"]
    save(folder / "place.nvm", "\n".join(lines) + "\n")


def opensfm(folder, scene):
    c = scene.camera
    side = max(c.w, c.h)
    camera = {
        "projection_type": "brown",
        "width": c.w,
        "height": c.h,
        "focal_x": c.fx / side,
        "focal_y": c.fy / side,
        "c_x": (c.cx - c.w / 2) / side,
        "c_y": (c.cy - c.h / 2) / side,
        "k1": c.k[0],
        "k2": c.k[1],
        "k3": c.k[2],
        "p1": c.p[0],
        "p2": c.p[1],
    }
    shots = {}
    for im in scene.images:
        w, *v = quaternion(im.r)
        angle = 2 * np.arctan2(np.linalg.norm(v), w)
        axis = np.array(v) / max(np.linalg.norm(v), 1e-300)
        shots[im.name] = {"rotation": (angle * axis).tolist(), "translation": im.t.tolist(), "camera": "v2 a phone"}
    first = {
        "cameras": {"v2 a phone": camera},
        "shots": shots,
        "points": {"7": {"color": [1.0, 2.0, 3.0], "coordinates": [0.5, 0.25, 4.0]}},
        "reference_lla": {"latitude": 47.0, "longitude": 8.0, "altitude": 400.0},
    }
    other = {"cameras": {}, "shots": {"other.jpg": {}}, "points": {}}
    save_json(folder / "reconstruction.json", [other, first])


def metashape(folder, scene):
    c = scene.camera
    # The chunk has another frame than the world.
    scale, r, t = 0.4, rotation([1, 2, 3], 50), np.array([3.0, -1.0, 2.0])
    cameras = []
    for i, im in enumerate(scene.images):
        matrix = im.c2w()
        matrix[:3, 3] = r.T @ (matrix[:3, 3] - t) / scale
        matrix[:3, :3] = r.T @ matrix[:3, :3]
        label = im.name.rsplit(".", 1)[0]
        camera = (
            f'<camera id="{i}" sensor_id="0" component_id="0" label="{label}">'
            f"<transform>{row(matrix.ravel())}</transform></camera>"
        )
        # Cameras may be in groups.
        cameras.append(f'<group id="0" label="walk" type="folder">{camera}</group>' if i == 1 else camera)
    cameras.append('<camera id="90" sensor_id="0" label="not_aligned"/>')
    xml = f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0">
  <chunk label="Chunk 1" enabled="true">
    <sensors next_id="1">
      <sensor id="0" label="a phone" type="frame">
        <resolution width="{c.w}" height="{c.h}"/>
        <calibration type="frame" class="initial"><resolution width="{c.w}" height="{c.h}"/><f>1</f></calibration>
        <calibration type="frame" class="adjusted">
          <resolution width="{c.w}" height="{c.h}"/>
          <f>{c.fy!r}</f><cx>{c.cx - c.w / 2!r}</cx><cy>{c.cy - c.h / 2!r}</cy><b1>{c.fx - c.fy!r}</b1>
          <k1>{c.k[0]!r}</k1><k2>{c.k[1]!r}</k2><k3>{c.k[2]!r}</k3><p1>{c.p[1]!r}</p1><p2>{c.p[0]!r}</p2>
        </calibration>
      </sensor>
    </sensors>
    <components next_id="1" active_id="0">
      <component id="0" label="Component 1">
        <transform>
          <rotation>{row(r.ravel())}</rotation><translation>{row(t)}</translation><scale>{scale!r}</scale>
        </transform>
      </component>
    </components>
    <cameras next_id="91">
      {chr(10).join(cameras)}
    </cameras>
  </chunk>
</document>
"""
    save(folder / "cameras.xml", xml)


def reality_capture(folder, scene):
    c = scene.camera
    lines = ["#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for im in scene.images:
        # R_z(-heading) R_x(pitch) R_y(roll), camera to world with OpenGL's axes.
        m = im.c2w(flip=True)[:3, :3]
        pitch = np.arcsin(m[2, 1])
        heading = np.arctan2(m[0, 1], m[1, 1])
        roll = np.arctan2(-m[2, 0], m[2, 2])
        angles = np.degrees([heading, pitch, roll])
        numbers = [*im.center, *angles, c.fx * 36 / max(c.w, c.h)] + [0.0] * 8
        lines.append(im.name + "," + ",".join(repr(float(n)) for n in numbers))
    save(folder / "cameras.csv", "\n".join(lines) + "\n")


def kapture(folder, scene):
    c = scene.camera
    model, params = c.colmap()
    sensors = ["# kapture format: 1.1", "# sensor_id, name, sensor_type, [sensor_params]+"]
    commas = lambda numbers: ", ".join(repr(float(n)) for n in numbers)
    sensors.append(f"cam0, a phone, camera, {model}, {c.w}, {c.h}, {commas(params)}")
    sensors.append("cam1, , camera, UNKNOWN_CAMERA, 10, 10")
    # The second half of the images is posed by a rig.
    r, t = rotation([0, 1, 1], 30), np.array([0.1, 0.2, -0.3])
    poses, records = [], []
    for i, im in enumerate(scene.images):
        if i < len(scene.images) // 2:
            poses.append(f"{i}, cam0, {commas(quaternion(im.r))}, {commas(im.t)}")
        else:
            poses.append(f"{i}, rig0, {commas(quaternion(r.T @ im.r))}, {commas(r.T @ (im.t - t))}")
        records.append(f"{i}, cam0, {im.name}")
    records.append("9999, cam1, other.jpg")
    head = "# kapture format: 1.1\n"
    save(folder / "sensors/sensors.txt", "\n".join(sensors) + "\n")
    save(folder / "sensors/rigs.txt", head + f"rig0, cam0, {commas(quaternion(r))}, {commas(t)}\n")
    save(folder / "sensors/trajectories.txt", head + "\n".join(poses) + "\n9999, cam0, , , , , 1, 2, 3\n")
    save(folder / "sensors/records_camera.txt", head + "\n".join(records) + "\n")


def tum(folder, scene):
    c = scene.camera
    model, params = c.colmap()
    lines, listed = ["# timestamp tx ty tz qx qy qz qw"], ["# timestamp filename"]
    for i, im in enumerate(scene.images):
        w, x, y, z = quaternion(im.r.T)
        lines.append(f"{1305031102.5 + 0.25 * i:.4f} {row(im.center)} {row([x, y, z, w])}")
        listed.append(f"{1305031102.5 + 0.25 * i:.4f} rgb/{im.name}")
    listed.append("1305031999.0000 rgb/late.png")
    save(folder / "groundtruth.txt", "\n".join(lines) + "\n")
    save(folder / "rgb.txt", "\n".join(listed) + "\n")
    save(folder / "cameras.txt", f"1 {model} {c.w} {c.h} {row(params)}\n")


def kitti(folder, scene):
    """Poses are of image_0; the images are those of a camera beside it."""
    c = scene.camera
    offset = np.array([-0.5, 0.0, 0.0])
    k = np.array([[c.fx, 0, c.cx - 0.5], [0, c.fy, c.cy - 0.5], [0, 0, 1]])
    calibration = ["P0: " + row(np.hstack([k, np.zeros((3, 1))]).ravel())]
    calibration.append("P2: " + row(np.hstack([k, (k @ offset)[:, None]]).ravel()))
    lines = []
    for im in scene.images:
        left = Image(im.name, im.r, im.t - offset)
        lines.append(row(left.c2w()[:3].ravel()))
    save(folder / "00.txt", "\n".join(lines) + "\n")
    save(folder / "calib.txt", "\n".join(calibration) + "\n")


def euroc(folder, scene):
    c = scene.camera
    body_from_cam = np.eye(4)
    body_from_cam[:3, :3], body_from_cam[:3, 3] = rotation([1, -1, 1], 100), [0.02, -0.06, 0.01]
    numbers = ", ".join(repr(float(n)) for n in body_from_cam.ravel())
    sensor = f"""sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)
T_BS:
  cols: 4
  rows: 4
  data: [{numbers[: len(numbers) // 2].rsplit(", ", 1)[0]},
         {numbers[len(numbers[: len(numbers) // 2].rsplit(", ", 1)[0]) + 2 :]}]
rate_hz: 20
resolution: [{c.w}, {c.h}]
camera_model: pinhole
intrinsics: [{c.fx!r}, {c.fy!r}, {c.cx - 0.5!r}, {c.cy - 0.5!r}] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [{c.k[0]!r}, {c.k[1]!r}, {c.p[0]!r}, {c.p[1]!r}]
"""
    save(folder / "mav0/cam0/sensor.yaml", sensor)
    poses, images = ["#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"], [
        "#timestamp [ns],filename"
    ]
    for i, im in enumerate(scene.images):
        body = im.c2w() @ np.linalg.inv(body_from_cam)
        time = 1403636579763555584 + 250000000 * i
        poses.append(f"{time}," + ",".join(repr(float(n)) for n in [*body[:3, 3], *quaternion(body[:3, :3])]))
        images.append(f"{time},{im.name}")
    save(folder / "mav0/state_groundtruth_estimate0/data.csv", "\n".join(poses) + "\n")
    save(folder / "mav0/cam0/data.csv", "\n".join(images) + "\n")


def polycam(folder, scene):
    c = scene.camera
    for im in scene.images:
        m = im.c2w(flip=True)
        frame = {f"t_{i}{j}": m[i, j] for i in range(3) for j in range(4)}
        frame |= {"fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, "width": c.w, "height": c.h, "blur_score": 100.0}
        save_json(folder / f"keyframes/corrected_cameras/{im.name.rsplit('.', 1)[0]}.json", frame)


def record3d(folder, scene):
    c = scene.camera
    k = np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]])
    poses = []
    for im in scene.images:
        m = im.c2w(flip=True)
        w, x, y, z = quaternion(m[:3, :3])
        poses.append([x, y, z, w, *im.center])
    save_json(folder / "metadata.json", {"K": k.T.ravel().tolist(), "w": c.w, "h": c.h, "fps": 60, "poses": poses})


def scanner_app(folder, scene):
    c = scene.camera
    k = np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]])
    for i, im in enumerate(scene.images):
        frame = {"cameraPoseARFrame": im.c2w(flip=True).ravel().tolist(), "intrinsics": k.ravel().tolist()}
        save_json(folder / f"frame_{i:05}.json", frame | {"frame_index": i})


# The parameters that a format can hold: two focal lengths, principal point, three radial terms, two tangential ones.
FORMATS = {
    nerfstudio: "ocrrrt",
    bundler: "rr",
    nvm: "",
    opensfm: "ocrrrt",
    metashape: "ocrrrt",
    reality_capture: "",
    kapture: "ocrrrt",
    tum: "ocrrrt",
    kitti: "oc",
    euroc: "ocrrt",
    polycam: "oc",
    record3d: "oc",
    scanner_app: "oc",
}

# Names as the format has them; others are called walk/a.jpg, ….
NUMBERED = {kitti: "{:06}.png", record3d: "{}.jpg", scanner_app: "frame_{:05}.jpg"}


def fixture(form):
    holds = FORMATS[form]
    k = [(-0.2, 0.05, -0.01)[i] if holds.count("r") > i else 0.0 for i in range(3)]
    camera = Camera(
        64,
        48,
        60.5,
        61.25 if "o" in holds else 60.5,
        31.75 if "c" in holds else 32.0,
        24.5 if "c" in holds else 24.0,
        tuple(k),
        (0.001, -0.002) if "t" in holds else (0.0, 0.0),
    )
    turns = [([1, 0, 0], 0), ([1, 2, -1], 40), ([0, 1, 0.2], 170), ([-3, 1, 2], 95)]
    images = []
    for i, (axis, angle) in enumerate(turns):
        name = NUMBERED.get(form, f"{'abcd'[i]}.jpg").format(i)
        images.append(Image(name, rotation(axis, angle), np.array([0.3 * i - 0.5, 0.125 * i, 2.0 - i])))
    return Scene(camera, images)


def read_model(folder):
    known = read_posed(folder)
    model, w, h, f, *rest = next(iter(known.values())).camera.split()
    if model not in ("SIMPLE_PINHOLE", "PINHOLE"):
        sys.exit(f"{model} has distortion")
    rest = list(map(float, rest if model == "PINHOLE" else [f, *rest]))
    return Scene(Camera(int(w), int(h), float(f), *rest), [Image(name, posed.r, posed.t) for name, posed in known.items()])


def main():
    match sys.argv[1:]:
        case ["fixtures"]:
            for form in FORMATS:
                scene = fixture(form)
                form(DATA / form.__name__, scene)
                write_colmap(DATA / "expected" / form.__name__, scene)
        case ["write", model, folder]:
            scene = read_model(Path(model))
            for form in FORMATS:
                if form not in NUMBERED:
                    form(Path(folder) / form.__name__, scene)
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
