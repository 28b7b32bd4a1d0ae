"""Tables of docs/results/trust.md: when is a pose trusted, and is it right then?"""

import math
import statistics
import tempfile
from pathlib import Path

from study.common import PLACES, RIGHT, SCENES, Package, cm, command, names_of, number, percent
from study.geometry import Posed, angle, read_posed, rotation, write_posed
from study.poses import ALL, LINES

np = Package("numpy")


@command("trust/out-of-map.csv")
def out_of_map(run):
    """Images of other places: how many are trusted."""
    table = run.table("trust/out-of-map.csv", "map", *NEGATIVES)
    for scene, folder, schemes in [("RedKitchen", "redkitchen", ALL), ("Herz-Jesu", "herzjesu", ALL), ("Lund door", "lund-door", LINES),
                                   ("rendered room", "rendered", LINES)]:  # fmt: skip
        found = run.document("eval", "negatives", "--map", run.map(folder), "--images", run.place("training-photos"), "--split", "final",
                             "--schemes", ",".join(schemes))  # fmt: skip
        for row in found["rows"]:
            table.add({"map": scene}, row)


NEGATIVES = ["scheme", "negative queries", "trusted", "doubtful", "not found", "log evidence, 99 % quantile", "log evidence, largest"]


@command("trust/places-negatives.csv", places=PLACES, schemes="points,dcl", every=(8, "each Nth of the photos"))
def places_negatives(run):
    """Images of other places, on every place: those of `training-photos` in the half that chose no constant."""
    photos = run.place("training-photos")
    listed = run.listed("negatives", [photo.relative_to(photos) for photo in sorted(photos.rglob("*.jpg"))[:: run.every]])
    table = run.table("trust/places-negatives.csv", "place", *NEGATIVES)
    for place in run.places:
        found = run.json("eval", "negatives", "--map", run.map(place), "--images", photos, "--list", listed, "--split", "final",
                         "--schemes", run.schemes)  # fmt: skip
        for row in found["rows"]:
            table.add({"place": place}, row)


@command("trust/gravity-negatives.csv", places=["redkitchen", "hololens-office"], schemes="dcl")
def gravity_negatives(run):
    """Images of other places, sealed with a random direction of gravity as if it were known to half a degree."""
    table = run.table("trust/gravity-negatives.csv", "place", *NEGATIVES)
    for place in run.places:
        options = run.scene(place)
        # Any direction down serves: those of the queries are random.
        built = run.made(run.kept() / f"{place}-down.vmap", "map", "build", *options[:4], "--list", options[5], "--down", "z")
        found = run.document("eval", "negatives", "--map", built, "--images", run.place("training-photos"), "--split", "final", "--schemes",
                             run.schemes, "--random-gravity", 0.5)  # fmt: skip
        for row in found["rows"]:
            table.add({"place": place}, row)


def stressed(run, folder: str, *options) -> dict:
    """Rows of `eval stress` by scheme and condition."""
    found = run.document("eval", "stress", *run.scene(folder), *options)
    return {(row["scheme"], row["stress"]): row for row in found["rows"]}


def stress_table(run, name: str, *options):
    """Both scenes under stress, points beside dcl."""
    columns = ["within (%)", "median (cm)", "trusted", "trusted wrongly"]
    table = run.table(name, "scene", "stress", *(f"{scheme} {column}" for scheme in ("points", "dcl") for column in columns))
    for scene, folder in SCENES.items():
        found = stressed(run, folder, "--query-keypoints", 1024, "--schemes", "points,dcl", *options)
        within = "0.05/5" if folder == "redkitchen" else RIGHT
        for condition in dict.fromkeys(condition for _, condition in found):
            rows = [found[scheme, condition] for scheme in ("points", "dcl")]
            table.add([scene, condition, *(cell for row in rows for cell in (
                percent(row["recall"][within]), cm(row["median_translation"]), row["trusted"], row["trusted_wrong"]))])  # fmt: skip


@command("trust/stress.csv")
def stress(run):
    """Queries under stress."""
    stress_table(run, "trust/stress.csv")


@command("trust/places-stress.csv", places=PLACES, schemes="points,dcl", stress="dark,motion,half-hidden,low-resolution,few-keypoints")
def places_stress(run):
    """Queries under stress, on every place. A pose is wrong beyond 25 cm (map units) or 2°."""
    table = run.table("trust/places-stress.csv", "place", "stress", "scheme", "queries", "within 5 cm and 5° (%)",
                      "within 25 cm and 2° (%)", "median error (map units)", "trusted", "trusted wrongly", "of these beyond 3 ±",
                      "trusted, centre beyond 3 ±", "trusted, orientation beyond 3 ±")  # fmt: skip
    for place in run.places:
        found = run.json("eval", "stress", *run.scene(place), "--schemes", run.schemes, "--stress", run.stress)
        for row in found["rows"]:
            own = [q for q in found["queries"] if (q["scheme"], q["stress"], q["state"]) == (row["scheme"], row["stress"], "trusted")]
            moved = [q for q in own if q["center_error_over_sd"] is None or q["center_error_over_sd"] > 3]
            turned = [q for q in own if q["rotation_error_deg"] > 3 * (q["rotation_sd_deg"] or 0)]
            wrong = [q for q in own if q["translation_error"] > 0.25 or q["rotation_error_deg"] > 2]
            table.add({"place": place, "median error (map units)": number(row["median_translation"], ".4g"), "trusted wrongly": len(wrong),
                       "of these beyond 3 ±": sum(q in moved or q in turned for q in wrong), "trusted, centre beyond 3 ±": len(moved),
                       "trusted, orientation beyond 3 ±": len(turned)}, row)  # fmt: skip


@command("trust/search.csv")
def search(run):
    """What the search loses, beside the optimum of the score."""
    table = run.table("trust/search.csv", "scene", "stress", "within 25 cm and 2° (%)", "median error (cm)", "median ± (cm)", "trusted",
                      "trusted wrongly", "doubtful", "not found", "within 25 cm and 2°, optimum (%)", "lost by the search")  # fmt: skip
    for scene, folder in SCENES.items():
        for row in stressed(run, folder, "--optimum", "--schemes", "dcl").values():
            table.add({"scene": scene, "within 25 cm and 2°, optimum (%)": percent(row["optimum"]["recall"][RIGHT]),
                       "lost by the search": row["search_failures"]}, row)  # fmt: skip


@command("trust/focal.csv")
def focal(run):
    """A focal length that is wrong."""
    table = run.table("trust/focal.csv", "scene", "focal length wrong by (%)", "scheme", "within 25 cm and 2° (%)", "median error (cm)",
                      "median ± (cm)", "trusted", "trusted wrongly", "doubtful")  # fmt: skip
    for scene, folder in SCENES.items():
        found = stressed(run, folder, "--stress", "focal-1,focal-3,focal-10,focal-30", "--schemes", ",".join(LINES))
        for wrong in (0, 1, 3, 10, 30):
            for scheme in LINES:
                table.add({"scene": scene, "focal length wrong by (%)": wrong}, found[scheme, f"focal-{wrong}" if wrong else "none"])


@command("trust/gravity.csv")
def gravity(run):
    """Queries with the direction of gravity, which is off by half a degree."""
    options = ["--stress", "half-hidden,sparse-map", "--schemes", ",".join(LINES)]
    known = {"no": stressed(run, "redkitchen", *options), "yes": stressed(run, "redkitchen", *options, "--gravity", 0.5)}
    table = run.table("trust/gravity.csv", "stress", "scheme", "gravity", "within 25 cm and 2° (%)", "median error (cm)",
                      "median error (°)", "trusted", "trusted wrongly", "doubtful", "not found")  # fmt: skip
    for condition in ("none", "half-hidden", "sparse-map"):
        for scheme in LINES:
            for name, found in known.items():
                table.add({"gravity": name}, found[scheme, condition])


@command("trust/frames.csv")
def frames(run):
    """Several images of one device together."""
    table = run.table("trust/frames.csv", "stress", "scheme", "images", "queries", "localized", "trusted", "median error (cm)",
                      "median error (°)", "within 25 cm and 2° (%)")  # fmt: skip
    for condition in ("none", "half-hidden", "sparse-map"):
        for row in run.document("eval", "rig", *run.scene("redkitchen"), "--stress", condition)["schemes"]:
            # The recipe is "4 frames".
            table.add({"stress": condition, "images": row["recipe"].split()[0]}, row)


SHIFT = [10.0, 0.0, 0.0]


@command("trust/twins.csv", room="redkitchen", schemes=["points", "dcl"])
def twins(run):
    """Queries in a map that holds a part of the scene twice, and in which of both places they are found.

    The twin is made of copies of map images whose poses are moved by ten map units: `8 of 24` copies every third of the 24 images
    nearest to the queries, `24 of 24` all of them, `8 in a row` eight neighbours."""
    scene = run.place(run.room)
    known = read_posed(scene / "posed")
    names, queries = names_of(scene / "map.txt"), names_of(scene / "query.txt")
    apart = {name: min(math.dist(known[name].center, known[query].center) for query in queries) for name in names}
    near = set(sorted(names, key=apart.get)[:24])
    block = [name for name in names if name in near]
    moved = lambda posed: Posed(posed.camera, posed.r, posed.t - posed.r @ SHIFT)
    table = run.table("trust/twins.csv", "scene", "twin", "scheme", "queries", "trusted in the right place", "trusted in the twin",
                      "doubtful", "other")  # fmt: skip
    for twin, copied in {"none": [], "8 of 24": block[1::3], "24 of 24": block, "8 in a row": block[8:16]}.items():
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            both = {f"a/{name}": known[name] for name in names} | {f"b/{name}": moved(known[name]) for name in copied}
            write_posed(folder / "posed", both)
            (folder / "posed/points3D.txt").write_text("")
            for name in both:
                link = folder / "images" / name
                link.parent.mkdir(parents=True, exist_ok=True)
                link.symlink_to((scene / "images" / name[2:]).resolve())
            run.run("map", "build", "--quiet", "--no-frame-check", "--posed", folder / "posed", "--images", folder / "images", "-o",
                    folder / "map.vmap")  # fmt: skip
            listed = folder / "queries.txt"
            listed.write_text("".join(f"{name} {known[name].camera}\n" for name in queries))
            for scheme in run.schemes:
                counts = {"right": 0, "twin": 0, "doubtful": 0, "other": 0}
                for query, found, true in localized(run, folder / "map.vmap", listed, scene, scheme, known):
                    if query["state"] != "trusted":
                        counts["doubtful" if query["state"] == "doubtful" else "other"] += 1
                        continue
                    distance = [math.dist(found.center, place.center) for place in (true, moved(true))]
                    counts["right" if distance[0] < 0.25 else "twin" if distance[1] < 0.25 else "other"] += 1
                table.add([run.room, twin, scheme, len(queries), *counts.values()])


def localized(run, built, listed, scene, scheme, known):
    """Each query of `veiloc localize`, its pose or None, and the true one."""
    document = run.json("localize", "--map", built, "--queries", listed, "--images", scene / "images", "--scheme", scheme)
    for query in document["queries"]:
        pose = query.get("cam_from_world")
        yield query, pose and Posed("", rotation(pose["q"]), np.array(pose["t"])), known[query["file"]]


ERRORS = ["none", "cx 1 %", "cx 2 %", "cx 5 %", "cx 10 %", "fy 0.9", "k1 -0.2", "f 1.03", "f 0.8", "f 1.3"]


@command("trust/camera.csv", scenes=["redkitchen", "herzjesu", "hololens-office", "tum-fr1-rpy", "llff-room", "fountain", "entry"],
         schemes=["points", "dcl"], every=(3, "take every n-th query"))  # fmt: skip
def camera(run):
    """Queries whose camera parameters are wrong, and poses that are trusted and not within their ±.

    `cx 5 %` means that the principal point of the query's camera is 5 % of the image's width too far right; `k1 -0.2` that a first
    radial term is given which the lens does not have; `fy 0.9` that the vertical focal length is 0.9 of the true one, and `f 1.03` that
    both are 1.03 of it."""
    table = run.table("trust/camera.csv", "scene", "scheme", "camera error", "queries", "trusted", "doubtful",
                      "trusted, centre beyond 3 ±", "trusted, orientation beyond 3 ±", "trusted beyond 25 cm or 2°",
                      "median error (map units)", "median error (°)")  # fmt: skip
    for name in run.scenes:
        scene, built = run.place(name), run.map(name)
        known, queries = read_posed(scene / "posed"), names_of(scene / "query.txt")[:: run.every]
        for scheme in run.schemes:
            for error in ERRORS:
                listed = run.listed("queries", [f"{query} {spoiled(known[query].camera.split(), error)}" for query in queries])
                moves, turns, states, beyond = [], [], [], [0, 0, 0]
                for query, found, true in localized(run, built, listed, scene, scheme, known):
                    states.append(query["state"])
                    moves.append(math.dist(found.center, true.center) if found else math.inf)
                    turns.append(angle(found.r, true.r) if found else math.inf)
                    if query["state"] == "trusted":
                        beyond[0] += moves[-1] > 3 * query["position_sd"]
                        beyond[1] += turns[-1] > 3 * query["confidence"]["rotation_sd_deg"]
                        beyond[2] += moves[-1] > 0.25 or turns[-1] > 2
                table.add([name, scheme, error, len(queries), states.count("trusted"), states.count("doubtful"), *beyond,
                           f"{statistics.median(moves):.4g}", f"{statistics.median(turns):.2g}"])  # fmt: skip


def spoiled(camera, error: str) -> str:
    """The camera with one of ERRORS."""
    model, width, height, *text = camera
    params = [float(p) for p in text]
    if error != "none":
        what, value = error.split()[:2]
        number = float(value)
        if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL"):
            f, cx, cy, k = (*params, 0.0)[:4]
            model, params = "OPENCV", [f, f, cx, cy, k, 0.0, 0.0, 0.0]
        elif model == "PINHOLE":
            model, params = "OPENCV", [*params, 0.0, 0.0, 0.0, 0.0]
        elif model != "OPENCV":
            raise SystemExit(f"camera model {model} is not supported here")
        if what == "cx":
            params[2] += number / 100 * int(width)
        elif what == "fy":
            params[1] *= number
        elif what == "f":
            params[0] *= number
            params[1] *= number
        else:
            params[4] += number
    return " ".join([model, width, height, *(repr(p) for p in params)])
