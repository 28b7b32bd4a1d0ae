#!/usr/bin/env python3
"""How what an outsider learns grows with the images he has: trainings, attacks, a power law and its plot.

    scripts/learning_law.py --veiloc BIN --train KEYPOINTS --validate KEYPOINTS --test KEYPOINTS… --out FOLDER

Each file of --test is a place, named after the file. Subsets are nested, by a hash of the images' names. For each of
--images and each network of --networks it trains what --kinds names: `neighbours`, and `positions` for each scheme of
--schemes, one at a time. What is done is not done again, and what was interrupted goes on: stop it and start it as you like, --minutes says
when it stops by itself. Whatever there is of results is fitted and drawn each time: FOLDER/law.json, FOLDER/law.svg and
FOLDER/positions.svg.

The law of neighbours is p = a nᵇ, least squares of the logarithms over the best network of each number of images; that
of positions is bits = a + b log2 n, because bits may be none. Intervals are a bootstrap: images of a place and points of
the curve are both drawn with replacement. How many images it takes to the precision at which the graph attack begins to
work, or to one bit told about every position, is an extrapolation of that law and nothing more.
"""

import argparse
import gzip
import hashlib
import json
import math
import random
import subprocess
import sys
import time
from pathlib import Path

NEEDED = 0.60
"""Precision at 20 from which the graph attack works (docs/audit.md)."""
ENOUGH = 1.0
"""Bits told about a position that halve the error along its line."""
DRAWS = 2000
FOREVER = 30
"""Beyond ten to this power of images nobody can tell it from never."""
COLORS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7"]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", required=True, help="the program")
    parser.add_argument("--train", required=True, type=Path, help="keypoints of all images")
    parser.add_argument("--validate", required=True, type=Path)
    parser.add_argument("--test", required=True, type=Path, nargs="+")
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--images", default="50,100,200,400,800,1555", help="numbers of images; more than there are: all")
    parser.add_argument("--networks", default="64x2,128x4", help="WIDTHxLAYERS, several")
    parser.add_argument("--kinds", default="neighbours,positions", help="of networks")
    parser.add_argument("--schemes", default="dcl,random-lines", help="of the networks of positions")
    parser.add_argument("--mirror", action="store_true", help="networks of positions see half of their images mirrored (SIFT alone)")
    parser.add_argument("--validation-images", type=int, help="judge steps of networks of positions by so many")
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--rate", type=float, default=0.002)
    parser.add_argument("--keypoints", type=int, default=512)
    parser.add_argument("--every", type=int, default=250)
    parser.add_argument("--attacked", type=int, default=4, help="images of a place that attacks by predicted neighbours are run on; 0 for none yet")
    parser.add_argument("--minutes", type=float, default=math.inf, help="stop after so many, to go on later")
    return parser.parse_args()


def subsets(args, counts):
    """A file of keypoints for each number of images; the fewer are among the more."""
    paths = {n: args.out / f"train{n}.jsonl.gz" for n in counts}
    missing = [n for n in counts if not paths[n].exists()]
    if missing:
        rows = []
        with gzip.open(args.train) as lines:
            for line in lines:
                name = json.loads(line)["name"]
                rows.append((hashlib.sha256(name.encode()).hexdigest(), line))
        rows.sort()
        for n in missing:
            part = paths[n].with_suffix(".new")
            with gzip.open(part, "wb", 1) as file:
                file.writelines(line for _, line in rows[:n])
            part.rename(paths[n])
    return paths


def run(command, log):
    """Runs veiloc; its talk goes to a log."""
    with open(log, "a") as talk:
        talk.write("$ " + " ".join(map(str, command)) + "\n")
        talk.flush()
        if subprocess.run(list(map(str, command)), stdout=talk, stderr=talk).returncode:
            sys.exit(f"veiloc failed, see {log}")


def trained(args, kind, train, name, network, left):
    """The document of a training, done as far as time allows; None when it is not finished."""
    out, document = args.out / f"{name}.net", args.out / f"{name}.json"
    if document.exists():
        found = json.loads(document.read_text())
        if found["steps_done"] == args.steps:
            return found
    if left() <= 0:
        return None
    width, layers = network.split("x")
    command = [args.veiloc, "train", *kind, "--train", train, "--validate", args.validate, "--test", *args.test]
    command += ["-o", out, "--resume", "--steps", args.steps, "--every", args.every, "--keypoints", args.keypoints]
    command += ["--rate", args.rate, "--width", width, "--layers", layers, "--json", document]
    if left() < math.inf:
        command += ["--minutes", f"{left():.2f}"]
    run(command, args.out / f"{name}.log")
    found = json.loads(document.read_text())
    return found if found["steps_done"] == args.steps else None


def attacked(args, place, name, left):
    """What attacks get from the neighbours that a network predicts."""
    document = args.out / f"{name}-{label(place)}-attack.json"
    if not document.exists():
        if left() <= 0 or not args.attacked:
            return None
        command = [args.veiloc, "attack", place, "--schemes", "random-lines,dcl", "--images", args.attacked]
        command += ["--attacks", "closed-form-consensus,graph,graph-near-angles", "--neighbours", "network"]
        command += ["--model", args.out / f"{name}.net", "--json", document.with_suffix(".new")]
        run(command, args.out / f"{name}.log")
        document.with_suffix(".new").rename(document)
    return json.loads(document.read_text())


def label(path):
    return path.name.split(".")[0]


def collect(args):
    """Every training and attack there is time for, the smallest sets first."""
    started = time.monotonic()
    left = lambda: args.minutes - (time.monotonic() - started) / 60
    counts = [int(n) for n in args.images.split(",")]
    files = subsets(args, counts)
    points = []
    for n in counts:
        for network in args.networks.split(","):
            kinds = args.kinds.split(",")
            name = f"neighbours-{network}-{n}"
            found = "neighbours" in kinds and trained(args, ["neighbours"], files[n], name, network, left)
            if found:
                attacks = {label(place): attacked(args, place, name, left) for place in args.test}
                points.append({"what": "neighbours", "network": network, "found": found, "attacks": attacks})
            for scheme in args.schemes.split(",") if "positions" in kinds else []:
                name = f"positions-{scheme.replace(':', '_').replace('/', '_')}-{network}-{n}"
                words = ["positions", "--scheme", scheme] + ["--mirror"] * args.mirror
                if args.validation_images:
                    words += ["--validation-images", args.validation_images]
                found = trained(args, words, files[n], name, network, left)
                if found:
                    points.append({"what": "positions", "network": network, "scheme": scheme, "found": found})
    return points


def line(x, y):
    """`a` and `b` of `a + b x`."""
    mx, my = sum(x) / len(x), sum(y) / len(y)
    spread = sum((a - mx) ** 2 for a in x)
    slope = sum((a - mx) * (b - my) for a, b in zip(x, y)) / spread
    return my - slope * mx, slope


def power(counts, values):
    """`a` and `b` of `a nᵇ`; none where a value is not above zero."""
    if min(values) <= 0:
        return None
    a, b = line([math.log(n) for n in counts], [math.log(v) for v in values])
    return math.exp(a), b


def growth(counts, values):
    """`a` and `b` of `a + b log2 n`."""
    return line([math.log2(n) for n in counts], values)


def images_to_precision(a, b):
    """Images at which the power law comes to what the graph attack needs."""
    return 10 ** exponent if b > 0 and (exponent := math.log10(NEEDED / a) / b) < FOREVER else math.inf


def images_to_bits(a, b):
    """Images at which growth comes to a bit."""
    return 10 ** exponent if b > 0 and (exponent := (ENOUGH - a) / b * math.log10(2)) < FOREVER else math.inf


def law(curve, fit, needed, seed=0):
    """The law of `{images: [value of each image judged]}`, with the 5 % and 95 % quantiles of a bootstrap."""
    if fit is power:
        curve = {n: v for n, v in curve.items() if sum(v) > 0}
    if len(curve) < 3:
        return None
    mean = lambda values: sum(values) / len(values)
    a, b = fit(list(curve), [mean(v) for v in curve.values()])
    rng, slopes, images = random.Random(seed), [], []
    judged = len(next(iter(curve.values())))
    for _ in range(DRAWS):
        who = [rng.randrange(judged) for _ in range(judged)]
        points = [rng.choice(list(curve)) for _ in curve]
        values = [mean([curve[n][i] for i in who]) for n in points]
        drawn = fit(points, values) if len(set(points)) >= 3 else None
        if drawn is None:
            continue
        slopes.append(drawn[1])
        images.append(needed(*drawn))
    quantile = lambda values, q: sorted(values)[int(q * (len(values) - 1))]
    between = lambda values: [quantile(values, 0.05), quantile(values, 0.95)]
    return {"a": a, "b": b, "b_interval": between(slopes), "needed": needed(a, b), "needed_interval": between(images)}


def judged(found, place, index):
    """The values of the images of one place, which come one after another in the order of the files."""
    return found["by_image"][index[place] : index[place] + index["count " + place]]


def summarize(args, points):
    places = [label(place) for place in args.test]
    index, at = {}, 0
    for path, place in zip(args.test, places):
        with gzip.open(path) as lines:
            index[place], index["count " + place] = at, sum(1 for line in lines if line.strip())
        at += index["count " + place]
    rows, curves, told_curves = [], {}, {}
    for point in points:
        found = point["found"]
        n = found["images"][0]
        if point["what"] == "neighbours":
            for precision in (p for p in found["precision"] if p["part"] == "test"):
                for place in places:
                    values = judged(precision, place, index)
                    series = curves.setdefault((precision["predictor"], place), {})
                    if sum(values) > sum(series.get(n, [0])):
                        series[n] = values
                rows.append({"images": n, "network": point["network"], **{k: precision[k] for k in ("predictor", "at_5", "at_10", "at_20", "chance")}})
            for place, attacks in point["attacks"].items():
                for attack in attacks["attacks"] if attacks else []:
                    row = {"images": n, "network": point["network"], "place": place, "precision": attacks["precision"]}
                    rows.append({**row, **{k: attack[k] for k in ("scheme", "attack", "median_px", "under_30px", "bits_over_prior")}})
        else:
            for told in (t for t in found["told"] if t["part"] == "test"):
                row = {"images": n, "network": point["network"], "scheme": point["scheme"], "place": told["data"]}
                keys = ("information_bits", "bits_over_prior", "median_px", "guess_median_px", "under_30px")
                rows.append({**row, **{k: told[k] for k in keys}})
                if told["data"] != "all":
                    series = told_curves.setdefault((point["scheme"], point["network"], label(Path(told["data"]))), {})
                    series[n] = told["by_image"]
    laws = [
        {"predictor": who, "place": place, **found}
        for (who, place), c in curves.items()
        if (found := law(c, power, images_to_precision))
    ]
    laws += [
        {"scheme": scheme, "network": network, "place": place, **found}
        for (scheme, network, place), c in told_curves.items()
        if (found := law(c, growth, images_to_bits))
    ]
    mean_curves = [
        {"predictor": who, "place": place, "points": [[n, sum(v) / len(v)] for n, v in sorted(c.items())]}
        for (who, place), c in curves.items()
    ]
    return {"version": 1, "rows": rows, "curves": mean_curves, "laws": laws}


PANEL, LEFT, TOP, BOTTOM = 300, 46, 34, 48
"""Of the plots: width of a panel, and its margins, pixels."""
DASHES = ("5 3", "", "1 2")
"""Of the networks, the smallest first."""


class Plot:
    """Panels side by side over the number of images, on a logarithmic axis, with a legend at the right."""

    def __init__(self, panels, legend, height, most_images, least, most, ticks):
        self.width, self.height, self.panels = panels * PANEL + legend, height, panels
        self.span = (math.log(40), math.log(most_images * 1.3))
        self.least, self.most, self.ticks = least, most, ticks
        self.svg = [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{self.width}" height="{height}" font-family="sans-serif" font-size="12">',
            f'<rect width="{self.width}" height="{height}" fill="white"/>',
        ]

    def at(self, panel, images, value):
        along = (math.log(images) - self.span[0]) / (self.span[1] - self.span[0])
        up = (value - self.least) / (self.most - self.least)
        return panel * PANEL + LEFT + along * (PANEL - LEFT - 12), self.height - BOTTOM - up * (self.height - TOP - BOTTOM)

    def axes(self, panel, title):
        """Lines of the ticks, each (value, text, whether it is drawn stronger)."""
        low, left, right = self.height - BOTTOM, panel * PANEL + LEFT, (panel + 1) * PANEL - 12
        self.svg.append(f'<text x="{left}" y="20" font-weight="bold">{title}</text>')
        for n in (50, 100, 200, 400, 800, 1600):
            if self.span[0] <= math.log(n) <= self.span[1]:
                x, _ = self.at(panel, n, self.least)
                self.svg.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{low}" stroke="#ddd"/>')
                self.svg.append(f'<text x="{x:.1f}" y="{low + 16}" text-anchor="middle">{n}</text>')
        for value, text, strong in self.ticks:
            _, y = self.at(panel, 50, value)
            color = "#999" if strong else "#ddd"
            self.svg.append(f'<line x1="{left}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}" stroke="{color}"/>')
            self.svg.append(f'<text x="{left - 5}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')

    def curve(self, panel, found, color, dash, dots=True, width=2):
        """A curve through (images, value)."""
        where = [self.at(panel, n, v) for n, v in sorted(found)]
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in where)
        self.svg.append(f'<polyline points="{points}" fill="none" stroke="{color}" stroke-width="{width}" stroke-dasharray="{dash}"/>')
        if dots:
            self.svg += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{color}"/>' for x, y in where]

    def write(self, entries, caption, path):
        """With the legend's entries (name, color, dash)."""
        x = self.panels * PANEL
        for i, (name, color, dash) in enumerate(entries):
            y = TOP + 14 + 18 * i
            self.svg.append(f'<line x1="{x}" x2="{x + 26}" y1="{y - 4}" y2="{y - 4}" stroke="{color}" stroke-width="2" stroke-dasharray="{dash}"/>')
            self.svg.append(f'<text x="{x + 32}" y="{y}">{name}</text>')
        self.svg.append(f'<text x="{LEFT}" y="{self.height - 12}">{caption}</text></svg>')
        path.write_text("\n".join(self.svg))


def by_width(rows):
    """The networks of the rows, the smallest first."""
    return sorted({r["network"] for r in rows}, key=lambda n: int(n.split("x")[0]))


def plot(summary, path):
    """Precision at 5, 10 and 20 against images: by descriptors alone, and with angles."""
    rows = [r for r in summary["rows"] if "at_20" in r]
    if not rows:
        return
    networks = by_width(rows)
    ticks = [(v / 100, f"{v} %", v == 100 * NEEDED) for v in range(0, 71, 10)]
    drawn = Plot(2, 150, 380, max(60, *(r["images"] for r in rows)), 0, 0.75, ticks)
    for panel, (title, who, plain) in enumerate((
        ("descriptors alone", "network", "statistic"),
        ("narrowed by angles (dcl)", "network, angles", "statistic, angles"),
    )):
        drawn.axes(panel, title)
        for network, dash in zip(networks, DASHES):
            for key, color in zip(("at_5", "at_10", "at_20"), COLORS):
                found = [(r["images"], r[key]) for r in rows if r["network"] == network and r["predictor"] == who]
                drawn.curve(panel, found, color, dash)
        found = {(r["images"], r["at_20"]) for r in rows if r["predictor"] == plain}
        drawn.curve(panel, found, "#555", "2 3", dots=False, width=1.5)
    entries = [(f"at {k}, {n}", c, d) for n, d in zip(networks, DASHES) for k, c in zip((5, 10, 20), COLORS)]
    caption = "images learned from; share of the neighbours named that are true, on places not learned from"
    drawn.write([*entries, ("at 20, statistic", "#555", "2 3")], caption, path)


def plot_positions(summary, path):
    """Bits told about positions against images, a panel for each place."""
    rows = [r for r in summary["rows"] if "information_bits" in r and r["place"] != "all"]
    if not rows:
        return
    places, schemes = sorted({label(Path(r["place"])) for r in rows}), sorted({r["scheme"] for r in rows})
    networks = by_width(rows)
    least = min(0, *(r["information_bits"] for r in rows))
    most = max(0.2, *(r["information_bits"] for r in rows))
    ticks = [(t / 10, f"{t / 10:.1f}", t == 0) for t in range(math.ceil(least * 10), math.floor(most * 10) + 1)]
    drawn = Plot(len(places), 170, 320, max(r["images"] for r in rows), least, most, ticks)
    for panel, place in enumerate(places):
        drawn.axes(panel, place)
        for scheme, color in zip(schemes, COLORS):
            for network, dash in zip(networks, DASHES):
                mine = lambda r: (r["scheme"], r["network"], label(Path(r["place"]))) == (scheme, network, place)
                drawn.curve(panel, [(r["images"], r["information_bits"]) for r in rows if mine(r)], color, dash)
    entries = [(f"{s}, {n}", c, d) for s, c in zip(schemes, COLORS) for n, d in zip(networks, DASHES)]
    drawn.write(entries, "images learned from; bits told about a position beyond its line", path)


def show(summary):
    for row in summary["rows"]:
        print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()))
    for found in summary["laws"]:
        low, high = found["b_interval"]
        few, many = found["needed_interval"]
        if "scheme" in found:
            print(
                f'{found["scheme"]}, {found["network"]}, {found["place"]}: bits = {found["a"]:+.4f} {found["b"]:+.4f} log2 n '
                f"({low:+.4f} to {high:+.4f}); {ENOUGH:.0f} bit at {found['needed']:.2g} images ({few:.2g} to {many:.2g})"
            )
            continue
        print(
            f'{found["predictor"]}, {found["place"]}: precision at 20 = {found["a"]:.4f} n^{found["b"]:.3f} '
            f"({low:.3f} to {high:.3f}); {100 * NEEDED:.0f} % at {found['needed']:.2g} images ({few:.2g} to {many:.2g})"
        )


def main():
    args = arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    summary = summarize(args, collect(args))
    (args.out / "law.json").write_text(json.dumps(summary, indent=1))
    plot(summary, args.out / "law.svg")
    plot_positions(summary, args.out / "positions.svg")
    show(summary)


if __name__ == "__main__":
    main()
