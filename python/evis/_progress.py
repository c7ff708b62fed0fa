"""Progress of work that lasts, with the time that is left."""

from __future__ import annotations

import sys
import time
from types import TracebackType

_EVERY_S = 0.1
_LINE_EVERY_S = 10.0
_LEAST_S = 1.0
_CELLS = 30


class TimeLeft:
    """The time left, which never rises: an estimate that grows stays where it was."""

    def __init__(self) -> None:
        self._least_s: float | None = None

    def after(self, elapsed_s: float, share: float) -> float | None:
        """Return the seconds left after ``elapsed_s``, ``share`` of the work done; None if not known."""
        if elapsed_s >= _LEAST_S and share > 0:
            left_s = elapsed_s * (1 - share) / share
            self._least_s = left_s if self._least_s is None else min(self._least_s, left_s)
        return self._least_s


class Progress:
    """A bar on standard error; where that is no terminal, a line every ten seconds.

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
        self._shown = shown and sys.stderr is not None
        self._is_terminal = self._shown and sys.stderr.isatty()
        self._start = self._drawn = time.monotonic()
        self._left = TimeLeft()
        self._done = 0
        self._note = ""

    def advance(self, units: int = 1, note: str = "") -> None:
        """Count ``units`` of work as done; ``note`` stands behind the bar, such as a rate."""
        self._note = f", {note}" if note else ""
        self.reach(self._done + units)

    def reach(self, done: int) -> None:
        """Count ``done`` units of work as done, all together."""
        self._done = done
        now = time.monotonic()
        if not self._shown:
            return
        if self._is_terminal and (now - self._drawn > _EVERY_S or self._done >= self._total):
            self._drawn = now
            print(f"\r{self.line(now - self._start)}", end="\033[K", file=sys.stderr, flush=True)
        elif not self._is_terminal and now - self._drawn >= _LINE_EVERY_S:
            self._drawn = now
            print(self.line(now - self._start, bar=False), file=sys.stderr, flush=True)

    def line(self, elapsed_s: float, *, bar: bool = True) -> str:
        """Return what is shown after ``elapsed_s`` seconds."""
        share = min(self._done / self._total, 1.0)
        filled = int(share * _CELLS)
        drawn = "#" * filled + "-" * (_CELLS - filled) + " " if bar else ""
        left_s = self._left.after(elapsed_s, share)
        left = "" if left_s is None else f"  {round(left_s) // 60}:{round(left_s) % 60:02d} left"
        return f"{drawn}{share:4.0%}  {self._done} {self._what}{self._note}{left}"

    def __enter__(self) -> Progress:
        """Return the bar."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        self.close()

    def close(self) -> None:
        """Take the bar away."""
        if self._is_terminal:
            print("\r", end="\033[K", file=sys.stderr, flush=True)
