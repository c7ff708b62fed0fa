"""A sensor and its stages, as values: what `evis.Sensor` is put together from."""

from ._sensor import (
    Diffusion,
    Exposure,
    Noise,
    Pattern,
    Photoreceptor,
    Readout,
    Refractory,
    Sensor,
    Times,
    Trigger,
)

__all__ = [
    "Diffusion",
    "Exposure",
    "Noise",
    "Pattern",
    "Photoreceptor",
    "Readout",
    "Refractory",
    "Sensor",
    "Times",
    "Trigger",
]
