"""What a sensor is, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Trigger: TypeAlias = Literal["crossing", "latch"]
"""``crossing``: every crossing at its own time; ``latch``: at most one event per pixel and sample."""

Interpolation: TypeAlias = Literal["log", "light"]
"""What is straight between two samples: the signal, or the light (exact while an edge crosses a pixel)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensor:
    """An ideal event sensor; values are checked when a `Simulator` is made.

    A pixel's signal is ``ln(Y / Y_ref + log_eps)`` with the luminance Y = 0.2126 R + 0.7152 G + 0.0722 B
    (Rec. ITU-R BT.709-6, item 3.2) of linear light.

    Attributes
    ----------
    threshold_on : float
        Rise of the signal that fires an ON event, log units, at least 0.001.
    threshold_off : float
        Fall of the signal that fires an OFF event, a magnitude, log units, at least 0.001.
    log_eps : float
        ``log_eps`` in the formula above; above 0.
    trigger : {"crossing", "latch"}
        How a change between two samples becomes events.
    interpolation : {"log", "light"}
        What is straight between two samples, where ``crossing`` asks when a threshold is crossed;
        ``latch`` does not ask.
    """

    threshold_on: float = 0.2
    threshold_off: float = 0.2
    log_eps: float = 1e-3
    trigger: Trigger = "crossing"
    interpolation: Interpolation = "log"
