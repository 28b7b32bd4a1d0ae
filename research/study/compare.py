"""Compares two runs on the same queries and tests which differences are significant.

    python3 research/study compare A.json B.json

Reads documents of `veiloc eval scene`, `eval pose` and `eval dataset`. Queries are paired by name and seed, so
a query that is difficult for both runs does not affect the difference. The 95 % interval of a difference comes from a
bootstrap: queries are drawn with replacement, a query with all its seeds and in both runs at once. A figure is called better
only if its interval excludes zero. Neighbouring frames of one trajectory are more alike than independent queries, which the
bootstrap ignores: its interval is rather too narrow.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd

COMMANDS = {"scene", "pose", "7scenes", "cambridge", "aachen", "aachen-v1.1"}
LEVEL = 0.95


def read(path) -> dict:
    """The document of an evaluation with known poses; raises SystemExit with the reason for any other file."""
    try:
        document = json.loads(Path(path).read_text())
        command, version = document["command"], document["version"]
    except OSError as error:
        sys.exit(f"{path}: {error.strerror}")
    except (ValueError, KeyError, TypeError) as error:
        sys.exit(f"{path}: this is not a document of an evaluation: {error!r}")
    if command.split()[-1] not in COMMANDS:
        sys.exit(f"{path}: this is a document of {command!r}; give one of eval scene, eval pose or eval dataset")
    if version != 1:
        sys.exit(f"{path}: this document has version {version}, but only version 1 is supported")
    return document


def queries(document: dict) -> pd.DataFrame:
    """Queries with a known pose, one a line; `translation` (map units) and `rotation` (degrees) are infinite without a pose."""

    def row(query: dict) -> str:
        gravity = f"gravity {query['gravity']}" if query.get("gravity") else None
        return ", ".join(x for x in [query["scheme"], query["recipe"], gravity, query.get("scene"), query.get("condition")] if x)

    def error(query: dict, field: str) -> float:
        return np.inf if query[field] is None else query[field]

    known = [query for query in document["queries"] if query.get("has_ground_truth", True)]
    if not known:
        sys.exit("no query of this document has a known pose, so errors cannot be computed; submit the result file to the benchmark")
    frame = pd.DataFrame([{
        "row": row(query), "scheme": query["scheme"], "name": query["name"], "seed": query["seed"],
        "translation": error(query, "translation_error"), "rotation": error(query, "rotation_error_deg"),
        "ms": sum(query["ms"].values())} for query in known])  # fmt: skip
    twice = frame[frame.duplicated(["row", "name", "seed"])]
    if len(twice):
        sys.exit(f"{twice.iloc[0].row}: the query {twice.iloc[0]['name']!r} appears twice with seed {twice.iloc[0].seed}")
    return frame


def threshold(text: str) -> tuple[float, float]:
    """`translation/degrees`, both positive: map units and degrees."""
    translation, rotation = map(float, text.split("/"))
    if not (0 < translation < np.inf and 0 < rotation < np.inf):
        raise ValueError(text)
    return translation, rotation


def thresholds(document: dict) -> list[str]:
    found = {text for row in document["schemes"] for text in row["recall"]}
    return sorted(found, key=threshold)


def recall(frame: pd.DataFrame, text: str) -> float:
    translation, rotation = threshold(text)
    return float(((frame.translation <= translation) & (frame.rotation <= rotation)).mean())


def pairs(a: pd.DataFrame, b: pd.DataFrame, row: str | None, against: str | None) -> list[tuple[str, str]]:
    """Rows to compare: the named ones, else those of both runs, else the only row of each."""

    def named(frame, name):
        rows = list(dict.fromkeys(frame.row))
        return [r for r in rows if r == name] or [r for r in rows if r.split(", ")[0] == name] if name else rows

    of_a, of_b = named(a, row), named(b, against)
    found = [] if against else [(r, r) for r in of_a if r in of_b]
    if not found and len(of_a) == len(of_b) == 1:
        found = [(of_a[0], of_b[0])]
    if not found:
        sys.exit(f"no rows to compare: the first has {'; '.join(dict.fromkeys(a.row))}; the second has {'; '.join(dict.fromkeys(b.row))}")
    return found


def compare(a: pd.DataFrame, b: pd.DataFrame, recalls: list[str], draws: int = 10_000, seed: int = 0) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Figures of two rows with their difference (`b` minus `a`), its interval and the result; and the paired queries."""
    both = a.merge(b, on=["name", "seed"], suffixes=("_a", "_b")).sort_values(["name", "seed"], ignore_index=True)
    if both.empty:
        sys.exit(f"{a.row.iloc[0]}: the runs have no query in common")
    bounds = [threshold(text) for text in recalls]

    def figures(at: np.ndarray) -> np.ndarray:
        values = []
        for side in ("a", "b"):
            translation, rotation, ms = (columns[f"{name}_{side}"][at] for name in ("translation", "rotation", "ms"))
            shares = [np.mean((translation <= t) & (rotation <= r)) for t, r in bounds]
            values.append([*shares, *(np.median(x) for x in (translation, rotation, ms))])
        return np.array(values)

    def difference(values: np.ndarray) -> np.ndarray:
        # Zero if neither has a pose.
        return np.where(values[0] == values[1], 0.0, np.subtract(values[1], values[0], where=values[0] != values[1], out=np.zeros(len(values[0]))))

    columns = {name: both[name].to_numpy() for name in both.columns if name.endswith(("_a", "_b"))}
    groups = list(both.groupby("name", sort=False).indices.values())
    random = np.random.default_rng(seed)
    sample = [np.concatenate([groups[k] for k in random.integers(len(groups), size=len(groups))]) for _ in range(draws)]
    drawn = np.sort([difference(figures(at)) for at in sample], axis=0)
    low, high = (drawn[min(int(share * draws), draws - 1)] for share in ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    whole = figures(np.arange(len(both)))
    names = [f"recall {text}" for text in recalls] + ["median translation", "median rotation, deg", "median time, ms"]
    more_is_better = np.array([True] * len(recalls) + [False] * 3)
    better_b, better_a = np.where(more_is_better, (low > 0, high < 0), (high < 0, low > 0))
    result = np.select([better_b, better_a], ["B is better", "A is better"], "not shown")
    table = pd.DataFrame({"figure": names, "A": whole[0], "B": whole[1], "B - A": difference(whole), "low": low, "high": high, "result": result})
    return table, both


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="study compare", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("a", metavar="A.json")
    parser.add_argument("b", metavar="B.json", help="may be the same file, with --row and --against")
    parser.add_argument("--row", help="compare only this row or scheme of A")
    parser.add_argument("--against", help="with this row or scheme of B; default: the row of the same name")
    parser.add_argument("--thresholds", type=lambda x: [t for t in x.split(",") if threshold(t)], metavar="T/DEG,…",
                        help="of recall, map units and degrees; default: those that both documents contain")  # fmt: skip
    parser.add_argument("--bootstrap-samples", type=int, default=10_000, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)
    if args.against and not args.row:
        parser.error("--against needs --row")
    documents = [read(args.a), read(args.b)]
    if documents[0]["data"] != documents[1]["data"]:
        print(f"A was evaluated on {documents[0]['data']}, and B on {documents[1]['data']}", file=sys.stderr)
    recalls = args.thresholds or [t for t in thresholds(documents[0]) if t in thresholds(documents[1])]
    a, b = map(queries, documents)
    for row_a, row_b in pairs(a, b, args.row, args.against):
        of_a, of_b = a[a.row == row_a], b[b.row == row_b]
        table, both = compare(of_a, of_b, recalls, args.bootstrap_samples, args.seed)
        nearer, farther = ((both.translation_b < both.translation_a).sum(), (both.translation_b > both.translation_a).sum())
        name = row_a if row_a == row_b else f"A: {row_a}; B: {row_b}"
        print(f"{name}: {len(both)} queries in both, B nearer in {nearer}, farther in {farther}")
        if len(of_a) + len(of_b) > 2 * len(both):
            print(f"left out: {len(of_a) - len(both)} of A alone, {len(of_b) - len(both)} of B alone")
        print(f"low and high: {LEVEL:.0%} of the differences", table.to_string(index=False, float_format="{:.5g}".format), "", sep="\n")


if __name__ == "__main__":
    main()
