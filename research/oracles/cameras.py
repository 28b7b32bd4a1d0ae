#!/usr/bin/env python3
"""Writes reference projections by pycolmap for all COLMAP cameras in veiloc: crates/core/geometry/tests/data/cameras.txt.

    python -m venv venv && venv/bin/pip install pycolmap numpy
    venv/bin/python research/oracles/cameras.py crates/core/geometry/tests/data/cameras.txt

A line is `camera MODEL,W,H,PARAMS…` or `point X Y U V X' Y'`: a position on the plane z = 1, its pixel, and the position to which
pycolmap unprojects this pixel. pycolmap stops iterating by step size, not by residual; the script prints the error of X', Y'.
"""
import sys

import numpy as np
import pycolmap

CAMERAS = {
    "SIMPLE_PINHOLE": [525.5, 320, 240],
    "PINHOLE": [1379.74, 1382.08, 760.6, 503.7],
    "SIMPLE_RADIAL": [2435.38, 648, 968, -0.0336422],
    "RADIAL": [900, 500, 400, -0.12, 0.03],
    "OPENCV": [900, 905, 510, 390, -0.15, 0.05, 0.001, -0.0007],
    "OPENCV_FISHEYE": [500, 505, 510, 390, -0.03, 0.01, -0.004, 0.0005],
    "FULL_OPENCV": [900, 905, 510, 390, -0.15, 0.05, 0.001, -0.0007, 0.01, 0.02, -0.01, 0.003],
    "FOV": [500, 505, 510, 390, 0.9],
    "SIMPLE_RADIAL_FISHEYE": [500, 510, 390, -0.02],
    "RADIAL_FISHEYE": [500, 510, 390, -0.02, 0.004],
    "THIN_PRISM_FISHEYE": [500, 505, 510, 390, -0.03, 0.01, 0.001, -0.0007, -0.004, 0.0005, 0.002, -0.001],
    "RAD_TAN_THIN_PRISM_FISHEYE": [500, 505, 510, 390, -0.03, 0.01, 0.002, -0.004, 0.001, -0.0002, 0.01, -0.007, 0.02, -0.01, 0.005, 0.003],
    "SIMPLE_DIVISION": [700, 510, 390, -0.2],
    "DIVISION": [700, 705, 510, 390, 0.1],
    "SIMPLE_FISHEYE": [500, 510, 390],
    "FISHEYE": [500, 505, 510, 390],
    "EUCM": [500, 505, 510, 390, 0.6, 1.1],
}
SIZES = {"SIMPLE_PINHOLE": (640, 480), "PINHOLE": (1536, 1024), "SIMPLE_RADIAL": (1296, 1936)}


def main() -> None:
    rng = np.random.default_rng(7)
    lines = ["# research/oracles/cameras.py, pycolmap " + pycolmap.__version__]
    for model, params in CAMERAS.items():
        width, height = SIZES.get(model, (1000, 800))
        camera = pycolmap.Camera(model=model, width=width, height=height, params=params)
        words = [repr(float(p)) for p in params]
        lines.append(f"camera {','.join([model, str(width), str(height), *words])}")
        # Inside the image, and at its centre, where quotients are small.
        reach = 0.45 * min(width, height) / params[0]
        xy = np.vstack([rng.uniform(-reach, reach, (24, 2)), [[0, 0], [1e-9, 0], [1e-5, -1e-5], [3e-3, 1e-3]]])
        rays = np.hstack([xy, np.ones((len(xy), 1))])
        pixels = np.asarray([camera.img_from_cam(ray) for ray in rays]).reshape(-1, 2)
        back = np.asarray([camera.cam_from_img(pixel) for pixel in pixels]).reshape(-1, 2)
        print(f"{model}: error of pycolmap's unprojection: {np.abs(back - xy).max():.1e} at most", file=sys.stderr)
        for (x, y), (u, v), (bx, by) in zip(xy, pixels, back):
            lines.append("point " + " ".join(repr(float(n)) for n in (x, y, u, v, bx, by)))
    with open(sys.argv[1], "w") as file:
        file.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
