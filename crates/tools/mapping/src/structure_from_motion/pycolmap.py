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

import pycolmap

# Frames of a video between which all pairs are matched, too, so that its path is closed where it returns.
LOOP_FRAMES = 100

# The principal point is estimated from as many images of one camera, and may be as far from the middle (of the longer side).
MIN_SHARED = 5
MAX_SHIFT = 0.03

# Decrease of the squared error, in variances of an observation, from which on the estimate is taken.
MIN_DECREASE = 100.0

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
    refined = pycolmap.Reconstruction(model)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = True
    options.print_summary = False
    pycolmap.bundle_adjustment(refined, options)
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


def main():
    task = json.load(sys.stdin)
    names, database = task["names"], task["database"]
    pycolmap.logging.minloglevel = 2
    pycolmap.set_random_seed(task["seed"])

    def extract():
        for camera in task["cameras"]:
            reader = pycolmap.ImageReaderOptions()
            if camera["simple_pinhole"]:
                reader.camera_model, reader.camera_params = "SIMPLE_PINHOLE", camera["simple_pinhole"]
            pycolmap.extract_features(
                database, task["images"], image_names=camera["names"], camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader
            )

    stage("features of structure from motion", len(names), database, "keypoints", extract)
    if task["rigs"]:
        apply_rigs(database, task["rigs"])
    known = {name for camera in task["cameras"] if camera["simple_pinhole"] for name in camera["names"]}
    constant = {camera for name, camera in query(database, "SELECT name, camera_id FROM images") if name in known}
    match(task, names)

    say(stage="camera poses", total=len(names))
    done = [0]

    def one_more(count=1):
        done[0] = min(done[0] + count, len(names))
        say(done=done[0])

    sparse = Path(task["sparse"])
    models = {}
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
        with tempfile.TemporaryDirectory(dir=sparse.parent) as written:
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
            if model.num_reg_images() < 3:
                continue
            models[len(models)] = model
            left -= {image.name for image in model.images.values() if image.has_pose}
        if len(left) == before:
            break
    say(done=len(names))
    if not constant:
        models = {number: with_principal_point(model) for number, model in models.items()}
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
