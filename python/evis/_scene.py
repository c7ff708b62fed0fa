"""Scenes and the cameras in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

from . import _evis, _toml
from ._evis import ConfigError

Vector = Sequence[float]


@dataclass(frozen=True, kw_only=True, slots=True)
class EventCamera:
    """An event camera: a pinhole that looks along its -Z, with +Y up (glTF axes), in metres.

    The lens is a vertical field of view or pinhole intrinsics, not both.

    Attributes
    ----------
    name : str
        Unique within the scene.
    width, height : int, optional
        Pixels; 640x480 where not given.
    fov_y_degrees : float, optional
        Vertical field of view; 60 where neither it nor intrinsics are given.
    fx, fy, cx, cy : float, optional
        Intrinsics in pixels, all four, for this width and height; pixel centres lie at +0.5.
    position : sequence of float
        (x, y, z) in metres, in the frame of `parent`.
    rotation : sequence of float, optional
        Unit quaternion (x, y, z, w), ``parent_from_camera``.
    look_at : sequence of float, optional
        Point to look at, in place of `rotation`.
    parent : str, optional
        Name of the node that carries the camera; the world where not given.
    motion : mapping, optional
        How it moves: a motion of the scene file's vocabulary, e.g. ``{"type": "spin", ...}``.
    near : float, optional
        Near plane in metres.
    threshold_on, threshold_off : float, optional
        Thresholds of this camera, where they differ from the run's.
    """

    name: str
    width: int | None = None
    height: int | None = None
    fov_y_degrees: float | None = None
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    position: Vector = (0.0, 0.0, 0.0)
    rotation: Vector | None = None
    look_at: Vector | None = None
    parent: str | None = None
    motion: Mapping[str, Any] | None = None
    near: float | None = None
    threshold_on: float | None = None
    threshold_off: float | None = None
