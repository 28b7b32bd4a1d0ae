"""The tables of the paper for a document of results, beside the published figures for the same data; curves of errors.

    python3 research/study paper results.json [--inversion inversion.json] [--attacks attacks.json] [--markdown | --latex] [--plot DIR]

Reads documents of `veiloc eval dataset` and `eval scene`. Scenes are columns, schemes are rows. Published
figures are shown only for exactly the same images. The sheets of privacy are of `veiloc eval inversion` (Tables 2 and 7) and of
`eval dataset --attack-json` or `eval adversaries`: the paper does not say which images it attacked, so its rows stand beside ours as
those of other images.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from study.compare import queries, read, recall

PUBLISHED_INVERSION = Path(__file__).resolve().parents[2] / "docs/results/privacy/inversion-paper.csv"
STAGES = ["extract", "seal", "decode", "retrieve", "match", "pose"]
MEDIANS = "median position error (cm) / median rotation error (°)"
# Table of the paper, meaning of its cells, thresholds of recall, and the scenes in the order of its columns.
SETS = {
    "7scenes": ("Table 5", f"{MEDIANS} / recall (%)", ["0.05/5"], "chess fire heads office pumpkin redkitchen stairs".split()),
    "cambridge": ("Table 3", MEDIANS, ["0.05/5"], "KingsCollege OldHospital ShopFacade StMarysChurch".split()),
    "aachen": ("Table 4", "recall (%)", ["0.25/2", "0.5/5", "5/10"], ["day", "night"]),
    "aachen-v1.1": (None, "recall (%)", ["0.25/2", "0.5/5", "5/10"], ["day", "night"]),
    "scene": (None, f"{MEDIANS} / recall (%)", ["0.05/5"], []),
}
# Tables 3 to 5: data set, method, a cell for each scene.
PUBLISHED = [[part.strip() for part in line.split("|")] for line in """
7scenes | HLoc (SP+SG) | 0.3/0.10/100 0.6/0.25/100 0.4/0.27/100 0.7/0.20/100 0.6/0.13/100 0.5/0.14/97 2.1/0.66/73
7scenes | HLoc (SP+NN) | 0.3/0.11/100 0.6/0.25/100 0.5/0.27/97 0.8/0.21/99 0.7/0.15/98 0.5/0.14/95 2.6/0.74/66
7scenes | DSAC* | 0.5/0.17/100 0.8/0.28/99 0.5/0.34/100 1.2/0.34/98 1.2/0.28/99 0.7/0.21/97 2.7/0.78/92
7scenes | ACE | 0.5/0.18/- 0.8/0.33/- 0.5/0.33/- 1.0/0.29/- 1.0/0.22/- 0.8/0.2/- 2.9/0.81/-
7scenes | GoMatch | 4/1.65/- 13/3.86/- 9/5.17/- 11/2.48/- 16/3.32/- 13/2.84/- 89/21.12/-
7scenes | DGC-GNN | 3/1.41/- 5/1.81/- 4/3.13/- 7/1.66/- 8/2.03/- 8/2.14/- 83/21.53/-
7scenes | GSFF Privacy | 0.8/0.28/96 0.8/0.33/94 1.0/0.67/90 1.5/0.51/90 2.0/0.50/78 1.2/0.33/85 28.2/0.98/29
7scenes | Random Lines, the paper's | 0.5/0.15/100 0.9/0.35/99 0.7/0.40/96 1.0/0.29/98 1.0/0.22/96 0.7/0.20/94 3.7/1.06/58
7scenes | DCL, the paper's | 1.0/0.36/97 2.0/0.76/81 1.3/0.77/83 2.0/0.61/83 2.1/0.48/80 1.4/0.42/84 26.3/6.59/13
cambridge | HLoc (SP+SG) | 12/0.2 15/0.3 4/0.2 7/0.2
cambridge | HLoc (SP+NN) | 12/0.2 15/0.3 4/0.2 8/0.2
cambridge | DSAC* | 18/0.3 21/0.4 5/0.3 15/0.6
cambridge | ACE | 28/0.4 31/0.6 5/0.3 18/0.6
cambridge | GLACE | 19/0.3 17/0.4 4/0.2 9/0.3
cambridge | GoMatch | 25/0.64 283/8.14 48/4.77 335/9.94
cambridge | DGC-GNN | 18/0.47 75/2.83 15/1.57 106/4.03
cambridge | SegLoc | 24/0.26 36/0.52 11/0.34 17/0.46
cambridge | GSFF Privacy | 24/0.39 26/0.49 5/0.27 13/0.48
cambridge | Random Lines, the paper's | 11/0.2 16/0.3 4/0.2 7/0.2
cambridge | DCL, the paper's | 25/0.4 38/0.7 10/0.4 16/0.5
aachen | HLoc (SP+NN) | 86.5/93.7/96.8 70.4/86.7/94.9
aachen | ACE x 50 | 6.9/17.2/50.0 0.0/1.0/5.1
aachen | GLACE | 8.6/20.8/64.0 1.0/1.0/17.3
aachen | Random Lines, the paper's | 79.9/87.1/94.2 54.1/63.3/85.7
aachen | DCL, the paper's | 41.0/57.9/72.7 13.3/21.4/38.8
""".strip().splitlines()]  # fmt: skip
# The distance between the anchors (Table 6, for Aachen Table 8): scheme, then cell by data set.
ANCHORS = {
    "dcl:paper": {"7scenes": "5.14/1.41", "cambridge": "22.50/0.50", "aachen": "41.0/57.9/72.7 and 13.3/21.4/38.8"},
    "dcl:s=2": {"7scenes": "5.14/1.42", "cambridge": "27.75/0.73", "aachen": "34.1/53.2/71.5 and 14.3/20.4/37.8"},
    "dcl:s=3": {"7scenes": "6.66/1.37", "cambridge": "32.50/0.75", "aachen": "26.8/49.5/70.3 and 12.2/24.5/37.8"},
    "dcl:horizontal": {},
}


def digits(value: float, count: int) -> str:
    return f"{value:.{count}f}" if np.isfinite(value) else "-" if np.isnan(value) else "∞"


def medians(frame: pd.DataFrame) -> tuple[float, float]:
    """Centimetres (hundredths of the map unit) and degrees."""
    return 100 * frame.translation.median(), frame.rotation.median()


class Results:
    """The queries of a document, with `row` (scheme, and what else tells rows apart) and `column` (scene or condition)."""

    def __init__(self, document: dict):
        self.set = document["command"].split()[-1]
        if self.set not in SETS:
            sys.exit(f"this is a document of {document['command']!r}; tables need eval dataset or eval scene")
        known = [query for query in document["queries"] if query.get("has_ground_truth", True)]
        self.frame = queries(document)
        self.frame["sealed"] = [query.get("sealed_bytes") for query in known]
        self.frame["times"] = [query["ms"] for query in known]
        several = len({query["recipe"] for query in known}) > 1
        self.frame["row"] = [", ".join([q["scheme"], *([q["recipe"]] if several else [])])
                             for q in known]  # fmt: skip
        place = ", ".join(document["data"])
        self.frame["column"] = [q.get("condition") or q.get("scene") or place for q in known]
        scenes = {scene["name"]: scene["is_official"] for scene in document.get("scenes", [])}
        order = [name for name in scenes if name in set(self.frame.column)]
        self.columns = order or sorted(set(self.frame.column))
        self.official = [column for column in self.columns if scenes.get(column, len(scenes) == 1 and all(scenes.values()))]
        self.rows = list(dict.fromkeys(self.frame.row))

    def cell(self, row: str, column: str) -> pd.DataFrame:
        return self.frame[(self.frame.row == row) & (self.frame.column == column)]

    def table(self, figure) -> pd.DataFrame:
        """One figure of each row and column; empty where nothing was run."""
        cells = {column: [figure(part) if len(part := self.cell(row, column)) else "" for row in self.rows] for column in self.columns}
        return pd.DataFrame(cells, index=self.rows)


def errors(results: Results, published: bool, thresholds: list[str] | None) -> tuple[str, pd.DataFrame, list[str]]:
    source, meaning, own, scenes = SETS[results.set]
    thresholds, notes = thresholds or own, []

    def figure(part: pd.DataFrame) -> str:
        shares = [digits(100 * recall(part, text), 1) for text in thresholds]
        centimetres, degrees = medians(part)
        both = [digits(centimetres, 2), digits(degrees, 3)]
        return "/".join({"aachen": shares, "aachen-v1.1": shares, "cambridge": both}.get(results.set, both + shares[:1]))

    table = results.table(figure)
    counts = [len(results.cell(results.rows[0], column)) for column in results.columns]
    above = {"queries": [str(count) for count in counts]}
    shown = [column for column in results.official if column in scenes]
    if published and shown:
        for _, method, cells in (line for line in PUBLISHED if line[0] == results.set):
            of_scene = dict(zip(scenes, cells.split()))
            above[method] = [of_scene[column] if column in shown else "" for column in results.columns]
        notes.append(f"Published figures: the paper, {source}.")
    other = [column for column in results.columns if column not in results.official]
    if source and other:
        notes.append(f"Not the published data, so published figures are not shown: {', '.join(other)}.")
    at = "" if results.set == "cambridge" else " at " + ", ".join("{} m and {}°".format(*text.split("/")) for text in thresholds)
    head = pd.DataFrame.from_dict(above, orient="index", columns=results.columns)
    return f"{meaning[0].upper()}{meaning[1:]}{at}.", pd.concat([head, table]), notes


def intervals(results: Results, draws: int, seed: int) -> tuple[str, pd.DataFrame, list[str]]:
    def figure(part: pd.DataFrame) -> str:
        if len(part) < 2:
            return ""
        values, random = 100 * part.translation.to_numpy(), np.random.default_rng(seed)
        drawn = np.sort([np.median(random.choice(values, len(values))) for _ in range(draws)])
        return " to ".join(digits(drawn[min(int(share * draws), draws - 1)], 2) for share in (0.025, 0.975))

    return "95 % interval of the median position error (cm), queries drawn with replacement.", results.table(figure), []


def ablation(results: Results, published: bool) -> tuple[str, pd.DataFrame, list[str]] | None:
    """Means over the scenes for the schemes of the paper's ablations, and the queries with all keypoints on one side."""
    rows = [row for row in results.rows if row.split(", ")[0] in ANCHORS]
    if len(rows) < 2:
        return None
    paper = published and results.columns == results.official and len(results.columns) == len(SETS[results.set][3])
    lines = {}
    for row in rows:
        own = results.frame[results.frame.row == row]
        centimetres, degrees = np.mean([medians(part) for _, part in own.groupby("column")], axis=0)
        line = {"mean of medians, cm/°": f"{digits(centimetres, 2)}/{digits(degrees, 3)}", "one-sided queries": str((own.sealed == 0).sum()),
                "of": str(len(own))}  # fmt: skip
        lines[row] = line | ({"the paper": ANCHORS[row.split(", ")[0]].get(results.set, "")} if paper else {})
    return "Distance between the anchors (H, 2H, 3H) and direction of the partition: mean over the scenes.", pd.DataFrame.from_dict(lines, orient="index"), []


def inversion(document: dict, data_set: str, published: bool) -> tuple[str, pd.DataFrame, list[str]]:
    """Tables 2 and 7: images reconstructed from what the closed form recovers with true neighbours, a column for each scheme."""
    if document["command"] != "eval inversion":
        sys.exit(f"this is a document of {document['command']!r}; --inversion needs eval inversion")
    attacked = {row["scheme"]: row for row in document["summary"] if row["attack"] in ("none", "closed-form")}
    objects = lambda row: "" if row["objects"] is None else f"{row['objects_found']} of {row['objects']}"
    metrics = {"e_recon (px)": lambda row: row["mean_px"] and digits(row["mean_px"], 1), "PSNR (dB)": lambda row: digits(row["psnr"], 2),
               "SSIM": lambda row: digits(row["ssim"], 3), "ST-LPIPS": lambda row: row["st_lpips"] and digits(row["st_lpips"], 3),
               "objects found again": objects}  # fmt: skip
    own = {scheme: {metric: of(row) or "" for metric, of in metrics.items()} for scheme, row in attacked.items()}
    own |= {"no descriptor": own.pop("none")} if "none" in own else {}
    own.pop("unordered", None)
    table, notes = pd.DataFrame(own), []
    if published and len(paper := pd.read_csv(PUBLISHED_INVERSION, dtype=str, keep_default_na=False).query("`data set` == @data_set")):
        for (number, features, network), rows in paper.groupby(["table", "features", "network"]):
            cells = rows.set_index("scheme").iloc[:, -4:].T
            cells.index = [f"the paper, {features}, {network}: {metric}" for metric in cells.index]
            table = pd.concat([table, cells[(cells != "").any(axis=1)]])
            notes.append(f"{features}, {network}: the paper's Table {number}, of its own images; LPIPS and ST-LPIPS do not compare.")
    title = f"Images reconstructed from points that the closed form recovers with {document['k']} true neighbours (mean of {document['images']} images)."
    return title, table.fillna(""), notes


def adversaries(document: dict) -> tuple[str, pd.DataFrame, list[str]]:
    """What each adversary recovers from the queries of each scene by its best attack."""
    if document["command"] != "eval adversaries":
        sys.exit(f"this is a document of {document['command']!r}; --attacks needs eval adversaries, or --attack-json of eval dataset")
    cells: dict[str, dict[str, str]] = {}
    for row in document["rows"]:
        error = f"{digits(row['median_px'], 1)} ({row['bits_over_prior']:+.2f})" if row.get("median_px") is not None else ""
        cells.setdefault(f"{row['data']}, {row['scheme']}", {})[row["adversary"]] = error
    return "Median error in pixels, and gain over the prior in bits, of each adversary's best attack.", pd.DataFrame(cells).T.fillna(""), []


def times(results: Results) -> tuple[str, pd.DataFrame, list[str]]:
    stages = pd.DataFrame(list(results.frame.times)).groupby(results.frame.row.to_numpy(), sort=False).median().reindex(columns=STAGES)
    cells = stages.apply(lambda column: column.map(lambda x: "" if np.isnan(x) else digits(x, 1)))
    return "Median time of each stage of a query (ms).", cells, []


def markdown(title: str, table: pd.DataFrame, notes: list[str]) -> str:
    line = lambda cells: "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"
    lines = [title, "", line(["method", *table.columns]), "|" + "---|" * (1 + len(table.columns)), *(line(row) for row in table.itertuples())]
    return "\n".join([*lines, *(f"\n{note}" for note in notes), ""])


def latex(title: str, table: pd.DataFrame, notes: list[str]) -> str:
    """A `tabular` with the rules of `booktabs`."""
    special = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "°": r"$^\circ$", "∞": r"$\infty$"}
    special |= {character: "\\" + character for character in "&%$#_{}"}
    line = lambda cells: " & ".join("".join(special.get(c, c) for c in str(cell)) for cell in cells) + r" \\"
    body = [line(["method", *table.columns]), r"\midrule", *(line(row) for row in table.itertuples())]
    return "\n".join([f"% {title}", rf"\begin{{tabular}}{{l{'c' * len(table.columns)}}}", r"\toprule", *body, r"\bottomrule", r"\end{tabular}",
                      *(f"% {note}" for note in notes), ""])  # fmt: skip


def text(title: str, table: pd.DataFrame, notes: list[str]) -> str:
    return "\n".join([title, table.to_string(), *notes, ""])


def plot(results: Results, folder: Path) -> None:
    """position.svg and orientation.svg: share of queries within a bound, a panel per scene; times.svg: stages, a bar per row."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    folder.mkdir(parents=True, exist_ok=True)
    for name, column, label in [("position", "translation", "position error, map units"), ("orientation", "rotation", "error, degrees")]:
        figure, panels = pyplot.subplots(1, len(results.columns), figsize=(4 * len(results.columns), 3.5), squeeze=False, sharey=True)
        for panel, scene in zip(panels[0], results.columns):
            for row in results.rows:
                values = np.sort(results.cell(row, scene)[column])
                shares = 100 * np.arange(1, len(values) + 1) / max(len(values), 1)
                panel.step(values[np.isfinite(values)], shares[np.isfinite(values)], where="post", label=row)
            panel.set(title=scene, xlabel=label, ylabel="share within, %", xscale="log", ylim=(0, 100))
        panels[0][0].legend()
        figure.savefig(folder / f"{name}.svg", bbox_inches="tight")
        pyplot.close(figure)
    stages = pd.DataFrame(list(results.frame.times)).groupby(results.frame.row.to_numpy(), sort=False).median()
    axes = stages[[stage for stage in STAGES if stage in stages]].plot.barh(stacked=True, xlabel="ms, median of each stage")
    axes.figure.savefig(folder / "times.svg", bbox_inches="tight")
    pyplot.close(axes.figure)


def tables(document: dict, form=text, published: bool = True, thresholds: list[str] | None = None, draws: int = 2000, seed: int = 0,
           inverted: dict | None = None, attacked: dict | None = None) -> str:  # fmt: skip
    """Errors, intervals, the ablation if its schemes were run, times, and privacy if its documents are given."""
    results = Results(document)
    sheets = [errors(results, published, thresholds), intervals(results, draws, seed), ablation(results, published), times(results),
              inverted and inversion(inverted, results.set, published), attacked and adversaries(attacked)]  # fmt: skip
    return "\n".join(form(*sheet) for sheet in sheets if sheet)


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="study paper", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", metavar="RESULTS.json")
    parser.add_argument("--inversion", type=Path, metavar="FILE", help="document of eval inversion, for the tables of images")
    parser.add_argument("--attacks", type=Path, metavar="FILE", help="document of eval adversaries or --attack-json, for a table of attacks")
    forms = parser.add_mutually_exclusive_group()
    forms.add_argument("--markdown", dest="form", action="store_const", const=markdown, default=text)
    forms.add_argument("--latex", dest="form", action="store_const", const=latex)
    parser.add_argument("--thresholds", type=lambda x: x.split(","), metavar="T/DEG,…", help="default: the paper's for the data set")
    parser.add_argument("--no-published", dest="published", action="store_false", help="leave published figures out")
    parser.add_argument("--bootstrap-samples", type=int, default=2000, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plot", type=Path, metavar="DIR", help="write position.svg, orientation.svg and times.svg")
    args = parser.parse_args(arguments)
    document = read(args.results)
    privacy = [json.loads(path.read_text()) if path else None for path in (args.inversion, args.attacks)]
    print(tables(document, args.form, args.published, args.thresholds, args.bootstrap_samples, args.seed, *privacy))
    if args.plot:
        plot(Results(document), args.plot)


if __name__ == "__main__":
    main()
