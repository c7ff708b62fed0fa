"""Recordings of scenes for evaluations: what is recorded, and the settings that are compared."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

from . import _check
from ._evis import ConfigError
from ._files import Recording, load, save
from ._method import Warp
from ._scene import EventCamera, Scene, scenes
from ._sensor import Sensor
from ._simulator import LabelName, Simulator
from .motion import Placement

LABEL_RATE_HZ = 50.0

#: What each task holds events against.
LABELS: Mapping[str, tuple[LabelName, ...]] = {
    "reconstruct": ("hdr",),
    "flow": ("flow", "hdr"),
    "match": ("depth", "flow", "hdr"),
}

#: Metres between the two cameras of a stereo pair.
_BASELINE_M = 0.1


def _paper(keyframe_hz: float, steps: int) -> Mapping[str, Any]:
    return {"method": Warp(variant="evis-paper", keyframe_hz=keyframe_hz, steps=steps)}


LADDER: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "native 1000 Hz": {"method": "native", "rate_hz": 1000.0},
        "draft": {"quality": "draft"},
        "standard": {"quality": "standard"},
        "paper 1000 Hz": {"method": "native", "rate_hz": 1000.0, "sensor": Sensor(trigger="latch")},
        "paper 250 x 4": _paper(250.0, 4),
        "paper 125 x 8": _paper(125.0, 8),
        "paper 40 x 8": _paper(40.0, 8),
        "paper 30 x 8": _paper(30.0, 8),
    }
)
"""Arguments of `evis.Simulator` by name: rendering at 1000 Hz, the presets, and the rates of the EVIS paper,
keyframes per second and instants between two of them; at 1000 Hz it renders every instant, and latches."""


def scene_named(text: str) -> Scene | None:
    """Return the scene that a user names, built-in or a scene file; None where it is something else."""
    path = Path(text)
    if path.suffix.lower() in (".toml", ".glb", ".gltf"):
        return Scene.load(path)
    return Scene.builtin(text) if text in scenes() and not path.exists() else None


def record(
    scene: Scene,
    path: str | PathLike[str],
    task: str,
    *,
    duration_s: float = 1.0,
    size: tuple[int, int] = (320, 240),
    progress: bool = False,
    **settings: Any,
) -> Recording:
    """Record a scene with the labels that an evaluation needs.

    Parameters
    ----------
    scene : Scene
        What is seen; its first camera counts. For ``match`` a second one stands 100 mm to its right.
    path : path
        The recording; replaced where it exists.
    task : {"reconstruct", "flow", "match"}
        The evaluation.
    duration_s : float
        Seconds.
    size : tuple of int
        Width and height in pixels.
    progress : bool
        Show a bar.
    **settings
        Further arguments of `evis.Simulator`, such as ``quality``; ``"draft"`` where neither it nor
        ``method`` is given.

    Raises
    ------
    ConfigError
        If something cannot be used.
    OSError
        If the file cannot be written.
    """
    if task not in LABELS:
        raise ConfigError(f"task is {_check.shown(task)}; it must be {_check.one_of(list(LABELS))}")
    if not settings.keys() & {"quality", "method", "settings"}:
        settings["quality"] = "draft"
    first = scene.cameras[0]
    cameras: list[str | EventCamera] = [first]
    if task == "match":
        right = Placement(parent=first, position=(_BASELINE_M, 0.0, 0.0))
        cameras.append(EventCamera(name="right", pose=right))
    simulator = Simulator(
        scene, cameras=cameras, size=size, labels=LABELS[task], label_rate_hz=LABEL_RATE_HZ, **settings
    )
    save(path, simulator.stream(duration=duration_s, progress=progress), overwrite=True)
    return load(path)
