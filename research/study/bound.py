"""Errors of estimated poses beside the Cramér–Rao bound, on random synthetic problems.

    python3 research/study bound [--problems N] [--csv FILE] [--plot FILE.svg]

Needs the Python package `veiloc`. A problem has 400 matches all over a 640 × 480 image, some of them wrong, and Gaussian noise on
its keypoints. The bound is the inverse Fisher information of the right matches at the true pose, `JᵀJ / σ²` with the pixel's (for
a line: its distance's) derivative by rotation and translation. `σ²` is the noise of the keypoints plus that of the obfuscation:
dither, uniform over one pixel, and the rounding of what is sent. Ratios are median errors over the medians of errors that are
drawn from the bound, over the problems that were found (half of the right matches agree); a row has the geometric mean over all
scenes, noises and shares of outliers.
"""

import argparse
import csv
import sys
from concurrent.futures import ThreadPoolExecutor
from zlib import crc32

import numpy as np
import veiloc

SIZE, BITS, DRAWS = np.array([640, 480]), 12, 16
SCHEMES = ["points", "random-lines", "dcl:paper"]
# Focal length in pixels, depths in map units, and thickness of a slanted plane.
SCENES = {"deep": (525.0, (2, 12), None), "near-planar": (525.0, (2, 6), 0.05), "narrow": (320 / np.tan(np.radians(10)), (2, 6), None)}


def generate(scene: str, noise: float, outliers: float, random, matches: int = 400) -> tuple:
    """Focal length, true R and t, observed pixels, map points, and which matches are right."""
    focal, (near, far), thickness = SCENES[scene]
    q, t = random.normal(size=4), random.uniform(-3, 3, 3)
    R, slant = veiloc.CameraPose(q=q / np.linalg.norm(q), t=t).R, random.uniform(-0.5, 0.5, 2)

    def points(pixels):
        rays = (pixels - SIZE / 2) / focal
        z = random.uniform(near, far, len(rays))
        if thickness:
            z = (near + far) / 2 / np.maximum(1 - rays @ slant, 0.2) + random.uniform(-thickness, thickness, len(rays))
        return (np.column_stack([rays, np.ones(len(rays))]) * z[:, None] - t) @ R

    exact = random.uniform(0, SIZE, (matches, 2))
    right = np.ones(matches, bool)
    right[random.choice(matches, round(outliers * matches), replace=False)] = False
    map_points = np.where(right[:, None], points(exact), points(random.uniform(0, SIZE, (matches, 2))))
    return focal, R, t, exact + noise * random.normal(size=exact.shape), map_points, right


def errors(R, t, R_true, t_true) -> tuple[float, float]:
    """Position error, map units, and rotation error, degrees."""
    chord = np.linalg.norm(R - R_true) / np.sqrt(8)
    return np.linalg.norm(R.T @ t - R_true.T @ t_true), np.degrees(2 * np.arcsin(min(chord, 1)))


def rotation(w) -> np.ndarray:
    half = np.linalg.norm(w) / 2
    return veiloc.CameraPose(q=np.concatenate([[np.cos(half)], np.sinc(half / np.pi) * np.asarray(w) / 2]), t=np.zeros(3)).R


def trial(scene: str, noise: float, outliers: float, scheme: str, index: int, seed: int) -> dict:
    """One problem; every scheme gets the same keypoints."""
    name = f"{seed} {scene} {noise} {outliers} {index}"
    random = np.random.default_rng(crc32(name.encode()))
    focal, R, t, pixels, points, right = generate(scene, noise, outliers, random)
    camera = {"model": "PINHOLE", "width": 640, "height": 480, "params": [focal, focal, 320, 240]}
    in_image = ((pixels >= 0) & (pixels < SIZE)).all(axis=1)
    pixels, points, right = pixels[in_image], points[in_image], right[in_image]
    sent = veiloc.obfuscate(pixels, 640, 480, scheme, angle_bits=BITS, seed=index)
    # Derivative of each pixel by the left tangent of the pose: rotation, then translation.
    x, y, z = (points @ R.T + t).T
    o = np.zeros_like(z)
    by_point = focal * np.stack([np.stack([1 / z, o, -x / z**2], 1), np.stack([o, 1 / z, -y / z**2], 1)], 1)
    turn = np.stack([np.stack([o, z, -y], 1), np.stack([-z, o, x], 1), np.stack([y, -x, o], 1)], 1)
    J = by_point @ np.concatenate([turn, np.broadcast_to(np.eye(3), (len(z), 3, 3))], 2)
    rounding = 0.25**2 / 12
    options = {"ransac_opt": {"seed": index}}
    if sent["kind"] == "points":
        estimate, used = veiloc.estimate_absolute_pose, (sent["points"],)
    elif sent["kind"] == "lines":
        estimate, used = veiloc.estimate_absolute_pose_lines, (sent["lines"],)
        J = np.einsum("ni,nij->nj", sent["lines"][:, :2], J)
    else:
        estimate, used = veiloc.estimate_absolute_pose_anchored, (sent["anchors"], sent["angles"])
        options |= {"layout": scheme, "layout_focal": sent["layout_focal"]}
        # A step of a pixel across its line turns the line by the inverse of its distance from the anchor.
        layout = camera | {"params": [sent["layout_focal"]] * 2 + [320, 240]}
        seen = np.column_stack([x, y]) / z[:, None] * focal + SIZE / 2
        angle = [veiloc.anchored_lines(seen + step, layout, scheme)[1] for step in ([0, 0], [1e-3, 0], [0, 1e-3])]
        turns = np.column_stack([np.angle(np.exp(1j * (moved - angle[0]))) for moved in angle[1:]]) / 1e-3
        radius = 1 / np.linalg.norm(turns, axis=1)
        rounding = np.mean(radius[right] ** 2) * (np.pi / 2**BITS) ** 2 / 12
        J = np.einsum("ni,nij->nj", turns * radius[:, None], J)
    J = J[right].reshape(-1, 6)
    bound = np.linalg.inv(J.T @ J / (noise**2 + 1 / 12 + rounding))
    steps = random.multivariate_normal(np.zeros(6), bound, DRAWS, method="cholesky")
    result = {"found": False, "predicted": [errors(rotation(s[:3]) @ R, rotation(s[:3]) @ t + s[3:], R, t) for s in steps]}
    try:
        pose, info = estimate(*used, points, camera, **options)
    except veiloc.NotLocalizedError:
        return result
    return result | {"found": (info["inliers"] & right).sum() >= right.sum() / 2, "error": errors(pose.R, pose.t, R, t)}


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="study bound", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=500, metavar="N", help="of each scene, noise, share of outliers and scheme")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.5, 1, 2], metavar="PX")
    parser.add_argument("--outliers", type=float, nargs="+", default=[30, 50, 80], metavar="PERCENT")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--csv", type=argparse.FileType("w"), default=sys.stdout, metavar="FILE")
    parser.add_argument("--plot", metavar="FILE.svg", help="position errors over the bound")
    args = parser.parse_args(arguments)
    rows, curves = csv.writer(args.csv, lineterminator="\n"), {}
    rows.writerow(["scheme", "found (%)", "position error over bound", "rotation error over bound", "problems"])
    for scheme in SCHEMES:
        ratios, shares = [], []
        for scene, outliers, noise in [(s, o, n) for s in SCENES for o in args.outliers for n in args.noise]:
            with ThreadPoolExecutor() as pool:
                trials = list(pool.map(lambda k: trial(scene, noise, outliers / 100, scheme, k, args.seed), range(args.problems)))  # noqa: B023
            found = [one for one in trials if one["found"]]
            shares.append(len(found) / len(trials))
            if found:
                predicted = np.concatenate([one["predicted"] for one in found])
                ratios.append(np.median([one["error"] for one in found], axis=0) / np.median(predicted, axis=0))
                curves.setdefault((scene, outliers), {}).setdefault(scheme, []).append((noise, ratios[-1][0]))
        means = np.exp(np.mean(np.log(ratios), axis=0))
        rows.writerow([scheme, f"{100 * np.mean(shares):.1f}", *(f"{mean:.2f}" for mean in means), len(shares) * args.problems])
    if args.plot:
        from matplotlib import pyplot

        figure, panels = pyplot.subplots(len(SCENES), len(args.outliers), figsize=(12, 9), sharex=True, sharey=True, squeeze=False)
        for panel, ((scene, outliers), of_scheme) in zip(panels.flat, curves.items()):
            for scheme, points in of_scheme.items():
                panel.plot(*zip(*points), marker="o", label=scheme)
            panel.set(title=f"{scene}, {outliers:.0f} % outliers", xlabel="noise of a keypoint, px", ylabel="error / bound", ylim=(0.8, 2))
        panels.flat[0].legend()
        figure.savefig(args.plot, bbox_inches="tight")


if __name__ == "__main__":
    main()
