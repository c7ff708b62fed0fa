"""Dense arrays that packets carry in the place of events."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import _check
from ._evis import ConfigError
from .representations import Dense

# What the engine makes, and the parameters that it takes.
_MADE = {
    "event_frame": (),
    "counts": (),
    "voxel_grid": ("bins", "polarity", "normalize"),
    "time_surface": ("tau_us", "decay"),
}

DenseRequest = tuple[str, int, str, bool, float, str, int]
"""Name, bins, polarity, normalize, tau_us, decay, and length of a window in microseconds."""


def dense_of(dense: Any) -> Dense:
    """Return what is asked for as a `Dense`."""
    own = Dense(dense) if isinstance(dense, str) else dense
    if not isinstance(own, Dense) or own.name not in _MADE:
        name = own.name if isinstance(own, Dense) else dense
        raise ConfigError(
            f"dense is {_check.shown(name)}; a simulator makes {_check.one_of(_MADE)}: a name, or "
            "evis.representations.Dense('voxel_grid', bins=5). Others are made of a packet's events"
        )
    unknown = sorted(set(own.parameters) - set(_MADE[own.name]))
    if unknown:
        takes = ", ".join(_MADE[own.name]) or "no parameters"
        raise ConfigError(f"dense {own!r} has {', '.join(unknown)}; in a simulator {own.name} takes {takes}")
    return own


def request_of(dense: Dense, window_us: Any) -> DenseRequest:
    """Return what the engine is asked for."""
    own: Callable[..., Any] = dense.parameters.get
    return (
        dense.name,
        _check.whole("bins", own("bins", 5)),
        str(own("polarity", "signed")),
        bool(own("normalize", False)),
        _check.number("tau_us", own("tau_us", 1.0)),
        str(own("decay", "exponential")),
        _check.time_us("dense_window_us", window_us),
    )
