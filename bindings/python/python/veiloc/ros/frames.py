"""The images of a bag as files with poses, from which `veiloc map build` makes a map."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import veiloc
from veiloc.ros import messages
from veiloc.ros.bag import Bag
from veiloc.ros.geometry import Matrix, angle_deg, inverse, pose

Progress = Callable[[str, int, int], object]


def write_frames(
    bag: Bag,
    out: Path,
    *,
    min_translation: float = 0.1,
    min_rotation_deg: float = 5.0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Writes `images/` and `posed/` (COLMAP's text) into a folder: images between which a camera moved or turned enough.

    Args:
        bag: the bag.
        out: the folder; it is made.
        min_translation: metres between two images of one camera that are kept.
        min_rotation_deg: degrees, likewise; an image is kept when it moved or turned enough. 0 keeps all.
        progress: a callable of (stage, done, total).

    Returns:
        `images`: how many were kept; `of`; `remarks`: what was left out; `down` and `metres`: of the frame of the poses (REP 103).

    Raises:
        Error: no image has a pose.
    """
    from PIL import Image

    kept: list[tuple[str, str, veiloc.CameraPose]] = []
    last: dict[str, Matrix] = {}
    left_out: dict[str, int] = {}
    total, seen = bag.count, 0
    for picture in bag.pictures():
        seen += 1
        if progress is not None:
            progress("images of the bag", seen, total)
        odom_from_base = bag.odom_from_base(picture.stamp)
        if odom_from_base is None:
            left_out["there is no pose near their time"] = left_out.get("there is no pose near their time", 0) + 1
            continue
        odom_from_cam = odom_from_base @ bag.extrinsics(picture)
        before = last.get(picture.topic)
        if before is not None:
            step = inverse(before) @ odom_from_cam
            if np.linalg.norm(step[:3, 3]) < min_translation and angle_deg(step) < min_rotation_deg:
                continue
        try:
            pixels = messages.image_of(picture.message)
        except veiloc.ImageError as error:
            left_out[str(error)] = left_out.get(str(error), 0) + 1
            continue
        camera = bag.cameras[picture.topic]
        if pixels.shape[:2] != (camera["height"], camera["width"]):
            why = f"they have {pixels.shape[1]} × {pixels.shape[0]} pixels, and their camera {camera['width']} × {camera['height']}"
            left_out[why] = left_out.get(why, 0) + 1
            continue
        last[picture.topic] = odom_from_cam
        data, ending = _file_of(picture.message)
        name = f"{picture.topic.strip('/').replace('/', '_')}/{picture.stamp:019d}{ending}"
        path = out / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if data is None:
            Image.fromarray(pixels).save(path)
        else:
            path.write_bytes(data)
        kept.append((picture.topic, name, pose(inverse(odom_from_cam))))
    remarks = [*bag.remarks, *(f"{count} images are left out: {why}" for why, count in left_out.items())]
    if not kept:
        raise veiloc.Error(f"{bag.path}: no image has a pose" + "".join(f"; {remark}" for remark in remarks))
    _write_model(bag, out / "posed", kept)
    return {"images": len(kept), "of": seen, "remarks": remarks, "down": [0.0, 0.0, -1.0], "metres": True}


def _file_of(message: Any) -> tuple[bytes | None, str]:
    """The bytes of a compressed image as they are, if they are a file of a known kind, and the ending of the file."""
    if hasattr(message, "encoding"):
        return None, ".png"
    data = bytes(message.data)
    for start, ending in ((b"\xff\xd8", ".jpg"), (b"\x89PNG", ".png")):
        if data.startswith(start):
            return data, ending
    return None, ".png"


def _write_model(bag: Bag, folder: Path, kept: list[tuple[str, str, veiloc.CameraPose]]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    numbers = {topic: number for number, topic in enumerate(bag.topics, 1)}
    cameras = []
    for topic, number in numbers.items():
        camera = bag.cameras[topic]
        params = " ".join(repr(float(value)) for value in camera["params"])
        cameras.append(f"{number} {camera['model']} {camera['width']} {camera['height']} {params}\n")
    images = []
    for number, (topic, name, cam_from_odom) in enumerate(kept, 1):
        numbers_of = " ".join(repr(float(value)) for value in [*cam_from_odom.q, *cam_from_odom.t])
        images.append(f"{number} {numbers_of} {numbers[topic]} {name}\n\n")
    for name, lines in (("cameras.txt", cameras), ("images.txt", images), ("points3D.txt", [])):
        beside = folder / f".{name}.new"
        beside.write_text("".join(lines))
        os.replace(beside, folder / name)
