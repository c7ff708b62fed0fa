"""Latency of a closed loop: milliseconds per step of a host that moves square and camera, on this machine.

`spinner`, 64 x 64 pixels, steps of 10 ms, `standard`, which takes decoupled sampling where no graphics card
renders; then rendered instants with its settings. What a step of a still scene takes is the fixed part.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import evis

SIZE, STEP_US, STEPS, WARM = (64, 64), 10_000, 100, 10
#: What moves in the scene.
DRIVEN = ["square", "camera"]
#: `standard` by rendered instants.
INSTANTS = {"method": "native", "rate_hz": 4000.0, "adaptive_px": 1.0, "samples": 16, "antialias": "edges"}


def steps(of: Callable[[int], dict[str, Any]], **settings: Any) -> tuple[list[float], int]:
    """Milliseconds of each step that is told what ``of`` says of its end, and the number of events."""
    scene = evis.Scene.builtin("spinner")
    sim = evis.Simulator(scene, size=SIZE, poses=DRIVEN, pose_step_us=STEP_US, **settings)
    took, events = [], 0
    for k in range(1, STEPS + WARM + 1):
        said = of(k)
        start = time.perf_counter()
        packet = sim.step(k * STEP_US, **said)
        if k > WARM:
            took.append((time.perf_counter() - start) * 1e3)
            events += len(packet.events)
    return took, events


def main() -> None:
    """Print Markdown."""
    times = [k * STEP_US for k in range(STEPS + WARM + 1)]
    bodies = evis.Scene.builtin("spinner").bodies(times)
    places = {name: bodies.names.index(name) for name in DRIVEN}

    def moves(k: int) -> dict[str, Any]:
        poses = {name: [*bodies.position[k, i], *bodies.rotation[k, i]] for name, i in places.items()}
        return {"poses": poses}

    def rests(_: int) -> dict[str, Any]:
        return {}

    def blinks(k: int) -> dict[str, Any]:
        return {"visible": {"square": k % 2 == 0}}

    print("| step | median ms | slowest of 20 | events per step |\n|---|--:|--:|--:|")
    methods: list[tuple[str, dict[str, Any]]] = [("standard", {"quality": "standard"})]
    if evis.devices():
        methods.append(("native", INSTANTS))
    for name, settings in methods:
        for what, of in [("moves", moves), ("appears or vanishes", blinks), ("rests: fixed part", rests)]:
            took, events = steps(of, **settings)
            slow = statistics.quantiles(took, n=20)[-1]
            median = statistics.median(took)
            print(f"| `{name}`, {what} | {median:.2f} | {slow:.2f} | {events / STEPS:.0f} |")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
