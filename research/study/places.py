"""Tables of docs/results/places.md: the same command on every place."""

from itertools import product

from study.common import MODEL_FILES, PLACES, command, percent

LAYOUTS = {
    "stripes 138": "dcl:axis=138:sectors=24:anchors=-0.62/-0.61+0.92/-1.16",
    "stripes 115": "dcl:axis=115:sectors=20:anchors=0.23/-0.33+-0.88/-0.47",
    "upright strips, 0.5": "dcl:axis=90:sectors=24:anchors=0/-0.5+0/0.5",
    "upright strips, 0.75": "dcl:axis=90:sectors=24:anchors=0/-0.75+0/0.75",
    "slanted strips": "dcl:axis=122:sectors=24:anchors=0.37/-0.59+-0.53/0.85",
}
# `dcl` is the slanted strips.
OTHERS = {"paper": "dcl:paper"} | {name: text for name, text in LAYOUTS.items() if name != "slanted strips"}
SCHEMES = {name: name for name in ["points", "random-lines", "dcl"]} | OTHERS
STAGES = ["retrieval", "matching", "search", "objective"]


def measured(run, table, lost=None):
    """Recall, the ± and trust of each place and scheme. A pose is right within 25 cm (map units) and 2°."""
    schemes = {name: SCHEMES[name] for name in run.schemes}
    for place in run.places:
        document = run.document("eval", "scene", *run.scene(place), "--schemes", ",".join(schemes.values()), "--thresholds",
                                "0.05/5,0.25/2", *run.more.split())
        for (name, text), scheme in zip(schemes.items(), document["schemes"]):
            queries = [q for q in document["queries"] if q["scheme"] == text]
            share = scheme.get("coverage_pose", {}).get("99")
            own = {"place": place, "scheme": name, "pose in 99 % region (%)": percent(share, 0)}
            table.add(own | trust_of(queries), scheme)
            stages = scheme.get("lost", {})
            if lost and stages:
                lost.add([place, name, sum(stages.values()), *(stages.get(stage, 0) for stage in STAGES)])


COLUMNS = [
    "place", "scheme", "queries", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)", "median error (map units)",
    "median error (°)", "trusted", "right poses trusted (%)", "trusted beyond 25 cm or 2°",
    "of these beyond 3 ±", "trusted, centre beyond 3 ±", "trusted, orientation beyond 3 ±",
    "pose in 99 % region (%)",
]  # fmt: skip


def is_right(query: dict) -> bool:
    """Whether a pose is within 25 cm (map units) and 2°."""
    moved, turned = query.get("translation_error"), query.get("rotation_error_deg")
    return moved is not None and moved <= 0.25 and turned <= 2


def trust_of(queries: list[dict]) -> dict:
    trusted = [q for q in queries if q.get("state") == "trusted"]
    right = [q for q in queries if is_right(q)]
    moved = [q for q in trusted if q["center_error_over_sd"] is None or q["center_error_over_sd"] > 3]
    turned = [q for q in trusted if q["rotation_error_deg"] > 3 * (q["rotation_sd_deg"] or 0)]
    wrong = [q for q in trusted if not is_right(q)]
    return {
        "queries": len(queries), "trusted": len(trusted),
        "right poses trusted (%)": f"{100 * sum(q.get('state') == 'trusted' for q in right) / max(1, len(right)):.0f}",
        "trusted beyond 25 cm or 2°": len(wrong), "of these beyond 3 ±": sum(q in moved or q in turned for q in wrong),
        "trusted, centre beyond 3 ±": len(moved), "trusted, orientation beyond 3 ±": len(turned),
    }  # fmt: skip


def key_of(entry: dict) -> tuple:
    """Scheme, condition and start of a row or query of `eval scene`: `optimum` and `floor` start from the true pose."""
    return entry["scheme"], entry.get("condition", "none"), entry["recipe"] if entry["recipe"] in ("optimum", "floor") else None


def rows_of(document: dict) -> dict:
    """The rows of `eval scene` with their queries, by scheme, condition and start."""
    return {key_of(row): (row, [q for q in document["queries"] if key_of(q) == key_of(row)]) for row in document["schemes"]}


MEASURED = {"places": PLACES, "schemes": (list(SCHEMES), "names of the table"), "more": ("", "further options of `veiloc eval scene`")}


@command("places/places.csv", "places/lost.csv", **MEASURED)
def places(run):
    """Recall, the ± and trust on every place, and the stages that lose queries."""
    measured(run, run.table("places/places.csv", *COLUMNS), run.table("places/lost.csv", "place", "scheme", "lost", *STAGES))


@command("places/alike.csv", needs=MODEL_FILES, places=["llff-room", "fountain", "entry", "hololens-office"],
         schemes=["points", "dcl"], more="--features alike-t-compact")
def alike(run):
    """The same with the compact features of a network."""
    measured(run, run.table("places/alike.csv", *COLUMNS))


def by_condition(run, table, place: str, column: str, names: dict, *options):
    """A row for each scheme and condition; `names` has the cell of each condition."""
    found = rows_of(run.document("eval", "scene", *run.scene(place), "--schemes", "points,dcl", "--thresholds", "0.05/5,0.25/2",
                                 "--conditions", ",".join(names), *options))  # fmt: skip
    for scheme, (condition, name) in product(("points", "dcl"), names.items()):
        row, queries = found[scheme, condition, None]
        table.add({"place": place, column: name} | trust_of(queries), row)


@command("places/gravity.csv", places=PLACES, wrong=(["hololens-office", "tum-fr1-rpy"], "places with wrong directions, too"))
def gravity(run):
    """With the direction of gravity as an accelerometer gives it, off by half a degree or one, and by 5° or 90° more than it says."""
    table = run.table("places/gravity.csv", *COLUMNS[:2], "gravity ± (°), wrong by (°)", *COLUMNS[2:-1])
    for place in run.places:
        how = ["0.5", "1"] + ["0.5,5", "0.5,90"] * (place in run.wrong)
        names = {"none": "none"} | {f"gravity:{text.replace(',', '/')}": text for text in how}
        by_condition(run, table, place, "gravity ± (°), wrong by (°)", names)


@command("places/bursts.csv", places=["hololens-office", "tum-fr1-rpy", "redkitchen"], frames=["1", "2", "3", "5"])
def bursts(run):
    """Frames of one walk together, with the odometry of a phone: 0.1° and 1 cm a step."""
    table = run.table("places/bursts.csv", *COLUMNS[:2], "frames", *COLUMNS[2:-1])
    for place in run.places:
        by_condition(run, table, place, "frames", {f"frames:{n}": n for n in run.frames}, "--max-distance", 2)
