"""Set a real recording beside a simulation of its kind: fills docs/real-recording.md and draws its picture.

Usage: tools/real_recording.py ASSETS   (the folder that has recordings/davis346_board_346x260.npz)
"""

from __future__ import annotations

import datetime
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import evis
from evis._pictures import polarity_picture
from evis.motion import Keys, Placement

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "real-recording.md"
PICTURE = ROOT / "docs" / "images" / "real-recording.jpg"
RECORDING = "recordings/davis346_board_346x260.npz"
SENSORS = ("ideal", "davis346", "v2e-noisy")
SIZE = (346, 260)


def board(seed: int = 0) -> Any:
    """Return 4x3 square tags, each of 6x6 cells in a black frame, on white paper; linear light."""
    random = np.random.RandomState(seed)
    texels, paper, ink = 10, 0.8, 0.04
    tag, gap = 8, 3
    cells = np.full((gap + 3 * (tag + gap), gap + 4 * (tag + gap)), paper, np.float32)
    for row in range(3):
        for column in range(4):
            y, x = gap + row * (tag + gap), gap + column * (tag + gap)
            cells[y : y + tag, x : x + tag] = ink
            inside = random.random_sample((6, 6)) < 0.5
            cells[y + 1 : y + 7, x + 1 : x + 7][inside] = paper
    return cells.repeat(texels, 0).repeat(texels, 1)


def scene() -> evis.Scene:
    """Make a board that a hand moves up and down, with small turns, before a grey wall."""
    builder = evis.SceneBuilder("board", duration=1.0)
    builder.texture("tags", board(), wrap="clamp")
    builder.material("tags", model="unlit", texture="tags")
    builder.material("wall", model="unlit", color=(0.25, 0.25, 0.25))
    builder.card("wall", size=(6, 6), material="wall", pose=Placement(position=(0, 0, -2)))
    t = np.linspace(0, 1, 81)
    w = 2 * np.pi
    heave, sway = 0.10 * np.sin(1.3 * w * t), 0.03 * np.sin(0.9 * w * t + 1)
    angle = np.radians(8 + 3 * np.sin(0.8 * w * t))
    rotations = np.stack([0 * t, 0 * t, -np.sin(angle / 2), np.cos(angle / 2)], axis=-1)
    velocity = [0.03 * 0.9 * w * np.cos(0.9 * w * t + 1), 0.10 * 1.3 * w * np.cos(1.3 * w * t), 0 * t]
    motion = Keys(
        times_s=t,
        positions=np.stack([sway, heave, 0 * t], axis=-1),
        velocities=np.stack(velocity, axis=-1),
        rotations=rotations,
        interpolation="hermite",
    )
    builder.card(
        "board", size=(0.94, 0.72), material="tags", pose=Placement(position=(0, 0, -1), motion=motion)
    )
    builder.camera(evis.EventCamera(name="eye", width=SIZE[0], height=SIZE[1], fov_y_degrees=50))
    return builder.build()


def numbers(events: evis.EventArray, seconds: float) -> tuple[float, float, float]:
    """Return events per pixel and second, the share of ON, and how often a pixel's next event differs."""
    place = events.y.astype(np.int64) * events.width + events.x
    order = np.argsort(place, kind="stable")
    same = np.diff(place[order]) == 0
    differs = np.diff(events.p[order].astype(np.int64)) != 0
    return (
        len(events) / (events.width * events.height * seconds),
        float(events.p.mean()),
        float(differs[same].mean()),
    )


def intervals(events: evis.EventArray) -> tuple[Any, Any]:
    """Return edges in seconds and the density of times between a pixel's events, per decade."""
    place = events.y.astype(np.int64) * events.width + events.x
    order = np.argsort(place, kind="stable")
    gaps = np.diff(events.t[order])[np.diff(place[order]) == 0] / 1e6
    edges = np.geomspace(1e-5, 1, 41)
    found, _ = np.histogram(gaps, edges)
    return edges, found / max(found.sum(), 1) / np.diff(np.log10(edges))


def main() -> int:
    """Simulate, count, draw, and fill the page."""
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    real = evis.load(Path(sys.argv[1]) / RECORDING, width=SIZE[0], height=SIZE[1]).events
    streams = {"real": real.slice_time(0, 1_000_000)}
    made = scene()
    for name in SENSORS:
        sim = evis.Simulator(made, sensor=name, rate_hz=1000.0, samples=4, seed=1)
        streams[name] = sim.step(1_000_000).view.events
        print(name, len(streams[name]), flush=True)

    figure = Figure(figsize=(8, 6.4), dpi=100, layout="constrained")
    for name, place in zip(streams, figure.subplots(2, 2).flat, strict=True):
        shown = streams[name].slice_time(700_000, 715_000)
        place.imshow(polarity_picture(shown.to_numpy(), SIZE), interpolation="nearest")
        place.set_title(f"{name}, 15 ms", fontsize=9)
        place.set_xticks([])
        place.set_yticks([])
    keep(figure, PICTURE)
    figure = Figure(figsize=(6, 3), dpi=100, layout="constrained")
    axis = figure.subplots()
    for name, events in streams.items():
        edges, density = intervals(events)
        axis.stairs(density, edges, label=name, linewidth=2 if name == "real" else 1)
    axis.set_xscale("log")
    axis.set_xlabel("time between two events of a pixel, seconds")
    axis.set_ylabel("share per decade")
    axis.legend(fontsize=8)
    keep(figure, PICTURE.with_stem("real-recording-intervals"))

    rows = [
        "| | events per pixel and second | share of ON | next event has the other polarity |",
        "|---|---|---|---|",
    ]
    for name, events in streams.items():
        rate, on, other = numbers(events, 1.0)
        title = "real DAVIS346" if name == "real" else f"simulated, `{name}`"
        rows.append(f"| {title} | {rate:.2f} | {on:.3f} | {other:.3f} |")
    device = evis.devices()[0].name
    rows.append("")
    rows.append(f"`make real-recording`, {datetime.date.today().isoformat()}, {device}.")
    text = PAGE.read_text("utf-8")
    filled = re.sub(
        r"(<!-- real -->\n).*?(<!-- /real -->)",
        lambda m: m[1] + "\n".join(rows) + "\n" + m[2],
        text,
        flags=re.DOTALL,
    )
    PAGE.write_text(filled, "utf-8")
    print("\n".join(rows))
    return 0


def keep(figure: Figure, path: Path) -> None:
    """Write a figure as a small JPEG."""
    from PIL import Image

    raw = path.with_suffix(".png")
    figure.savefig(raw)
    Image.open(raw).convert("RGB").save(path, quality=80, optimize=True)
    raw.unlink()


if __name__ == "__main__":
    sys.exit(main())
