"""How instants are sampled."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Literal, TypeAlias

from . import _check
from ._short import ShortRepr


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Warp(ShortRepr):
    """How the instants between two keyframes come from both: those of a scene, and those that are pushed.

    Values are checked where a warp is used: when a `Simulator` is made, or in
    `EventEmulator.push_keyframe`. ``docs/methods.md`` says what the variants do, and when they fail.

    Attributes
    ----------
    variant : {"splat", "evis-paper"}
        ``splat`` reads light from the nearest surface of both keyframes, and leaves unknown what neither
        shows. ``evis-paper`` is the published warp: linear motion, colours, black holes; its sensor latches,
        with ``log_eps`` 1e-5.
    keyframe_hz : float, optional
        Keyframes of a scene rendered per second, on a grid fixed in absolute time; 125 if not given. Not for
        keyframes that are pushed.
    steps : int, optional
        Instants per gap, the keyframe that ends it included. If not given, 8 on scenes, and between pushed
        keyframes as many as ``step_px`` asks for.
    margin : int, optional
        Pixels that keyframes show beyond each border of the sensor. If not given, 32 on scenes and 0 for
        pushed keyframes, whose pictures are larger by it on every side.
    step_px : float, optional
        Pushed keyframes, where ``steps`` is not given: pixels that the picture moves from instant to instant,
        at most; 0.3 if not given. A gap in which it moves by no more than a pixel is not divided.
    detect_cuts : bool, optional
        Pushed keyframes: whether keyframes that nothing links are taken for a cut, so that light goes
        straight from one to the other; if not given, ``splat`` does so and ``evis-paper`` does not.
    """

    variant: Literal["splat", "evis-paper"] = "splat"
    keyframe_hz: float | None = None
    steps: int | None = None
    margin: int | None = None
    step_px: float | None = None
    detect_cuts: bool | None = None

    @classmethod
    def evis_paper(cls, steps: int = 8) -> Warp:
        """Return the settings that the EVIS paper publishes, with ``steps`` instants per gap."""
        return cls(variant="evis-paper", steps=steps)


Method: TypeAlias = Literal["native", "decoupled", "splat", "evis-paper"] | Warp


def as_json(warp: Warp | None) -> str | None:
    """Return the settings for the engine."""
    return None if warp is None else json.dumps(_check.plain(warp))
