"""Progress bar of long calls, if tqdm is installed."""

import sys
from typing import Any


class ProgressBar:
    """A bar for `progress=`: `Map.build(..., progress=veiloc.ProgressBar())`. Needs tqdm.

    Raises:
        ImportError: tqdm is not installed.
    """

    def __init__(self) -> None:
        from tqdm.auto import tqdm

        self._new = tqdm
        self._bar: Any = None
        self._stage = ""

    def __call__(self, stage: str, done: int, total: int) -> None:
        if self._bar is None or stage != self._stage:
            self.close()
            self._stage, self._bar = stage, self._new(total=total, desc=stage)
        self._bar.update(done - self._bar.n)
        if done >= total:
            self.close()

    def close(self) -> None:
        """Closes the bar on the screen."""
        if self._bar is not None:
            self._bar.close()
        self._bar = None


def default_progress() -> "ProgressBar | None":
    """Default of `progress=`: a bar in a notebook with tqdm, otherwise nothing."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is None or not hasattr(shell, "kernel"):
        return None
    try:
        return ProgressBar()
    except ImportError:
        return None
