#!/usr/bin/env python3
"""Writes docs/reference/flags.md: the help of every command, as the program prints it. Standard library only.

    cargo build --workspace
    scripts/flags_page.py target/debug/veiloc            write the page
    scripts/flags_page.py target/debug/veiloc --check    fail when the page is not what the program says
"""

import argparse
import re
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).resolve().parent.parent / "docs/reference/flags.md"
HEAD = """# Commands and flags

The help of every command, as `veiloc COMMAND --help` prints it.
`scripts/flags_page.py` writes this page; do not edit it.
"""


def help_of(program: str, command: list[str]) -> str:
    # Settings of the caller's environment are shown in the help.
    run = subprocess.run([program, *command, "--help"], capture_output=True, text=True, env={"COLUMNS": "110"}, check=True)
    return "\n".join(line.rstrip() for line in run.stdout.strip().splitlines())


def commands_in(text: str) -> list[str]:
    """Names in the list of subcommands."""
    listed = re.search(r"^Commands:\n(.*?)(?:\n\n|\Z)", text, re.S | re.M)
    names = re.findall(r"^  ([a-z0-9-]+)", listed.group(1), re.M) if listed else []
    return [name for name in names if name != "help"]


def sections(program: str, command: list[str]) -> list[str]:
    text = help_of(program, command)
    own = [f"\n## `{' '.join(['veiloc', *command])}`\n\n```text\n{text}\n```\n"]
    return own + [part for name in commands_in(text) for part in sections(program, [*command, name])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("veiloc", help="the program, built with the whole workspace")
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    arguments = parser.parse_args()
    page = HEAD + "".join(sections(arguments.veiloc, []))
    if not arguments.check:
        PAGE.write_text(page)
    elif not PAGE.exists() or PAGE.read_text() != page:
        sys.exit(f"{PAGE} is not what {arguments.veiloc} says; run {sys.argv[0]} {arguments.veiloc}")


if __name__ == "__main__":
    main()
