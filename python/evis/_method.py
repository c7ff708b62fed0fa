"""How instants are sampled."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Literal, TypeAlias

from . import _check
from ._evis import ConfigError

#: Rates of ``method="evis-paper"`` where none are given.
_PAPER_RATE = (125.0, 8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Splat:
    """Keyframes are rendered; the instants between two of them are splatted from both.

    Values are checked when a `Simulator` is made. ``docs/methods.md`` says what each option does, and when it
    fails.

    Attributes
    ----------
    keyframe_hz : float
        Keyframes rendered per second, on a grid fixed in absolute time.
    steps : int
        Instants per gap between keyframes, the keyframe that ends it included.
    margin : int
        Pixels that keyframes show beyond each border.
    supersample : int
        Keyframe pixels per sensor pixel along each axis, 1 to 4.
    motion : {"exact", "linear"}
        By the matrices of camera and object at the instant, or by motion vectors times the elapsed part of
        the gap.
    carrier : {"index", "colour"}
        What is splatted: the number of the source pixel, whose light is then read from its keyframe, or its
        luminance, with a softmax over depth.
    nearest : bool
        Where both keyframes show something, the nearer surface wins; else the newer keyframe.
    blend : bool
        Where both show the same surface, both count, in log light and by their distance in time.
    dilate : int
        Pixels by which the motion of nearer surfaces reaches over their antialiased fringe.
    sharpness : float
        Of the softmax: importance is e^(sharpness (1/z) / max(1/z)).
    hole_below : float
        A pixel with less splatted weight of colours than this is a hole.
    fill : float or None
        Luminance of what neither keyframe shows; None leaves the pixel's memory untouched and counts it as
        unknown.
    """

    keyframe_hz: float = 125.0
    steps: int = 8
    margin: int = 32
    supersample: int = 1
    motion: Literal["exact", "linear"] = "exact"
    carrier: Literal["index", "colour"] = "index"
    nearest: bool = True
    blend: bool = True
    dilate: int = 0
    sharpness: float = 12.0
    hole_below: float = 0.3
    fill: float | None = None

    @classmethod
    def evis_paper(cls, keyframe_hz: float = _PAPER_RATE[0], steps: int = _PAPER_RATE[1]) -> Splat:
        """Return the settings that the EVIS paper publishes; its sensor latches, with ``log_eps`` 1e-5."""
        return cls(
            keyframe_hz=keyframe_hz,
            steps=steps,
            motion="linear",
            carrier="colour",
            nearest=False,
            blend=False,
            hole_below=1e-4,
            fill=0.0,
        )

    @property
    def is_evis_paper(self) -> bool:
        """Whether these are the paper's settings, at some rate."""
        return self == Splat.evis_paper(self.keyframe_hz, self.steps)


Method: TypeAlias = Literal["native", "splat", "evis-paper"] | Splat


def chosen(method: Method) -> Splat | None:
    """Return the splat that ``method`` stands for, None where it is none."""
    if isinstance(method, Splat):
        return method
    if method == "native":
        return None
    if method == "splat":
        return Splat()
    if method == "evis-paper":
        return Splat.evis_paper()
    raise ConfigError(
        f"method is {method!r}; it must be 'native', 'splat', 'evis-paper' or a Splat"
    )


def name(splat: Splat) -> str:
    """Return the method's name, as event files store it."""
    return "evis-paper" if splat.is_evis_paper else "splat"


def as_json(splat: Splat | None) -> str | None:
    """Return the settings for the engine."""
    return None if splat is None else json.dumps(_check.plain(splat))
