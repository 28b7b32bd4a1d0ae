#!/usr/bin/env python3
"""Prints the help of every command of a program as one page of Markdown, for the archive of a release. Standard library only.

    scripts/flags_page.py target/release/veiloc > flags.md
"""

import re
import subprocess
import sys

HEAD = """# Commands and flags

The help of every command, as `veiloc COMMAND --help` prints it.
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


if __name__ == "__main__":
    print(HEAD + "".join(sections(sys.argv[1], [])), end="")
