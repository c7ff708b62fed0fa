"""Keyframes to events: PyTorch against the engine on the same CPU, and what PyTorch reads and writes.

Prints, per picture size and method, the ratio of the times of a push (least of some, alternating, both on as
many threads), and, per pixel and instant, the bytes that PyTorch's operations read and write, and how many
operations there are.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import torch
from torch.utils._python_dispatch import TorchDispatchMode

import evis
from evis._torch_keyframes import TorchKeyframes

SENSORS = {
    "splat": evis.Sensor(threshold_on=0.15, threshold_off=0.15),
    "evis-paper": evis.Sensor(threshold_on=0.15, threshold_off=0.15, trigger="latch", log_eps=1e-5),
}


class Traffic(TorchDispatchMode):
    """Counts operations, and the bytes of the tensors that they take and give; views count nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.bytes = self.operations = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run an operation and count it."""
        out = func(*args, **(kwargs or {}))
        given, made = (
            [leaf for leaf in torch.utils._pytree.tree_leaves(tree) if isinstance(leaf, torch.Tensor)]
            for tree in ((args, kwargs), out)
        )
        memory = {tensor.untyped_storage().data_ptr() for tensor in given}
        if func._schema.name.startswith("aten::") and not _is_view(made, memory, func):
            self.operations += 1
            self.bytes += sum(tensor.numel() * tensor.element_size() for tensor in [*given, *made])
        return out


def _is_view(made: list[torch.Tensor], memory: set[int], func: Any) -> bool:
    shares = bool(made) and all(tensor.untyped_storage().data_ptr() in memory for tensor in made)
    return shares and not func._schema.is_mutable


def keyframes(envs: int, height: int, width: int, count: int) -> list[tuple[Any, ...]]:
    """Two textured surfaces that move by 4 pixels per gap in opposite directions."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    made = []
    for k in range(count):
        near = np.broadcast_to(abs(y - height / 2) < height / 4, (envs, height, width))
        texture = [np.sin((x - shift * k) / 3) * np.cos(y / 4 + x / 9) for shift in (4, -4)]
        light = np.where(near, 0.5 + 0.4 * texture[0], 0.6 + 0.3 * texture[1]).astype(np.float32)
        depth = np.where(near, 1.0, 3.0).astype(np.float32)
        motion = np.zeros((envs, height, width, 2), np.float32)
        motion[..., 0] = np.where(near, -4, 4)
        made.append((light, depth, motion, 8000 * k))
    return made


def measure(envs: int, size: tuple[int, int], variant: Any, steps: int, threads: int) -> None:
    """Print one line."""
    width, height = size
    frames = keyframes(envs, height, width, 9)
    warp = evis.Warp(variant=variant, steps=steps)
    engine = evis.EventEmulator(width, height, SENSORS[variant], batch=envs, threads=threads)
    own = _own(envs, size, variant, steps)
    times: list[list[float]] = [[], []]
    traffic = [(0.0, 0.0), (0.0, 0.0)]
    for *pictures, t_us in frames:
        tensors = [torch.from_numpy(picture) for picture in pictures]
        begin = time.perf_counter()
        expected = engine.push_keyframe(*pictures, t_us, warp=warp)
        middle = time.perf_counter()
        found = own.push(*tensors, t_us)
        times[0].append(middle - begin)
        times[1].append(time.perf_counter() - middle)
        equal = all(np.array_equal(a.to_numpy(), b.to_numpy()) for a, b in zip(expected, found, strict=True))
    for i, wanted in enumerate((steps, 2 * steps)):
        one = _own(envs, size, variant, wanted)
        for *pictures, t_us in frames[:2]:
            one.push(*(torch.from_numpy(picture) for picture in pictures), t_us)
        with Traffic() as counted:
            one.push(*(torch.from_numpy(picture) for picture in frames[2][:3]), frames[2][3])
        traffic[i] = (counted.bytes / (envs * width * height), counted.operations)
    ratio = min(times[1][1:]) / min(times[0][1:])
    per_instant = [(traffic[1][j] - traffic[0][j]) / steps for j in (0, 1)]
    # The gap's last instant is its keyframe, which is not warped.
    per_gap = traffic[0][0] - (steps - 1) * per_instant[0]
    nanoseconds = 1e9 * min(times[0][1:]) / (envs * width * height * steps)
    print(
        f"{variant:10} {envs:4} x {width}x{height}, {steps} instants: torch / engine {ratio:5.1f} "
        f"(engine {nanoseconds:.0f} ns per pixel and instant), equal {equal}; per pixel and instant "
        f"{per_instant[0]:.0f} B in {per_instant[1]:.0f} operations, per pixel and gap {per_gap:.0f} B more"
    )


def _own(envs: int, size: tuple[int, int], variant: Any, steps: int) -> TorchKeyframes:
    width, height = size
    warp = evis.Warp(variant=variant, steps=steps)
    return TorchKeyframes(
        envs, height, width, sensor=SENSORS[variant], warp=warp, reference_luminance=1.0, device="cpu"
    )


def main() -> None:
    """Measure all sizes and methods."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=1)
    threads = parser.parse_args().threads
    torch.set_num_threads(threads)
    for envs, size in ((16, (64, 64)), (2, (346, 260))):
        for variant in ("splat", "evis-paper"):
            measure(envs, size, variant, 8, threads)


if __name__ == "__main__":
    main()
