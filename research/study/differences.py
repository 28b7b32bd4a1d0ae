"""Tables of docs/results/privacy.md: where the figures of the paper's attack (Eq. 3) differ from the paper's, and why."""

import gzip
import json
import statistics

from study.common import RESULTS, Package, command, read_csv

PAGE = "privacy"
np, spatial = Package("numpy"), Package("scipy.spatial")
WIDTH, HEIGHT, NEAR_PX, K = 640, 480, 30, 20
#: Gain of an attack over the prior that is called vulnerable, and the time of a frame of 30 a second.
VULNERABLE_BITS, FRAME_MS = 0.5, 33
PLACES = {"RedKitchen": "redkitchen", "Herz-Jesu": "herzjesu"}


def neighbours(keypoints, k):
    return spatial.cKDTree(keypoints).query(keypoints, k + 1)[1][:, 1:]


def minimum(slopes, offsets):
    """Where the sum of `(slope t + offset)²` is least. `[K]` each."""
    square = (slopes**2).sum()
    return -(slopes * offsets).sum() / square if square > 1e-18 else 0.0


def choices(slopes, offsets, starts):
    """The least sum of the smaller of two squared distances, `[2, K]`, from these starts: the nearer line of each neighbour, then the minimum,
    until nothing changes."""
    found = []
    for t in starts:
        for _ in range(20):
            nearer = np.abs(slopes * t + offsets).argmin(axis=0)[None]
            moved = minimum(*(np.take_along_axis(x, nearer, 0)[0] for x in (slopes, offsets)))
            if abs(moved - t) < 1e-9:
                break
            t = moved
        found.append(((np.abs(slopes * t + offsets).min(axis=0) ** 2).sum(), t))
    return min(found)


def recovered(candidates, near, index, is_global):
    """The answer for a keypoint whose line is one of the candidates, `(through, direction)` each."""
    answers = []
    for through, direction in candidates:
        origin, along = through[index], direction[index]
        normals = [np.c_[-d[near, 1], d[near, 0]] for _, d in candidates]
        slopes = np.array([n @ along for n in normals])
        offsets = np.array([((origin - p[near]) * n).sum(axis=1) for (p, _), n in zip(candidates, normals)])
        if len(candidates) == 1:
            return origin + minimum(slopes[0], offsets[0]) * along
        crossings = -offsets[np.abs(slopes) > 1e-9] / slopes[np.abs(slopes) > 1e-9]
        cost, t = choices(slopes, offsets, crossings if is_global else [np.median(crossings)])
        answers.append((cost, *(origin + t * along)))
    return np.array(min(answers)[1:])


def permuted(keypoints, draw):
    """Pairs of keypoints with one coordinate exchanged."""
    sent, order = keypoints.copy(), draw.permutation(len(keypoints))
    for a, b in zip(order[::2], order[1::2]):
        axis = draw.integers(2)
        sent[a, axis], sent[b, axis] = sent[b, axis], sent[a, axis]
    return sent


@command("privacy/permutation.csv", images=2, keypoints=["2048", "1024", "512"], every=5)
def permutation(run):
    """Coordinate permutation under the paper's attack, with the best choice of each neighbour's line, and with one found from a start."""
    table = run.table("privacy/permutation.csv", "images", "keypoints", "random lines, mean (px)", "permutation, global minimum (px)", "over lines",
                      "permutation, minimum from one start (px)", "over lines, one start")  # fmt: skip
    for name, place in PLACES.items():
        with gzip.open(run.place("problems") / f"{place}_keypoints.jsonl.gz", "rt") as lines:
            images = [json.loads(next(lines)) for _ in range(run.images)]
        for most in map(int, run.keypoints):
            errors, draw = [[], [], []], np.random.default_rng(0)
            for image in images:
                keypoints = np.unique(np.array(image["keypoints"])[:most], axis=0)
                near, angles, sent = neighbours(keypoints, K), draw.uniform(0, np.pi, len(keypoints)), permuted(keypoints, draw)
                random = [(keypoints, np.c_[np.cos(angles), np.sin(angles)])]
                axes = [(sent, np.tile(direction, (len(sent), 1))) for direction in ([0.0, 1.0], [1.0, 0.0])]
                for own, candidates, is_global in zip(errors, (random, axes, axes), (True, True, False)):
                    own += [np.linalg.norm(recovered(candidates, near[i], i, is_global) - keypoints[i]) for i in range(0, len(keypoints), run.every)]
            lines, best, local = (float(np.mean(own)) for own in errors)
            table.add([name, most, f"{lines:.1f}", f"{best:.1f}", f"{best / lines:.2f}", f"{local:.1f}", f"{local / lines:.2f}"])


@command("privacy/uniform.csv", keypoints=1500, seeds=20, k=["5", "10", "20", "50", "100"])
def uniform(run):
    """The paper's Fig. 4: how many of 1500 uniform keypoints the paper's attack on `dcl:paper` recovers to 30 pixels."""
    table = run.table("privacy/uniform.csv", "true neighbours", f"under {NEAR_PX} px, mean of {run.seeds} seeds", "standard deviation",
                      f"of these within {NEAR_PX} px of their anchor")  # fmt: skip
    for k in map(int, run.k):
        counts = [recovered_of_scene(np.random.default_rng(seed), run.keypoints, k) for seed in range(run.seeds)]
        all_near, at_anchor = zip(*counts)
        table.add([k, f"{statistics.mean(all_near):.1f}", f"{statistics.stdev(all_near):.1f}", f"{statistics.mean(at_anchor):.1f}"])


def recovered_of_scene(draw, count, k):
    """Keypoints with an error below 30 px, and those of them that lie as near to their anchor."""
    keypoints = draw.uniform(0, 1, (count, 2)) * [WIDTH, HEIGHT]
    is_first = keypoints[:, :1] < WIDTH / 2
    anchors = np.where(is_first, [WIDTH / 2, 0.0], [WIDTH / 2, HEIGHT])
    directions = keypoints - anchors
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    near, normals = neighbours(keypoints, k), np.c_[-directions[:, 1], directions[:, 0]]
    slopes = np.einsum("nkc,nc->nk", normals[near], directions)
    offsets = np.einsum("nkc,nkc->nk", normals[near], anchors[:, None] - anchors[near])
    t = np.divide(-(slopes * offsets).sum(axis=1), (slopes**2).sum(axis=1), where=(slopes**2).sum(axis=1) > 1e-18, out=np.zeros(count))
    is_found = np.linalg.norm(anchors + t[:, None] * directions - keypoints, axis=1) < NEAR_PX
    return int(is_found.sum()), int((is_found & (np.linalg.norm(keypoints - anchors, axis=1) < NEAR_PX)).sum())


@command("privacy/comparison.csv")
def comparison(run):
    """The paper's Table 1 as measured here: what each scheme hides, needs and costs, from other tables of docs/results."""
    table = run.table("privacy/comparison.csv", "sent", "vulnerable to who has only the query", "bits, RedKitchen; Herz-Jesu", "true neighbours, median (px)",
                      "retrieval from what is sent", "within 25 cm and 2°, seven places (%)", "pose (ms)", "real time")  # fmt: skip
    attacked, places = read_csv(RESULTS / "privacy/schemes.csv"), read_csv(RESULTS / "places/places.csv")
    times = {row["pipeline"]: row["pose, median (ms)"] for row in read_csv(RESULTS / "poses/time.csv") if row["matches of"] == "redkitchen_nn"}
    means = {row["layout"]: row["statistic"].split(", ")[-1] for row in read_csv(RESULTS / "privacy/layout-private-means.csv")}
    for scheme, of_place in {"points": "points", "random-lines": "random-lines", "coordinate-permutation": "", "dcl:paper": "paper", "dcl": "dcl"}.items():
        best = [max((float(row[f"{place}: bits"]) for row in attacked if row["scheme"] == scheme and row["adversary"].startswith("query-only")), default=None)
                for place in PLACES]  # fmt: skip
        bits = "positions are sent" if scheme == "points" else f"{best[0]:.2f}; {best[1]:.2f}" if best[0] is not None else f"{means['slanted strips']} (mean of places)"
        most = 9.0 if scheme == "points" else max(best) if best[0] is not None else float(means["slanted strips"])
        oracle = next((row["RedKitchen: median (px)"] for row in attacked if (row["scheme"], row["adversary"]) == (scheme, "true-neighbours")), "")
        rows = [(int(row["queries"]), float(row["within 25 cm and 2° (%)"])) for row in places if row["scheme"] == of_place]
        recall = f"{sum(n * share for n, share in rows) / sum(n for n, _ in rows):.0f}" if rows else ""
        ms = times.get(f"veiloc, {scheme}", "")
        table.add([scheme, "yes" if most > VULNERABLE_BITS else "no", bits, oracle, "yes", recall, ms, "yes" if ms and float(ms) < FRAME_MS else ""])


@command("privacy/random-anchors.csv", images=2, attacks="closed-form,closed-form-informed,graph")
def random_anchors(run):
    """An assignment of anchors at random, as in ray clouds, beside the paper's halves and random lines, with 20 true neighbours."""
    table = run.table("privacy/random-anchors.csv", "images", "scheme", "attack", "prior (px)", "mean (px)", "median (px)", "< 10 px (%)", "bits")
    for name, place in PLACES.items():
        keypoints = run.place("problems") / f"{place}_keypoints.jsonl.gz"
        found = run.document("attack", keypoints, "--limit", run.images, "--attacks", f"prior,{run.attacks}", "--schemes",
                             "random-lines,dcl:random,dcl:paper,dcl")  # fmt: skip
        prior = {row["scheme"]: row["median_px"] for row in found["attacks"] if row["attack"] == "prior"}
        for row in found["attacks"]:
            if row["attack"] != "prior":
                table.add([name, row["scheme"], row["attack"], f"{prior[row['scheme']]:.0f}", f"{row['mean_px']:.1f}", f"{row['median_px']:.1f}",
                           f"{100 * row['under_10px']:.1f}", f"{row['bits_over_prior']:.2f}"])  # fmt: skip
