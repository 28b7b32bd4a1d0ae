"""Compares poses from points, lines and anchored lines of the same keypoints; also with PoseLib, if it is installed.

    python examples/python/solver_comparison.py
"""

import time

import numpy as np

import veiloc

CAMERA = {"model": "SIMPLE_PINHOLE", "width": 640, "height": 480, "params": [525.0, 320.0, 240.0]}


def problem(rng: np.random.Generator, count: int = 500, wrong: float = 0.4) -> tuple:
    """Pixels `[N, 2]` with noise of 0.5 px and outliers, points `[N, 3]`, and the true pose."""
    q, t = rng.normal(size=4), rng.normal(size=3)
    pose = veiloc.CameraPose(q, t)
    pixels = rng.uniform([0, 0], [640, 480], (count, 2))
    rays = np.column_stack([(pixels - [320, 240]) / 525, np.ones(count)])
    points = (rays * rng.uniform(2, 8, (count, 1)) - t) @ pose.R
    pixels += rng.normal(scale=0.5, size=pixels.shape)
    pixels[: int(wrong * count)] = rng.uniform([0, 0], [640, 480], (int(wrong * count), 2))
    return pixels, points, pose


def main() -> None:
    """Prints median errors and times of 20 problems."""
    rng = np.random.default_rng(0)
    problems = [problem(rng) for _ in range(20)]

    def lines(pixels, points):
        sent = veiloc.obfuscate(pixels, 640, 480, "random-lines")
        return veiloc.estimate_absolute_pose_lines(sent["lines"], points, CAMERA)[0]

    def anchored(pixels, points):
        sent = veiloc.obfuscate(pixels, 640, 480, "dcl")
        lines = sent["anchors"], sent["angles"]
        return veiloc.estimate_absolute_pose_anchored(*lines, points, CAMERA, layout_focal=sent["layout_focal"])[0]

    ways = {
        "points": lambda pixels, points: veiloc.estimate_absolute_pose(pixels, points, CAMERA)[0],
        "random lines": lines,
        "dual convergent lines": anchored,
    }
    try:
        import poselib
    except ImportError:
        print("PoseLib is not installed (pip install poselib)")
    else:

        def theirs(pixels, points):
            found, _ = poselib.estimate_absolute_pose(pixels, points, CAMERA, {"max_reproj_error": 4.0}, {})
            return veiloc.CameraPose(found.q, found.t)

        ways["PoseLib, points"] = theirs

    for name, way in ways.items():
        began = time.perf_counter()
        errors = [pose.error(way(pixels, points)) for pixels, points, pose in problems]
        ms = 1e3 * (time.perf_counter() - began) / len(problems)
        degrees, off = np.median(errors, axis=0)
        print(f"{name:<22} {degrees:.4f}°  {off:.5f} units  {ms:.1f} ms")


if __name__ == "__main__":
    main()
