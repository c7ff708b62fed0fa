"""Accuracy and cost of a MuJoCo robot's events: `EventRenderer` as it comes, and `native`, beside the truth.

``python benches/mujoco_accuracy.py MODEL.xml [--camera INDEX]`` simulates a model, renders it by each method,
and scores the events against the oracle, which traces rays through a copy of the scene whose bodies move as
MuJoCo moved them (an animation in its glTF file). Cost is processor time of `observe` and `render`.
"""

from __future__ import annotations

import argparse
import json
import re
import struct
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

import evis
import evis.mujoco

#: Poses of each body, (T, 7), at times in seconds, (T,).
Motion = dict[str, tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]]
#: `native` as `EventRenderer` would have it without decoupled sampling.
METHODS: dict[str, dict[str, Any]] = {
    "as it comes": {},
    "native": {"method": "native"},
    "native, 1 px, 16 coverage samples": {
        "method": "native",
        "rate_hz": 4000.0,
        "adaptive_px": 1.0,
        "samples": 16,
        "antialias": "edges",
    },
}


def started(model: mujoco.MjModel, speed: float) -> mujoco.MjData:
    """Return the first keyframe, or the start, with every joint in motion: about `speed` rad/s and m/s."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qvel[:] = speed * np.random.default_rng(0).normal(size=model.nv)
    mujoco.mj_forward(model, data)
    return data


def render(
    model: mujoco.MjModel, arguments: argparse.Namespace, settings: dict[str, Any]
) -> tuple[evis.mujoco.EventRenderer, npt.NDArray[Any], Motion, float]:
    """Return the renderer, its events, the poses that it was given, and its processor seconds."""
    data = started(model, arguments.speed)
    width, height = arguments.size
    renderer = evis.mujoco.EventRenderer(
        model, height, width, camera=arguments.camera, pose_step_us=arguments.portion_us, **settings
    )
    given: list[tuple[list[int], dict[str, Any]]] = []
    step = renderer.simulator.step

    def noted(until_us: int, poses: Any = None, **rest: Any) -> Any:
        given.append((list(rest.get("pose_times_us", ())), poses or {}))
        return step(until_us, poses, **rest) if poses else step(until_us)

    renderer.simulator.step = noted  # type: ignore[method-assign]
    renderer.observe(data)
    parts, took = [], 0.0
    while data.time < arguments.duration - 1e-9:
        mujoco.mj_step(model, data)
        began = time.process_time()
        renderer.observe(data)
        parts.append(renderer.render())
        took += time.process_time() - began
    motion: Motion = {}
    for name in given[0][1]:
        times = np.concatenate([np.asarray(times) for times, _ in given]) * 1e-6
        motion[name] = times, np.concatenate([poses[name][0] for _, poses in given])
    return renderer, np.concatenate([np.asarray(part) for part in parts]), motion, took


def animated(glb: bytes, motion: Motion) -> bytes:
    """Return a GLB file whose nodes move."""
    length, _ = struct.unpack_from("<II", glb, 12)
    document = json.loads(glb[20 : 20 + length])
    binary = bytearray(glb[20 + length + 8 :])
    names = {node.get("name"): index for index, node in enumerate(document["nodes"])}
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []

    def accessor(values: npt.NDArray[np.float64], kind: str) -> int:
        binary.extend(b"\0" * (-len(binary) % 4))
        data = values.astype("<f4").tobytes()
        document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary.extend(data)
        made = {"bufferView": len(document["bufferViews"]) - 1, "componentType": 5126, "type": kind}
        bounds = {"min": [float(values.min())], "max": [float(values.max())]} if kind == "SCALAR" else {}
        document["accessors"].append({**made, "count": len(values), **bounds})
        return len(document["accessors"]) - 1

    for name, (times, poses) in motion.items():
        if name not in names:
            continue
        node = document["nodes"][names[name]]
        # Poses are those in the world: no other body may carry the node.
        named = [other for other in document["nodes"] if other.get("name")]
        carried = {child for other in named for child in other.get("children", ())}
        if "matrix" in node or names[name] in carried:
            raise SystemExit(f"the node {name} cannot be animated: it has a matrix, or hangs on another body")
        clock = accessor(times, "SCALAR")
        for path, values, kind in [
            ("translation", poses[:, :3], "VEC3"),
            ("rotation", poses[:, 3:], "VEC4"),
        ]:
            samplers.append({"input": clock, "output": accessor(values, kind), "interpolation": "LINEAR"})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": names[name], "path": path}})
    document["animations"] = [{"channels": channels, "samplers": samplers}]
    document["buffers"][0]["byteLength"] = len(binary)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary.extend(b"\0" * (-len(binary) % 4))
    head = struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(binary))
    parts = [(0x4E4F534A, text), (0x004E4942, bytes(binary))]
    return head + b"".join(struct.pack("<II", len(part), kind) + part for kind, part in parts)


def moved(text: str, motion: Motion, folder: Path) -> str:
    """Return a scene file whose cameras and lights move."""
    for number, (name, (times, poses)) in enumerate(motion.items()):
        found = re.search(r"\{[^{}]*name = " + re.escape(json.dumps(name)) + r"[^{}]*\}", text)
        if found is None:
            continue
        rows = np.column_stack([times, poses]).tolist()
        lines = "".join(" ".join(map(repr, row)) + "\n" for row in rows)
        (folder / f"{number}.txt").write_text(lines)
        still = re.sub(r"(position|rotation) = \[[^\]]*\],? ?", "", found.group()).rstrip("} ,")
        motions = f'{{ kind = "trajectory", file = "{number}.txt", from_zero = false }}'
        text = text.replace(found.group(), f"{still}, motion = {motions} }}")
    return text


def truth(renderer: evis.mujoco.EventRenderer, motion: Motion, arguments: argparse.Namespace) -> evis.Truth:
    """Return what the oracle says of the scene as its bodies moved."""
    _, (text, glb, sky) = renderer.scene.__reduce__()
    reference = renderer.simulator.reference_luminance
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "model.glb").write_bytes(animated(glb, motion))
        if sky is not None:
            (place / "sky.hdr").write_bytes(sky)
        (place / "scene.toml").write_text(moved(text, motion, place))
        width, height = arguments.size
        made = place / "truth.h5"
        command = [sys.executable, "-m", "evis", "truth", str(place / "scene.toml"), "-o", str(made)]
        command += ["--camera", renderer.cameras[0].name]
        command += ["--size", f"{width}x{height}", "--duration", str(arguments.duration)]
        command += ["--truth-pixels", str(arguments.truth_pixels), "--reference-luminance", str(reference)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return evis.Truth.load(made)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("model")
    parser.add_argument("--camera", type=int, default=-1)
    parser.add_argument("--size", type=lambda text: tuple(map(int, text.split("x"))), default=(346, 260))
    parser.add_argument("--duration", type=float, default=0.1)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--portion-us", type=int, default=None)
    parser.add_argument("--truth-pixels", type=int, default=1500)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    model = mujoco.MjModel.from_xml_path(arguments.model)
    known = None
    print("| method | F1 1 ms scaled | 1 ms | 300 us | events | core-s per simulated second |")
    print("|---|--:|--:|--:|--:|--:|")
    for name, settings in METHODS.items():
        renderer, events, motion, took = render(model, arguments, settings)
        if known is None:
            known = truth(renderer, motion, arguments)
        made = evis.metrics.score(events, known)
        one, fine = made.at(1000), made.at(300)
        method = renderer.simulator.method
        print(
            f"| {name} (`{method}`) | {one.scaled.f1:.3f} | {one.plain.f1:.3f} | {fine.plain.f1:.3f} | "
            f"{len(events)} | {took / arguments.duration:.0f} |",
            flush=True,
        )
        renderer.close()


if __name__ == "__main__":
    main()
