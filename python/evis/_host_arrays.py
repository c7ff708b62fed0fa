"""Arrays of other programs, wherever they are, as NumPy's."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _check
from ._evis import ConfigError


def unwrapped(values: Any) -> Any:
    """Return a tensor that a proxy has as ``.torch``, without its history; anything else as it is."""
    if hasattr(type(values), "torch"):
        # It would warn if it were used as a tensor.
        values = values.torch
    return values.detach() if hasattr(values, "detach") else values


class Copies:
    """Brings arrays to the CPU and counts what that copies."""

    def __init__(self) -> None:
        self.size = 0
        self.seconds = 0.0
        self.device = ""

    def in_words(self, unit: str) -> str:
        """Say where arrays were, and what each `unit` takes: a push, a keyframe."""
        return (
            f"tensors are on {self.device}, and events are made on the CPU: each {unit} copies "
            f"{self.size / 1e6:.1f} MB ({1e3 * self.seconds:.1f} ms this time)"
        )

    def take(self, what: str, values: Any) -> npt.NDArray[Any]:
        if isinstance(values, np.ndarray):
            return values
        values = unwrapped(values)
        device = str(getattr(values, "device", "cpu"))
        if not device.startswith("cpu"):
            to_cpu = getattr(values, "cpu", None) or getattr(values, "numpy", None)
            if to_cpu is None:
                raise ConfigError(
                    f"{what} is on {device}, and is nothing that can be copied from there; give a tensor "
                    "with cpu(), or a NumPy array"
                )
            before = time.perf_counter()
            values = to_cpu()
            self.seconds += time.perf_counter() - before
            self.device = device
            self.size += int(np.asarray(values).nbytes)
        try:
            array = np.asarray(values)
        except ValueError:  # rows of different lengths
            array = np.empty(0, object)
        if array.dtype.kind not in "biuf":
            raise ConfigError(f"{what} is {_check.shown(values)}; it must be an array or a tensor of numbers")
        return array
