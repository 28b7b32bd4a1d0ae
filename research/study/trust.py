"""Tables of docs/results/trust.md: when is a pose trusted, and is it right then?"""

import math
import os
import tempfile
from pathlib import Path

from study.common import PLACES, RIGHT, SCENES, Package, cm, command, names_of, number, percent
from study.geometry import Posed, read_posed, rotation, write_posed
from study.places import is_right, rows_of, trust_of
from study.poses import ALL

LINES = ["points", "random-lines", "dcl"]

np = Package("numpy")


@command("trust/out-of-map.csv")
def out_of_map(run):
    """Images of other places: how many are trusted."""
    table = run.table("trust/out-of-map.csv", "map", *NEGATIVES)
    for scene, folder, schemes in [("RedKitchen", "redkitchen", ALL), ("Herz-Jesu", "herzjesu", ALL), ("Lund door", "lund-door", LINES),
                                   ("rendered room", "rendered", LINES)]:  # fmt: skip
        for row in out_of_map_rows(run, run.map(folder), ",".join(schemes)):
            table.add({"map": scene}, row)


NEGATIVES = ["scheme", "negative queries", "trusted", "doubtful", "not found", "log evidence, 99 % quantile", "log evidence, largest"]


def out_of_map_rows(run, built, schemes: str, *options, condition: str = "negatives") -> list[dict]:
    """Rows of the photos in the half that chose no constant, with quantiles of their evidence in which those without are below all."""
    found = run.document("eval", "scene", "--map", built, "--conditions", condition, "--negatives", run.place("training-photos"),
                         "--negatives-split", "final", "--schemes", schemes, "--jobs", os.cpu_count(), *options)  # fmt: skip
    for row, queries in rows_of(found).values():
        evidence = sorted(query.get("log_evidence", -math.inf) for query in queries)
        last = {percent: evidence[math.ceil(len(evidence) * percent / 100) - 1] for percent in (99, 100)}
        row["log_evidence"] = {str(percent): None if value == -math.inf else value for percent, value in last.items()}
    return found["schemes"]


@command("trust/places-negatives.csv", places=PLACES, schemes="points,dcl", every=(8, "each Nth of the photos"))
def places_negatives(run):
    """Images of other places, on every place: those of `training-photos` in the half that chose no constant."""
    photos = run.place("training-photos")
    listed = run.listed(f"negatives-{run.every}", [photo.relative_to(photos) for photo in sorted(photos.rglob("*.jpg"))[:: run.every]])
    table = run.table("trust/places-negatives.csv", "place", *NEGATIVES)
    for place in run.places:
        for row in out_of_map_rows(run, run.map(place), run.schemes, "--negatives-list", listed):
            table.add({"place": place}, row)


@command("trust/gravity-negatives.csv", places=["redkitchen", "hololens-office"], schemes="dcl")
def gravity_negatives(run):
    """Images of other places, sealed with a random direction of gravity as if it were known to half a degree."""
    table = run.table("trust/gravity-negatives.csv", "place", *NEGATIVES)
    for place in run.places:
        options = run.scene(place)
        # Any direction down serves: those of the queries are random.
        built = run.made(run.kept() / f"{place}-down.vmap", "map", "build", *options[:4], "--list", options[5], "--down", "z")
        for row in out_of_map_rows(run, built, run.schemes, condition="negatives+gravity:0.5"):
            table.add({"place": place}, row)


STRESS = ["none", "dark", "motion", "half-hidden", "side-hidden", "low-resolution", "sparse-map", "few-keypoints"]


def stressed(run, folder: str, schemes, conditions=STRESS, *options) -> dict:
    """Rows of `eval scene` by scheme and condition, with what the search loses if the optimum is there, too. A trusted pose beyond
    25 cm (map units) or 2° is wrong."""
    found = rows_of(run.document("eval", "scene", *run.scene(folder), "--conditions", ",".join(conditions), "--schemes", ",".join(schemes),
                                 "--jobs", os.cpu_count(), *options))  # fmt: skip
    for (scheme, condition, start), (row, queries) in found.items():
        trust = trust_of(queries) if not start else {}
        row |= {"stress": condition, "trusted_wrong": trust.get("trusted beyond 25 cm or 2°"), "trust": trust}
        best, optimum = found.get((scheme, condition, "optimum"), ({}, []))
        row |= {"optimum": best, "search_failures": sum(not is_right(q) and is_right(o) for q, o in zip(queries, optimum))}
    return {(scheme, condition): row for (scheme, condition, start), (row, _) in found.items() if not start}


def stress_table(run, name: str, *options):
    """Both scenes under stress, points beside dcl."""
    columns = ["within (%)", "median (cm)", "trusted", "trusted wrongly"]
    table = run.table(name, "scene", "stress", *(f"{scheme} {column}" for scheme in ("points", "dcl") for column in columns))
    for scene, folder in SCENES.items():
        found = stressed(run, folder, ["points", "dcl"], STRESS, "--query-keypoints", 1024, *options)
        within = "0.05/5" if folder == "redkitchen" else RIGHT
        for condition in STRESS:
            rows = [found[scheme, condition] for scheme in ("points", "dcl")]
            table.add([scene, condition, *(cell for row in rows for cell in (
                percent(row["recall"][within]), cm(row["median_translation"]), row["trusted"], row["trusted_wrong"]))])  # fmt: skip


@command("trust/stress.csv")
def stress(run):
    """Queries under stress."""
    stress_table(run, "trust/stress.csv")


@command("trust/places-stress.csv", places=PLACES, schemes=["points", "dcl"],
         stress=["none", "dark", "motion", "half-hidden", "low-resolution", "few-keypoints"])  # fmt: skip
def places_stress(run):
    """Queries under stress, on every place. A pose is wrong beyond 25 cm (map units) or 2°."""
    table = run.table("trust/places-stress.csv", "place", "stress", "scheme", "queries", "within 5 cm and 5° (%)",
                      "within 25 cm and 2° (%)", "median error (map units)", "trusted", "trusted wrongly", "of these beyond 3 ±",
                      "trusted, centre beyond 3 ±", "trusted, orientation beyond 3 ±")  # fmt: skip
    for place in run.places:
        for row in stressed(run, place, run.schemes, run.stress).values():
            table.add({"place": place, "median error (map units)": number(row["median_translation"], ".4g")} | row["trust"], row)


@command("trust/search.csv")
def search(run):
    """What the search loses, beside the optimum of the score."""
    table = run.table("trust/search.csv", "scene", "stress", "within 25 cm and 2° (%)", "median error (cm)", "median ± (cm)", "trusted",
                      "trusted wrongly", "doubtful", "not found", "within 25 cm and 2°, optimum (%)", "lost by the search")  # fmt: skip
    for scene, folder in SCENES.items():
        for row in stressed(run, folder, ["dcl"], STRESS, "--optimum").values():
            table.add({"scene": scene, "within 25 cm and 2°, optimum (%)": percent(row["optimum"]["recall"][RIGHT]),
                       "lost by the search": row["search_failures"]}, row)  # fmt: skip


@command("trust/focal.csv")
def focal(run):
    """A focal length that is wrong."""
    table = run.table("trust/focal.csv", "scene", "focal length wrong by (%)", "scheme", "within 25 cm and 2° (%)", "median error (cm)",
                      "median ± (cm)", "trusted", "trusted wrongly", "doubtful")  # fmt: skip
    for scene, folder in SCENES.items():
        conditions = {0: "none"} | {wrong: f"camera:f~{wrong}%" for wrong in (1, 3, 10, 30)}
        found = stressed(run, folder, LINES, conditions.values())
        for wrong, condition in conditions.items():
            for scheme in LINES:
                table.add({"scene": scene, "focal length wrong by (%)": wrong}, found[scheme, condition])


@command("trust/gravity.csv")
def gravity(run):
    """Queries with the direction of gravity, which is off by half a degree."""
    conditions = ["none", "half-hidden", "sparse-map"]
    known = {"no": conditions, "yes": ["gravity:0.5", *(f"{condition}+gravity:0.5" for condition in conditions[1:])]}
    found = stressed(run, "redkitchen", LINES, [*known["no"], *known["yes"]])
    table = run.table("trust/gravity.csv", "stress", "scheme", "gravity", "within 25 cm and 2° (%)", "median error (cm)",
                      "median error (°)", "trusted", "trusted wrongly", "doubtful", "not found")  # fmt: skip
    for at, condition in enumerate(conditions):
        for scheme in LINES:
            for name, own in known.items():
                table.add({"gravity": name, "stress": condition}, found[scheme, own[at]])


@command("trust/frames.csv")
def frames(run):
    """Several images of one device together."""
    table = run.table("trust/frames.csv", "stress", "scheme", "images", "queries", "localized", "trusted", "median error (cm)",
                      "median error (°)", "within 25 cm and 2° (%)")  # fmt: skip
    stress = {"none": "", "half-hidden": "half-hidden+", "sparse-map": "sparse-map+"}
    names = {f"{prefix}frames:{count}": (name, count) for name, prefix in stress.items() for count in (1, 2, 4, 8)}
    rows = run.document("eval", "scene", *run.scene("redkitchen"), "--conditions", ",".join(names), "--jobs", os.cpu_count())["schemes"]
    for row in sorted(rows, key=lambda row: (list(stress).index(names[row["condition"]][0]), ALL.index(row["scheme"]))):
        condition, count = names[row["condition"]]
        table.add({"stress": condition, "images": count}, row)


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
            run.run("map", "build", "--quiet", "--no-coordinate-frame-check", "--posed", folder / "posed", "--images", folder / "images", "-o",
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


# The name in the table, and the condition.
ERRORS = {"none": "none"} | {f"cx {n} %": f"camera:cx+{n}%" for n in (1, 2, 5, 10)} | {
    "fy 0.9": "camera:fy-10%", "k1 -0.2": "camera:k1-0.2", "f 1.03": "camera:f+3%", "f 0.8": "camera:f-20%", "f 1.3": "camera:f+30%"}  # fmt: skip


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
        *scene, listed = run.scene(name)
        listed = run.listed(f"{name}-every-{run.every}", listed.read_text().splitlines()[:: run.every])
        found = rows_of(run.document("eval", "scene", *scene, listed, "--conditions", ",".join(ERRORS.values()), "--schemes",
                                     ",".join(run.schemes), "--jobs", os.cpu_count()))  # fmt: skip
        for scheme in run.schemes:
            for error, condition in ERRORS.items():
                row, queries = found[scheme, condition, None]
                table.add({"scene": name, "camera error": error, "median error (°)": number(row["median_rotation_deg"], ".2g"),
                           "median error (map units)": number(row["median_translation"], ".4g")} | trust_of(queries), row)  # fmt: skip
