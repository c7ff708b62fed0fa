"""Speed of reading event files from Python, beside other packages', as ratios of one run.

Two million random events on 1280 x 720, in files in memory that EVIS wrote. All take turns, and each counts
with its least time on processors, all threads together, from a path to the columns t, x, y and p. Packages
come with ``evis[readers]``; rows of those that are missing are left away.
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import evis

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
# The functions that the tests hold EVIS's files against other packages with.
from readers import ENDINGS, READERS

WIDTH, HEIGHT, EVENTS, REPETITIONS = 1280, 720, 2_000_000, 4

#: Decoded by the tests themselves, in Python.
SKIPPED = {"rosbags"}


def main() -> None:
    """Print Markdown."""
    rng = np.random.default_rng(1)
    columns = [rng.integers(0, limit, EVENTS) for limit in (2_000_000, WIDTH, HEIGHT, 2)]
    columns[0].sort()
    events = evis.EventArray.from_columns(*columns, width=WIDTH, height=HEIGHT)
    memory = Path("/dev/shm")
    print("| file | reader | time | million events/s | times the one of evis |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        for format, others in READERS.items():
            path = Path(folder) / f"{format}.{ENDINGS[format]}"
            evis.save(path, events, format=format)
            readers: dict[str, Callable[[Path], Any]] = {"evis": lambda path: evis.load(path).events.columns}
            readers |= {
                name: read
                for name, read in others.items()
                if name not in SKIPPED and importlib.util.find_spec(name)
            }
            seconds = dict.fromkeys(readers, float("inf"))
            for _ in range(REPETITIONS):
                for name, read in readers.items():
                    start = time.process_time()
                    read(path)
                    seconds[name] = min(seconds[name], time.process_time() - start)
            for name, least in seconds.items():
                rate, ratio = EVENTS / least * 1e-6, least / seconds["evis"]
                print(f"| {format} | {name} | {least * 1e3:.0f} ms | {rate:.1f} | {ratio:.1f} |", flush=True)
            path.unlink()


if __name__ == "__main__":
    main()
