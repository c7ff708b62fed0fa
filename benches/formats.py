"""Speed of event files from Python, beside other packages', as ratios of one run.

Two million random events on 1280 x 720, written by EVIS into a file in memory. All take turns, and each
counts with its least time on processors, all threads together. Packages come with ``evis[readers]``; a row
of one that is missing is left away. Each returns the events as it gives them: arrays, packets or columns.
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

WIDTH, HEIGHT, EVENTS, REPETITIONS = 1280, 720, 2_000_000, 4


def events() -> evis.EventArray:
    """Make sorted random events over two seconds."""
    rng = np.random.default_rng(1)
    columns = [rng.integers(0, limit, EVENTS) for limit in (2_000_000, WIDTH, HEIGHT, 2)]
    columns[0].sort()
    return evis.EventArray.from_columns(*columns, width=WIDTH, height=HEIGHT)


def faery(path: str) -> None:
    """Read all packets."""
    import faery

    for _ in faery.events_stream_from_file(path):
        pass


def evutils(path: str) -> None:
    """Read all at once."""
    from evutils.io import EventReader

    for _ in EventReader(path, n_events=1_000_000):
        pass


def expelliarmus(path: str, encoding: str) -> None:
    """Read all at once."""
    from expelliarmus import Wizard

    Wizard(encoding=encoding).read(path)


def aedat(path: str) -> None:
    """Read all packets."""
    from aedat import Decoder

    for _ in Decoder(path):
        pass


def h5py(path: str) -> None:
    """Read all columns."""
    import h5py

    with h5py.File(path) as file:
        for name in "txyp":
            file["events"][name][:]


def text(path: str) -> None:
    """Read all columns."""
    np.loadtxt(path, ndmin=2, skiprows=1)


READERS: dict[str, dict[str, Callable[[str], Any]]] = {
    "raw": {
        "faery": faery,
        "evutils": evutils,
        "expelliarmus": lambda path: expelliarmus(path, "evt3"),
    },
    "dat": {"faery": faery, "evutils": evutils, "expelliarmus": lambda path: expelliarmus(path, "dat")},
    "aedat4": {"faery": faery, "aedat": aedat},
    "npy": {"numpy": np.load},
    "h5": {"h5py": h5py},
    "txt": {"numpy": text},
}


def main() -> None:
    """Print Markdown."""
    stream = events()
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        print("| file | reader | time | million events/s | times the one of evis |\n|---|---|---|---|---|")
        for ending, others in READERS.items():
            path = str(Path(folder) / f"events.{ending}")
            evis.save(path, stream)
            readers = {"evis": lambda path: evis.load(path).events} | {
                name: read for name, read in others.items() if importlib.util.find_spec(name)
            }
            seconds = dict.fromkeys(readers, float("inf"))
            for _ in range(REPETITIONS if ending != "txt" else 1):
                for name, read in list(readers.items()):
                    start = time.process_time()
                    try:
                        read(path)
                    except Exception as error:
                        print(f"{name} does not read .{ending}: {error}", file=sys.stderr)
                        del readers[name], seconds[name]
                        continue
                    seconds[name] = min(seconds[name], time.process_time() - start)
            for name, least in seconds.items():
                rate, ratio = EVENTS / least * 1e-6, least / seconds["evis"]
                print(f"| {ending} | {name} | {least * 1e3:.0f} ms | {rate:.1f} | {ratio:.1f} |", flush=True)


if __name__ == "__main__":
    main()
