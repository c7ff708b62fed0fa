"""Instants per second of a MuJoCo robot: this renderer beside MuJoCo's own software OpenGL.

``python benches/mujoco_renderer.py MODEL.xml [--camera INDEX]`` runs both in turn, on the same machine, at
346x260 and 500 instants per simulated second. MuJoCo's side needs OSMesa (Debian: ``libosmesa6``).
"""

from __future__ import annotations

import argparse
import os
import time
import warnings

os.environ.setdefault("MUJOCO_GL", "osmesa")

import mujoco
import numpy as np

import evis.mujoco

WIDTH, HEIGHT, RATE_HZ = 346, 260, 500.0


def started(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the first keyframe, or the start, with every joint in motion: about 1 rad/s and 1 m/s."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv)
    mujoco.mj_forward(model, data)
    return data


def own(model: mujoco.MjModel, camera: int, shadows: bool, instants: int) -> float:
    """Return frames per second of MuJoCo's renderer, without physics."""
    data = started(model)
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        renderer.update_scene(data, camera)
        renderer.render()
        took = 0.0
        for k in range(instants):
            while data.time < (k + 1) / RATE_HZ:
                mujoco.mj_step(model, data)
            start = time.perf_counter()
            renderer.update_scene(data, camera)
            renderer.render()
            took += time.perf_counter() - start
    return instants / took


def events(
    model: mujoco.MjModel, camera: int, instants: int, settings: dict[str, object]
) -> tuple[float, int]:
    """Return instants per second of the event renderer, physics left out, and the events."""
    data = started(model)
    with evis.mujoco.EventRenderer(
        model, HEIGHT, WIDTH, camera=camera, pose_step_us=8000, **settings
    ) as renderer:
        renderer.observe(data)
        took, count = 0.0, 0
        # The first portion builds pipelines and draws everything.
        for portion in range(1 + instants // 4):
            while data.time < 0.008 * (portion + 1) - 1e-9:
                mujoco.mj_step(model, data)
                start = time.perf_counter()
                renderer.observe(data)
                took += (time.perf_counter() - start) * (portion > 0)
            start = time.perf_counter()
            found = renderer.render()
            if portion:
                took += time.perf_counter() - start
                count += len(found)
    return (instants // 4 * 4) / took, count


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("model")
    parser.add_argument("--camera", type=int, default=-1)
    parser.add_argument("--instants", type=int, default=100)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    model = mujoco.MjModel.from_xml_path(arguments.model)
    few = max(arguments.instants // 10, 4)
    for shadows in (True, False):
        model.light_castshadow[:] = model.light_castshadow.astype(bool) & shadows
        print(f"shadows {'on' if shadows else 'off'}")
        frames = own(model, arguments.camera, shadows, few)
        print(f"  MuJoCo, OSMesa, offsamples {model.vis.quality.offsamples}: {frames:.1f} frames/s")
        for samples in (1, 4):
            for adaptive_px in (None, 0.3):
                settings = {"rate_hz": RATE_HZ, "samples": samples, "adaptive_px": adaptive_px}
                rate, count = events(model, arguments.camera, arguments.instants, settings)
                how = "every tile" if adaptive_px is None else f"adaptive {adaptive_px} px"
                print(
                    f"  evis, {samples} sample(s), {how}: {rate:.1f} instants/s, {rate / frames:.1f} times; "
                    f"{count} events"
                )


if __name__ == "__main__":
    main()
