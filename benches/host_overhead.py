"""What a host pays besides its own kinematics: microseconds per environment and instant, by batch size.

``python benches/host_overhead.py [ENVIRONMENTS ...]`` steps a batch in which every environment has a pose of
one node for each instant. `poses` is Python's part of `Simulator.step`, from arrays to the engine; `engine`
is what the engine does on the processor to prepare the work of its device (`Report.host_ms`), rendering left
out; `rest` is the step without waiting for the device, less these; `rest, counts` the same where packets
carry counts in the place of events.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

import evis
from evis import _poses
from evis.motion import Placement

RATE_HZ, STEP_US, STEPS = 500.0, 10_000, 40
INSTANTS = round(STEP_US * 1e-6 * RATE_HZ)


def scene(environments: int) -> evis.Scene:
    """Return a checkered cube before a camera of 16x16 pixels, so many times."""
    builder = evis.SceneBuilder("overhead", ambient=(1.0, 1.0, 1.0))
    builder.texture("checker", pattern="checker")
    builder.material("painted", texture="checker")
    builder.box("cube", size=(0.8, 0.8, 0.8), material="painted")
    builder.camera(evis.EventCamera(name="eye", width=16, height=16, pose=Placement(position=(0, 0, 3))))
    builder.environments(environments)
    return builder.build()


def measure(environments: int, dense: str | None = None) -> tuple[float, float, float]:
    """Return microseconds per environment and instant: poses, engine, rest."""
    sim = evis.Simulator(
        scene(environments),
        poses=["cube"],
        rate_hz=RATE_HZ,
        samples=1,
        reference_luminance=1.0,
        method="native",
        dense=dense,
    )
    found: list[tuple[float, float, float]] = []
    for step in range(1, STEPS + 1):
        times = (step - 1) * STEP_US + np.arange(1, INSTANTS + 1) * round(1e6 / RATE_HZ)
        poses = np.zeros((environments, INSTANTS, 7))
        poses[..., 6] = 1.0
        poses[..., 0] = 0.3 * np.sin(times * 1e-5)
        start = time.perf_counter()
        _poses.node_poses(["cube"], environments, step * STEP_US, {"cube": poses}, times, None)
        given_ms = 1e3 * (time.perf_counter() - start)
        start = time.perf_counter()
        packet = sim.step(step * STEP_US, {"cube": poses}, pose_times_us=times)
        took_ms = 1e3 * (time.perf_counter() - start)
        report = packet.report
        rest_ms = took_ms - given_ms - report.host_ms - report.device_wait_ms
        found.append((given_ms, report.host_ms, rest_ms))
    # The first steps build what later ones use.
    return tuple(  # type: ignore[return-value]
        1e3 * statistics.median(column) / (environments * INSTANTS) for column in zip(*found[5:], strict=True)
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("environments", nargs="*", type=int, default=[1, 8, 64, 256])
    print("| environments | poses | engine | rest | rest, counts |\n|--:|--:|--:|--:|--:|")
    for environments in parser.parse_args().environments:
        poses, engine, rest = measure(environments)
        *_, counted = measure(environments, "counts")
        print(f"| {environments} | {poses:.1f} | {engine:.1f} | {rest:.1f} | {counted:.1f} |", flush=True)


if __name__ == "__main__":
    main()
