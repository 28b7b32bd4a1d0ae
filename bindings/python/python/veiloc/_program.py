"""The `veiloc` program: the same as the binary of the Rust crate `veiloc-cli`."""

import signal
import sys

from veiloc import _native


def main() -> int:
    """Runs the program with the process's arguments and returns its exit code."""
    # The program prints and waits by itself: Ctrl-C ends it as it ends any program.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _native.run_program(["veiloc", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
