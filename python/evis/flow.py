"""Frames between frames, by optical flow or by a network: for films whose motion is above a pixel per frame.

Needs OpenCV: ``pip install 'evis[flow]'``. What it measures, and what it cannot do, is in docs/video.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _check
from ._evis import ConfigError
from ._luminance import WEIGHTS, luminance
from ._networks import Network

Float = npt.NDArray[np.float32]

_MULTIPLE = 32
"""Networks halve pictures; sides that they leave open are padded to multiples of this."""

_UNDIVIDED_PX = 1.0
"""A pair that moves no farther is left alone: straight light between its frames is nearer to the truth."""


def _opencv() -> Any:
    try:
        import cv2
    except ImportError as error:
        raise ConfigError(
            "flow is not usable without OpenCV; pip install 'evis[flow]', or opencv-python-headless"
        ) from error
    return cv2


def _decoded(value: npt.NDArray[Any], transfer: str) -> npt.NDArray[Any]:
    """Return the light of stored values, both from 0 to 1."""
    if transfer == "srgb":
        return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    if transfer == "rec709":
        return np.where(value < 0.081, value / 4.5, ((value + 0.099) / 1.099) ** (1 / 0.45))
    if transfer == "linear":
        return value
    if transfer.startswith("gamma:"):
        return np.asarray(value ** float(transfer[6:]))
    raise ConfigError(f"transfer is {transfer!r}; it must be srgb, rec709, gamma:G or linear")


def _checked(frame: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a frame whose dtype and shape can be used."""
    if frame.dtype not in (np.uint8, np.uint16, np.float32):
        raise ConfigError(f"frames are of dtype {frame.dtype}; they must be uint8, uint16 or float32")
    if frame.ndim != 2 and not (frame.ndim == 3 and frame.shape[2] == 3):
        raise ConfigError(f"frames are of shape {frame.shape}; they must be (H, W) or (H, W, 3)")
    return frame


def _light(frame: npt.NDArray[Any], transfer: str) -> Float:
    """Return linear luminance, float32 (H, W)."""
    frame = _checked(frame)
    if frame.dtype == np.float32:
        return luminance(frame)
    last = int(np.iinfo(frame.dtype).max)
    table = _decoded(np.arange(last + 1, dtype=np.float64) / last, transfer)
    return luminance(table.astype(np.float32)[frame])


class _Pair:
    """Two frames and the motion between them."""

    def __init__(self, cv2: Any, before: Float, after: Float, eps: float) -> None:
        self._cv2 = cv2
        self._logs = [np.log(np.maximum(light, 0) + np.float32(eps)) for light in (before, after)]
        # Flow is found on what eyes see: 8 bits of the logarithm, one scale for both frames.
        low, high = (float(np.percentile(np.stack(self._logs), q)) for q in (0.5, 99.5))
        scale = 255 / max(high - low, 1e-3)
        codes = [np.clip((log - low) * scale, 0, 255).astype(np.uint8) for log in self._logs]
        # Small pictures are enlarged for it: what moves by a pixel there is smaller than its patches.
        self._zoom = max(1, min(4, round(640 / max(before.shape))))
        if self._zoom > 1:
            enlarged = {"fx": self._zoom, "fy": self._zoom, "interpolation": cv2.INTER_CUBIC}
            codes = [cv2.resize(code, None, **enlarged) for code in codes]
        finder = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        finder.setFinestScale(0)
        finder.setPatchStride(2)
        finder.setGradientDescentIterations(30)
        finder.setVariationalRefinementIterations(8)
        self.forward = self._flow(finder, codes[0], codes[1], before.shape)
        self.backward = self._flow(finder, codes[1], codes[0], before.shape)
        height, width = before.shape
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        self._x, self._y = x, y

    def _flow(self, finder: Any, one: Any, other: Any, shape: tuple[int, int]) -> Float:
        found = finder.calc(one, other, None)
        if self._zoom > 1:
            found = self._cv2.resize(found, shape[::-1], interpolation=self._cv2.INTER_AREA) / self._zoom
        return np.asarray(found, np.float32)

    def motion(self) -> float:
        """Return the motion that a hundredth of all pixels exceeds."""
        speed = [np.hypot(flow[..., 0], flow[..., 1]) for flow in (self.forward, self.backward)]
        return float(np.percentile(np.stack(speed), 99))

    def _warp(self, image: Float, flow: Float) -> Float:
        # Bilinear lookup would blur between the frames and not at them, and fire for it.
        moved = self._cv2.remap(
            image,
            self._x + flow[..., 0],
            self._y + flow[..., 1],
            self._cv2.INTER_CUBIC,
            borderMode=self._cv2.BORDER_REPLICATE,
        )
        return np.asarray(moved, np.float32)

    def at(self, part: float) -> Float:
        """Return the light at ``part`` of the way, blended from both sides in log light."""
        f = np.float32(part)
        # Motion at the time between, from both flows (Jiang et al., Super SloMo, CVPR 2018, equation 4).
        to_before = -(1 - f) * f * self.forward + f * f * self.backward
        to_after = (1 - f) * (1 - f) * self.forward - f * (1 - f) * self.backward
        sides, weights = [], []
        for log, flow, other, own, weight in (
            (self._logs[0], to_before, self.backward, self.forward, 1 - f),
            (self._logs[1], to_after, self.forward, self.backward, f),
        ):
            sides.append(self._warp(log, flow))
            # A side that does not come back to where it started shows something that the other hides.
            there = np.dstack([self._warp(own[..., k], flow) for k in range(2)])
            back = np.dstack([self._warp(other[..., k], flow + there) for k in range(2)])
            astray = np.hypot(*(there + back).transpose(2, 0, 1))
            weights.append(
                weight * np.exp(-np.minimum(astray, 20)).astype(np.float32) + np.float32(1e-6) * weight
            )
        total = weights[0] + weights[1]
        mean = (weights[0] * sides[0] + weights[1] * sides[1]) / total
        return np.asarray(mean, np.float32)


def _is_time(shape: list[Any]) -> bool:
    """Whether an input of this shape is a number."""
    sides = shape[1:] if len(shape) == 4 else shape
    return all(side == 1 or (len(shape) < 4 and not isinstance(side, int)) for side in sides)


class _Interpolation:
    """A network that gives the frame between two.

    It takes stored values from 0 to 1: two pictures (1, C, H, W), or one of both, (1, 2 C, H, W), with C of 1
    or 3; and, where it knows times, a number between 0 and 1, or a picture (1, 1, H, W) full of it. Its first
    output is the picture.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self.network = net = Network(path)
        channels = [shape[1] if len(shape) == 4 and not _is_time(shape) else 0 for _, shape in net.inputs]
        self._packed = channels[:1] in ([2], [6])
        pictures = 1 if self._packed else 2
        self.channels = (channels or [0])[0] // (2 if self._packed else 1)
        others = net.inputs[pictures:]
        full = len(others) == 1 and channels[pictures] == 1
        self.knows_times = len(others) == 1 and (full or _is_time(others[0][1]))
        alike = all(count == channels[0] for count in channels[:pictures])
        if self.channels not in (1, 3) or not alike or bool(others) != self.knows_times:
            shapes = ", ".join(f"{name} {shape}" for name, shape in net.inputs)
            raise ConfigError(
                f"{net.path.name} takes {shapes}; it must take two pictures (1, C, H, W), or one of both, "
                "and a time between 0 and 1 or none"
            )
        self._time_shape = (1,) * len(others[0][1]) if self.knows_times and not full else None

    def __call__(self, before: Float, after: Float, part: float) -> Float:
        """Return the picture (C, H, W) at ``part`` of the way; in the middle, if it knows no times."""
        height, width = before.shape[1:]
        _, high, wide = self.network.image_shape(0, height, width, _MULTIPLE)
        if high < height or wide < width:
            raise ConfigError(
                f"{self.network.path.name} takes pictures of {wide}x{high}; the frames are {width}x{height}: "
                "export it for this size, or with open sizes"
            )
        room = ((0, 0), (0, high - height), (0, wide - width))
        sides = [np.pad(side, room, mode="edge")[None].astype(np.float32) for side in (before, after)]
        arrays = [np.concatenate(sides, axis=1)] if self._packed else sides
        if self.knows_times:
            shape = (1, 1, high, wide) if self._time_shape is None else self._time_shape
            arrays.append(np.full(shape, part, np.float32))
        made = self.network.run(arrays)[0]
        if made.shape != (1, self.channels, high, wide):
            raise ConfigError(
                f"{self.network.path.name} gives {made.shape} for {sides[0].shape}; it must give a picture "
                "of that shape"
            )
        return np.asarray(made[0, :, :height, :width], np.float32)


class _Learned:
    """Frames between two by a network."""

    def __init__(
        self, network: _Interpolation, before: npt.NDArray[Any], after: npt.NDArray[Any], transfer: str
    ) -> None:
        self._network = network
        # Networks see pictures as people do: floats are light, and get the curve of screens.
        self._curve = "srgb" if before.dtype == np.float32 else transfer
        self._known = {0.0: self._stored(before), 1.0: self._stored(after)}

    def _stored(self, frame: npt.NDArray[Any]) -> Float:
        """Return stored values from 0 to 1, float32 (C, H, W)."""
        if frame.dtype == np.float32:
            light = np.clip(frame, 0, 1)
            value = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
        else:
            value = frame / np.iinfo(frame.dtype).max
        colours = value if value.ndim == 3 else value[..., None]
        if self._network.channels == 1 and colours.shape[2] == 3:
            colours = (colours @ WEIGHTS)[..., None]
        each = np.repeat(colours, self._network.channels // colours.shape[2], axis=2)
        return np.asarray(each.transpose(2, 0, 1), np.float32)

    def at(self, part: float) -> Float:
        """Return linear luminance at ``part`` of the way, float32 (H, W)."""
        value = np.clip(self._value(part), 0, 1).transpose(1, 2, 0)
        light = _decoded(value, self._curve)
        return luminance(light if light.shape[2] == 3 else light[..., 0])

    def _value(self, part: float) -> Float:
        if part not in self._known:
            if self._network.knows_times:
                made = self._network(self._known[0.0], self._known[1.0], part)
            else:
                # Halves of halves: `part` is a fraction of a power of two.
                step = 1.0
                while (part / step) % 1:
                    step /= 2
                made = self._network(self._value(part - step), self._value(part + step), 0.5)
            self._known[part] = made
        return self._known[part]


class Upsampler:
    """Puts frames between two frames; what `upsample` and ``evis video --upsample`` use.

    Parameters
    ----------
    network : path, optional
        An ONNX file that gives the frame between two, in place of warping by optical flow. It takes stored
        values from 0 to 1: two pictures, float32 (1, C, H, W), or one of both (1, 2 C, H, W), with C of 1 or
        3; and a number between 0 and 1 (or a picture (1, 1, H, W) full of it) where it knows times. Without
        that it is asked for the middle, again and again. Needs onnxruntime too:
        ``pip install 'evis[evaluate]'``.
    step_px : float
        Pixels per step that at most a hundredth of the pixels exceeds. A pair of frames that moves by no more
        than a pixel is left alone, whatever this is.
    most : int
        Steps per pair of frames, at most.
    log_eps : float
        ``eps`` in ln(Y + eps), in which flow blends frames; the sensor's.

    Raises
    ------
    ConfigError
        If OpenCV or onnxruntime is missing, or a value or the network cannot be used.
    FormatError
        If the file holds no network.
    OSError
        If it cannot be read.
    """

    __slots__ = ("_cv2", "_log_eps", "_most", "_network", "_step_px")

    def __init__(
        self,
        network: str | PathLike[str] | None = None,
        *,
        step_px: float = 1.0,
        most: int = 64,
        log_eps: float = 1e-3,
    ) -> None:
        self._cv2 = _opencv()
        for what, value in (("step_px", step_px), ("most", most), ("log_eps", log_eps)):
            if not _check.number(what, value) > 0:
                raise ConfigError(f"{what} is {value}; it must be above 0")
        self._network = None if network is None else _Interpolation(network)
        self._step_px, self._most, self._log_eps = step_px, most, log_eps

    def __str__(self) -> str:
        """Say what makes the frames."""
        if self._network is None:
            return "optical flow (DIS)"
        return f"{self._network.network.path.name}, sha256 {self._network.network.sha256}"

    def between(
        self,
        before: tuple[int, npt.NDArray[Any]],
        after: tuple[int, npt.NDArray[Any]],
        *,
        transfer: str = "srgb",
    ) -> list[tuple[int, Float]]:
        """Return the frames between two.

        Parameters
        ----------
        before, after : (int, ndarray)
            Microseconds and frame: uint8, uint16 or float32, (H, W) or (H, W, 3).
        transfer : str
            Curve of integers: ``"srgb"``, ``"rec709"``, ``"gamma:G"``, ``"linear"``.

        Returns
        -------
        list of (int, ndarray)
            Microseconds, and linear luminance, float32 (H, W), in order; none where little moves.

        Raises
        ------
        ConfigError
            If a frame or the curve cannot be used, the second does not come after the first, or the network
            does not run.
        """
        (start_us, first), (end_us, last) = before, after
        if end_us <= start_us:
            raise ConfigError(f"t_us is {end_us}; it must be above {start_us}, the time of the frame before")
        lights = [_light(np.asarray(frame), transfer) for frame in (first, last)]
        if lights[0].shape != lights[1].shape:
            shapes = [light.shape for light in lights]
            raise ConfigError(f"a frame is of shape {shapes[1]}; those before it are {shapes[0]}")
        pair = _Pair(self._cv2, lights[0], lights[1], self._log_eps)
        motion = pair.motion()
        if motion <= _UNDIVIDED_PX:
            return []
        most = min(self._most, end_us - start_us)
        steps = int(np.clip(np.ceil(motion / self._step_px), 1, most))
        if self._network is None:
            eps = np.float32(self._log_eps)

            def light_at(part: float) -> Float:
                return np.asarray(np.maximum(np.exp(pair.at(part)) - eps, 0), np.float32)

        else:
            light_at = _Learned(self._network, np.asarray(first), np.asarray(last), transfer).at
            if not self._network.knows_times:
                # Halves of halves.
                steps = 1 << min((steps - 1).bit_length(), most.bit_length() - 1)
        span_us = end_us - start_us
        return [(start_us + round(span_us * k / steps), light_at(k / steps)) for k in range(1, steps)]


def upsample(
    frames: Iterable[tuple[int, npt.NDArray[Any]]],
    *,
    transfer: str = "srgb",
    network: str | PathLike[str] | None = None,
    step_px: float = 1.0,
    most: int = 64,
    log_eps: float = 1e-3,
) -> Iterator[tuple[int, Float]]:
    """Put frames between frames until nearly nothing moves by more than a pixel per step.

    Flow (DIS) is found in both directions, and each new frame is warped from both sides, weighted by time
    and by whether the two flows agree, in log light; or a network makes it. The given frames come out
    unchanged; the signal is continuous at them. Where flow is wrong (repeated texture, thin or fast things,
    flicker, what comes into view), so are the new frames.

    Parameters
    ----------
    frames : iterable of (int, ndarray)
        Microseconds and frame, as `evis.frames` gives them: uint8, uint16 or float32, (H, W) or (H, W, 3).
    transfer : str
        Curve of integers: ``"srgb"``, ``"rec709"``, ``"gamma:G"``, ``"linear"``; `Frames` knows its own.
    network, step_px, most, log_eps
        As `Upsampler` takes them.

    Yields
    ------
    (int, ndarray)
        Microseconds, and linear luminance, float32 (H, W), for ``EventEmulator.push(frame, t_us)``.

    Raises
    ------
    ConfigError, FormatError, OSError
        As `Upsampler` and `Upsampler.between`.
    """
    upsampler = Upsampler(network, step_px=step_px, most=most, log_eps=log_eps)
    held: tuple[int, npt.NDArray[Any]] | None = None
    for t_us, frame in frames:
        given = (t_us, np.asarray(frame))
        light = _light(given[1], transfer)
        if held is not None:
            yield from upsampler.between(held, given, transfer=transfer)
        yield t_us, light
        held = given
