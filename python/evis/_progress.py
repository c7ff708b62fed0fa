"""A bar for work that lasts, with the time that is left."""

from __future__ import annotations

import sys
import time
from types import TracebackType

_EVERY_S = 0.1
_CELLS = 30


class Progress:
    """A bar on standard error; silent where that is no terminal.

    Parameters
    ----------
    total : int
        Units of work.
    what : str
        What they are.
    shown : bool
        False for no bar.
    """

    def __init__(self, total: int, what: str, *, shown: bool = True) -> None:
        self._total = max(total, 1)
        self._what = what
        self._shown = shown and sys.stderr is not None and sys.stderr.isatty()
        self._start = self._drawn = time.monotonic()
        self._done = 0
        self._note = ""

    def advance(self, units: int = 1, note: str = "") -> None:
        """Count ``units`` of work as done; ``note`` stands behind the bar, such as a rate."""
        self._done += units
        self._note = f", {note}" if note else ""
        now = time.monotonic()
        if self._shown and (now - self._drawn > _EVERY_S or self._done >= self._total):
            self._drawn = now
            print(f"\r{self.line(now - self._start)}", end="\033[K", file=sys.stderr, flush=True)

    def line(self, elapsed_s: float) -> str:
        """Return what is shown after ``elapsed_s`` seconds."""
        share = min(self._done / self._total, 1.0)
        filled = int(share * _CELLS)
        left = round(elapsed_s * (1 - share) / share) if share > 0 else 0
        bar = "#" * filled + "-" * (_CELLS - filled)
        return f"{bar} {share:4.0%}  {self._done} {self._what}{self._note}  {left // 60}:{left % 60:02d} left"

    def __enter__(self) -> Progress:
        """Return the bar."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        if self._shown:
            print("\r", end="\033[K", file=sys.stderr, flush=True)
