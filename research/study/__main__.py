"""Makes the tables of docs/results, and writes them into its pages.

    python3 research/study PAGE             the commands of a page, with what each writes
    python3 research/study PAGE NAME […]    one of them; `--help` lists its options
    python3 research/study figures […]      makes tables, and notes the commit, command and machine of each
    python3 research/study tables [--check] writes the tables of the CSV files into the pages
    python3 research/study paper FILE       the paper's tables for a document of results
    python3 research/study compare A B      which differences of two runs are more than chance
    python3 research/study bound            errors beside the Cramér–Rao bound

The pages are poses, privacy, trust, places, features, mapping, peers, scale, service, packs, inversion, robots, and readme. Data are those of VEILOC_DATA, the program is
target/release/veiloc. Rows are printed, and written with `--out docs/results`. `python3 -m study`, from research/, is the same.
"""

import importlib
import sys
from pathlib import Path

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from study import common, figures, tables  # noqa: E402

PAGES = ["poses", "privacy", "trust", "places", "features", "mapping", "peers", "scale", "service", "packs", "inversion", "robots", "readme"]


def main(page: str = "--help", *words: str):
    if page == "figures":
        return figures.main(PAGES, list(words))
    if page == "tables":
        return tables.main(list(words))
    if page in ("paper", "compare", "bound"):
        return importlib.import_module(f"study.{page}").main(list(words))
    if page not in PAGES:
        print(__doc__.strip())
        return page not in ("--help", "-h")
    importlib.import_module(f"study.{page}")
    commands = {name: command for (of, name), command in common.COMMANDS.items() if of == page}
    if not words or words[0] not in commands:
        for name, command in commands.items():
            print(f"{name:20} {(command.make.__doc__ or '').splitlines()[0]:90} {' '.join(command.tables)}")
        return bool(words) and words[0] not in ("--help", "-h")
    run = common.parse(commands[words[0]], list(words[1:]))
    return commands[words[0]].make(run)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
