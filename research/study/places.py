#!/usr/bin/env python3
"""Measures recall, the ± and trust on several places with the same command, and writes one CSV.

    research/study/places.py --veiloc target/release/veiloc --data $VEILOC_DATA --csv docs/results/places/places.csv

Each place is a folder with `posed`, `images`, `map.txt` and `query.txt`; `veiloc eval scene` builds a map with its
self-test and localizes the queries under each scheme. A pose is right within 25 cm (map units) and 2°. Other options are those of
`veiloc eval scene`, for example `--features`.
"""

import argparse
import csv
import hashlib
import json
import subprocess
import tempfile
from pathlib import Path

PLACES = ["hololens-office", "tum-fr1-rpy", "llff-room", "fountain", "entry", "redkitchen", "herzjesu"]
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
COLUMNS = [
    "place", "scheme", "queries", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)", "median error (map units)",
    "median error (°)", "trusted", "right poses trusted (%)", "trusted beyond 25 cm or 2°",
    "of these beyond 3 ±", "trusted, centre beyond 3 ±", "trusted, orientation beyond 3 ±",
    "pose in 99 % region (%)",
]  # fmt: skip


def write_csv(path: Path | None, columns: list[str], rows: list[list]):
    """Writes a table for `docs/results`; nothing without a path."""
    if path:
        with path.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(rows)


def kept_document(veiloc, work: Path, *command) -> dict:
    """What a command prints with `--json`; kept in `work`, so that it runs once and an interrupted script goes on."""
    words = [str(word) for word in command]
    kept = work / f"{'-'.join(Path(word).name for word in words[:2])}-{hashlib.sha256(' '.join(words).encode()).hexdigest()[:16]}.json"
    if not kept.exists():
        work.mkdir(parents=True, exist_ok=True)
        partial = kept.with_suffix(".partial")
        done = subprocess.run([veiloc, *words, "--quiet", "--json", partial], stdout=subprocess.DEVNULL)
        # 1 and 4: some queries were not found or are doubtful.
        if done.returncode not in (0, 1, 4):
            raise subprocess.CalledProcessError(done.returncode, [veiloc, *words])
        partial.rename(kept)
    return json.loads(kept.read_text())


def row(place: str, name: str, scheme: dict, queries: list[dict]) -> list:
    def is_right(query: dict) -> bool:
        moved, turned = query.get("translation_error"), query.get("rotation_error_deg")
        return moved is not None and moved <= 0.25 and turned <= 2

    trusted = [q for q in queries if q["state"] == "trusted"]
    right = [q for q in queries if is_right(q)]
    moved = [q for q in trusted if q["center_error_over_sd"] > 3]
    turned = [q for q in trusted if q["rotation_error_deg"] > 3 * q["rotation_sd_deg"]]
    wrong = [q for q in trusted if not is_right(q)]
    beyond = [q for q in wrong if q in moved or q in turned]
    trusted_right = sum(q["state"] == "trusted" for q in right)
    share = scheme.get("coverage_pose", {}).get("99")
    recall = scheme["recall"]
    return [
        place, name, len(queries), f"{100 * recall['0.05/5']:.1f}", f"{100 * recall['0.25/2']:.1f}",
        f"{scheme['median_translation']:.4f}", f"{scheme['median_rotation_deg']:.3f}", len(trusted),
        f"{100 * trusted_right / max(1, len(right)):.0f}", len(wrong), len(beyond), len(moved), len(turned),
        "" if share is None else f"{100 * share:.0f}",
    ]  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--lost", type=Path, help="CSV of lost queries by stage")
    parser.add_argument("--places", default=",".join(PLACES))
    parser.add_argument("--schemes", default=",".join(SCHEMES), help="names of the table")
    args, options = parser.parse_known_args()
    schemes = {name: SCHEMES[name] for name in args.schemes.split(",")}
    rows, lost = [], []
    with tempfile.TemporaryDirectory() as work:
        found = Path(work) / "scene.json"
        for place in args.places.split(","):
            folder = args.data / place
            subprocess.run(
                [args.veiloc, "eval", "scene", "--quiet", "--posed", folder / "posed", "--images", folder / "images",
                 "--map-list", folder / "map.txt", "--query-list", folder / "query.txt",
                 "--schemes", ",".join(schemes.values()), "--thresholds", "0.05/5,0.25/2", *options, "--json", found],
                check=True, stdout=subprocess.DEVNULL)  # fmt: skip
            document = json.loads(found.read_text())
            for (name, text), scheme in zip(schemes.items(), document["schemes"]):
                rows.append(row(place, name, scheme, [q for q in document["queries"] if q["scheme"] == text]))
                print(*rows[-1], sep="  ", flush=True)
                stages = scheme.get("lost", {})
                if stages:
                    lost.append([place, name, sum(stages.values()), *(stages.get(stage, 0) for stage in STAGES)])
    write_csv(args.csv, COLUMNS, rows)
    write_csv(args.lost, ["place", "scheme", "lost", *STAGES], lost)


if __name__ == "__main__":
    main()
