"""Speed of the emulator from Python, as ratios on this machine.

The scene is I = 0.5 + 0.4 sin(0.3 + 2 pi (x / 41.7 - 9.7 t)), 346 x 260, 200 frames at 1 kHz, C = 0.2. Where
the module ``eventcv`` can be imported, it runs on the same frames.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import evis

WIDTH, HEIGHT, FRAMES, REPETITIONS = 346, 260, 200, 3
PIXELS = WIDTH * HEIGHT * FRAMES


def light(k: int) -> Any:
    """Return light of frame ``k``, 0 to 1, shape (H, W)."""
    x = np.arange(WIDTH)
    row = 0.5 + 0.4 * np.sin(0.3 + 2 * np.pi * (x / 41.7 - 9.7e-3 * k))
    return np.repeat(row[None], HEIGHT, axis=0)


def best(run: Callable[[], int]) -> tuple[float, int]:
    """Return least seconds of several runs, and the number of events."""
    seconds, events = float("inf"), 0
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        events = run()
        seconds = min(seconds, time.perf_counter() - start)
    return seconds, events


def emulate(frames: list[Any], sensor: str, threads: int, **keywords: Any) -> int:
    """Push all frames; return the number of events."""
    emulator = evis.EventEmulator(WIDTH, HEIGHT, sensor, threads=threads)
    return sum(len(emulator.push(frame, 1000 * k, **keywords)) for k, frame in enumerate(frames))


def silent(width: int, height: int) -> float:
    """Return seconds of a push in which nothing fires: the median of 60, each by its least of 40 runs."""
    frames = [np.full((height, width), 0.5 + 0.002 * k, np.float32) for k in range(8)]
    least = [float("inf")] * 61
    for _ in range(40):
        emulator = evis.EventEmulator(width, height, threads=1)
        for k in range(len(least)):
            start = time.perf_counter()
            emulator.push(frames[k % 8], 1000 * k)
            least[k] = min(least[k], time.perf_counter() - start)
    # The first frame sets every reference.
    return float(np.median(least[1:]))


def eventcv(frames: Any) -> int:
    """Run EventCV without noise on an array (N, H, W) of 0 to 1."""
    import eventcv as other

    settings = {"sigma_thres": 0.0, "leak_rate_hz": 0.0, "shot_noise_rate_hz": 0.0, "refractory_us": 0}
    return len(other.simulate(frames, fps=1000.0, cutoff_hz=0.0, **settings))


def main() -> None:
    """Print Markdown."""
    floats = [light(k).astype(np.float32) for k in range(FRAMES)]
    codes = [np.round(light(k) * 255).astype(np.uint8) for k in range(FRAMES)]
    rows: list[tuple[str, Callable[[], int]]] = []
    for threads in (1, 2):
        rows += [
            (f"evis, ideal, float32, {threads} thread(s)", lambda n=threads: emulate(floats, "ideal", n)),
            (
                f"evis, ideal, uint8, {threads} thread(s)",
                lambda n=threads: emulate(codes, "ideal", n, transfer="linear"),
            ),
            (f"evis, v2e, float32, {threads} thread(s)", lambda n=threads: emulate(floats, "v2e", n)),
        ]
    if importlib.util.find_spec("eventcv"):
        stack = np.stack(floats)
        rows.append(("EventCV, noise off, all cores", lambda: eventcv(stack)))
    print("| chain | time | Mpixel/s | million events/s | events |\n|---|---|---|---|---|")
    for name, run in rows:
        seconds, events = best(run)
        pixels, fired = PIXELS / seconds * 1e-6, events / seconds * 1e-6
        print(f"| {name} | {seconds * 1e3:.0f} ms | {pixels:.0f} | {fired:.1f} | {events} |")
    print("\n| silent frames, float32, 1 thread | per push | Mpixel/s |\n|---|---|---|")
    for width, height in ((WIDTH, HEIGHT), (1280, 720)):
        seconds = silent(width, height)
        print(f"| {width}x{height} | {seconds * 1e6:.1f} us | {width * height / seconds * 1e-6:.0f} |")


if __name__ == "__main__":
    main()
