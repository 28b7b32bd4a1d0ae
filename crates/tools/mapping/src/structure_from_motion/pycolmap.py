"""Structure from motion by pycolmap, run by veiloc: reads a JSON document on stdin, prints one JSON object a line on stdout.

Input: database, images (folder), names, sparse (folder for models), cameras (of each the names, and the parameters if they are
known), rigs (of each its cameras: prefix of their names, and xyzw, the rotation from the rig to the camera), matching ("exhaustive"
or "sequential"), seed.
Output lines: {"stage": name, "total": n}, {"done": n}, and for each image that has no pose
{"unregistered": name, "keypoints": n, "verified_pairs": n}.
"""

import json
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
import pycolmap

# Frames of a video between which all pairs are matched, too, so that its path is closed where it returns.
LOOP_FRAMES = 100

# The principal point is estimated from as many images of one camera, and may be as far from the middle (of the longer side).
MIN_SHARED = 5
MAX_SHIFT = 0.03

# Decrease of the squared error, in variances of an observation, from which on the estimate is taken.
MIN_DECREASE = 100.0

# Images of one camera are of several zooms if a camera for each image decreases the squared error by this many variances an image,
# and logarithms of their focal lengths are this far apart. Of 24 images of one camera it was 24, of two zooms of it 396.
MIN_DECREASE_OF_ZOOMS = 100.0
MIN_ZOOM = 0.05

# Points of the smallest model: fewer are those of no place, which images with a camera each may seem to agree on.
MIN_POINTS = 50

# Seconds between two looks at the progress.
INTERVAL = 2.0

# Prints the rows of a database as JSON; arguments: the file and the SQL.
QUERY = """
import json, sqlite3, sys
connection = sqlite3.connect("file:" + sys.argv[1] + "?mode=ro", uri=True, timeout=1)
print(json.dumps(connection.execute(sys.argv[2]).fetchall()))
"""


def say(**line):
    print(json.dumps(line), flush=True)


def query(database, sql, default=()):
    """Rows of the database; it may be locked, or not have its tables yet.

    Another process reads them: the SQLite of this Python and that of pycolmap would remove each other's locks on the file.
    """
    command = [sys.executable, "-c", QUERY, str(database), sql]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return json.loads(done.stdout) if done.returncode == 0 else default


def stage(name, total, database, table, work):
    """Runs `work` and prints the number of rows of a table meanwhile."""
    say(stage=name, total=total)
    finished = threading.Event()

    def watch():
        last = -1
        while not finished.wait(INTERVAL):
            rows = query(database, f"SELECT count(*) FROM {table}")
            if rows and rows[0][0] != last:
                last = rows[0][0]
                say(done=min(last, total))

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        work()
    finally:
        finished.set()
        watcher.join()
    say(done=total)


def match(task, names):
    database = task["database"]
    if task["matching"] == "exhaustive":
        total = len(names) * (len(names) - 1) // 2
        stage("matches of structure from motion", total, database, "two_view_geometries", lambda: pycolmap.match_exhaustive(database))
        return
    options = pycolmap.SequentialPairingOptions()
    total = len(names) * options.overlap
    stage(
        "matches of structure from motion",
        total,
        database,
        "two_view_geometries",
        lambda: pycolmap.match_sequential(database, pairing_options=options),
    )
    chosen = sorted(names)[:: max(1, len(names) // LOOP_FRAMES)]
    pairs = Path(task["sparse"]).parent / "loop_pairs.txt"
    pairs.write_text("".join(f"{a} {b}\n" for i, a in enumerate(chosen) for b in chosen[i + 1 :]))
    imported = pycolmap.ImportedPairingOptions()
    imported.match_list_path = str(pairs)
    total = len(chosen) * (len(chosen) - 1) // 2
    known = query(database, "SELECT count(*) FROM two_view_geometries", [(0,)])[0][0]
    stage(
        "matches where the path returns",
        known + total,
        database,
        "two_view_geometries",
        lambda: pycolmap.match_image_pairs(database, pairing_options=imported),
    )


def min_model_size(images):
    """Images of the smallest model that is kept, of a number of images."""
    return min(10, max(3, images // 2))


def with_principal_point(model):
    """The model with the principal point estimated, or as it is.

    COLMAP leaves it in the middle of the image, because few images do not determine it. Many images of one camera do, and a point in the
    wrong place bends the model.
    """
    shared = {}
    for image in model.images.values():
        if image.has_pose:
            shared[image.camera_id] = shared.get(image.camera_id, 0) + 1
    if not shared or min(shared.values()) < MIN_SHARED:
        return model
    refined = adjusted(pycolmap.Reconstruction(model), principal_point=True)
    for each in (model, refined):
        each.update_point_3d_errors()
    ratio = refined.compute_mean_reprojection_error() / model.compute_mean_reprojection_error()
    decrease = 2 * model.compute_num_observations() * (1 - ratio**2)
    far = max(
        max(abs(camera.principal_point_x - camera.width / 2), abs(camera.principal_point_y - camera.height / 2))
        / max(camera.width, camera.height)
        for camera in refined.cameras.values()
    )
    return refined if decrease >= MIN_DECREASE and far <= MAX_SHIFT else model


def apply_rigs(database, rigs):
    """Groups the images of each rig by what follows the prefix in their names; their cameras keep what they are."""
    configs = []
    for rig in rigs:
        cameras = []
        for number, camera in enumerate(rig):
            pose = None if number == 0 else pycolmap.Rigid3d(pycolmap.Rotation3d(camera["xyzw"]), [0.0, 0.0, 0.0])
            cameras.append(pycolmap.RigConfigCamera(ref_sensor=number == 0, image_prefix=camera["prefix"], cam_from_rig=pose))
        configs.append(pycolmap.RigConfig(cameras=cameras))
    with pycolmap.Database.open(database) as opened:
        pycolmap.apply_rig_config(configs, opened)


def rebuilt(model, camera_of):
    """The model with other cameras. `camera_of`: of an image its key; images of one key share a camera, with the median parameters."""
    own = {image.image_id: camera_of(image) for image in model.images.values() if image.has_pose}
    members = {}
    for image, key in own.items():
        members.setdefault(key, []).append(model.cameras[model.images[image].camera_id])
    number = {key: i + 1 for i, key in enumerate(members)}
    other = pycolmap.Reconstruction()
    for key, cameras in members.items():
        first, params = cameras[0], np.median([camera.params for camera in cameras], axis=0)
        camera = pycolmap.Camera(model=first.model, width=first.width, height=first.height, params=params, camera_id=number[key])
        other.add_camera_with_trivial_rig(camera)
    for image, key in own.items():
        image = model.images[image]
        keypoints = np.array([point.xy for point in image.points2D])
        taken = pycolmap.Image(name=image.name, keypoints=keypoints, camera_id=number[key], image_id=image.image_id)
        pose = image.cam_from_world
        other.add_image_with_trivial_frame(taken, pose() if callable(pose) else pose)
    for point in model.points3D.values():
        track = pycolmap.Track()
        for element in point.track.elements:
            if element.image_id in own:
                track.add_element(element.image_id, element.point2D_idx)
        if track.length() >= 2:
            other.add_point3D(point.xyz, track)
    return adjusted(other)


def adjusted(model, principal_point=False):
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_principal_point = principal_point
    pycolmap.bundle_adjustment(model, options)
    return model


def log_focal(camera):
    return float(np.log(camera.mean_focal_length()))


def zooms(values):
    """Numbers of the groups of values that are more than MIN_ZOOM apart, in their order."""
    order, groups, group = np.argsort(values), [0] * len(values), 0
    for before, after in zip(order, order[1:]):
        group += values[after] - values[before] > MIN_ZOOM
        groups[after] = group
    return groups


def has_zooms(model):
    """Whether images that share a camera have several focal lengths: with a camera for each image they fit much better, at focal
    lengths that are apart."""
    images = [image for image in model.images.values() if image.has_pose]
    if len(images) < MIN_SHARED or len({image.camera_id for image in images}) == len(images):
        return False
    before = rebuilt(model, lambda image: image.camera_id)
    apart = rebuilt(model, lambda image: -image.image_id)
    for each in (before, apart):
        each.update_point_3d_errors()
    ratio = apart.compute_mean_reprojection_error() / before.compute_mean_reprojection_error()
    decrease = 2 * before.compute_num_observations() * (1 - ratio**2) / len(images)
    shared = {}
    for image in apart.images.values():
        shared.setdefault(model.images[image.image_id].camera_id, []).append(log_focal(apart.cameras[image.camera_id]))
    return decrease >= MIN_DECREASE_OF_ZOOMS and any(max(zooms(values)) > 0 for values in shared.values())


def by_zoom(model, group_of):
    """The model of images with a camera each, with a camera for those of each group and focal length."""
    members = {}
    for image in model.images.values():
        if image.has_pose:
            members.setdefault(group_of[image.name], []).append(image)
    key = {}
    for group, images in members.items():
        found = zooms([log_focal(model.cameras[image.camera_id]) for image in images])
        key.update({image.image_id: (group, zoom) for image, zoom in zip(images, found)})
    return rebuilt(model, lambda image: key[image.image_id])


def extract(task, database, is_shared):
    def run():
        for camera in task["cameras"]:
            reader = pycolmap.ImageReaderOptions()
            if camera["simple_pinhole"]:
                reader.camera_model, reader.camera_params = "SIMPLE_PINHOLE", camera["simple_pinhole"]
            mode = pycolmap.CameraMode.SINGLE if is_shared else pycolmap.CameraMode.PER_IMAGE
            pycolmap.extract_features(database, task["images"], image_names=camera["names"], camera_mode=mode, reader_options=reader)

    stage("features of structure from motion", len(task["names"]), database, "keypoints", run)


def map_images(task, database):
    """All models, with their poses."""
    names = task["names"]
    known = {name for camera in task["cameras"] if camera["simple_pinhole"] for name in camera["names"]}
    constant = {camera for name, camera in query(database, "SELECT name, camera_id FROM images") if name in known}
    say(stage="camera poses", total=len(names))
    done = [0]

    def one_more(count=1):
        done[0] = min(done[0] + count, len(names))
        say(done=done[0])

    models = []
    # COLMAP begins again when a model stays small, which a first pair without parallax leads to. So a part of the place that has few
    # of the images gets its chance when the others have their poses.
    left = set(names)
    while len(left) >= 3:
        options = pycolmap.IncrementalPipelineOptions()
        options.random_seed = task["seed"]
        options.extract_colors = False
        options.min_model_size = min_model_size(len(left))
        options.image_names = sorted(left)
        options.constant_cameras = constant
        options.ba_refine_sensor_from_rig = False
        # It writes its models, too, also attempts of two images, which are no model.
        with tempfile.TemporaryDirectory(dir=Path(task["sparse"]).parent) as written:
            found = pycolmap.incremental_mapping(
                database,
                task["images"],
                written,
                options,
                initial_image_pair_callback=lambda: one_more(2),
                next_image_callback=one_more,
            )
        before = len(left)
        for model in found.values():
            if model.num_reg_images() < 3 or model.num_points3D() < MIN_POINTS:
                continue
            models.append(model)
            left -= {image.name for image in model.images.values() if image.has_pose}
        if len(left) == before:
            break
    say(done=len(names))
    return models


def registered_in(models):
    """Images of the largest model."""
    return max((model.num_reg_images() for model in models), default=0)


def apart_by_zoom(task, models):
    """The models, or others with a camera for each focal length if images that should share a camera do not.

    A shared camera is what keeps a model straight. But photographs of one size may be of several zooms, and only EXIF would say so.
    """
    if not any(has_zooms(model) for model in models):
        return models
    database = str(Path(task["database"]).with_name("database-apart.db"))
    Path(database).unlink(missing_ok=True)
    extract(task, database, is_shared=False)
    match({**task, "database": database}, task["names"])
    group_of = {name: number for number, camera in enumerate(task["cameras"]) for name in camera["names"]}
    others = [by_zoom(model, group_of) for model in map_images(task, database)]
    return others if registered_in(others) >= registered_in(models) else models


def main():
    task = json.load(sys.stdin)
    names, database = task["names"], task["database"]
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(task["seed"])

    extract(task, database, is_shared=True)
    if task["rigs"]:
        apply_rigs(database, task["rigs"])
    match(task, names)
    models = map_images(task, database)
    if not task["rigs"]:
        models = [with_principal_point(model) for model in apart_by_zoom(task, models)]
    sparse = Path(task["sparse"])
    models = dict(enumerate(models))
    for number, model in models.items():
        folder = sparse / str(number)
        folder.mkdir(parents=True, exist_ok=True)
        model.write(folder)

    largest = max(models.values(), key=lambda model: model.num_reg_images(), default=None)
    registered = set()
    if largest is not None:
        registered = {image.name for image in largest.images.values() if image.has_pose}
    ids = dict(query(database, "SELECT name, image_id FROM images"))
    keypoints = dict(query(database, "SELECT image_id, rows FROM keypoints"))
    verified = {}
    for (pair,) in query(database, "SELECT pair_id FROM two_view_geometries WHERE rows >= 15"):
        for image in divmod(pair, 2147483647):
            verified[image] = verified.get(image, 0) + 1
    for name in names:
        if name not in registered:
            image = ids.get(name)
            say(unregistered=name, keypoints=keypoints.get(image, 0), verified_pairs=verified.get(image, 0))


main()
