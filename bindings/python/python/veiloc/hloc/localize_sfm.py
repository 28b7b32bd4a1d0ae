"""`hloc.localize_sfm` on lines: the same arguments and files, and `scheme`, which selects how keypoints are obfuscated.

The query's keypoints and matches are read as hloc reads them. Then each keypoint is obfuscated as on a device, and the pose is
estimated from the result. `scheme="points"` obfuscates nothing.
"""

import logging
import pickle
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from veiloc import _native
from veiloc._native import CameraPose, ColmapModel
from veiloc.errors import InputError, NotLocalizedError
from veiloc.hloc.files import Hdf5, read_queries, read_retrieval

if TYPE_CHECKING:
    from veiloc._native import Scheme, _CameraFields as Camera

logger = logging.getLogger("veiloc.hloc")

Log = dict[str, Any]


def main(
    reference_sfm: "Path | str | ColmapModel",
    queries: "Path | str",
    retrieval: "Path | str",
    features: "Path | str",
    matches: "Path | str",
    results: "Path | str",
    ransac_thresh: float = 12,
    covisibility_clustering: bool = False,
    prepend_camera_name: bool = False,
    config: "dict[str, Any] | None" = None,
    *,
    scheme: "Scheme" = "points",
    angle_bits: int = 12,
    seed: int = 0,
) -> dict[str, CameraPose]:
    """Localizes queries in a COLMAP model and writes their poses, one a line: `NAME QW QX QY QZ TX TY TZ`.

    Args:
        reference_sfm: the model's folder.
        queries: list of names with intrinsics (or a pattern of such lists).
        retrieval: pairs of queries and images of the model.
        features, matches: hloc's HDF5 files.
        results: the file to write; the log `RESULTS_logs.pkl` beside it also holds the keypoints.
        ransac_thresh: pixels; for `config={"ransac_opt": {"score": "msac"}}`. The default score has no threshold.
        covisibility_clustering: localize with each cluster of covisible images, and return the best pose.
        prepend_camera_name: write the folder of a query before its name.
        config: `ransac_opt` and `bundle_opt` of `veiloc.estimate_absolute_pose`.
        scheme: how keypoints are obfuscated: `"points"` (not at all), `"dcl"` and its layouts, `"random-lines"`,
            `"coordinate-permutation"`.
        angle_bits: bits of each quantized angle.
        seed: seed of all randomness.

    Returns:
        The poses written, by query.

    Raises:
        InputError: a file cannot be read, or the files do not belong together.
        MapError: the model cannot be read.
    """
    options = _options(dict(config or {}), ransac_thresh, seed)
    model = reference_sfm if isinstance(reference_sfm, ColmapModel) else ColmapModel.open(Path(reference_sfm))
    listed, pairs = read_queries(Path(queries)), read_retrieval(Path(retrieval))
    obfuscation = {"scheme": scheme, "angle_bits": angle_bits, "seed": seed}
    poses: dict[str, CameraPose] = {}
    logs: Log = {"features": features, "matches": matches, "retrieval": retrieval, "scheme": scheme, "loc": {}}
    points = model.points
    with Hdf5(Path(features)) as keypoints, Hdf5(Path(matches)) as matched:
        for name, camera in listed:
            if name not in pairs:
                logger.warning("No images retrieved for query image %s. Skipping...", name)
                continue
            images = _in_model(model, pairs[name])
            if not images:
                logger.warning("None of the images retrieved for %s is in the model. Skipping...", name)
                continue
            found = keypoints.keypoints(name)
            clusters = _clusters(model, images) if covisibility_clustering else [images]
            tried = [_localize(model, points, found, name, camera, c, matched, obfuscation, options) for c in clusters]
            best = max(range(len(tried)), key=lambda i: tried[i]["num_inliers"])
            log = tried[best]
            pose = log["PnP_ret"]["cam_from_world"] if log["PnP_ret"] else model.pose(images[0])
            assert pose is not None
            poses[name] = pose
            log["covisibility_clustering"] = covisibility_clustering
            if covisibility_clustering:
                log = {**log, "best_cluster": best, "log_clusters": tried}
            logs["loc"][name] = log
    logger.info("Localized %d / %d images.", len(poses), len(listed))
    _write(Path(results), poses, prepend_camera_name)
    Path(f"{results}_logs.pkl").write_bytes(pickle.dumps(logs))
    return poses


def _options(config: dict[str, Any], threshold: float, seed: int) -> dict[str, Any]:
    ransac, bundle = dict(config.pop("ransac_opt", {})), dict(config.pop("bundle_opt", {}))
    if config:
        raise InputError(f"config: unknown key {', '.join(config)}; the keys are ransac_opt and bundle_opt, as for estimate_absolute_pose")
    if ransac.get("score") == "msac":
        ransac.setdefault("max_reproj_error", threshold)
    elif threshold != 12:
        logger.warning("ransac_thresh has no effect: only the score msac has a threshold; the likelihood estimates the noise.")
    ransac.setdefault("seed", seed)
    return {"ransac_opt": ransac, "bundle_opt": bundle}


def _in_model(model: ColmapModel, names: list[str]) -> list[str]:
    present = [name for name in names if model.pose(name) is not None]
    for name in sorted(set(names) - set(present)):
        logger.warning("Image %s was retrieved but not in database", name)
    return present


def _clusters(model: ColmapModel, images: list[str]) -> list[list[str]]:
    """Clusters of covisible images (connected components), the largest first."""
    seen = {name: _seen(model, name) for name in images}
    left, clusters = list(images), []
    while left:
        open_, cluster = [left.pop(0)], []
        while open_:
            name = open_.pop()
            cluster.append(name)
            joined = [other for other in left if seen[other] & seen[name]]
            left = [other for other in left if other not in joined]
            open_ += joined
        clusters.append(sorted(cluster, key=images.index))
    return sorted(clusters, key=len, reverse=True)


def _seen(model: ColmapModel, name: str) -> set[int]:
    rows = model.point_rows(name)
    return set() if rows is None else set(rows[rows != -1].tolist())


def _localize(
    model: ColmapModel,
    points: npt.NDArray[np.float64],
    keypoints: npt.NDArray[np.float64],
    name: str,
    camera: "Camera",
    images: list[str],
    matched: Hdf5,
    obfuscation: dict[str, Any],
    options: dict[str, Any],
) -> Log:
    """One query against some images, as hloc's `pose_from_cluster`."""
    pairs: dict[tuple[int, int], list[int]] = {}
    count = 0
    for index, image in enumerate(images):
        rows = model.point_rows(image)
        if rows is None or not (rows != -1).any():
            continue
        matches = matched.matches(name, image)
        if matches.size and (matches[:, 1].max() >= len(rows) or matches[:, 0].max() >= len(keypoints)):
            raise InputError(f"{name}, {image}: a match names a keypoint that does not exist; use features, matches and model of the same run")
        matches = matches[rows[matches[:, 1]] != -1]
        count += len(matches)
        for keypoint, other in matches:
            pairs.setdefault((int(keypoint), int(rows[other])), []).append(index)
    own = np.array([keypoint for keypoint, _ in pairs], dtype=np.int64)
    rows = np.array([row for _, row in pairs], dtype=np.int64)
    log: Log = {
        "db": images,
        "PnP_ret": None,
        "keypoints_query": keypoints[own],
        "points3D_ids": rows.tolist(),
        "num_matches": count,
        "keypoint_index_to_db": (own.tolist(), list(pairs.values())),
        "num_inliers": 0,
    }
    try:
        pose, info = _estimate(keypoints, own, points[rows], camera, name, obfuscation, options)
    except NotLocalizedError:
        return log
    except InputError as error:
        if len(own) >= 6:
            raise
        logger.warning("%s: %s", name, error)
        return log
    log["PnP_ret"] = {"cam_from_world": pose, **info}
    log["num_inliers"] = info["num_inlier_keypoints"]
    return log


def _estimate(
    keypoints: npt.NDArray[np.float64],
    own: npt.NDArray[np.int64],
    points: npt.NDArray[np.float64],
    camera: "Camera",
    name: str,
    obfuscation: dict[str, Any],
    options: dict[str, Any],
) -> "tuple[CameraPose, dict[str, Any]]":
    """Estimates the pose from obfuscated keypoints; a keypoint with several points counts once."""
    if obfuscation["scheme"] == "points":
        return _native.estimate_absolute_pose(keypoints[own], points, camera, keypoints=own, **options)
    # A device sends one line for each keypoint, even when several points match it.
    used, back = np.unique(own, return_inverse=True)
    flat = _native.undistort(keypoints[used], camera)
    seed = obfuscation["seed"] ^ zlib.crc32(name.encode())
    bits = obfuscation["angle_bits"]
    size = (camera["width"], camera["height"])
    sent = _native.obfuscate(flat, *size, obfuscation["scheme"], angle_bits=bits, seed=seed)
    if sent["kind"] == "anchored":
        return _native.estimate_absolute_pose_anchored(
            sent["anchors"][back],
            sent["angles"][back],
            points,
            camera,
            layout=obfuscation["scheme"],
            layout_focal=sent["layout_focal"],
            keypoints=own,
            **options,
        )
    lines = sent["lines"][back]
    if sent["kind"] == "either":
        lines, points, own = lines.reshape(-1, 3), np.repeat(points, 2, axis=0), np.repeat(own, 2)
    return _native.estimate_absolute_pose_lines(lines, points, camera, keypoints=own, **options)


def _write(path: Path, poses: dict[str, CameraPose], prepend_camera_name: bool) -> None:
    lines = []
    for query, pose in poses.items():
        parts = query.split("/")
        name = "/".join(parts[-2:]) if prepend_camera_name else parts[-1]
        numbers = " ".join(str(float(x)) for x in (*pose.q, *pose.t))
        lines.append(f"{name} {numbers}\n")
    logger.info("Writing poses to %s...", path)
    path.write_text("".join(lines))
