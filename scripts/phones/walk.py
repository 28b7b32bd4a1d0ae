"""The transform from the map to the AR world over a walk, with wrong answers among the right ones.

The frames of a scene's `query.txt`, or of `--list`, are sealed by libveiloc_c, answered by `veiloc serve`, and given to an alignment with
the poses of the device's own tracking: those of `posed-given`, or the true ones with a drift of 1 % of the path. Every tenth answer is
that of another frame: trusted, and wrong. The place of the camera in the map by the alignment is compared with the true one.

    scripts/phones/walk.py --veiloc VEILOC --libraries target/debug --map kitchen.vmap --scene ../shared/data/redkitchen [--csv F]

`--split N MAP QUERIES` instead writes two lists of the scene's images: N for a map, evenly spaced, and the others for `--list`. The map
is built beforehand from the scene's `map.txt`, or the list MAP, with the poses in `posed`. Standard library only; the C library by
ctypes.
"""

import argparse
import ctypes
import http.client
import math
import pathlib
import random
import re
import statistics
import subprocess
import sys
import tempfile
import time

import run

UPDATES = ["used", "contradicts", "doubtful-agrees", "doubtful", "no-pose"]


class Pose(ctypes.Structure):
    _fields_ = [("position", ctypes.c_double * 3), ("rotation", ctypes.c_double * 4)]


class Camera(ctypes.Structure):
    _fields_ = [("model", ctypes.c_char_p), ("width", ctypes.c_uint32), ("height", ctypes.c_uint32), ("params", ctypes.c_double * 16),
                ("param_count", ctypes.c_uint32), ("focal", ctypes.c_uint32)]


class Frame(ctypes.Structure):
    _fields_ = [("bytes", ctypes.c_char_p), ("length", ctypes.c_size_t), ("format", ctypes.c_uint32), ("width", ctypes.c_uint32),
                ("height", ctypes.c_uint32), ("row_stride", ctypes.c_size_t), ("turn_degrees", ctypes.c_int32)]


class Bytes(ctypes.Structure):
    _fields_ = [("data", ctypes.POINTER(ctypes.c_uint8)), ("length", ctypes.c_size_t)]


class Info(ctypes.Structure):
    _fields_ = [("state", ctypes.c_uint32), ("used", ctypes.c_uint32), ("contradicting", ctypes.c_uint32), ("distances", ctypes.c_uint32),
                ("distance_ratio", ctypes.c_double)]


def colmap_pose(pose):
    """A pose of a camera, world to camera, as the axes of COLMAP state it: position and x y z w."""
    rotation, translation = pose
    made = Pose()
    made.position[:] = [-c for c in run.applied(run.transposed(rotation), translation)]
    made.rotation[:] = run.to_quaternion(run.transposed(rotation))
    return made


def drifted(poses, names, drift=0.01, seed=1):
    """Poses of a tracking that is off by a random walk of `drift` metres a metre, in a world of its own."""
    generator, step, tracking, last = random.Random(seed), [0.0] * 3, {}, None
    turn, shift = run.quaternion(run.AR_FROM_MAP[0]), run.AR_FROM_MAP[1]
    for name in names:
        rotation, translation = poses[name]
        centre = [-c for c in run.applied(run.transposed(rotation), translation)]
        path = math.dist(centre, last) if last else 0.0
        last = centre
        step = [c + drift * path * generator.gauss(0, 1) for c in step]
        world = [a + b + c for a, b, c in zip(run.applied(turn, centre), shift, step)]
        cam_from_world = run.product(rotation, run.transposed(turn))
        tracking[name] = (cam_from_world, [-c for c in run.applied(cam_from_world, world)])
    return tracking


def names_of(path):
    return [line.split()[0] for line in path.read_text().splitlines() if line.strip()]


def split(scene, count, map_list, query_list):
    """Lists of `count` images for a map, evenly spaced in the walk, and of the others."""
    names = sorted(names_of(scene / "map.txt") + names_of(scene / "query.txt"))
    chosen = {round(i * (len(names) - 1) / (int(count) - 1)) for i in range(int(count))}
    for path, is_map in ((map_list, True), (query_list, False)):
        pathlib.Path(path).write_text("".join(f"{name}\n" for i, name in enumerate(names) if (i in chosen) == is_map))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("veiloc", "libraries", "map", "list"):
        parser.add_argument(f"--{name}", type=pathlib.Path)
    parser.add_argument("--scene", type=pathlib.Path, required=True)
    parser.add_argument("--split", nargs=3, metavar=("N", "MAP", "QUERIES"))
    parser.add_argument("--csv", type=pathlib.Path)
    parser.add_argument("--wrong-every", type=int, default=10)
    given = parser.parse_args()
    if given.split:
        split(given.scene, *given.split)
        return
    if None in (given.veiloc, given.libraries, given.map):
        parser.error("--veiloc, --libraries and --map are needed")
    library = ctypes.CDLL(str(given.libraries.resolve() / "libveiloc_c.so"))
    library.veiloc_alignment_info.restype = Info
    library.veiloc_alignment_new.argtypes = [ctypes.c_double, ctypes.c_void_p]
    library.veiloc_bytes_free.argtypes = [Bytes]
    pointer = ctypes.c_void_p

    def call(name, *arguments):
        status = getattr(library, name)(*arguments)
        if status != 0:
            library.veiloc_last_error.restype = ctypes.c_char_p
            raise RuntimeError(f"{name}: {library.veiloc_last_error().decode()}")

    work = pathlib.Path(tempfile.mkdtemp(prefix="veiloc-walk-"))
    names = names_of(given.list or given.scene / "query.txt")
    truth, own = run.poses_of(given.scene / "posed/images.txt"), given.scene / "posed-given/images.txt"
    tracking = run.poses_of(own) if own.exists() else drifted(truth, names)
    words = (given.scene / "posed/cameras.txt").read_text().splitlines()[-1].split()[1:]
    run.run(given.veiloc, "map", "profile", given.map, "--out", work / "profile", "--quiet")
    run.run(given.veiloc, "map", "pack", given.map, "--out", work / "pack", "--quiet")
    run.run(given.libraries / "examples/reference", work / "pack", ",".join(words), work / "frames",
            *(given.scene / "images" / name for name in names))
    log = open(work / "log", "w+")
    service = subprocess.Popen([given.veiloc, "serve", "--map", f"place={given.map}", "--listen", "127.0.0.1:0", "--rate", "1000", "--burst",
                                "1000"], stdout=log, stderr=log)
    try:
        port = None
        while port is None:
            time.sleep(0.1)
            found = re.search(r"serving place on http://127\.0\.0\.1:(\d+)", (work / "log").read_text())
            port = found and int(found.group(1))
            if service.poll() is not None:
                sys.exit((work / "log").read_text())
        profile_bytes = (work / "profile").read_bytes()
        profile, sealer, session, alignment = pointer(), pointer(), pointer(), pointer()
        call("veiloc_profile_new", profile_bytes, ctypes.c_size_t(len(profile_bytes)), ctypes.byref(profile))
        call("veiloc_sealer_new", profile, None, ctypes.byref(sealer))
        call("veiloc_session_new", None, ctypes.byref(session))
        call("veiloc_alignment_new", 1.0, ctypes.byref(alignment))
        camera = Camera(model=words[0].encode(), width=int(words[1]), height=int(words[2]), param_count=len(words) - 3)
        camera.params[:len(words) - 3] = [float(word) for word in words[3:]]
        answers = []
        for i, name in enumerate(names):
            pixels = (work / f"frames/{i}.rgba").read_bytes()
            frame = Frame(bytes=pixels, length=len(pixels), format=1, width=camera.width, height=camera.height)
            extracted, query, sent, pose = pointer(), pointer(), Bytes(), colmap_pose(tracking[name])
            try:
                call("veiloc_sealer_extract", sealer, ctypes.byref(frame), ctypes.byref(camera), 3, ctypes.byref(pose), None,
                     ctypes.byref(extracted))
                call("veiloc_sealer_seal", sealer, None, extracted, ctypes.byref(query))
            except RuntimeError:
                answers.append(None)
                continue
            finally:
                library.veiloc_extracted_free(extracted)
            call("veiloc_query_bytes", query, 0, ctypes.byref(sent))
            connection = http.client.HTTPConnection("127.0.0.1", port)
            connection.request("POST", "/v1/maps/place/localize", bytes(sent.data[:sent.length]),
                               {"content-type": "application/x-protobuf", "accept": "application/x-protobuf"})
            reply = connection.getresponse()
            body = reply.read()
            answers.append(body if reply.status == 200 else None)
            library.veiloc_bytes_free(sent)
            library.veiloc_query_free(query)
        rows = []
        for i, name in enumerate(names):
            # A wrong answer is the right one of a frame on the other side of the walk.
            is_wrong = i % given.wrong_every == given.wrong_every // 2
            body = answers[(i + len(names) // 2) % len(names)] if is_wrong else answers[i]
            if body is None:
                continue
            answer, update, pose, found = pointer(), ctypes.c_uint32(), colmap_pose(tracking[name]), Pose()
            call("veiloc_answer_new", body, ctypes.c_size_t(len(body)), ctypes.byref(answer))
            centre = list(colmap_pose(truth[name]).position)
            single = Pose()
            library.veiloc_answer_camera_in_map.argtypes = [pointer, ctypes.c_uint32, ctypes.c_double, pointer]
            call("veiloc_answer_camera_in_map", answer, 3, 1.0, ctypes.byref(single))
            alone = math.dist(list(single.position), centre)
            call("veiloc_alignment_add", alignment, answer, 3, ctypes.byref(pose), ctypes.byref(update))
            error = math.nan
            if library.veiloc_alignment_info(alignment).state > 0:
                call("veiloc_alignment_camera_in_map", alignment, 3, ctypes.byref(pose), ctypes.byref(found), None)
                error = math.dist(list(found.position), centre)
            rows.append((i, int(is_wrong), UPDATES[update.value], alone, error))
            library.veiloc_answer_free(answer)
        info = library.veiloc_alignment_info(alignment)
        lines = ["frame,wrong,update,answer_error_m,alignment_error_m"]
        lines += [f"{i},{wrong},{update},{alone:.4f},{error:.4f}" for i, wrong, update, alone, error in rows]
        if given.csv:
            given.csv.write_text("\n".join(lines) + "\n")
        print("\n".join(lines))
        errors = [row[4] for row in rows if not math.isnan(row[4])]
        wrong = [row for row in rows if row[1]]
        print(f"{len(rows)} answers, {len(wrong)} wrong, {sum(row[2] == 'used' for row in wrong)} of them used; error of the camera's place: "
              f"median {statistics.median(errors):.3f} m, largest {max(errors):.3f} m; distances {info.distances}, ratio {info.distance_ratio:.3f}")
    finally:
        service.terminate()
        service.wait()


if __name__ == "__main__":
    main()
