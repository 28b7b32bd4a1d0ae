"""Tables of docs/results/poses.md: the paper's estimator on learned features, and when it finds the pose."""

import json
import statistics

from study.common import CELLS, MODEL_FILES, PLACES, RIGHT, Package, command, number, percent
from study.geometry import angle, center, rotation

PAGE = "poses"
np, poselib = Package("numpy"), Package("poselib")

SCHEMES = ["points", "random-lines", "dcl:paper", "dcl"]
THRESHOLDS = f"0.05/5,{RIGHT}"
# What the paper reports: images, share within 5 cm and 5° (%), median error, time of the pose (ms). Tables 2 and 4, and its text.
PUBLISHED = [("7Scenes, six scenes", "80 to 97", "0.010 to 0.021", 4), ("7Scenes, stairs", "13", "0.263", 4),
             ("Cambridge, four scenes", "", "0.10 to 0.38", 6)]  # fmt: skip


def recipes(run) -> str:
    """The paper's estimator with PoseLib's least number of hypotheses, and the default of veiloc."""
    return f"{run.estimators('paper', hypotheses=1000)},default"


@command("poses/learned-recipe.csv", needs=MODEL_FILES, places=PLACES, features=["sift", "xfeat", "alike-t", "aliked-t16"], schemes=SCHEMES)
def learned_recipe(run):
    """The paper's estimator and ours on learned features, in every place; one thread."""
    table = run.table("poses/learned-recipe.csv", "place", "features", "scheme", "estimator", "queries", "localized",
                      "within 5 cm and 5° (%)", "within 25 cm and 2° (%)", "median error (map units)", "inliers (%)", "pose (ms)")  # fmt: skip
    for place, share, error, ms in PUBLISHED:
        table.add([place, "superpoint", "dcl:paper", "as published", "", "", share, "", error, "", ms])
    for place in run.places:
        for features in run.features:
            found = run.document("eval", "scene", *run.scene(place), "--features", features, "--schemes", ",".join(run.schemes),
                                 "--thresholds", THRESHOLDS, "--estimator", recipes(run))  # fmt: skip
            for row in found["schemes"]:
                own = [q["ms"]["pose"] for q in found["queries"] if (q["scheme"], q["recipe"]) == (row["scheme"], row["recipe"]) and "pose" in q["ms"]]
                cells = {"place": place, "features": features, "estimator": {"default": "veiloc"}.get(row["recipe"], row["recipe"]),
                         "pose (ms)": number(statistics.median(own) if own else None, ".1f"), "inliers (%)": CELLS["inliers (%)"](row) if row["localized"] else ""}  # fmt: skip
                table.add(cells, row)


def is_right(problem: dict):
    """Which matches are within 4 px of the true projection."""
    points, pixels = np.array(problem["points3d"]), np.array(problem["points2d"])
    fx, fy, cx, cy = problem["camera"]["params"]
    seen = points @ rotation(problem["cam_from_world"]["q"]).T + problem["cam_from_world"]["t"]
    at = seen[:, :2] / seen[:, 2:] * [fx, fy] + [cx, cy]
    return (np.linalg.norm(at - pixels, axis=1) < 4) & (seen[:, 2] > 0)


def with_share(problem: dict, share: float, rng) -> dict:
    """The problem without as many of its wrong or its right matches as gives this share of right ones."""
    right = is_right(problem)
    rights, wrongs = right.sum(), (~right).sum()
    kept = min(rights, round(wrongs * share / (1 - share))), min(wrongs, round(rights * (1 - share) / share))
    chosen = np.sort(np.concatenate([rng.permutation(np.flatnonzero(of))[:count] for of, count in zip((right, ~right), kept)]))
    return problem | {key: [value[i] for i in chosen] for key, value in problem.items() if isinstance(value, list)}


class Replica:
    """The paper's search, written apart from veiloc: PoseLib's `p6lp`, MSAC on the distance to the line, local optimization.

    With `both`, a pose needs inliers in both halves: in each at least a quarter of the share of the other."""

    def __init__(self, problem: dict, both: bool = False, max_error: float = 4 / 2**0.5):
        fx, fy, cx, cy = problem["camera"]["params"]
        width, height = problem["camera"]["width"], problem["camera"]["height"]
        self.points, pixels = np.array(problem["points3d"]), np.array(problem["points2d"])
        self.side = (pixels[:, 0] >= width / 2).astype(int)
        anchors = np.array([[width / 2, 0], [width / 2, height]])[self.side]
        one = np.ones((len(pixels), 1))
        rays = [np.hstack([(x - [cx, cy]) / [fx, fy], one]) for x in (pixels, anchors)]
        self.lines = np.cross(*rays)
        # A residual is in pixels: the focal lengths are equal to a thousandth.
        self.lines /= np.linalg.norm(self.lines[:, :2], axis=1, keepdims=True)
        self.scale, self.bound, self.both = fx, max_error, both

    def residuals(self, r, t):
        """Distance of each projection to its line in pixels; infinite behind the camera."""
        seen = self.points @ r.T + t
        with np.errstate(all="ignore"):
            return np.where(seen[:, 2] > 0, self.scale * (seen * self.lines).sum(1) / seen[:, 2], np.inf)

    def cost(self, r, t) -> float:
        e = np.minimum(np.abs(self.residuals(r, t)), self.bound)
        shares = [np.mean(e[self.side == side] < self.bound) for side in (0, 1)] if self.both else [1]
        return float((e**2).sum()) if min(shares) >= max(shares) / 4 else np.inf

    def refined(self, r, t, rounds: int = 10):
        """Gauss–Newton on the inliers, as long as the cost falls."""
        best = self.cost(r, t)
        for _ in range(rounds):
            e = self.residuals(r, t)
            near = np.abs(e) < self.bound
            seen, lines = self.points[near] @ r.T + t, self.lines[near]
            of_point = self.scale * (lines - np.outer((seen * lines).sum(1) / seen[:, 2], [0, 0, 1])) / seen[:, 2:]
            step = np.linalg.lstsq(np.hstack([np.cross(seen, of_point), of_point]), -e[near], rcond=None)[0]
            turn = rotation([1, *step[:3] / 2])
            if self.cost(turn @ r, turn @ t + step[3:]) >= best:
                break
            r, t = turn @ r, turn @ t + step[3:]
            best = self.cost(r, t)
        return best, r, t

    def search(self, hypotheses: int, rng):
        best = (np.inf, np.eye(3), np.zeros(3))
        for _ in range(hypotheses):
            # Of the first three lines not all are of one anchor.
            while True:
                chosen = rng.choice(len(self.points), 6, replace=False)
                if 0 < self.side[chosen[:3]].sum() < 3:
                    break
            for pose in poselib.p6lp(list(self.lines[chosen]), list(self.points[chosen])):
                if self.cost(pose.R, pose.t) < best[0]:
                    best = min(best, self.refined(pose.R, pose.t), key=lambda found: found[0])
        return best


def judged(replica: Replica, problem: dict, found) -> tuple[float, float, bool]:
    """Errors of a found pose in map units and degrees, and whether it is wrong and has a better score than the refined true pose."""
    cost, r, t = found
    truth, t0 = rotation(problem["cam_from_world"]["q"]), np.array(problem["cam_from_world"]["t"])
    away, rotated = float(np.linalg.norm(center(r, t) - center(truth, t0))), angle(truth, r)
    return away, rotated, (away > 0.05 or rotated > 5) and cost < replica.refined(truth, t0)[0]


@command("poses/recipe-cause.csv", needs=MODEL_FILES, scene_of=("redkitchen", "a place"), features=["sift", "aliked-t16"],
         shares=["given", "50", "70", "90"])  # fmt: skip
def recipe_cause(run):
    """The paper's estimator on `dcl:paper` beside the share of right matches: ours, and a search written apart with PoseLib's solver."""
    searches = {"paper": run.estimators("paper", hypotheses=1000), "paper, 10 times the hypotheses": run.estimators("paper", hypotheses=10000),
                "likelihood": run.estimators("likelihood", hypotheses=1000), "veiloc": "default"}  # fmt: skip
    table = run.table("poses/recipe-cause.csv", "features", "matches", "right (%)", "larger half (%)", *(f"{name} (%)" for name in searches),
                      "PoseLib's p6lp, written apart (%)", "the same, inliers in both halves (%)", "a wrong pose scores better (%)", "of these with less right than larger half (%)")  # fmt: skip
    for features in run.features:
        given = run.made(run.kept() / f"{run.scene_of}-{features}.jsonl", "eval", "problems", *run.scene(run.scene_of), "--features", features)
        problems = [json.loads(line) for line in given.read_text().splitlines()]
        for share in run.shares:
            rng = np.random.default_rng(0)
            own = problems if share == "given" else [with_share(problem, float(share) / 100, rng) for problem in problems]
            file = given.with_name(f"{given.stem}-{share}.jsonl")
            file.write_text("".join(f"{json.dumps(problem)}\n" for problem in own))
            within = [run.document("eval", "pose", file, "--schemes", "dcl:paper", "--thresholds", "0.05/5", "--estimator", text)["schemes"][0]
                      for text in searches.values()]  # fmt: skip
            replicas = [Replica(problem) for problem in own]
            found, both = ([judged(replica, problem, replica.search(1000, rng)) for replica, problem in zip(of, own)]
                           for of in (replicas, [Replica(problem, both=True) for problem in own]))  # fmt: skip
            right = np.array([is_right(problem).mean() for problem in own])
            half = np.array([max(replica.side.mean(), 1 - replica.side.mean()) for replica in replicas])
            hits = [np.mean([away <= 0.05 and rotated <= 5 for away, rotated, _ in of]) for of in (found, both)]
            lost = np.array([better for *_, better in found])
            table.add([features, "as given" if share == "given" else "wrong or right ones removed", percent(np.median(right), 0),
                       percent(np.median(half), 0), *(CELLS["within 5 cm and 5° (%)"](row) for row in within), *map(percent, hits),
                       percent(lost.mean()), percent((right < half)[lost].mean() if lost.any() else None)])  # fmt: skip
