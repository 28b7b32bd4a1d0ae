"""Tables of docs/results/mapping.md: maps of images alone, of a video, of other programs' poses, merged maps, GPS.

A place without `map.txt` and `query.txt` holds every fourth image out. A query without a pose counts as infinite error; no median if
fewer than half are localized. Times are processor time, which other programs on the machine change little. Maps are kept.
"""

from __future__ import annotations

import base64
import importlib.util
import json
import re
import shutil
import subprocess
import sys
import urllib.request
from pathlib import Path

from study.common import Package, command, names_of, processor_seconds
from study.geometry import Posed, angle, center, mean_rotation, quaternion, read_posed, rotation, similarity, write_posed

np, pycolmap, Image = Package("numpy"), Package("pycolmap"), Package("PIL.Image")
HELD_OUT = ["queries", "localized", "trusted", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)", "median error (map units)",
            "median error (°)"]  # fmt: skip


def timed(run, *words):
    """Runs a command of the program; its processor seconds."""
    before = processor_seconds()
    run.run(*words)
    return processor_seconds() - before


def place_of(folder):
    """The model, its poses, and the names of map images and queries."""
    model = folder / "posed" if (folder / "posed").is_dir() else folder / "sparse"
    known = read_posed(model)
    if (folder / "map.txt").exists():
        return model, known, names_of(folder / "map.txt"), names_of(folder / "query.txt")
    held_out = sorted(known)[2::4]
    return model, known, sorted(set(known) - set(held_out)), held_out


def held_out_cells(run, built, queries, images, known, moved=None):
    """The cells of HELD_OUT: queries, {name: camera}, in a map whose poses the similarity `moved` brings to the given ones."""
    listed = run.listed("held-out", [f"{name} {camera}" for name, camera in queries.items()])
    s, turn, t = moved or (1.0, np.eye(3), np.zeros(3))
    found = []
    for query in run.json("localize", "--map", built, "--queries", listed, "--images", images)["queries"]:
        true, pose = known[query["file"]], query.get("cam_from_world")
        if pose is None:
            found.append((np.inf, np.inf, False))
            continue
        r = rotation(pose["q"])
        c = s * turn @ center(r, np.array(pose["t"])) + t
        found.append((np.linalg.norm(c - true.center), angle(r @ turn.T, true.r), query["state"] == "trusted"))
    found = np.array(found)
    median = lambda column, form: format(value, form) if np.isfinite(value := np.median(found[:, column])) else ""
    within = lambda distance, degrees: f"{100 * ((found[:, 0] < distance) & (found[:, 1] < degrees)).mean():.0f}"
    return [len(found), int(np.isfinite(found[:, 0]).sum()), int(found[:, 2].sum()), within(0.05, 5), within(0.25, 2), median(0, ".4f"),
            median(1, ".3f")]  # fmt: skip


def fitted(x, y, turn=None):
    """The similarity of centres, and the RMS of their distances after it."""
    s, r, t = similarity(x, y, turn)
    return (s, r, t), np.sqrt((np.linalg.norm(s * x @ r.T + t - y, axis=1) ** 2).mean())


# Least error of centres over their extent from which orientations tell the rotation, degrees.
TURNING = 5
# A Python for `--python` that adds the processor time of pycolmap to a file.
TIMED = """#!{python}
import resource, subprocess, sys
done = subprocess.run([{python!r}, *sys.argv[1:]])
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
with open({file!r}, "a") as file:
    print(usage.ru_utime + usage.ru_stime, file=file)
sys.exit(done.returncode)
"""


def once(file, compute):
    """The JSON value of a file, or else `compute`, kept in it."""
    if not file.exists():
        value = compute()
        file.write_text(json.dumps(value))
    return json.loads(file.read_text())


@command("mapping/images-alone.csv",
         places=["herzjesu", "fountain", "entry", "lund-door", "llff-room", "redkitchen", "hololens-office", "tum-fr1-rpy"])  # fmt: skip
def images_alone(run):
    """Maps of images alone beside maps of given poses, and the hold-outs in both.

    Poses in the first map are moved by the similarity that fits the centres of its map images to the given ones; where the centres do
    not tell the rotation, as of a camera that turns on the spot, the orientations do. Queries of the map of images alone have one of two
    cameras: the one that the map estimated (`map info` prints it; the choice of a user whose phone took the map images), and the one of
    the given model, which disagrees with the map by the error of its estimate. Time of pycolmap is what it would take alone."""
    table = run.table("mapping/images-alone.csv", "place", "map of", "camera of queries", "images", "registered", "processor time (s)",
                      "of this pycolmap (s)", "centres of map images, RMS (map units)", *HELD_OUT)  # fmt: skip
    for place in run.places:
        folder, kept = run.place(place), run.kept() / "alone" / place
        model, known, names, held_out = place_of(folder)
        kept.mkdir(parents=True, exist_ok=True)
        listed = kept / "map.txt"
        listed.write_text("".join(f"{name}\n" for name in names))
        build = ["map", "build", "--quiet", "--images", folder / "images", "--list", listed]

        def alone():
            python, times = kept / "python", kept / "python.txt"
            times.unlink(missing_ok=True)
            python.write_text(TIMED.format(python=sys.executable, file=str(times)))
            python.chmod(0o755)
            seconds = timed(run, *build, "--python", python, "--work", kept / "work", "-o", kept / "alone.vmap")
            return seconds, sum(map(float, times.read_text().split()))

        seconds, of_pycolmap = once(kept / "alone.json", alone)
        of_given = once(kept / "given.json", lambda: timed(run, *build, "--posed", model, "-o", kept / "given.vmap"))
        sparse = [pycolmap.Reconstruction(found) for found in sorted((kept / "work/sfm/sparse").iterdir())]
        largest = max(sparse, key=lambda found: found.num_reg_images())
        posed = [image for image in largest.images.values() if image.has_pose]
        x, y = (np.array(of) for of in zip(*((image.projection_center(), known[image.name].center) for image in posed)))
        moved, apart = fitted(x, y)
        # The extent in the second direction; about the first one, centres on a line tell no rotation.
        extent = np.linalg.svd(y - y.mean(0), compute_uv=False)[1] / np.sqrt(len(y))
        if apart > np.radians(TURNING) * extent:
            turns = [known[image.name].r.T @ image.cam_from_world().rotation.matrix() for image in posed]
            moved, apart = fitted(x, y, mean_rotation(turns))
        info = run.json("map", "info", kept / "alone.vmap", "--images")
        (estimated,) = {image["camera"].replace(",", " ") for image in info["image_list"]}
        print(f"{place}: {estimated}; given {known[names[0]].camera}", file=sys.stderr)
        of_alone = [len(names), largest.num_reg_images(), round(seconds), round(of_pycolmap), f"{apart:.4f}"]
        given, own = {name: known[name].camera for name in held_out}, dict.fromkeys(held_out, estimated)
        for kind, camera, cells, queries, file, of in [
            ("images alone", "its own", of_alone, own, "alone", moved), ("images alone", "given", of_alone, given, "alone", moved),
            ("given poses", "given", [len(names), len(names), round(of_given), "", ""], given, "given", None),
        ]:  # fmt: skip
            found = held_out_cells(run, kept / f"{file}.vmap", queries, folder / "images", known, of)
            table.add([place, kind, camera, *cells, *found])


RATE = 20


@command("mapping/video.csv", needs="imageio-ffmpeg", room="redkitchen")
def video(run):
    """A map of a video: frames that are taken, registered images, hold-outs.

    The video is made here (H.264, 20 frames a second) of the map images in the order of the walk: each one once blurred along a line of
    7 pixels, as by a moving hand, and once as it is, and every tenth one for a second more, as by a hand that rests. The hold-outs are
    localized with the camera that the map estimated."""
    table = run.table("mapping/video.csv", "place", "frames of the video", "frames taken", "of these blurred", "registered",
                      "processor time (s)", "centres of map images, RMS (map units)", *HELD_OUT)  # fmt: skip
    place, work = run.place(run.room), run.kept() / "video"
    _, known, names, held_out = place_of(place)
    (work / "video").mkdir(parents=True, exist_ok=True)
    # Of each frame of the video, the image and whether it is sharp.
    shown = []
    for at, name in enumerate(sorted(names)):
        image = Image.open(place / "images" / name).convert("RGB")
        pixels = np.asarray(image, dtype=float)
        blurred = Image.fromarray(np.mean([np.roll(pixels, shift, axis=1) for shift in range(-3, 4)], axis=0).astype(np.uint8))
        for frame, is_sharp in [(blurred, False)] + [(image, True)] * (1 + RATE * (at % 10 == 9)):
            frame.save(work / f"video/{len(shown):05}.png")
            shown.append((name, is_sharp))
    walk, built = work / "walk.mp4", work / "walk.vmap"
    encode = ["-framerate", RATE, "-i", work / "video/%05d.png", "-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", walk]
    ffmpeg = Package("imageio_ffmpeg").get_ffmpeg_exe()
    subprocess.run([ffmpeg, "-v", "error", "-y", *map(str, encode)], check=True)
    seconds = timed(run, "map", "build", "--quiet", "--images", walk, "--python", sys.executable, "-o", built)
    taken = json.loads((work / "walk.sfm/frames/video.json").read_text())["frames"]
    run.run("map", "export", "--quiet", built, "--colmap", work / "export", "--text")
    posed = read_posed(work / "export")
    source = lambda name: known[shown[taken[int(Path(name).stem) - 1]][0]]
    x, y = (np.array(of) for of in zip(*((own.center, source(name).center) for name, own in posed.items())))
    moved, apart = fitted(x, y)
    (estimated,) = {own.camera for own in posed.values()}
    found = held_out_cells(run, built, dict.fromkeys(held_out, estimated), place / "images", known, moved)
    blurred = sum(not shown[number][1] for number in taken)
    table.add([place.name, len(shown), len(taken), blurred, len(posed), round(seconds), f"{apart:.4f}", *found])


@command("mapping/formats.csv", needs="COLMAP and evo", room="redkitchen")
def formats(run):
    """A map of the place's poses in each format of other programs, and its hold-outs.

    With `colmap` on the PATH the Bundler and VisualSFM files are COLMAP's, with evo in this Python (`pip install evo`) the trajectory of
    TUM is evo's; the others are written by research/oracles/pose_formats.py. "Round trip" is the largest difference of a rotation matrix
    or a centre between the given model and `map export --colmap` of the map, over the scale of the scene (RMS distance of the
    centres)."""
    from oracles import pose_formats

    table = run.table("mapping/formats.csv", "format", "written by", "images", "in the map", "round trip", *HELD_OUT)
    place, work = run.place(run.room), run.kept() / "formats"
    _, known, names, held_out = place_of(place)
    for form in [pose_formats.write_colmap, *pose_formats.FORMATS]:
        scene = pose_formats.read_model(place / "posed")
        scene.images = [image for image in scene.images if image.name in names]
        kind = "colmap" if form is pose_formats.write_colmap else form.__name__
        folder, images = work / kind, place / "images"
        shutil.rmtree(folder, ignore_errors=True)
        if numbered := pose_formats.NUMBERED.get(form):
            # Formats without names need images whose names are numbers; they are copies of the same images. KITTI's folders say which
            # camera took the images.
            images = work / f"{kind}-images" / ("image_2" if form is pose_formats.kitti else "images")
            images.mkdir(parents=True, exist_ok=True)
            for i, image in enumerate(scene.images):
                name = numbered.format(i)
                shutil.copy(place / "images" / image.name, images / Path(name).with_suffix(Path(image.name).suffix))
                image.name = name
        by = written(folder, scene, form)
        (work / "map.vmap").unlink(missing_ok=True)
        # Features and matches are those of the same images; the self-test would take most of the time.
        run.run("map", "build", "--quiet", "--posed", folder, "--images", images, "--work", work / "work", "--no-self-test", "-o",
                work / "map.vmap")  # fmt: skip
        run.run("map", "export", "--quiet", work / "map.vmap", "--colmap", work / "export", "--text")
        without = lambda name: str(Path(name).with_suffix(""))
        given = {without(image.name): image for image in scene.images}
        found = {without(name): own for name, own in read_posed(work / "export").items()}
        centers = np.array([image.center for image in given.values()])
        scale = np.sqrt(((centers - centers.mean(0)) ** 2).sum(1).mean())
        apart = max(max(np.abs(found[name].r - image.r).max(), np.abs(found[name].center - image.center).max() / scale)
                    for name, image in given.items() if name in found)  # fmt: skip
        cells = held_out_cells(run, work / "map.vmap", {name: known[name].camera for name in held_out}, place / "images", known)
        table.add([kind, by, len(names), len(found), f"{apart:.1e}", *cells])


def written(folder, scene, form):
    """Writes a format, by its own program if that is installed; the name of the program."""
    from oracles import pose_formats

    if form in (pose_formats.nvm, pose_formats.bundler) and shutil.which("colmap"):
        model, c = folder / "model", scene.camera
        pose_formats.write_colmap(model, scene)
        # It exports no model with more distortion; this scene has none. It writes images without points, too.
        (model / "cameras.txt").write_text(f"1 SIMPLE_PINHOLE {c.w} {c.h} {pose_formats.row([c.fx, c.cx, c.cy])}\n")
        (model / "points3D.txt").write_text("")
        kind, out = ("NVM", folder / "place.nvm") if form is pose_formats.nvm else ("Bundler", folder / "bundle")
        subprocess.run(["colmap", "model_converter", "--input_path", model, "--output_path", out, "--output_type", kind], check=True,
                       capture_output=True)  # fmt: skip
        shutil.rmtree(model)
        return "colmap"
    form(folder, scene)
    if form is pose_formats.tum and importlib.util.find_spec("evo"):
        times = [float(line.split()[0]) for line in (folder / "rgb.txt").read_text().splitlines()[1:-1]]
        trajectory = Package("evo.core.trajectory").PoseTrajectory3D(poses_se3=[image.c2w() for image in scene.images],
                                                                     timestamps=np.array(times))  # fmt: skip
        Package("evo.tools.file_interface").write_tum_trajectory_file(folder / "groundtruth.txt", trajectory)
        return "evo"
    return "pose_formats.py"


SEEDS = [1, 2, 3]


def gauge(seed):
    """A random similarity: scale, rotation, translation."""
    random = np.random.default_rng(seed)
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    q[:, 0] *= np.linalg.det(q)
    return np.exp(random.uniform(np.log(0.2), np.log(5))), q, random.normal(size=3) * 10


def regauged(posed, moved):
    """The pose in another gauge."""
    scale, turn, shift = moved
    r = posed.r @ turn.T
    return Posed(posed.camera, r, -r @ (scale * turn @ posed.center + shift))


@command("mapping/merges.csv", places=["redkitchen", "herzjesu", "hololens-office"])
def merges(run):
    """Two halves of a place in different gauges, joined by `veiloc map merge`.

    The map images are cut into the first and the second half of the walk (by name). The poses of the second half are transformed by a
    random similarity (scale 0.2 to 5, any rotation), a map is made of each half, and the second is merged into the first, with
    `--keep-loose`; *refused*: without that option nothing is written. The errors are those of the similarity that the command prints,
    against the inverse of the true one: its scale, its rotation, and the RMS distance of the second half's camera centres from their true
    place. The hold-outs are localized in the first half, in the merged map, and in a map of all images with the given poses."""
    table = run.table("mapping/merges.csv", "place", "map", "images", "images that agree", "refused", "error of scale (%)",
                      "error of rotation (°)", "centres of the second half, RMS (map units)", *HELD_OUT)  # fmt: skip
    for place in run.places:
        folder, kept = run.place(place), run.kept() / "merges" / place
        _, known, names, held_out = place_of(folder)
        names = sorted(names)
        halves = names[: len(names) // 2], names[len(names) // 2 :]
        queries = {name: known[name].camera for name in held_out}
        first, whole, second, merged = (kept / f"{file}.vmap" for file in ("first", "whole", "second", "merged"))

        def build(file, images):
            write_posed(kept / file.stem, images)
            run.run("map", "build", "--quiet", "--images", folder / "images", "--work", kept / "work", "--posed", kept / file.stem, "-o",
                    file)  # fmt: skip

        build(whole, {name: known[name] for name in names})
        build(first, {name: known[name] for name in halves[0]})
        localized = lambda file: held_out_cells(run, file, queries, folder / "images", known)
        for kind, file, count in [("all images, given poses", whole, len(names)), ("the first half", first, len(halves[0]))]:
            table.add([place, kind, count, *[""] * 5, *localized(file)])
        for seed in SEEDS:
            moved = scale, turn, shift = gauge(seed)
            build(second, {name: regauged(known[name], moved) for name in halves[1]})
            document = run.json("map", "merge", first, second, "-o", merged, "--keep-loose")
            found = document["alignment"]
            s, r, t = found["scale"], np.array(found["rotation"]), np.array(found["translation"])
            true = np.array([known[name].center for name in halves[1]])
            apart = np.linalg.norm(s * (scale * true @ turn.T + shift) @ r.T + t - true, axis=1)
            loose = any(warning["name"] == "loose-merge" for warning in document["warnings"])
            table.add([place, f"the halves merged, gauge {seed}", document["images"], found["localized"], "yes" if loose else "no",
                       f"{100 * (s * scale - 1):.3f}", f"{angle(r, turn.T):.4f}", f"{np.sqrt((apart**2).mean()):.4f}", *localized(merged)])  # fmt: skip


@command("mapping/anchors.csv", places=["redkitchen", "herzjesu", "hololens-office"])
def anchors(run):
    """Content anchors over a map's life: created, aligned, merged, and carried to a map that replaces theirs.

    Forty points of the map of the second half of the walk (by name), which is made in a random gauge, are the true places of anchors with
    random rotations. The map is aligned to the true camera centres with 1 cm of noise along each axis, merged in its gauge into the map
    of the first half, and the merged map is replaced by a map of the hold-outs in another gauge, whose images have no common names; and
    where the device's own tracking is known, by a map of the same images with its poses. There the true places are those by the
    similarity that fits the camera centres of both. An error is the distance from the true place, in the units of the true frame;
    the stated ± is that of `map anchors`, the median. A refused transfer has the reason."""
    table = run.table("mapping/anchors.csv", "place", "map", "images that agree", "anchors", "median error (mm)", "largest error (mm)",
                      "largest error (°)", "stated ± (mm)", "median error of camera centres (mm)")  # fmt: skip
    for place in run.places:
        folder, kept = run.place(place), run.kept() / "anchors" / place
        _, known, names, held_out = place_of(folder)
        names, random = sorted(names), np.random.default_rng(1)
        halves, still = (names[: len(names) // 2], names[len(names) // 2 :]), (1.0, np.eye(3), np.zeros(3))
        to = lambda moved, x: moved[0] * np.asarray(x) @ moved[1].T + moved[2]
        shutil.rmtree(kept, ignore_errors=True)

        def build(name, images, poses=known, moved=still):
            write_posed(kept / name, {image: regauged(poses[image], moved) for image in images})
            run.run("map", "build", "--quiet", "--no-coordinate-frame-check", "--images", folder / "images", "--work", run.kept() / "work",
                    "--posed", kept / name, "-o", kept / f"{name}.vmap")  # fmt: skip
            return kept / f"{name}.vmap"

        def exported(file):
            run.run("map", "export", file, "--quiet", "--text", "--colmap", file.with_suffix(".colmap"))
            return file.with_suffix(".colmap")

        def row(what, file, moved, agree="", stated=()):
            found = run.json("map", "anchors", file)["anchors"]
            turn = [angle(rotation(a["map_from_anchor"]["q"]), moved[1] @ turns[a["name"]]) for a in found]
            off = [np.linalg.norm(a["map_from_anchor"]["t"] - to(moved, places[a["name"]])) for a in found]
            cameras = read_posed(exported(file))
            centers = [np.linalg.norm(c.center - to(moved, known[name].center)) for name, c in cameras.items()]
            mm = lambda length: f"{1000 * length / moved[0]:.1f}" if length < np.inf else ""
            table.add([place, what, agree, len(found), mm(np.median(off)), mm(max(off)), f"{max(turn):.3f}",
                       mm(np.median(stated)) if len(stated) else "", mm(np.median(centers))])  # fmt: skip

        def carried(what, file, moved, *how):
            done = subprocess.run([run.veiloc, "map", "anchors", file, *map(str, how)], capture_output=True, text=True)
            if done.returncode:
                reason = re.sub(r"[│\s]+", " ", done.stderr.split("×")[-1].split("help:")[0].split("believed: ")[-1])
                table.add([place, f"{what}: refused, {reason.strip()}", *[""] * 7])
                return
            agree = re.search(r"(\d+) images agree", done.stderr).group(1)
            row(what, file, moved, agree, [float(x) for x in re.findall(r"± (\S+)  \d", done.stderr)])

        first, moved = build("first", halves[0]), gauge(1)
        second = build("second", halves[1], moved=moved)
        cloud = [line.split()[1:4] for line in (exported(second) / "points3D.txt").read_text().splitlines() if line[:1].isdigit()]
        chosen = random.choice(np.array(cloud, float), 40, replace=False)
        places = {f"{i:02}": (x - moved[2]) @ moved[1] / moved[0] for i, x in enumerate(chosen)}
        turns = {name: rotation(random.normal(size=4)) for name in places}
        pose = lambda name: {"q": list(quaternion(moved[1] @ turns[name])), "t": list(to(moved, places[name]))}
        document = {"version": 1, "anchors": [{"name": name, "map_from_anchor": pose(name)} for name in places]}
        (kept / "anchors.json").write_text(json.dumps(document))
        run.run("map", "anchors", second, "--import", kept / "anchors.json")
        row("created, in a gauge", second, moved)

        lines = [" ".join(map(str, [name, *(known[name].center + random.normal(size=3) * 0.01)])) for name in halves[1]]
        aligned = kept / "aligned.vmap"
        run.run("map", "align", second, "--positions", run.listed("centres", lines), "--known-down", "none", "-o", aligned)
        row("aligned to centres ± 1 cm", aligned, still)
        merged = kept / "merged.vmap"
        agree = run.json("map", "merge", first, second, "-o", merged, "--keep-loose")["alignment"]["localized"]
        row("merged into the other half", merged, still, agree)
        other = gauge(2)
        carried("replaced by a map of the hold-outs", build("hold-outs", held_out, moved=other), other, "--carry-from", merged)
        if (folder / "posed-given").is_dir():
            given = read_posed(folder / "posed-given")
            tracked = similarity(*(np.array([poses[name].center for name in names]) for poses in (known, given)))
            for how in (["--carry-from", merged], ["--carry"]):
                new = build("tracking", names, given)
                if how == ["--carry"]:
                    shutil.copy(merged.with_suffix(".anchors.json"), new.with_suffix(".anchors.json"))
                carried(f"replaced by one of the device's tracking ({how[0]})", new, tracked, *how)


NOISE = [0.0, 1.0, 3.0]
SEED = 1
# Where the place is put: degrees, metres above the ellipsoid.
ORIGIN = (48.0, 11.0, 500.0)
A, E2 = 6378137.0, 0.00669437999014


def ecef(latitude, longitude, height):
    lat, lon = np.radians([latitude, longitude])
    n = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
    across = (n + height) * np.cos(lat)
    return np.array([across * np.cos(lon), across * np.sin(lon), (n * (1 - E2) + height) * np.sin(lat)])


def enu_from_ecef(latitude, longitude):
    lat, lon = np.radians([latitude, longitude])
    east = [-np.sin(lon), np.cos(lon), 0]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return np.array([east, np.cross(up, east), up])


def geodetic(enu):
    """Latitude, longitude, height of an offset from ORIGIN, by Bowring's iteration."""
    x, y, z = ecef(*ORIGIN) + enu_from_ecef(*ORIGIN[:2]).T @ enu
    lon, p = np.arctan2(y, x), np.hypot(x, y)
    lat = np.arctan2(z, p * (1 - E2))
    for _ in range(10):
        n = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
        height = p / np.cos(lat) - n
        lat = np.arctan2(z, p * (1 - E2 * n / (n + height)))
    return np.degrees(lat), np.degrees(lon), height


def offset(latitude, longitude, height):
    """East, north, up from ORIGIN, metres."""
    return enu_from_ecef(*ORIGIN[:2]) @ (ecef(latitude, longitude, height) - ecef(*ORIGIN))


def with_gps(jpeg, place):
    """The bytes of a JPEG file with GPS as its only EXIF data."""
    latitude, longitude, height = place

    def dms(angle):
        angle = abs(angle)
        rest = (angle % 1) * 60
        return int(angle), int(rest), round((rest % 1) * 60, 6)

    exif = Image.Exif()
    exif[0x8825] = {1: "S" if latitude < 0 else "N", 2: dms(latitude), 3: "W" if longitude < 0 else "E", 4: dms(longitude), 5: b"\0",
                    6: round(height, 3)}  # fmt: skip
    data = exif.tobytes()
    if not data.startswith(b"Exif"):
        data = b"Exif\0\0" + data
    return jpeg[:2] + b"\xff\xe1" + (len(data) + 2).to_bytes(2, "big") + data + jpeg[2:]


def geopose(address, sealed, camera):
    privacy = {"dataRetention": [], "dataAcceptableUse": [], "dataSanitizationApplied": ["dcl"], "dataSanitizationRequested": []}
    reading = {"timestamp": 0, "sensorId": "camera", "imageFormat": "VEILOC_SEALED_QUERY", "size": [int(n) for n in camera.split()[1:3]],
               "imageBytes": base64.b64encode(sealed).decode(), "privacy": privacy}  # fmt: skip
    body = {"id": "query", "timestamp": 0, "type": "geopose", "sensors": [{"id": "camera", "type": "camera"}],
            "sensorReadings": {"cameraReadings": [reading]}}  # fmt: skip
    request = urllib.request.Request(f"{address}/geopose", json.dumps(body).encode(), {"Content-Type": "application/json"})
    try:
        return json.load(urllib.request.urlopen(request))
    except urllib.error.HTTPError as error:
        if json.load(error).get("type", "").endswith("not-localized"):
            return None
        raise


@command("mapping/gps.csv", places=["herzjesu", "fountain"])
def gps(run):
    """GPS in EXIF to GeoPoses of hold-outs: `veiloc map align --gps`, `veiloc serve --geo-reference`, `POST /geopose`.

    No place of the data has GPS, so it is made here: the images of a place with poses in metres are copied without a change of their
    pixels, and their EXIF gets the true position plus normal noise of NOISE metres along each axis, independent between images. (Real
    receivers err by a few metres, and neighbours err alike, which no similarity can find.) The map gets poses in a random gauge, as
    structure from motion would give them. Queries are sealed and sent to a service, and their GeoPoses are compared with the true
    positions and with the GPS of their own files."""
    table = run.table("mapping/gps.csv", "place", "noise of GPS per axis (m)", "images with GPS", "extent of the cameras (m)",
                      "error of scale (%)", "± of scale (%)", "refused", "queries", "with a GeoPose", "GeoPose to the true position, median (m)", "its accuracy, median (m)",
                      "GeoPose to the query's own GPS, median (m)", "own GPS to the true position, median (m)")  # fmt: skip
    for place in run.places:
        folder, kept = run.place(place), run.kept() / "gps" / place
        _, known, names, held_out = place_of(folder)
        centers = np.array([known[name].center for name in names])
        # The cameras are upright on average; the direction of north is arbitrary.
        up = -np.mean([known[name].r[1] for name in names], axis=0)
        up /= np.linalg.norm(up)
        east = np.cross([0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [1.0, 0.0, 0.0], up)
        east /= np.linalg.norm(east)
        enu_from_world = np.array([east, np.cross(up, east), up])
        enu = {name: enu_from_world @ (posed.center - centers.mean(0)) for name, posed in known.items()}
        write_posed(kept / "posed", {name: regauged(known[name], gauge(SEED)) for name in names})
        run.run("map", "build", "--quiet", "--images", folder / "images", "--posed", kept / "posed", "-o", kept / "given.vmap")
        for noise in NOISE:
            rng, own = np.random.default_rng(SEED), {}
            images, aligned, profile, sealed = kept / f"images-{noise}", kept / "place.vmap", kept / "place.profile", kept / "query.vquery"
            images.mkdir(parents=True, exist_ok=True)
            for name in [*names, *held_out]:
                own[name] = geodetic(enu[name] + noise * rng.normal(size=3))
                (images / name).write_bytes(with_gps((folder / "images" / name).read_bytes(), own[name]))
            align = ["map", "align", kept / "given.vmap", "--gps", images, "-o", aligned, "--no-self-test"]
            refused = subprocess.run([run.veiloc, *align, "--quiet"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode
            found = run.json(*align, "--accept-fit")["alignment"]
            run.run("map", "profile", "--quiet", aligned, "-o", profile)
            origin = ",".join(repr(x) for x in found["origin"])
            service = subprocess.Popen(
                [run.veiloc, "serve", "--map", f"place={aligned}", "--geo-reference", f"place={origin}", "--listen", "127.0.0.1:0",
                 "--rate", "1000", "--answer-quantum", "0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)  # fmt: skip
            try:
                address = next(m[1] for m in (re.search(r"serving place on (http://[\d.:]+)", line) for line in service.stdout) if m)
                off_truth, off_gps, stated = [], [], []
                for name in held_out:
                    # The file with GPS: sealing reads no location.
                    camera = known[name].camera
                    run.run("seal", "--quiet", images / name, "--camera", camera.replace(" ", ","), "--profile", profile, "-o", sealed)
                    answer = geopose(address, sealed.read_bytes(), camera)
                    if answer is not None:
                        position = answer["geopose"]["position"]
                        stated.append(answer["accuracy"]["position"])
                        there = offset(position["lat"], position["lon"], position["h"])
                        off_truth.append(np.linalg.norm(there - enu[name]))
                        off_gps.append(np.linalg.norm(there - offset(*own[name])))
            finally:
                service.kill()
                service.wait()
            off_own = [np.linalg.norm(offset(*own[name]) - enu[name]) for name in held_out]
            table.add([place, noise, len(names), f"{np.sqrt(((centers - centers.mean(0)) ** 2).sum(1).mean()):.1f}",
                       f"{100 * (found['scale'] * gauge(SEED)[0] - 1):.1f}", f"{100 * found['accuracy']['scale']:.1f}",
                       "yes" if refused else "no", len(held_out), len(off_truth),
                       *(f"{np.median(off):.2f}" for off in (off_truth, stated, off_gps, off_own))])  # fmt: skip
