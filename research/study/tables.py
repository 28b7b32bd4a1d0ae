"""Writes the tables of docs/results from the CSV files beside the pages.

    python3 research/study tables               # writes every table
    python3 research/study tables --check       # writes nothing; fails when a table is not what its CSV file says
    python3 research/study tables --print FILE  # prints all rows of one CSV file as Markdown

A page names a table's file, relative to the page, and the script fills the lines between two comments:

    <!-- table: poses/solvers.csv -->
    <!-- end -->

A page shows at most 12 rows. Of a larger file it selects rows by the values of columns, and columns by their names:

    <!-- table: trust/stress.csv | where scene = RedKitchen; Herz-Jesu | where stress = none | columns scene; queries -->

A link to the whole file follows such a table. `columns -a; b` leaves columns out.
The first line of a CSV file is the header, with units; numbers are plain. A column is aligned to the right when all its
cells are numbers or empty. A page has no table outside such comments, and a CSV file belongs to a page, which has its table or,
where that would be long, a link to it: both are checked.
"""

import argparse
import csv
import re
import sys
from pathlib import Path

from study.common import RESULTS

BEGIN = re.compile(r"<!-- table: (\S+)((?: \| [^|]+)*) -->")
MOST_ROWS = 12
END = "<!-- end -->"
LINK = re.compile(r"\]\((\S+\.csv)\)")
NUMBER = re.compile(r"-?[0-9]+(\.[0-9]+)?")


class WrongTable(Exception):
    """A page or a CSV file that is not as the head of this file says."""


def selected(rows: list[list[str]], selection: str) -> list[list[str]]:
    """Header and rows that the clauses of a table's comment select."""
    header = rows[0]

    def index(name: str) -> int:
        if name not in header:
            raise WrongTable(f"no column {name!r}")
        return header.index(name)

    for clause in filter(None, selection.split(" | ")):
        kind, _, what = clause.strip().partition(" ")
        if kind == "where":
            name, _, values = what.partition(" = ")
            column, kept = index(name), values.split("; ")
            missing = set(kept) - {row[column] for row in rows[1:]}
            if missing:
                raise WrongTable(f"no row has {name} = {', '.join(sorted(missing))}")
            rows = [rows[0], *(row for row in rows[1:] if row[column] in kept)]
        elif kind == "columns":
            columns = [index(name) for name in what.removeprefix("-").split("; ")]
            if what.startswith("-"):
                columns = [column for column in range(len(header)) if column not in columns]
            rows = [[row[column] for column in columns] for row in rows]
            header = rows[0]
        else:
            raise WrongTable(f"unknown clause {clause!r}")
    return rows


def table_lines(path: Path, selection: str = "", limit: int | None = None) -> list[str]:
    """The Markdown lines of the selected part of one CSV file."""
    if not path.is_file():
        raise WrongTable(f"no file {path.name}")
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    if len(rows) < 2:
        raise WrongTable(f"{path.name} has no rows")
    header = rows[0]
    if len(set(header)) != len(header):
        raise WrongTable(f"{path.name}: two columns have one name")
    for number, row in enumerate(rows, start=1):
        if len(row) != len(header):
            raise WrongTable(f"{path.name}, row {number}: {len(row)} cells in place of {len(header)}")
        if any("|" in cell or "\n" in cell for cell in row):
            raise WrongTable(f"{path.name}, row {number}: a cell holds | or a line break")
    whole = (len(rows) - 1, len(header))
    rows = selected(rows, selection)
    header = rows[0]
    if limit and len(rows) - 1 > limit:
        raise WrongTable(f"{path.name}: {len(rows) - 1} rows are shown, more than {limit}")
    aligned = []
    for column in range(len(header)):
        cells = [row[column] for row in rows[1:] if row[column]]
        aligned.append("--:" if cells and all(NUMBER.fullmatch(cell) for cell in cells) else "---")
    lines = ["| " + " | ".join(header) + " |", "|" + "|".join(aligned) + "|"]
    lines += ["| " + " | ".join(row) + " |" for row in rows[1:]]
    if (len(rows) - 1, len(header)) != whole:
        lines += ["", f"[All {whole[0]} rows, {whole[1]} columns]({path.parent.name}/{path.name})"]
    return lines


def filled(page: Path, used: set[Path]) -> str:
    """The page's text with every table as its CSV file has it; the files are added to `used`."""
    lines: list[str] = []
    inside = fenced = False
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        begin = BEGIN.fullmatch(line)
        if begin and inside:
            raise WrongTable(f"line {number}: a table begins before the last one ends")
        if begin:
            path = page.parent / begin.group(1)
            lines += [line, *table_lines(path, begin.group(2), MOST_ROWS)]
            used.add(path)
            inside = True
        elif line == END:
            if not inside:
                raise WrongTable(f"line {number}: a table ends that did not begin")
            lines.append(line)
            inside = False
        elif not inside:
            fenced ^= line.startswith("```")
            if line.startswith("|") and not fenced:
                raise WrongTable(f"line {number}: a table without a CSV file")
            used.update(page.parent / link for link in LINK.findall(line))
            lines.append(line)
    if inside:
        raise WrongTable("the last table does not end")
    return "\n".join(lines) + "\n"


def main(words: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="study tables", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; fail when a page is not as its CSV files say")
    parser.add_argument("--print", type=Path, metavar="FILE", help="print one CSV file as Markdown")
    args = parser.parse_args(words)
    if args.print:
        print("\n".join(table_lines(args.print)))
        return 0
    check = args.check
    faults = []
    used: set[Path] = set()
    for page in sorted(RESULTS.glob("*.md")):
        try:
            text = filled(page, used)
        except WrongTable as fault:
            faults.append(f"docs/results/{page.name}: {fault}")
            continue
        if text == page.read_text(encoding="utf-8"):
            continue
        if check:
            faults.append(f"docs/results/{page.name}: a table is not what its CSV file says; run python3 research/study tables")
        else:
            page.write_text(text, encoding="utf-8")
            print(f"docs/results/{page.name}: written")
    if not faults:
        for path in sorted(set(RESULTS.rglob("*.csv")) - used):
            faults.append(f"docs/results/{path.relative_to(RESULTS)}: no page shows it")
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0
