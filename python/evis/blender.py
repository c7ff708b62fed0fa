"""Blender: multi-layer EXR sequences with the passes Combined, Depth and Vector, as keyframes.

Cycles writes linear, scene-referred light before the view transform, planar depth in metres, and motion to
the frame before and to the frame after; these are what `EventEmulator.push_keyframe` takes.
``examples/blender/render.py`` sets the passes of a scene. Needs the extra ``blender`` (OpenEXR), not Blender.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check, _limits
from ._emulator import EventEmulator
from ._events import EventArray
from ._evis import ConfigError, FormatError
from ._sensor import Sensor

__all__ = ["Keyframe", "events", "keyframes", "read"]

Paths: TypeAlias = str | PathLike[str] | Iterable[str | PathLike[str]]
"""A folder of EXR files, or files in order."""

#: Cycles writes 1e10 where a ray meets nothing.
_FARTHEST_M = 1e9


@dataclass(frozen=True, slots=True, repr=False)
class Keyframe:
    """What a frame of Blender holds, in the conventions of `EventEmulator.push_keyframe`.

    Attributes
    ----------
    hdr : numpy.ndarray
        float32 (H, W, 3), linear RGB, as Combined.
    depth : numpy.ndarray
        float32 (H, W), planar z in metres, +inf where nothing is.
    motion_vectors : numpy.ndarray
        float32 (H, W, 2), pixels, x right, y down: where each pixel's surface was at the frame before,
        ``before = here + motion``.
    motion_forward : numpy.ndarray
        float32 (H, W, 2): where it will be at the frame after, ``after = here + motion``.
    """

    hdr: npt.NDArray[np.float32]
    depth: npt.NDArray[np.float32]
    motion_vectors: npt.NDArray[np.float32]
    motion_forward: npt.NDArray[np.float32]

    def __repr__(self) -> str:
        """Say how large it is."""
        return f"Keyframe({self.depth.shape[1]}x{self.depth.shape[0]})"


def read(path: str | PathLike[str], *, layer: str | None = None) -> Keyframe:
    """Read a multi-layer EXR file of Blender.

    Parameters
    ----------
    path : path
        The file.
    layer : str, optional
        View layer, where the file has several.

    Returns
    -------
    Keyframe
        The vector pass, pixels with y up (XY from here to the frame before, ZW from the frame after to
        here), has become two motions with y down.

    Raises
    ------
    OSError
        If the file cannot be read.
    FormatError
        If it is no EXR file, or a pass is missing; says how to ask for it.
    ConfigError
        If there are several view layers and none is named, or none of the name.
    ImportError
        If OpenEXR is not installed.
    """
    path = Path(path)
    channels = _channels(path)
    layers = sorted({name.rsplit(".", 2)[0] for name in channels if name.count(".") >= 2})
    if not layers:
        raise FormatError(
            f"{path} has the channels {', '.join(sorted(channels))}; render to OpenEXR MultiLayer"
        )
    if layer is None:
        if len(layers) > 1:
            raise ConfigError(
                f"{path} has the view layers {', '.join(layers)}; choose one: layer='{layers[0]}'"
            )
        layer = layers[0]
    if layer not in layers:
        raise ConfigError(f"{path} has no view layer {_check.shown(layer)}; it has {', '.join(layers)}")

    def plane(what: str, *names: str) -> npt.NDArray[np.float32]:
        for name in names:
            if (values := channels.get(f"{layer}.{what}.{name}")) is not None:
                return np.asarray(values, np.float32)
        have = sorted({name.split(".")[-2] for name in channels if name.startswith(f"{layer}.")})
        raise FormatError(
            f"{path} has no pass {what}, only {', '.join(have)}; switch it on in the view layer's passes "
            "(Z for Depth; Vector only without motion blur)"
        )

    depth = plane("Depth", "Z", "V").copy()
    depth[depth >= _FARTHEST_M] = np.inf
    x, y, z, w = (plane("Vector", name) for name in "XYZW")
    return Keyframe(
        hdr=np.stack([plane("Combined", name) for name in "RGB"], axis=-1),
        depth=depth,
        motion_vectors=np.stack([x, -y], axis=-1),
        motion_forward=np.stack([-z, w], axis=-1),
    )


def keyframes(paths: Paths, *, layer: str | None = None) -> Iterator[Keyframe]:
    """Read the frames of a sequence one after another.

    Parameters
    ----------
    paths : path or iterable of path
        A folder, whose ``.exr`` files come in the order of the numbers that their names end with, or files.
    layer : str, optional
        View layer, where the files have several.

    Yields
    ------
    Keyframe
        Read when it is asked for.

    Raises
    ------
    ConfigError
        If there is no file; if a file of a folder has no number, or a number is missing or there twice.
    """
    return (read(path, layer=layer) for path in _files(paths))


def events(
    paths: Paths, *, fps: float, sensor: Sensor | str | None = None, seed: int = 0, layer: str | None = None
) -> EventArray:
    """Simulate an event camera on a rendered sequence.

    Parameters
    ----------
    paths : path or iterable of path
        See `keyframes`.
    fps : float
        Frames per second of the scene, as rendered: frame k is at ``round(k * 1e6 / fps)`` microseconds.
    sensor : Sensor or str, optional
        The sensor, or the name of a preset or TOML file; an ideal one where not given.
    seed : int
        Seed of everything random.
    layer : str, optional
        View layer, where the files have several.

    Returns
    -------
    EventArray
        Of all the sequence, t from its first frame on.

    Raises
    ------
    ConfigError
        If ``fps`` is not above 0, there are fewer than two frames, or their sizes differ.
    OSError, FormatError, ImportError
        See `read`.
    """
    fps = _check.number("fps", fps, " frames per second")
    if not 0.001 <= fps <= 1e6:
        raise ConfigError(f"fps is {fps:g}; it must be between 0.001 and 1000000 frames per second")
    files = _files(paths)
    if len(files) < 2:
        raise ConfigError(f"paths has {len(files)} frame; events take two and more")
    parts = []
    emulator: EventEmulator[EventArray] | None = None
    for number, path in enumerate(files):
        frame = read(path, layer=layer)
        height, width = frame.depth.shape
        if emulator is None:
            emulator = EventEmulator(width, height, sensor, seed=seed)
        elif (emulator.width, emulator.height) != (width, height):
            raise ConfigError(
                f"{path} is {width}x{height}; the frames before it are {emulator.width}x{emulator.height}"
            )
        part = emulator.push_keyframe(
            frame.hdr,
            frame.depth,
            frame.motion_vectors,
            round(number * 1e6 / fps),
            motion_forward=frame.motion_forward,
        )
        parts.append(part.to_numpy())
    return EventArray._trusted(np.concatenate(parts), width, height)


def _files(paths: Paths) -> list[Path]:
    if not isinstance(paths, (str, PathLike)):
        return [Path(path) for path in paths]
    folder = Path(paths)
    if not folder.is_dir():
        raise ConfigError(
            f"paths is '{folder}', which is no folder; give a folder of EXR files, or a list of files"
        )
    numbered: dict[int, Path] = {}
    for path in sorted(folder.glob("*.exr")):
        found = re.search(r"(\d+)$", path.stem)
        if found is None:
            raise ConfigError(f"{path} has no frame number at its end; give the files in order: paths=[...]")
        other = numbered.setdefault(int(found[1]), path)
        if other is not path:
            raise ConfigError(f"{path} and {other.name} are both frame {int(found[1])}; give a list of files")
    if not numbered:
        raise ConfigError(f"{folder} has no .exr file")
    first, last = min(numbered), max(numbered)
    missing = [number for number in range(first, last) if number not in numbered]
    if missing:
        raise ConfigError(f"{folder} has no frame {missing[0]} between {first} and {last}; render it")
    return [numbered[number] for number in sorted(numbered)]


def _channels(path: Path) -> dict[str, npt.NDArray[Any]]:
    try:
        import OpenEXR
    except ImportError as error:
        raise ImportError("EXR files need OpenEXR; install it: pip install 'evis[blender]'") from error
    with _limits.readable(path).open("rb"):
        # Raises what is wrong with the path; OpenEXR says less.
        pass
    try:
        file = OpenEXR.File(str(path), separate_channels=True)
        channels = [part.channels for part in file.parts]
    except Exception as error:
        raise FormatError(f"{path} cannot be read: {error}; render it again") from error
    return {name: channel.pixels for part in channels for name, channel in part.items()}
