"""What each tuned constant of the pose estimator changes: the table docs/results/poses/constants.csv.

The sources are copied, each constant becomes a value that a variable of the environment multiplies, and `veiloc eval pose`
runs on the matches of the places with one constant halved or doubled at a time.
"""

import json
import math
import os
import re
import shutil
import statistics
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from study.common import PLACES, ROOT, command, number

PAGE = "poses"
SOURCES = Path("crates/core/pose/src")
SCHEMES = ["points", "random-lines", "dcl"]
FACTORS = [0.5, 2.0]
CONSTANT = re.compile(
    r"^((?:pub(?:\([a-z]+\))? )?)const ([A-Z][A-Z0-9_]*): (f64|usize|\[f64; (?:CAMERA|\d+)\]) = ([^;]+);(.*)$", re.MULTILINE
)
# Sizes of arrays and identities, not tuned.
FIXED = {"CAMERA", "POSE", "POSE_AND_FOCAL", "POSE_AND_CAMERA", "ANGLE_BINS", "PIXEL_BINS", "DIRECTION_BINS", "OFFSET_BINS", "GRID",
         "CHANCE_LOG_EVIDENCE", "SUBSET_SIZE", "UNMEASURED_SD", "UNMEASURED_LOG_ODDS"}  # fmt: skip
TUNED = """
//! Values that a variable of the environment multiplies.

/// `VEILOC_TUNED` is `FILE::NAME=FACTOR`.
fn factor(name: &str) -> f64 {
    let given = std::env::var("VEILOC_TUNED").unwrap_or_default();
    given.split_once('=').filter(|(own, _)| *own == name).map_or(1.0, |(_, factor)| factor.parse().expect("a number"))
}

pub(crate) trait Scaled {
    fn scaled(self, name: &str) -> Self;
}

impl Scaled for f64 {
    fn scaled(self, name: &str) -> Self {
        self * factor(name)
    }
}

impl Scaled for usize {
    fn scaled(self, name: &str) -> Self {
        ((self as f64 * factor(name)).round() as usize).max(1)
    }
}

impl<const N: usize> Scaled for [f64; N] {
    fn scaled(self, name: &str) -> Self {
        self.map(|value| value * factor(name))
    }
}
"""


def constants(folder: Path) -> list[tuple[Path, str, str, str]]:
    """File, name, value and meaning of each constant outside tests, in the order of the files."""
    found = []
    for path in sorted((folder / SOURCES).rglob("*.rs")):
        own = path.relative_to(folder / SOURCES)
        if own.parts[0] == "solvers" or "tests" in own.parts[-1]:
            continue
        text = path.read_text().split("#[cfg(test)]")[0]
        for match in CONSTANT.finditer(text):
            if match[2] in FIXED:
                continue
            before = text[: match.start()].splitlines()
            meaning = []
            while before and before[-1].startswith(("///", "#[")):
                line = before.pop()
                if line.startswith("///"):
                    meaning.insert(0, line.removeprefix("///").strip())
            found.append((own, match[2], " ".join(match[4].split()), " ".join(meaning)))
    return found


def scaled(folder: Path, listed):
    """Makes each constant a value of the environment, in its own file and in those that name it."""
    module = folder / SOURCES
    (module / "tuned.rs").write_text(TUNED.lstrip())
    lib = module / "lib.rs"
    lib.write_text(re.sub(r"^(mod \w+;)", r"mod tuned;\n\1", lib.read_text(), count=1, flags=re.MULTILINE))
    for own, name, _, _ in listed:
        path = module / own
        text = path.read_text()
        where = f"{own}::{name}"

        def static(match):
            kind, value = match[3], match[4]
            body = f'crate::tuned::Scaled::scaled({value}, "{where}")'
            return f"{match[1]}static {name}: std::sync::LazyLock<{kind}> = std::sync::LazyLock::new(|| {body});{match[5]}"

        own_constant = re.compile(CONSTANT.pattern.replace("([A-Z][A-Z0-9_]*)", f"({name})"), re.MULTILINE)
        text = own_constant.sub(static, text, count=1)
        path.write_text(text)
        named, defined = re.compile(rf"use [^;]*\b{name}\b"), re.compile(rf"(const|static) {name}:")
        others = [(other, other.read_text()) for other in module.rglob("*.rs") if other != path]
        users = [path] + [other for other, content in others if named.search(content) and not defined.search(content)]
        for user in users:
            lines = user.read_text().splitlines(keepends=True)
            inside_use = False
            for at, line in enumerate(lines):
                inside_use = inside_use or bool(re.match(r"\s*(pub(\([a-z]+\))? )?use ", line))
                if not (inside_use or "///" in line or "//!" in line or f"static {name}:" in line):
                    lines[at] = re.sub(rf"(?<![\w:]){name}\b(?!\s*[:=] )", f"(*{name})", line)
                if inside_use and ";" in line:
                    inside_use = False
            user.write_text("".join(lines))
    for path in module.rglob("*.rs"):
        if path.relative_to(module).parts[0] != "solvers":
            path.write_text(path.read_text().replace("const fn", "fn"))


@command("poses/constants.csv", needs="builds the program again, and runs it several hundred times")
def constants_of_the_estimator(run):
    """What each tuned constant of the estimator changes when it is halved or doubled."""
    source = run.work.resolve() / "constants"
    shutil.rmtree(source / "sources", ignore_errors=True)
    for name in subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines():
        if (ROOT / name).is_file():
            (source / "sources" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, source / "sources" / name)
    listed = constants(ROOT)
    scaled(source / "sources", listed)
    target = Path(os.environ.get("CARGO_TARGET_DIR", source / "target"))
    built = subprocess.run(["cargo", "build", "--release", "--quiet", "--package", "veiloc-cli", "--target-dir", target],
                           cwd=source / "sources", env={**os.environ, "RUSTFLAGS": "-Awarnings"}, check=False)  # fmt: skip
    if built.returncode:
        sys.exit("the scaled sources do not build")
    kinds = {"as given": [], "wrong camera": [], "gravity": ["--gravity", "0.5"]}
    files = {kind: source / f"{kind.replace(' ', '-')}.jsonl" for kind in kinds}
    problems = [thinned for name in PLACES for thinned in problems_of(run, source, name)]
    for kind, file in files.items():
        changed = wrong_camera if kind == "wrong camera" else lambda i, problem: problem
        file.write_text("".join(json.dumps(changed(i, problem)) + "\n" for i, problem in enumerate(problems)))

    def measured(tuned: str) -> list:
        """For each kind of problems: localized right, trusted, trusted but wrong, and the errors of the centre."""
        found = []
        for kind, options in kinds.items():
            words = [target / "release/veiloc", "eval", "pose", files[kind], "--schemes", ",".join(SCHEMES), "--quiet", "--json", *options]
            done = subprocess.run(list(map(str, words)), stdout=subprocess.PIPE, text=True, env={**os.environ, "VEILOC_TUNED": tuned})
            if done.returncode not in (0, 1, 4):
                return []
            queries = json.loads(done.stdout)["queries"]
            errors = [(q["translation_error"] or math.inf, q["rotation_error_deg"] or math.inf) for q in queries]
            right = [t <= 0.25 and r <= 2 for t, r in errors]
            trusted = [q["state"] == "trusted" for q in queries]
            found.append((100 * sum(right) / len(right), sum(trusted), sum(t and not r for t, r in zip(trusted, right)),
                          statistics.median(t for t, _ in errors)))  # fmt: skip
        return found

    columns = ("within 25 cm and 2° (%)", "trusted", "trusted, wrong", "median error over own")
    table = run.table("poses/constants.csv", "file", "constant", "value", "factor",
                      *[f"{kind}: {column}" for kind in kinds for column in columns], "what it is")  # fmt: skip
    base = measured("")

    def cells(found: list) -> list[str]:
        if not found:
            return ["fails", "", "", ""] * len(kinds)
        return [cell for (right, trusted, wrong, error), own in zip(found, base)
                for cell in (number(right, ".1f"), trusted, wrong, number(error / own[3], ".3f"))]  # fmt: skip

    table.add(["", "as built", "", "1", *cells(base), ""])
    jobs = [(own, name, value, meaning, factor) for own, name, value, meaning in listed for factor in FACTORS]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        results = pool.map(lambda job: measured(f"{job[0]}::{job[1]}={job[4]}"), jobs)
        for (own, name, value, meaning, factor), found in zip(jobs, results):
            table.add([str(own), name, value, number(factor, "g"), *cells(found), meaning])


def problems_of(run, folder: Path, name: str) -> list[dict]:
    """At most 20 problems of a place, evenly spread."""
    file, place = folder / f"{name}.jsonl", run.place(name)
    run.made(file, "eval", "problems", "--posed", place / "posed", "--images", place / "images", "--map-list", place / "map.txt",
             "--query-list", place / "query.txt")  # fmt: skip
    lines = file.read_text().splitlines()
    return [json.loads(line) for line in lines[:: math.ceil(len(lines) / 20)]]


def wrong_camera(i: int, problem: dict) -> dict:
    """The problem with a focal length 3 % too long or 12 % too short, or a principal point 3 % of the width too far right."""
    camera = problem["camera"]
    fx, fy, cx, cy = camera["params"]
    zoom, shift = [(1.03, 0), (0.88, 0), (1, 0.03 * camera["width"])][i % 3]
    return {**problem, "camera": {**camera, "params": [zoom * fx, zoom * fy, cx + shift, cy]}}
