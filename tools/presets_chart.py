"""Draw cost against error of the quality presets, docs/images/presets.svg, from the table of accuracy.md.

Usage: tools/presets_chart.py
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "accuracy.md"
PICTURE = ROOT / "docs" / "images" / "presets.svg"
STREAM_S = 0.05
"""What rows simulate, but for the finest ones on two scenes."""
FINE = "rendered finely: 0.2 px, 144 samples, shadow rays"
FINE_STREAM_S = {"street": 0.03, "warehouse": 0.03}
SERIES = {
    "decoupled sampling: draft, standard, high": (r"`(draft|standard|high)` \(decoupled", "#0072b2", "o"),
    "rendered without a GPU, steps of 1 and 0.5 px": (
        r"(`draft` rendered|rendering 0\.5 px)",
        "#d55e00",
        "s",
    ),
    FINE: (r"0\.2 px, 144 samples, rays", "#009e73", "^"),
}

Points = dict[str, list[tuple[float, float]]]


def rows(page: str) -> list[tuple[str, str, float, float]]:
    """Return settings, scene, F1 within 1 ms and processor seconds of the table of the presets."""
    table = page.split("| settings | scene | F1 |")[1].split("\n\n")[0]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]
    return [(each[0], each[1].strip("`"), float(each[2]), float(each[8])) for each in cells]


def points(page: str, name: str) -> Points:
    """Return (core-seconds per simulated second, 1 - F1) by scene, of a series."""
    found: Points = defaultdict(list)
    for settings, scene, f1, seconds in rows(page):
        if re.match(SERIES[name][0], settings):
            stream_s = FINE_STREAM_S.get(scene, STREAM_S) if name == FINE else STREAM_S
            found[scene].append((seconds / stream_s, 1 - f1))
    return found


def drawn(page: str) -> str:
    """Return all numbers that are drawn; the picture holds them as its description."""
    return repr([dict(points(page, name)) for name in SERIES])


def draw(page: str) -> Any:
    """Return the picture, a figure of matplotlib."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator, NullLocator

    figure = Figure(figsize=(7.5, 4.2), layout="constrained")
    axes = figure.subplots()
    for name, (_, colour, marker) in SERIES.items():
        label = name
        for scene, places in points(page, name).items():
            costs, errors = zip(*sorted(places), strict=True)
            axes.plot(costs, errors, color=colour, marker=marker, markersize=5, label=label)
            label = "_"  # a line of the legend per series
            at, offset, side = (0, (0, 6), "center") if marker == "s" else (-1, (6, 2), "left")
            if (name, scene) == (FINE, "spinner"):
                offset, side = (-6, -4), "right"
            place = (costs[at], errors[at])
            axes.annotate(scene, place, offset, textcoords="offset points", ha=side, color=colour)
    axes.axhline(0.02, color="black", linewidth=1, linestyle="--", label="F1 0.98")
    axes.set(xscale="log", yscale="log", xlim=(20, 16_000), ylim=(0.0008, 0.4))
    for axis, ticks in (
        (axes.xaxis, (20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000)),
        (axes.yaxis, (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)),
    ):
        axis.set_major_locator(FixedLocator(ticks))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
    axes.set_xlabel("core-seconds per simulated second, 640x480 (less is better)")
    axes.set_ylabel("error of events: 1 - F1 within 1 ms")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", frameon=False)
    return figure


def main() -> None:
    """Draw it."""
    import matplotlib as mpl

    # The same picture for the same numbers.
    mpl.rcParams["svg.hashsalt"] = "evis"
    page = PAGE.read_text("utf-8")
    draw(page).savefig(PICTURE, metadata={"Date": None, "Description": drawn(page)})


if __name__ == "__main__":
    main()
