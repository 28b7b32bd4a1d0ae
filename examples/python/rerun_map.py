"""Shows a map and answers in Rerun, a viewer for spatial data.

    pip install rerun-sdk
    python examples/python/rerun_map.py                         # a rendered room; writes room.rrd
    python examples/python/rerun_map.py place.vmap place.rrd    # a map of yours

`rerun FILE.rrd` opens the file. It shows the place: protect it as the map.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import rerun as rr

import veiloc


def log_map(place: veiloc.Map) -> None:
    """Logs the points and cameras of a map; its up direction is that of the viewer, if it is an axis."""
    if place.down is not None and place.down[2] < -0.99:
        rr.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    rr.log("map/points", rr.Points3D(place.points, colors=[150, 160, 170]), static=True)
    cameras = place.cameras
    for name, pose in place.poses.items():
        log_camera(f"map/cameras/{name}", pose, cameras[name], static=True)


def log_camera(entity: str, pose: veiloc.CameraPose, camera: dict, static: bool = False) -> None:
    """Logs a camera by its pose and its size and focal length."""
    # Rerun wants the camera in the world: x right, y down, z forward, as COLMAP.
    rr.log(entity, rr.Transform3D(translation=pose.center, mat3x3=np.asarray(pose.R).T), static=static)
    resolution = [camera["width"], camera["height"]]
    rr.log(entity, rr.Pinhole(focal_length=camera["params"][0], resolution=resolution, image_plane_distance=0.2), static=static)


def log_answer(name: str, answer: veiloc.Answer, camera: dict) -> None:
    """Logs an answer: its camera, and an ellipsoid of one standard deviation, enlarged ten times."""
    log_camera(f"answers/{name}", answer.pose, camera)
    variances, axes = np.linalg.eigh(answer.center_covariance)
    color = [40, 160, 90] if answer.state == "trusted" else [220, 160, 30]
    # The columns of a rotation matrix: a right-handed system.
    axes[:, 0] *= np.linalg.det(axes)
    rr.log(f"answers/{name}/deviation", rr.Transform3D(mat3x3=np.asarray(answer.pose.R) @ axes))
    rr.log(f"answers/{name}/deviation", rr.Ellipsoids3D(half_sizes=[10 * np.sqrt(variances)], colors=[color]))
    rr.log("log", rr.TextLog(f"{name}: {answer.state}, {answer.inliers} inliers, ± {answer.position_sd:.4f}"))


def room(folder: Path) -> None:
    """A rendered room, and the answers to its queries."""
    posed, queries = veiloc.render_room(folder)
    place = veiloc.Map.build(posed, folder, self_test=False, down="-z", metres=True)
    log_map(place)
    # All images of the room have one camera.
    known = next(iter(place.cameras.values()))
    sealer = veiloc.Sealer(place.profile)
    for number, (name, camera, _) in enumerate(queries):
        rr.set_time("query", sequence=number)
        try:
            answer = place.localize(sealer.seal(sealer.extract(folder / name, camera)))
        except veiloc.NotLocalizedError as why:
            rr.log("log", rr.TextLog(f"{name}: {why}"))
            continue
        log_answer(name, answer, known)


def main() -> None:
    given = sys.argv[1:]
    out = given[1] if len(given) > 1 else "room.rrd"
    rr.init("veiloc")
    rr.save(out)
    if given:
        log_map(veiloc.Map.open(given[0]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            room(Path(folder))
    print(out)


if __name__ == "__main__":
    main()
