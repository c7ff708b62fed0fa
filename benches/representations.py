"""Speed of dense arrays from Python, beside tonic's, as ratios of one run.

A million random events, sorted by time, at 640 x 480. All take turns, and each counts with its least
time on the processor. tonic comes with ``evis[readers]``; without it, its rows are left away.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import evis

WIDTH, HEIGHT, EVENTS, BINS, REPETITIONS = 640, 480, 1_000_000, 5, 6


def scatter(events: evis.EventArray) -> Any:
    """Make the voxel grid with NumPy, as one writes it down."""
    grid = np.zeros(BINS * HEIGHT * WIDTH, np.float32)
    t, x, y, p = events.columns
    place = (t - t[0]) * (BINS - 1) / (t[-1] - t[0])
    bins = place.astype(np.int64)
    later, sign = place - bins, np.where(p > 0, 1.0, -1.0)
    voxel = (bins * HEIGHT + y) * WIDTH + x
    np.add.at(grid, voxel, sign * (1.0 - later))
    inside = bins + 1 < BINS
    np.add.at(grid, voxel[inside] + HEIGHT * WIDTH, (sign * later)[inside])
    return grid.reshape(BINS, HEIGHT, WIDTH)


def main() -> None:
    """Print Markdown."""
    rng = np.random.default_rng(1)
    columns = [rng.integers(0, limit, EVENTS) for limit in (50_000, WIDTH, HEIGHT, 2)]
    columns[0].sort()
    events = evis.EventArray.from_columns(*columns, width=WIDTH, height=HEIGHT)
    # Name, what runs, and the row that it is compared with.
    rows: list[tuple[str, Callable[[], Any], str]] = [
        ("evis voxel grid", lambda: events.voxel_grid(BINS), "evis voxel grid"),
        ("NumPy voxel grid", lambda: scatter(events), "evis voxel grid"),
        ("evis counts", events.counts, "evis counts"),
        (
            "evis time surfaces, 4 times",
            lambda: events.time_surface(5e3, at_us=[12_499, 24_998, 37_497, 49_996]),
            "evis time surfaces, 4 times",
        ),
    ]
    if importlib.util.find_spec("tonic"):
        from tonic import transforms

        array, size = events.to_numpy(), (WIDTH, HEIGHT, 2)
        rows += [
            ("tonic ToVoxelGrid", lambda: transforms.ToVoxelGrid(size, BINS)(array), "evis voxel grid"),
            ("tonic ToImage", lambda: transforms.ToImage(size)(array), "evis counts"),
            (
                "tonic ToTimesurface, 4 times",
                lambda: transforms.ToTimesurface(size, dt=12_499, tau=5e3)(array),
                "evis time surfaces, 4 times",
            ),
        ]
    seconds = {name: float("inf") for name, _, _ in rows}
    for _ in range(REPETITIONS):
        for name, run, _ in rows:
            # In a row, so that what the row before left in the caches does not count.
            for _ in range(3):
                start = time.thread_time()
                run()
                seconds[name] = min(seconds[name], time.thread_time() - start)
    print("| representation | time | million events/s | times the one of evis |\n|---|---|---|---|")
    for name, _, beside in rows:
        least = seconds[name]
        ratio = least / seconds[beside]
        print(f"| {name} | {least * 1e3:.2f} ms | {EVENTS / least * 1e-6:.1f} | {ratio:.1f} |")


if __name__ == "__main__":
    main()
