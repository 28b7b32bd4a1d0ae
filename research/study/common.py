"""What the pages share: their commands, the program and its documents, the places, tables as CSV files, cells."""

import argparse
import ast
import csv
import hashlib
import importlib.util
import json
import os
import resource
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs/results"
PLACES = ["hololens-office", "tum-fr1-rpy", "llff-room", "fountain", "entry", "redkitchen", "herzjesu"]
# The two scenes of most tables, and what they are called there.
SCENES = {"RedKitchen": "redkitchen", "Herz-Jesu": "herzjesu"}
# Needs of commands that `study figures` looks for.
MODEL_FILES, PYTORCH = "network files in VEILOC_MODELS", "PyTorch"


def is_here(needs: str) -> bool:
    """Whether this machine has what a command needs; false for needs that are not known."""
    known = {"": True, MODEL_FILES: "VEILOC_MODELS" in os.environ, PYTORCH: importlib.util.find_spec("torch") is not None}
    return known.get(needs, False)


@dataclass
class Command:
    """One command of a page; `needs` says why `study figures` does not run it."""

    page: str
    name: str
    make: object
    tables: tuple
    needs: str = ""
    options: dict = field(default_factory=dict)


COMMANDS: dict[tuple[str, str], Command] = {}


def command(*tables: str, needs: str = "", **options):
    """Registers a function of a page: `study PAGE NAME`. The page is the module, or its PAGE.
    `tables` are the files of docs/results that it writes without options.
    Options are `name=default` or `name=(default, help)`; a list is given with commas."""

    taken = [name for name in options if hasattr(Run, name)]
    assert not taken, f"methods of Run have the names of the options {taken}"

    def register(make):
        page = make.__globals__.get("PAGE", make.__module__.rpartition(".")[2])
        name = make.__name__.strip("_").replace("_", "-")
        COMMANDS[page, name] = Command(page, name, make, tables, needs, options)
        return make

    return register


def list_of(text: str) -> list[str]:
    return text.split(",") if text else []


def parse(command: Command, words: list[str]) -> "Run":
    """The run of a command with the options of its command line."""
    parser = argparse.ArgumentParser(prog=f"study {command.page} {command.name}", description=command.make.__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("--veiloc", default=ROOT / "target/release/veiloc", help="the program, several with commas where two are compared")
    parser.add_argument("--data", type=Path, default=os.environ.get("VEILOC_DATA"), help="folder of the places (VEILOC_DATA)")
    parser.add_argument("--work", type=Path, default=ROOT / "target/study", help="folder of maps and documents, which are kept")
    parser.add_argument("--out", type=Path, help="write the tables into PAGE/NAME.csv of this folder, such as docs/results")
    for name, given in command.options.items():
        default, about = given if isinstance(given, tuple) else (given, None)
        how = {"action": "store_true"} if default is False else {"default": default, "type": type(default)}
        if isinstance(default, list):
            how |= {"type": list_of}
        elif default is None:
            how |= {"type": str}
        parser.add_argument(f"--{name.replace('_', '-')}", help=about, **how)
    return parser.parse_args(words, Run())


class Run(argparse.Namespace):
    """One run of a command: its options, and the program."""

    def place(self, name: str) -> Path:
        """Folder of a place: `images`, `posed` (COLMAP's text), `map.txt` and `query.txt`."""
        if self.data is None:
            sys.exit("set VEILOC_DATA or --data to the folder of the places")
        return Path(self.data).resolve() / name

    def kept(self) -> Path:
        """Folder of what this very program has made."""
        if not hasattr(self, "digest"):
            program = Path(self.veiloc)
            if not program.exists():
                sys.exit(f"no program {program}: cargo build --release --features full, or --veiloc PROGRAM")
            self.digest = hashlib.sha256(program.read_bytes()).hexdigest()[:12]
        folder = self.work.resolve() / self.digest
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def run(self, *words, **how):
        """Runs a command of the program, which must succeed."""
        return subprocess.run([self.veiloc, *map(str, words)], check=True, stdout=subprocess.DEVNULL, **how)

    def made(self, file: Path, *words) -> Path:
        """A file that a command writes; kept, so that the command runs once."""
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            self.run(*words, "--quiet", "-o", file)
        return file

    def document(self, *words) -> dict:
        """What a command prints with `--json`; kept, so that it runs once and an interrupted table goes on."""
        words = [str(word) for word in words]
        name = f"{'-'.join(Path(word).name for word in words[:2])}-{hashlib.sha256(' '.join(words).encode()).hexdigest()[:16]}.json"
        kept = self.kept() / name
        if not kept.exists():
            partial = kept.with_suffix(".partial")
            partial.write_text(self.printed(*words))
            partial.rename(kept)
        return json.loads(kept.read_text())

    def printed(self, *words) -> str:
        """What a command prints with `--json`, now: for inputs that change under one name."""
        done = subprocess.run([self.veiloc, *map(str, words), "--quiet", "--json"], stdout=subprocess.PIPE, text=True)
        # 1 and 4: some queries were not found or are doubtful.
        if done.returncode not in (0, 1, 4):
            raise subprocess.CalledProcessError(done.returncode, [self.veiloc, *words])
        return done.stdout

    def json(self, *words) -> dict:
        return json.loads(self.printed(*words))

    def posed(self, name: str, images: Path | None = None) -> list:
        """Options with the poses and images of a place."""
        folder = self.place(name)
        return ["--posed", folder / "posed", "--images", images or folder / "images"]

    def scene(self, name: str, images: Path | None = None) -> list:
        """Options of `veiloc eval` that select a scene: a folder of the data, `lund-door`, or `rendered`."""
        folder, lists = self.place(name) if name != "rendered" else self.kept() / "demo", None
        if name == "rendered":
            if not (folder / "place.vmap").exists():
                self.run("demo", "--quiet", "--out", folder)
            names = sorted(path.name for path in (folder / "images").iterdir())
            lists = {kind: [n for n in names if n.startswith(f"{kind}-")] for kind in ("map", "query")}
        elif name == "lund-door":
            # It has no query images: every third image is left out of the map and is a query.
            names = sorted(path.name for path in (folder / "images").iterdir())
            lists = {"map": [n for i, n in enumerate(names) if i % 3 != 1], "query": names[1::3]}
        if lists is None:
            return [*self.posed(name, images), "--map-list", folder / "map.txt", "--query-list", folder / "query.txt"]
        files = {kind: self.listed(f"{name}-{kind}", own) for kind, own in lists.items()}
        posed = folder / ("sparse" if name == "lund-door" else "posed")
        return ["--posed", posed, "--images", folder / "images", "--map-list", files["map"], "--query-list", files["query"]]

    def listed(self, name: str, lines) -> Path:
        """A text file of these lines in the work folder."""
        file = self.kept() / f"{name}.txt"
        file.write_text("".join(f"{line}\n" for line in lines))
        return file

    def estimators(self, names: str, **changes) -> str:
        """A value of `--estimator`: these estimators with changes, one file each."""
        files = []
        for name in names.split(","):
            file = self.kept() / "-".join(["estimator", name, *(f"{key}-{value}" for key, value in changes.items())])
            lines = [f"{key.replace('_', '-')} = {json.dumps(value)}\n" for key, value in changes.items()]
            files.append(file.with_name(f"{file.name}.toml"))
            files[-1].write_text(f'name = "{name}"\nbase = "{name}"\n{"".join(lines)}')
        return ",".join(map(str, files))

    def map(self, name: str) -> Path:
        """The map of a scene, with its self-test."""
        options = self.scene(name)
        return self.made(self.kept() / f"{name}.vmap", "map", "build", *options[:4], "--list", options[5])

    def table(self, name: str, *columns: str) -> "Table":
        return Table(self.out and self.out / name, columns)

    def example(self, package: str, name: str, *options: str, kind: str = "example") -> Path:
        """An example or another program of the workspace, built."""
        subprocess.run(["cargo", "build", "--release", "--locked", "-q", "-p", package, f"--{kind}", name, *options], check=True, cwd=ROOT)
        return ROOT / "target/release" / ("examples" if kind == "example" else "") / name


class Table:
    """A table of docs/results. Each row is printed and, with a path, written at once: an interrupted run shows what it has."""

    def __init__(self, path: Path | None, columns):
        self.path, self.columns, self.rows = path, list(columns), []
        if path:
            path.parent.mkdir(parents=True, exist_ok=True)

    def add(self, cells, row: dict | None = None):
        """A row: a list of cells, or a dictionary with those that CELLS does not make of `row`, an entry of a document."""
        if isinstance(cells, dict):
            cells = [cells[column] if column in cells else CELLS[column](row) for column in self.columns]
        self.rows.append(list(cells))
        print(*cells, sep="  ", flush=True)
        write_csv(self.path, self.columns, self.rows)


def write_csv(path: Path | None, columns: list[str], rows: list[list]):
    """Writes a table; nothing without a path."""
    if path:
        with path.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([columns, *rows])


def read_csv(path: Path) -> list[dict]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def number(value, form: str) -> str:
    return "" if value is None else format(value, form)


def percent(share, digits: int = 1) -> str:
    return number(None if share is None else 100 * share, f".{digits}f")


def cm(value) -> str:
    return number(None if value is None else 100 * value, ".2f")


RIGHT = "0.25/2"
# Cells of an entry of a document, by their column.
CELLS = {
    **{key: (lambda row, key=key.replace(" ", "_"): row[key])
       for key in ("scheme", "queries", "localized", "trusted", "doubtful", "not found", "stress")},
    "trusted wrongly": lambda row: row["trusted_wrong"],
    "negative queries": lambda row: row["queries"],
    "query (bytes)": lambda row: row["sealed_bytes"],
    "hypotheses (median)": lambda row: f"{row['median_hypotheses']:.0f}",
    "median error (cm)": lambda row: cm(row["median_translation"]),
    "median error (°)": lambda row: number(row["median_rotation_deg"], ".3f"),
    "median error (map units)": lambda row: number(row["median_translation"], ".4f"),
    "median ± (cm)": lambda row: cm(row.get("median_position_sd")),
    "within 5 cm and 5° (%)": lambda row: percent(row["recall"]["0.05/5"]),
    "within 25 cm and 2° (%)": lambda row: percent(row["recall"][RIGHT]),
    "inliers (%)": lambda row: percent(row["mean_inlier_ratio"]),
    "log evidence, 99 % quantile": lambda row: number(row["log_evidence"]["99"], ".1f"),
    "log evidence, largest": lambda row: number(row["log_evidence"]["100"], ".1f"),
}  # fmt: skip


class Package:
    """A package that is imported when it is first used, so that commands are listed without it."""

    def __init__(self, name: str):
        self._name = name

    def __getattr__(self, what: str):
        return getattr(importlib.import_module(self._name), what)


def names_of(path: Path) -> list[str]:
    """The first words of a list's lines."""
    return [line.split()[0] for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]


def child_seconds(command, environment=()) -> float:
    """Runs a program with one thread and returns its processor seconds; it must succeed."""
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    child = subprocess.Popen(list(map(str, command)), env={**os.environ, "RAYON_NUM_THREADS": "1", **dict(environment)}, **silent)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = status
    if status != 0:
        raise SystemExit(f"{' '.join(map(str, command))} failed")
    return usage.ru_utime + usage.ru_stime


def processor_seconds() -> float:
    """Processor time of the children that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def one_thread():
    """ONNX Runtime's options for one thread."""
    options = Package("onnxruntime").SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return options


def imports(file: Path) -> set[str]:
    """Packages that a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module.split(".")[0])
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Package":
            names.update(word.value.split(".")[0] for word in node.args if isinstance(word, ast.Constant))
    return names - set(sys.stdlib_module_names) - {"study", "oracles", "veiloc_train"}
