"""The `veiloc` program: the same as the binary of the Rust crate `veiloc-cli`."""

import signal
import sys

from veiloc import _native


def main() -> int:
    """Runs the program with the process's arguments and returns its exit code."""
    # Python's handler would only run after the native call returns.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _native.run_program(["veiloc", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
