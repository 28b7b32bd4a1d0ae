#!/usr/bin/env python3
"""Tests our COLMAP reader and writer against COLMAP's own.

    .venv/bin/python research/oracles/colmap.py fixtures      writes crates/server/map/tests/data/colmap/{text,binary}
    .venv/bin/python research/oracles/colmap.py rigs          writes crates/server/map/tests/data/colmap/rigs-{text,binary}
    .venv/bin/python research/oracles/colmap.py read DIR      reads a model that we wrote, and prints its content as COLMAP reads it

`fixtures` creates a small model (five camera models, four images, points, an image without 2D points), and pycolmap writes it as text
and as binary; the tests of crates/server/map compare our two readers with them.
`rigs` does the same with a rig of two cameras, one of which has a pose on it, and a camera of its own.
`read` recomputes every reprojection error with COLMAP's projection and compares it with the ERROR column.
"""

import sys
from pathlib import Path

import numpy as np
import pycolmap

CAMERAS = [
    ("SIMPLE_PINHOLE", [525.5, 320, 240]),
    ("PINHOLE", [500, 510, 320, 240]),
    ("SIMPLE_RADIAL", [500, 320, 240, -0.03]),
    ("RADIAL", [500, 320, 240, -0.03, 0.01]),
    ("OPENCV", [500, 510, 320, 240, -0.1, 0.02, 0.001, -0.0007]),
]


def fixtures(root):
    rng = np.random.default_rng(0)
    model = pycolmap.Reconstruction()
    for i, (name, params) in enumerate(CAMERAS):
        camera = pycolmap.Camera(model=name, width=640, height=480, params=params, camera_id=i + 1)
        model.add_camera_with_trivial_rig(camera)
    points = rng.uniform([-1, -1, 3], [1, 1, 5], (12, 3))
    for i in range(4):
        axis = rng.normal(size=3) * 0.05
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(axis), rng.normal(size=3) * 0.2)
        image = pycolmap.Image(name=f"photo {i}.jpg" if i == 1 else f"photo{i}.jpg", camera_id=i + 2, image_id=10 * i + 3)
        if i < 3:
            camera = model.cameras[i + 2]
            pixels = [camera.img_from_cam(pose * p) + rng.normal(size=2) * 0.3 for p in points]
            pixels.insert(i, rng.uniform(0, 400, 2))  # a keypoint without a point
            image.points2D = pycolmap.Point2DList([pycolmap.Point2D(p) for p in pixels])
        model.add_image_with_trivial_frame(image, pose)
    for k, point in enumerate(points):
        track = pycolmap.Track()
        for i in range(3):
            if (i + k) % 4 != 0:
                track.add_element(10 * i + 3, k if k < i else k + 1)
        model.add_point3D(point, track, rng.integers(0, 256, 3).astype(np.uint8))
    model.update_point_3d_errors()
    for name, write in [("text", model.write_text), ("binary", model.write_binary)]:
        folder = root / name
        folder.mkdir(parents=True, exist_ok=True)
        write(str(folder))
        for extra in ["frames", "rigs"]:
            for file in folder.glob(f"{extra}.*"):
                file.unlink()


def rigs(root):
    rng = np.random.default_rng(1)
    pose = lambda turn, step: pycolmap.Rigid3d(pycolmap.Rotation3d(rng.normal(size=3) * turn), rng.normal(size=3) * step)
    camera = lambda number: pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number)
    model = pycolmap.Reconstruction()
    for i in (1, 2, 3):
        model.add_camera(pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 510, 320, 240], camera_id=i))
    stereo = pycolmap.Rig(rig_id=5)
    stereo.add_ref_sensor(camera(1))
    stereo.add_sensor(camera(2), pose(0.8, 0.3))
    alone = pycolmap.Rig(rig_id=6)
    alone.add_ref_sensor(camera(3))
    model.add_rig(stereo)
    model.add_rig(alone)
    # Frame: its rig, and the camera of each of its images. The third has no image of the reference sensor.
    number = 0
    for frame_id, (rig, cameras) in enumerate([(5, [1, 2]), (5, [2, 1]), (5, [2]), (6, [3])], 1):
        frame = pycolmap.Frame(frame_id=frame_id, rig_id=rig, rig_from_world=pose(0.5, 1.0))
        images = []
        for sensor in cameras:
            number += 1
            frame.add_data_id(pycolmap.data_t(camera(sensor), number))
            images.append(pycolmap.Image(name=f"camera{sensor}/{frame_id}.jpg", camera_id=sensor, image_id=number))
            images[-1].frame_id = frame_id
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
        model.register_frame(frame_id)
    for name, write in [("rigs-text", model.write_text), ("rigs-binary", model.write_binary)]:
        folder = root / name
        folder.mkdir(parents=True, exist_ok=True)
        write(str(folder))


def read(folder):
    model = pycolmap.Reconstruction(str(folder))
    print(model.summary())
    stored = {i: p.error for i, p in model.points3D.items()}
    model.update_point_3d_errors()
    apart = [abs(p.error - stored[i]) / max(stored[i], 1e-9) for i, p in model.points3D.items()]
    print(f"ERROR column against COLMAP's projection: {len(apart)} points, largest relative difference {max(apart):.2e}")


if __name__ == "__main__":
    if sys.argv[1:] == ["fixtures"]:
        fixtures(Path(__file__).resolve().parents[2] / "crates/server/map/tests/data/colmap")
    elif sys.argv[1:] == ["rigs"]:
        rigs(Path(__file__).resolve().parents[2] / "crates/server/map/tests/data/colmap")
    elif len(sys.argv) == 3 and sys.argv[1] == "read":
        read(Path(sys.argv[2]))
    else:
        sys.exit(__doc__)
