"""What a host pays besides its own kinematics: microseconds per environment and instant, by batch size.

``python benches/host_overhead.py [ENVIRONMENTS ...]`` steps a batch in which every environment has a pose of
one node for each instant. `poses` is Python's part of `Simulator.step`, from arrays to the engine; `engine`
is what the engine does on the processor to prepare the work of its device (`Report.host_ms`), rendering left
out; `rest` is the step without waiting for the device, less these; `rest, counts` the same where packets
carry counts in the place of events.

``--mujoco MODEL.xml`` measures `evis.mujoco.EventRenderer`, per environment and observed step, with every
joint in motion: `observe` is the whole call, `MuJoCo` what its kinematics alone take for the same states, and
`poses` what `render` takes to hand the poses to the engine. Time is the processor's, of this thread.
"""

from __future__ import annotations

import argparse
import statistics
import time
import warnings

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


def measure_mujoco(path: str, environments: int) -> tuple[float, float, float]:
    """Return microseconds per environment and observed step: observe, MuJoCo's kinematics, poses."""
    import mujoco

    import evis.mujoco

    model = mujoco.MjModel.from_xml_path(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        renderer = evis.mujoco.EventRenderer(
            model, 16, 16, environments=environments, rate_hz=RATE_HZ, samples=1, method="native"
        )
    states = []
    for seed in range(environments):
        data = mujoco.MjData(model)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qvel[:] = np.random.default_rng(seed).normal(size=model.nv)
        mujoco.mj_forward(model, data)
        states.append(data)
    renderer.observe(states)
    own = mujoco.MjData(model)
    found: list[tuple[float, float, float]] = []
    for _ in range(2 * STEPS):
        for data in states:
            mujoco.mj_step(model, data)
        start = time.thread_time()
        renderer.observe(states)
        observed = time.thread_time() - start
        start = time.thread_time()
        for data in states:
            own.qpos[:] = data.qpos
            mujoco.mj_kinematics(model, own)
            mujoco.mj_comPos(model, own)
            mujoco.mj_camlight(model, own)
        kinematics = time.thread_time() - start
        start = time.thread_time()
        renderer._rows(renderer._seen[-1].t_us, renderer._seen[-2].t_us)
        found.append((observed, kinematics, time.thread_time() - start))
        # What was rendered is let go of; here it must not grow.
        while len(renderer._seen) > 2:
            renderer._seen.popleft()
    return tuple(  # type: ignore[return-value]
        1e6 * statistics.median(column) / environments for column in zip(*found[5:], strict=True)
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("environments", nargs="*", type=int)
    parser.add_argument("--mujoco", metavar="MODEL.xml")
    arguments = parser.parse_args()
    if arguments.mujoco is not None:
        print("| environments | observe | MuJoCo | poses |\n|--:|--:|--:|--:|")
        for environments in arguments.environments or [1, 8, 64]:
            observe, kinematics, poses = measure_mujoco(arguments.mujoco, environments)
            print(f"| {environments} | {observe:.1f} | {kinematics:.1f} | {poses:.1f} |", flush=True)
        return
    print("| environments | poses | engine | rest | rest, counts |\n|--:|--:|--:|--:|--:|")
    for environments in arguments.environments or [1, 8, 64, 256]:
        poses, engine, rest = measure(environments)
        *_, counted = measure(environments, "counts")
        print(f"| {environments} | {poses:.1f} | {engine:.1f} | {rest:.1f} | {counted:.1f} |", flush=True)


if __name__ == "__main__":
    main()
