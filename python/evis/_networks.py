"""Networks in ONNX form, run by onnxruntime: what the measurements of `evis.evaluate` are made with.

Needs onnxruntime: ``pip install 'evis[evaluate]'``. Inputs and outputs tell what a network is; sizes that it
fixes are met by padding, and by scaling for pictures.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _check, _limits
from ._evis import ConfigError, FormatError

Float = npt.NDArray[np.float32]
Points = npt.NDArray[np.float64]

_CELL = 8
"""Pixels per side of XFeat's cells: a score for each, and one for none of them."""


class Network:
    """An ONNX network with float32 inputs.

    Attributes
    ----------
    path : Path
        The file.
    inputs, outputs : list of (name, shape)
        Dimensions that the file leaves open are names.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        if not isinstance(path, (str, PathLike)):
            raise ConfigError(f"a network is {_check.shown(path)}; it must be the path of an ONNX file")
        try:
            import onnxruntime
        except ImportError as error:
            raise ConfigError(
                "networks are not usable without onnxruntime; pip install 'evis[evaluate]'"
            ) from error
        self.path = Path(path)
        content = _limits.readable(self.path).read_bytes()
        self.sha256 = hashlib.sha256(content).hexdigest()
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime raises classes of its own
            raise FormatError(f"{self.path} is no network that onnxruntime reads: {error}") from error
        self.inputs = [(each.name, list(each.shape)) for each in self._session.get_inputs()]
        self.outputs = [(each.name, list(each.shape)) for each in self._session.get_outputs()]
        for each in self._session.get_inputs():
            if each.type != "tensor(float)":
                raise ConfigError(
                    f"{self.path.name} takes {each.name} as {each.type}; it must take tensor(float)"
                )

    def run(self, arrays: Sequence[Float]) -> list[npt.NDArray[Any]]:
        """Run the network on its inputs, in their order."""
        names = [name for name, _ in self.inputs]
        try:
            found = self._session.run(None, dict(zip(names, arrays, strict=True)))
        except Exception as error:  # as above
            shapes = ", ".join(f"{n} {a.shape}" for n, a in zip(names, arrays, strict=True))
            raise ConfigError(f"{self.path.name} does not run on {shapes}: {error}") from error
        return [np.asarray(array) for array in found]

    def image_shape(self, index: int, height: int, width: int, multiple: int) -> tuple[int, int, int]:
        """Return channels, height and width of an input (1, C, H, W), for pictures of this size.

        Open sizes become the next multiples of ``multiple``, as networks that halve pictures need them.
        """
        name, shape = self.inputs[index]
        many = len(shape) == 4 and isinstance(shape[0], int) and shape[0] != 1
        if len(shape) != 4 or many or not isinstance(shape[1], int):
            raise ConfigError(f"{self.path.name} takes {name} as {shape}; it must be (1, channels, H, W)")
        sides = [
            side if isinstance(side, int) else -(-own // multiple) * multiple
            for side, own in zip(shape[2:], (height, width), strict=True)
        ]
        return shape[1], sides[0], sides[1]


def _padded(array: Float, height: int, width: int) -> tuple[Float, tuple[slice, slice]]:
    """Put (..., h, w) into the middle of zeros (..., height, width); return where it is."""
    h, w = array.shape[-2:]
    top, left = -(-(height - h) // 2), -(-(width - w) // 2)
    where = (slice(top, top + h), slice(left, left + w))
    framed = np.zeros((*array.shape[:-2], height, width), np.float32)
    framed[..., where[0], where[1]] = array
    return framed, where


class VoxelNetwork:
    """A network on voxel grids of windows: (1, bins, H, W), and states that it hands to itself.

    States begin with zeros. Grids are padded with zeros, as EVREAL pads them. A second input of the first
    one's shape is a second grid: the window before (as E-RAFT takes it).
    """

    def __init__(self, path: str | PathLike[str], height: int, width: int, *, multiple: int = 8) -> None:
        self.network = net = Network(path)
        self.bins, high, wide = net.image_shape(0, height, width, multiple)
        if high < height or wide < width:
            raise ConfigError(
                f"{net.path.name} takes pictures of {wide}x{high}; the events are {width}x{height}: export "
                "it for this size, or with open sizes"
            )
        self._size = (height, width)
        self._padded = (high, wide)
        first = net.inputs[0][1]
        others = net.inputs[1:]
        self.grids = 2 if others and others[0][1] == first else 1
        # A dimension that carries the name of one of the grid's is as long as that.
        sides = (1, self.bins, *self._padded)
        known = {name: side for name, side in zip(first, sides, strict=True) if isinstance(name, str)}
        self._states = [self._zeros(name, shape, known) for name, shape in others[self.grids - 1 :]]
        if len(net.outputs) <= len(self._states):
            raise ConfigError(
                f"{net.path.name} has {len(self._states)} states and {len(net.outputs)} outputs; a picture "
                "and the next states must come out"
            )

    def _zeros(self, name: str, shape: list[Any], known: dict[str, int]) -> Float:
        sides = [side if isinstance(side, int) else known.get(side, 0) for side in shape]
        if 0 in sides:
            raise ConfigError(
                f"{self.network.path.name} leaves the size of its state {name} open: {shape}; export it with "
                f"fixed sizes, or with the names of {self.network.inputs[0][0]}"
            )
        return np.zeros(sides, np.float32)

    def reset(self) -> None:
        """Begin a sequence."""
        for state in self._states:
            state[...] = 0.0

    def run(self, grid: Float, before: Float | None = None) -> list[npt.NDArray[Any]]:
        """Return what comes out for a grid (bins, H, W), without states; pictures have the events' size."""
        framed, where = _padded(grid[None], *self._padded)
        arrays = [framed]
        if self.grids == 2:
            earlier = np.zeros_like(grid) if before is None else before
            arrays = [_padded(earlier[None], *self._padded)[0], framed]
        made = self.network.run([*arrays, *self._states])
        kept = len(made)
        if self._states:
            # The picture, then the next states, is the order of FireNet's and E2VID's recurrences.
            kept = len(made) - len(self._states)
            self._states = [np.ascontiguousarray(state, np.float32) for state in made[kept:]]
        return [
            out[..., where[0], where[1]] if out.ndim == 4 and out.shape[2:] == self._padded else out
            for out in made[:kept]
        ]


def opencv() -> Any:
    """Return OpenCV, which scales pictures and finds essential matrices."""
    try:
        import cv2
    except ImportError as error:
        raise ConfigError("matching needs OpenCV; pip install 'evis[evaluate]'") from error
    return cv2


class MatchNetwork:
    """A network that matches two pictures.

    Of one picture, (1, 1 or 3, H, W): XFeat's outputs, which are features (1, D, H / 8, W / 8), scores of 64
    places per cell of 8x8 pixels and of none, (1, 65, H / 8, W / 8), and reliability (1, 1, H / 8, W / 8).
    Key points and mutual nearest neighbours are found as its authors do (G. Potje et al., XFeat, CVPR 2024:
    softmax, maxima of 5x5 pixels above 0.05, the best 4096 by score times reliability).

    Of two pictures, or two voxel grids: the places of matches in both, (N, 2) and (N, 2) or (N, 4), in
    pixels of its input, 0 at the first pixel's centre.
    """

    def __init__(self, path: str | PathLike[str], height: int, width: int) -> None:
        self._cv2 = opencv()
        self.network = net = Network(path)
        self.channels, self._high, self._wide = net.image_shape(0, height, width, 32)
        self.pairs = len(net.inputs) == 2
        if len(net.inputs) > 2 or (not self.pairs and not self._like_xfeat()):
            raise ConfigError(
                f"{net.path.name} has the inputs {net.inputs} and the outputs {net.outputs}; it must take "
                "two pictures and give the places of matches, or take one and give features, 65 scores per "
                "cell, and reliability, as XFeat"
            )
        if not self.pairs and self.channels not in (1, 3):
            raise ConfigError(
                f"{net.path.name} takes {self.channels} channels; of one picture it must take 1 or 3"
            )
        self._scale = min(self._high / height, self._wide / width)

    def _like_xfeat(self) -> bool:
        shapes = [shape for _, shape in self.network.outputs]
        return len(shapes) == 3 and all(len(shape) == 4 for shape in shapes) and shapes[1][1] == 65

    def _framed(self, array: Float) -> Float:
        """Scale (C, H, W) to the input, and fill the rest with each channel's mean, which adds no edge."""
        size = [round(side * self._scale) for side in array.shape[1:]]
        made = np.empty((len(array), self._high, self._wide), np.float32)
        for channel, plane in zip(made, array, strict=True):
            channel[...] = plane.mean()
            channel[: size[0], : size[1]] = self._cv2.resize(plane, (size[1], size[0]))
        return made[None]

    def _places(self, places: npt.NDArray[Any]) -> Points:
        """From pixels of the input, 0 at a centre, to pixels of the picture, 0.5 at a centre."""
        return (np.asarray(places, np.float64).reshape(-1, 2) + 0.5) / self._scale

    def prepare(self, picture: Float) -> Any:
        """Do what concerns one picture, (H, W), or one grid (C, H, W)."""
        if picture.ndim == 2:
            picture = np.broadcast_to(picture, (self.channels, *picture.shape))
        size = [round(side * self._scale) for side in picture.shape[1:]]
        framed = self._framed(np.ascontiguousarray(picture, np.float32))
        return framed if self.pairs else self._features(framed, size)

    def match(self, one: Any, other: Any) -> tuple[Points, Points]:
        """Return the places of matches in both, (N, 2) each, pixels with centres at +0.5."""
        if self.pairs:
            made = [np.asarray(out).reshape(-1, np.shape(out)[-1]) for out in self.network.run([one, other])]
            if made[0].shape[1] == 4:
                made = [made[0][:, :2], made[0][:, 2:]]
            if len(made) < 2 or any(m.shape[1] != 2 for m in made[:2]) or len(made[0]) != len(made[1]):
                raise ConfigError(
                    f"{self.network.path.name} gives {[m.shape for m in made]}; it must give (N, 4), or "
                    "(N, 2) twice"
                )
            return self._places(made[0]), self._places(made[1])
        (places, features), (others, other_features) = one, other
        if not len(places) or not len(others):
            return np.empty((0, 2)), np.empty((0, 2))
        alike = features @ other_features.T
        forth, back = alike.argmax(axis=1), alike.argmax(axis=0)
        mutual = np.flatnonzero(back[forth] == np.arange(len(forth)))
        return places[mutual], others[forth[mutual]]

    def _features(self, framed: Float, size: list[int]) -> tuple[Points, Float]:
        features, scores, reliability = (out[0] for out in self.network.run([framed]))
        scores = np.exp(scores - scores.max(axis=0))
        scores = (scores / scores.sum(axis=0))[:-1]
        rows, columns = scores.shape[1:]
        heat = scores.reshape(_CELL, _CELL, rows, columns).transpose(2, 0, 3, 1)
        heat = np.ascontiguousarray(heat.reshape(rows * _CELL, columns * _CELL))
        peak = (heat == self._cv2.dilate(heat, np.ones((5, 5), np.uint8))) & (heat > 0.05)
        peak[size[0] :] = peak[:, size[1] :] = False
        y, x = np.nonzero(peak)
        # Cells' centres are at (8 i + 3.5); beyond the outermost ones the border's values hold.
        at = [((place - (_CELL - 1) / 2) / _CELL).astype(np.float32)[:, None] for place in (x, y)]

        def sampled(planes: Float, how: int) -> Float:
            stack = np.ascontiguousarray(planes.transpose(1, 2, 0))
            parts = [
                self._cv2.remap(stack[..., k : k + 4], *at, how, borderMode=self._cv2.BORDER_REPLICATE)
                for k in range(0, stack.shape[2], 4)
            ]
            return np.concatenate([part.reshape(len(x), -1) for part in parts], axis=1)

        weight = heat[y, x] * sampled(reliability, self._cv2.INTER_LINEAR)[:, 0]
        best = np.argsort(-weight, kind="stable")[:4096]
        units = features / np.maximum(np.linalg.norm(features, axis=0), 1e-12)
        found = sampled(units, self._cv2.INTER_CUBIC)[best]
        found = found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)
        return self._places(np.stack([x, y], axis=1)[best]), found.astype(np.float32)
