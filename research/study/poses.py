"""Tables of docs/results/poses.md."""

import ctypes
import gzip
import json
import os
import statistics
import subprocess
import tempfile
import time as clock
from pathlib import Path

from study import constants, direct, learned_recipe  # noqa: F401, with commands of this page
from study.common import RIGHT, SCENES, Package, cm, command, number, percent
from study.geometry import angle, center, rotation

np, poselib, veiloc = Package("numpy"), Package("poselib"), Package("veiloc")

ALL = ["points", "random-lines", "coordinate-permutation", "dcl", "dcl:paper"]
LINES = ["points", "random-lines", "dcl:paper"]


@command("poses/schemes.csv", "poses/paper.csv", "trust/coverage.csv")
def schemes(run):
    """Poses of every scheme, beside the paper's figures, and how often the true pose lies in its region."""
    regions = [f"{what} in {share} % region (%)" for what in ("centre", "pose") for share in (50, 90, 99)]
    table = run.table("poses/schemes.csv", "scene", "keypoints", "scheme", "hypotheses (median)", "queries", "localized", "trusted",
                      "median error (cm)", "median error (°)", "query (bytes)")  # fmt: skip
    paper = run.table("poses/paper.csv", "source", "images", "method", "median error (cm)", "median error (°)",
                      "recall at 5 cm and 5° (%)")  # fmt: skip
    cover = run.table("trust/coverage.csv", "scene", "scheme", "trusted", *regions, "error over ± (median)")
    for method, *cells in (("HLoc, SuperPoint + NN, points", "0.5", "0.14", "95"), ("random lines", "0.7", "0.20", "94"),
                           ("dcl:paper", "1.4", "0.42", "84")):  # fmt: skip
        paper.add(["paper", "7Scenes RedKitchen", method, *cells])
    for scene, folder, keypoints in [("RedKitchen", "redkitchen", 2048), ("Herz-Jesu", "herzjesu", 2048), ("Herz-Jesu", "herzjesu", 4096),
                                     ("Lund door", "lund-door", 2048), ("rendered room", "rendered", 2048)]:  # fmt: skip
        found = run.document("eval", "scene", *run.scene(folder), "--schemes", ",".join(ALL), "--query-keypoints", keypoints,
                             "--thresholds", "0.05/5,0.25/2")  # fmt: skip
        for row in found["schemes"]:
            own = [q for q in found["queries"] if q["scheme"] == row["scheme"]]
            if folder in SCENES.values():
                table.add({"scene": scene, "keypoints": keypoints}, row)
            if folder == "redkitchen" and row["scheme"] in LINES:
                paper.add({"source": "veiloc", "images": "RedKitchen seq-01 hold-out", "method": row["scheme"].replace("-", " "),
                           "recall at 5 cm and 5° (%)": percent(row["recall"]["0.05/5"], 0)}, row)  # fmt: skip
            over = [q["center_error_over_sd"] for q in own if q["state"] == "trusted" and q.get("center_error_over_sd") is not None]
            if keypoints == 2048 and row["trusted"]:
                shares = [percent(row[kind][share]) for kind in ("coverage", "coverage_pose") for share in ("50", "90", "99")]
                cover.add([scene, row["scheme"], row["trusted"], *shares, number(statistics.median(over), ".2f")])


@command("poses/collapse.csv")
def collapse(run):
    """The paper's score beside the likelihood, with the same hypotheses."""
    found = run.document("eval", "scene", *run.scene("redkitchen"), "--schemes", "dcl:paper", "--estimator",
                         f"{run.estimators('paper', hypotheses=1000)},{run.estimators('default', hypotheses=1000, prior=False)}",
                         "--thresholds", "0.05/5")  # fmt: skip
    table = run.table("poses/collapse.csv", "score", "hypotheses", "queries", "localized", "median error (cm)", "median error (°)",
                      "within 5 cm and 5° (%)", "inliers (%)")  # fmt: skip
    for row in found["schemes"]:
        score = {"msac": "MSAC on the distance to the line (paper)"}.get(row["score"], row["score"])
        table.add({"score": score, "hypotheses": 1000} | ({} if row["localized"] else {"inliers (%)": ""}), row)


@command("poses/recipes.csv")
def recipes(run):
    """Poses of given matches by each way of estimating them."""
    columns = [f"{scheme} {what}" for scheme in LINES for what in ("recall (%)", "median (cm)")]
    table = run.table("poses/recipes.csv", "matches of", "recipe", *columns)
    for problem in ("redkitchen_nn", "redkitchen_r08", "herzjesu_nn", "herzjesu_r08"):
        threshold = "0.05/5" if problem.startswith("redkitchen") else "0.1/1"
        common = ["eval", "pose", run.place(f"problems/{problem}.jsonl.gz"), "--seeds", 5, "--thresholds", threshold, "--schemes",
                  ",".join(LINES), "--estimator"]  # fmt: skip
        searched = run.document(*common, run.estimators("paper,likelihood,likelihood+prior,vote", hypotheses=1000))["schemes"]
        oracles = run.document(*common, "optimum,floor")["schemes"]
        by = {(row["recipe"], row["scheme"]): row for row in [*oracles, *searched]}
        for recipe in dict.fromkeys(row["recipe"] for row in [*searched, *oracles]):
            rows = [by[recipe, scheme] for scheme in LINES]
            table.add([problem, recipe, *(c for row in rows for c in (percent(row["recall"][threshold]), cm(row["median_translation"])))])


@command("poses/data-sets.csv")
def data_sets(run):
    """A rendered place in the files of each data set: what a reader with the data runs, from end to end."""
    table = run.table("poses/data-sets.csv", "layout", "condition", "scheme", "queries", "localized", "median error (cm)",
                      "median error (°)", "smallest threshold (m/°)", "within it (%)")  # fmt: skip
    for layout in ("7scenes", "cambridge", "aachen", "aachen-v1.1"):
        root = run.kept() / layout
        if not root.exists():
            run.run("synth", "export", "--quiet", "--layout", layout, "--out", root)
        truth = ["--truth", root / "queries/poses.txt"] if layout.startswith("aachen") else []
        for row in run.document("eval", "dataset", layout, "--root", root, "--jobs", 1, *truth)["schemes"]:
            best = list(row["recall"])[0]
            table.add({"layout": layout, "condition": row.get("condition", ""), "smallest threshold (m/°)": best,
                       "within it (%)": percent(row["recall"][best])}, row)  # fmt: skip


@command("poses/ablations.csv")
def ablations(run):
    """The paper's ablations: more partitions, and halves that lie beside each other."""
    names = {"points": "points", "random-lines": "random lines", "dcl:paper": "dcl:paper", "dcl:s=2": "dcl, s = 2", "dcl:s=3": "dcl, s = 3",
             "dcl:horizontal": "dcl, halves side by side"}  # fmt: skip
    table = run.table("poses/ablations.csv", "scene", "scheme", "queries", "localized", "trusted", "median error (cm)",
                      "median error (°)", "within 5 cm and 5° (%)", "within 25 cm and 2° (%)")  # fmt: skip
    for scene, folder in SCENES.items():
        found = run.document("eval", "scene", *run.scene(folder), "--schemes", ",".join(names), "--thresholds", f"0.05/5,{RIGHT}")
        for row, name in zip(found["schemes"], names.values()):
            table.add({"scene": scene, "scheme": name}, row)


TIMED = ["points", "random-lines", "dcl"]


@command("poses/time.csv", rounds=(3, "alternating rounds"), files=([], "files of matches in place of those of the data"))
def time(run):
    """Pose estimation beside PoseLib's P3P LO-RANSAC: the same matches, one thread each, in alternating rounds.

    PoseLib gets the keypoints and its own defaults (inlier threshold 4 px), because it has no robust estimator for lines; veiloc gets the
    obfuscated keypoints of each scheme. A query's time is the fastest of all rounds. Recall is at the thresholds of the tables: 5 cm /
    5 degrees on RedKitchen, 10 cm / 1 degree on Herz-Jesu. `--veiloc OLD,NEW` compares two builds: both run in every round."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    names = ["herzjesu_nn", "redkitchen_nn", "herzjesu_r08", "redkitchen_r08"]
    files = [Path(file) for file in run.files] or [run.place(f"problems/{name}.jsonl.gz") for name in names]
    programs = str(run.veiloc).split(",")
    table = run.table("poses/time.csv", "matches of", "pipeline", "matches (median)", "pose, median (ms)", "time over PoseLib",
                      "median error (cm)", "recall (%)")  # fmt: skip
    for file in files:
        with gzip.open(file, "rt") as lines:
            problems = [json.loads(line) for line in lines]
        bounds = (0.05, 5.0) if file.name.startswith("redkitchen") else (0.1, 1.0)
        rounds = []
        for seed in range(run.rounds):
            found = {"PoseLib P3P, points": by_poselib(problems)}
            for i, program in enumerate(programs, 1):
                which = f" {i}" if len(programs) > 1 else ""
                found |= {f"veiloc, {scheme}{which}": rows for scheme, rows in by_veiloc(program, file, seed).items()}
            rounds.append(found)
        size, baseline = np.median([len(p["points2d"]) for p in problems]), None
        for name in rounds[0]:
            # Milliseconds, error of the centre, error of the rotation: [rounds, queries, 3].
            every = np.stack([found[name] for found in rounds])
            ms = float(np.median(every[:, :, 0].min(axis=0)))
            baseline = baseline or ms
            hits = (every[:, :, 1] <= bounds[0]) & (every[:, :, 2] <= bounds[1])
            table.add([file.name.split(".")[0], name, int(size), f"{ms:.2f}", f"{ms / baseline:.2f}",
                       f"{100 * statistics.median(np.median(every[:, :, 1], axis=1)):.2f}", f"{100 * hits.mean():.1f}"])  # fmt: skip


def by_veiloc(program, file, seed):
    command = [program, "-q", "eval", "pose", file, "--schemes", ",".join(TIMED), "--seed", str(seed), "--json"]
    document = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    rows = {scheme: [] for scheme in TIMED}
    for query in document["queries"]:
        error = [query[key] if query[key] is not None else float("inf") for key in ("translation_error", "rotation_error_deg")]
        rows[query["scheme"]].append((query["ms"]["pose"], *error))
    return {scheme: np.array(values) for scheme, values in rows.items()}


def by_poselib(problems):
    rows = []
    for problem in problems:
        points2d, points3d = np.array(problem["points2d"]), np.array(problem["points3d"])
        started = clock.perf_counter()
        pose, _ = poselib.estimate_absolute_pose(points2d, points3d, problem["camera"], {"max_reproj_error": 4.0}, {})
        ms = 1e3 * (clock.perf_counter() - started)
        truth = rotation(problem["cam_from_world"]["q"])
        away = center(pose.R, pose.t) - center(truth, np.array(problem["cam_from_world"]["t"]))
        rows.append((ms, np.linalg.norm(away), angle(truth, pose.R)))
    return np.array(rows)


@command("poses/solvers.csv", problems=(100_000, "problems of a family"), rounds=5, passes=3,
         only=("", "only families whose solver or problems contain this text"))  # fmt: skip
def solvers(run):
    """Our minimal solvers beside PoseLib's: the same problems, in alternating rounds, with the same criteria.

    For each family of problems, `solver_benchmark` (crate veiloc-benches) generates and solves the problems and writes both; here
    PoseLib's C++ functions solve the same problems. A small C loop, compiled here, calls them in the shared object of the `poselib`
    wheel, so the time of Python is not measured. Each side's time is the sum over chunks of 500 problems of the fastest pass over the
    chunk, and the smallest of all rounds.

    u4lp and p6lp_dual_radial have no counterpart in PoseLib. They are compared with its p6lp on the same scene; for u4lp this means two
    more lines instead of the vertical. PoseLib's p6lp eliminates the translation with its first three lines; dual-radial samples are
    ordered so that this works, and "any order" shows the other case. PoseLib's up2p rotates both verticals for every sample; ours
    rotates them once for all samples.

    Criteria for both sides:
      poses     returned per problem
      valid     share of the returned poses that fulfil the equations and have every point in front of the camera (on its half-line for
                p5lp_radial). PoseLib's line solvers leave this check to the caller
      truth     share of the problems with a pose within 1e-6 of the true one, and within 1e-3:
                ||R - R_true|| + ||t - t_true||, with map points one to eight units away"""
    binary = run.example("veiloc-benches", "solver_benchmark", kind="bin")

    def ours(*words):
        return json.loads(subprocess.run([binary, *map(str, words)], check=True, capture_output=True, text=True).stdout)

    both = lambda what: (what, what.replace(" (", ", PoseLib (") if " (" in what else f"{what}, PoseLib")
    columns = [c for what in ("poses", "valid (%)", "truth at 1e-6 (%)", "truth at 1e-3 (%)", "time (ns)") for c in both(what)]
    table = run.table("poses/solvers.csv", "solver", "PoseLib solver", "problems", *columns, "time over PoseLib")
    with tempfile.TemporaryDirectory() as folder:
        rival = PoseLib(folder)
        for family in range(ours()):
            about = ours("--family", family, "--problems", 1, "--passes", 1)
            if run.only not in about["solver"] + " " + about["problems"]:
                continue
            given = ["--family", family, "--problems", run.problems, "--passes"]
            about = ours(*given, 1, "--out", folder)
            size, name = about["size"], about["rival"]
            rows = np.fromfile(f"{folder}/problems.f64").reshape(-1, 6 * size + 18)
            poses = np.fromfile(f"{folder}/poses.f64").reshape(-1, 13)
            times = [(ours(*given, run.passes)["ns"], rival.measure(name, rows, size, run.passes)) for _ in range(run.rounds)]
            ns = [min(side) for side in zip(*times)]
            found = zip(judge(rows, size, poses, about["solver"]), judge(rows, size, rival.solve(name, rows, size), name))
            cells = [format(value, form) for values, form in zip(found, (".2f", ".2f", ".3f", ".3f")) for value in values]
            table.add([f"`{about['solver']}`", f"`{name}`", about["problems"], *cells, *(f"{value:.0f}" for value in ns),
                       f"{ns[0] / ns[1]:.2f}"])  # fmt: skip
SHIM = r"""
#include <stdint.h>
#include <time.h>

/* std::vector<T>: begin, end, end of capacity. Eigen::Vector3d: three doubles. */
typedef struct { char *begin, *end, *room; } vector;
typedef int (*solver)(const vector *, const vector *, vector *);
typedef int (*gravity_solver)(const vector *, const vector *, const double *, const double *, vector *);

static vector view(const double *at, int n) {
    vector v = {(char *)at, (char *)(at + 3 * n), (char *)(at + 3 * n)};
    return v;
}

static int one(void *f, int gravity, const double *row, int n, vector *out) {
    vector x = view(row, n), points = view(row + 3 * n, n);
    out->end = out->begin;
    return gravity ? ((gravity_solver)f)(&x, &points, row + 6 * n, row + 6 * n + 3, out)
                   : ((solver)f)(&x, &points, out);
}

/* Nanoseconds of `passes` passes over `count` problems: each chunk's fastest, summed. */
double measure(void *f, int gravity, const double *rows, long count, int n, int passes) {
    static vector out;
    double total = 0.0;
    long stride = 6 * n + 18;
    for (long from = 0; from < count; from += 500) {
        long to = from + 500 < count ? from + 500 : count;
        double best = 1e300;
        for (int pass = 0; pass < passes; pass++) {
            struct timespec a, b;
            clock_gettime(CLOCK_MONOTONIC, &a);
            for (long i = from; i < to; i++)
                one(f, gravity, rows + i * stride, n, &out);
            clock_gettime(CLOCK_MONOTONIC, &b);
            double ns = 1e9 * (double)(b.tv_sec - a.tv_sec) + (double)(b.tv_nsec - a.tv_nsec);
            best = ns < best ? ns : best;
        }
        total += best;
    }
    return total;
}

/* Rows of (problem, q, t) in `poses`; returns their number. The size of a pose follows from the vector. */
long solve(void *f, int gravity, const double *rows, long count, int n, double *poses, long room) {
    static vector out;
    long stride = 6 * n + 18, filled = 0;
    for (long i = 0; i < count; i++) {
        one(f, gravity, rows + i * stride, n, &out);
        /* Quaternion and translation, padded to the alignment of the quaternion. */
        for (char *at = out.begin; at < out.end && filled < room; at += SIZE_OF_POSE, filled++) {
            poses[8 * filled] = (double)i;
            for (int k = 0; k < 7; k++) poses[8 * filled + 1 + k] = ((double *)at)[k];
        }
    }
    return filled;
}

/* Bytes of what one problem returned. */
long bytes(void *f, int gravity, const double *row, int n) {
    static vector out;
    one(f, gravity, row, n, &out);
    return out.end - out.begin;
}
"""
V3 = "RKSt6vectorIN5Eigen6MatrixIdLi3ELi1ELi0ELi3ELi1EEESaIS3_EES7_"
POSES = "PS0_INS_10CameraPoseESaI{}_EE"
SYMBOLS = {
    "p3p": "_ZN7poselib3p3pE" + V3 + POSES.format("S8"),
    "p6lp": "_ZN7poselib4p6lpE" + V3 + POSES.format("S8"),
    "p5lp_radial": "_ZN7poselib11p5lp_radialE" + V3 + POSES.format("S8"),
    "up2p": "_ZN7poselib4up2pE" + V3 + "RKS3_S9_" + POSES.format("SA"),
}


class PoseLib:
    """PoseLib's functions in the wheel's shared object."""

    def __init__(self, folder):
        library = ctypes.CDLL(poselib._core.__file__)
        self.functions = {name: ctypes.cast(library[symbol], ctypes.c_void_p) for name, symbol in SYMBOLS.items()}
        # The first call finds the size of a pose, which depends on the compiler's alignment; the second uses it.
        probe = self.compile(folder, 64)
        self.size_of_pose = self.probe(probe)
        self.shim = self.compile(folder, self.size_of_pose)

    @staticmethod
    def compile(folder, size_of_pose):
        source, target = os.path.join(folder, "shim.c"), os.path.join(folder, f"shim{size_of_pose}.so")
        with open(source, "w") as file:
            file.write(SHIM)
        subprocess.run(
            ["cc", "-O2", "-shared", "-fPIC", f"-DSIZE_OF_POSE={size_of_pose}", source, "-o", target], check=True)
        shim = ctypes.CDLL(target)
        pointer, number = np.ctypeslib.ndpointer(np.float64, flags="C"), ctypes.c_long
        shim.measure.restype = ctypes.c_double
        shim.measure.argtypes = [ctypes.c_void_p, ctypes.c_int, pointer, number, ctypes.c_int, ctypes.c_int]
        shim.solve.restype = number
        shim.solve.argtypes = [ctypes.c_void_p, ctypes.c_int, pointer, number, ctypes.c_int, pointer, number]
        shim.bytes.restype = number
        shim.bytes.argtypes = [ctypes.c_void_p, ctypes.c_int, pointer, ctypes.c_int]
        return shim

    def probe(self, shim):
        rng = np.random.default_rng(1)
        while True:
            x = rng.uniform([-0.6, -0.4, 1], [0.6, 0.4, 1], size=(3, 3))
            points = x * rng.uniform(1, 8, size=(3, 1))
            x /= np.linalg.norm(x, axis=1, keepdims=True)
            poses = len(poselib.p3p(x, points))
            if poses > 1:
                row = np.concatenate([x.ravel(), points.ravel(), np.zeros(18)])
                size = shim.bytes(self.functions["p3p"], 0, row, 3) / poses
                assert size in (56, 64, 96), f"a pose of {size} bytes"
                return int(size)

    def measure(self, name, rows, size, passes):
        return self.shim.measure(self.functions[name], name == "up2p", rows, len(rows), size, passes) / len(rows)

    def solve(self, name, rows, size):
        """Rows of (problem, R row by row, t)."""
        found = np.empty((9 * len(rows), 8))
        found = found[:self.shim.solve(
            self.functions[name], name == "up2p", rows, len(rows), size, found, len(found))]
        w, x, y, z = found[:, 1:5].T
        turns = np.stack([
            w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z], axis=1)
        return np.column_stack([found[:, 0], turns, found[:, 5:8]])


def judge(rows, size, poses, solver):
    """Poses per problem, percentages of valid poses, of true poses found within 1e-6, and within 1e-3."""
    count = len(rows)
    # u4lp gets only the first four of the six lines of PoseLib's p6lp.
    used = 4 if solver == "u4lp" else size
    vectors = rows[:, :3 * size].reshape(count, size, 3)[:, :used]
    points = rows[:, 3 * size:6 * size].reshape(count, size, 3)[:, :used]
    truth = rows[:, 6 * size + 6:]
    problem = poses[:, 0].astype(int)
    r, t = poses[:, 1:10].reshape(-1, 3, 3), poses[:, 10:].copy()
    if solver == "p5lp_radial":
        t[:, 2] = 0
    with np.errstate(all="ignore"):
        error = np.linalg.norm(poses[:, 1:10] - truth[problem, :9], axis=1)
        error += np.linalg.norm(t - truth[problem, 9:], axis=1)
        best = np.full(count, np.inf)
        np.fmin.at(best, problem, error)
        seen = np.einsum("nij,nkj->nki", r, points[problem]) + t[:, None, :]
        v = vectors[problem]
        length = np.linalg.norm(seen, axis=2)
        if solver in ("p3p", "up2p"):
            off = np.linalg.norm(np.cross(v, seen), axis=2)
            front = np.sum(v * seen, axis=2) > 0
        elif solver == "p5lp_radial":
            off = np.abs(np.sum(v * seen, axis=2))
            front = v[:, :, 1] * seen[:, :, 0] - v[:, :, 0] * seen[:, :, 1] > 0
        else:
            off = np.abs(np.sum(v * seen, axis=2))
            front = seen[:, :, 2] > 0
        orthonormal = np.abs(r @ r.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) < 1e-6
        valid = np.all((off < 1e-6 * (1 + length)) & front, axis=1) & orthonormal
    valid = 100 * float(valid.mean()) if len(poses) else float("nan")
    return len(poses) / count, valid, 100 * float((best < 1e-6).mean()), 100 * float((best < 1e-3).mean())


@command(correspondences=1000, problems=40, rounds=7)
def python_calls(run):
    """Overhead of a call from Python: our Python call, our Rust call and PoseLib's Python call on the same problems.

    Problems are points with noise of 0.5 px and 30 % outliers. Each round times every problem once with each method. A problem's time is
    its fastest; ratios are those of the sums. Needs the packages `veiloc` and `poselib`."""
    camera = {"model": "PINHOLE", "width": 640, "height": 480, "params": [525.0, 525.0, 320.0, 240.0]}
    rng = np.random.default_rng(0)

    def problem(count):
        """Pixels `[N, 2]` and points `[N, 3]`."""
        q, t = rng.normal(size=4), rng.normal(size=3)
        pixels = rng.uniform([0, 0], [640, 480], (count, 2))
        rays = np.column_stack([(pixels - [320, 240]) / 525, np.ones(count)])
        points = (rays * rng.uniform(2, 8, (count, 1)) - t) @ veiloc.CameraPose(q, t).R
        pixels += rng.normal(scale=0.5, size=pixels.shape)
        wrong = rng.permutation(count)[: int(0.3 * count)]
        pixels[wrong] = rng.uniform([0, 0], [640, 480], (len(wrong), 2))
        return pixels, points

    problems = [problem(run.correspondences) for _ in range(run.problems)]
    file = run.kept() / "problems.f64"
    np.concatenate([np.hstack(problem).ravel() for problem in problems]).astype("<f8").tofile(file)
    rust = run.example("veiloc-benches", "time_poses", kind="bin")

    def of_rust():
        printed = subprocess.run([rust, file, str(run.correspondences)], capture_output=True, text=True, check=True).stdout
        return np.array(printed.split(), float)

    def timed(call):
        """Milliseconds of each problem."""
        times = []
        for pixels, points in problems:
            began = clock.perf_counter()
            call(pixels, points)
            times.append(1e3 * (clock.perf_counter() - began))
        return np.array(times)

    ways = {
        "rust": of_rust, "python": lambda: timed(lambda p, x: veiloc.estimate_absolute_pose(p, x, camera)),
        "poselib": lambda: timed(lambda p, x: poselib.estimate_absolute_pose(p, x, camera, {"max_reproj_error": 4.0}, {})),
    }  # fmt: skip
    best = {name: np.full(len(problems), np.inf) for name in ways}
    for _ in range(run.rounds):
        for name, way in ways.items():
            best[name] = np.minimum(best[name], way())
    for name, times in best.items():
        print(f"{name:<8} {times.mean():.3f} ms per call, {times.sum() / best['rust'].sum():.3f} x our Rust call")
