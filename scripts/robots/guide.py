"""Runs the commands of docs/guide/robots.md in an empty folder, and prints the time of each.

    scripts/robots/guide.py --wheel DIST/veiloc-….whl --place DATA/hololens-office [--csv docs/results/robots/commands.csv]

The wheel stands for `./bindings/python` of the page's first command. Needs CPython 3.11, for which PyPI has rclpy.
"""

import argparse
import csv
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/guide/robots.md"


def commands() -> list[str]:
    """The lines of the first block of the page."""
    block = re.search(r"```sh\n(.*?)```", PAGE.read_text(), re.S)
    lines = block.group(1).strip().splitlines()
    if len(lines) != 10:
        sys.exit(f"{PAGE}: {len(lines)} commands, and the page says ten")
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wheel", type=Path, required=True)
    parser.add_argument("--place", type=Path, required=True)
    parser.add_argument("--csv", type=Path)
    args = parser.parse_args()
    lines, rows = commands(), []
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "bindings").symlink_to(ROOT / "bindings")
        script = ["set -em"]
        for number, line in enumerate(lines):
            script += [line.replace("./bindings/python[ros]", f"{args.wheel.resolve()}[ros]"), f"echo @ {number}"]
        env = {**os.environ, "PLACE": str(args.place.resolve()), "ROS_DOMAIN_ID": str(os.getpid() % 100), "PIP_QUIET": "1",
               "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
        script += ["kill %1", "wait || true"]
        child = subprocess.Popen(["bash", "-c", "\n".join(script)], cwd=folder, env=env, stdout=subprocess.PIPE, text=True, start_new_session=True)
        began = time.monotonic()
        try:
            for text in child.stdout:
                if text.startswith("@ "):
                    number, seconds = text.split()[1], time.monotonic() - began
                    began += seconds
                    rows.append([int(number) + 1, f"`{lines[int(number)]}`", f"{seconds:.1f}"])
                    print(f"{seconds:7.1f} s  {lines[int(number)]}", flush=True)
                else:
                    print(f"           {text}", end="", flush=True)
            if child.wait() != 0:
                sys.exit(f"command {len(rows) + 1} failed: {lines[len(rows)] if len(rows) < len(lines) else 'the end'}")
        finally:
            try:
                os.killpg(child.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
    if args.csv:
        args.csv.parent.mkdir(parents=True, exist_ok=True)
        with args.csv.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([["", "command", "time (s)"], *rows])


if __name__ == "__main__":
    main()
