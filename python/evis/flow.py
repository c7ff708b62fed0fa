"""Frames between frames, by optical flow: for films whose motion is above a pixel per frame.

Needs OpenCV: ``pip install 'evis[flow]'``. What it measures, and what it cannot do, is in docs/video.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _check
from ._evis import ConfigError

Float = npt.NDArray[np.float32]

_UNDIVIDED_PX = 1.0
"""A pair that moves no farther is left alone: straight light between its frames is nearer to the truth."""

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Rec. ITU-R BT.709-6, item 3.2."""


def _opencv() -> Any:
    try:
        import cv2
    except ImportError as error:
        raise ConfigError(
            "flow is not usable without OpenCV; pip install 'evis[flow]', or opencv-python-headless"
        ) from error
    return cv2


def _light(frame: npt.NDArray[Any], transfer: str) -> Float:
    """Return linear luminance, float32 (H, W)."""
    if frame.dtype in (np.uint8, np.uint16):
        last = int(np.iinfo(frame.dtype).max)
        value = np.arange(last + 1, dtype=np.float64) / last
        if transfer == "srgb":
            table = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        elif transfer == "rec709":
            table = np.where(value < 0.081, value / 4.5, ((value + 0.099) / 1.099) ** (1 / 0.45))
        elif transfer == "linear":
            table = value
        elif transfer.startswith("gamma:"):
            table = value ** float(transfer[6:])
        else:
            raise ConfigError(f"transfer is {transfer!r}; it must be srgb, rec709, gamma:G or linear")
        light = table.astype(np.float32)[frame]
    elif frame.dtype == np.float32:
        light = frame
    else:
        raise ConfigError(f"frames are of dtype {frame.dtype}; they must be uint8, uint16 or float32")
    if light.ndim == 3 and light.shape[2] == 3:
        light = light @ _LUMINANCE
    if light.ndim != 2:
        raise ConfigError(f"frames are of shape {frame.shape}; they must be (H, W) or (H, W, 3)")
    return np.ascontiguousarray(light, np.float32)


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


def upsample(
    frames: Iterable[tuple[int, npt.NDArray[Any]]],
    *,
    transfer: str = "srgb",
    step_px: float = 1.0,
    most: int = 64,
    log_eps: float = 1e-3,
) -> Iterator[tuple[int, Float]]:
    """Put frames between frames until nearly nothing moves by more than a pixel per step.

    Flow (DIS) is found in both directions, and each new frame is warped from both sides, weighted by time
    and by whether the two flows agree, in log light. The given frames come out unchanged; the signal is
    continuous at them. Where flow is wrong (repeated texture, thin or fast things, flicker, what comes into
    view), so are the new frames.

    Parameters
    ----------
    frames : iterable of (int, ndarray)
        Microseconds and frame, as `evis.frames` gives them: uint8, uint16 or float32, (H, W) or (H, W, 3).
    transfer : str
        Curve of integers: ``"srgb"``, ``"rec709"``, ``"gamma:G"``, ``"linear"``; `Frames` knows its own.
    step_px : float
        Pixels per step that at most a hundredth of the pixels exceeds. A pair of frames that moves by no more
        than a pixel is left alone, whatever this is.
    most : int
        Steps per pair of frames, at most.
    log_eps : float
        ``eps`` in ln(Y + eps), in which frames are blended; the sensor's.

    Yields
    ------
    (int, ndarray)
        Microseconds, and linear luminance, float32 (H, W), for ``EventEmulator.push(frame, t_us)``.

    Raises
    ------
    ConfigError
        If OpenCV is missing, or a frame cannot be used.
    """
    cv2 = _opencv()
    for what, value in (("step_px", step_px), ("most", most), ("log_eps", log_eps)):
        if not _check.number(what, value) > 0:
            raise ConfigError(f"{what} is {value}; it must be above 0")
    held: tuple[int, Float] | None = None
    for t_us, frame in frames:
        light = _light(np.asarray(frame), transfer)
        if held is not None:
            start_us, before = held
            if t_us <= start_us:
                raise ConfigError(
                    f"t_us is {t_us}; it must be above {start_us}, the time of the frame before"
                )
            if light.shape != before.shape:
                raise ConfigError(f"a frame is of shape {light.shape}; those before it are {before.shape}")
            pair = _Pair(cv2, before, light, log_eps)
            motion = pair.motion()
            steps = 1
            if motion > _UNDIVIDED_PX:
                steps = int(np.clip(np.ceil(motion / step_px), 1, min(most, t_us - start_us)))
            for k in range(1, steps):
                log = pair.at(k / steps)
                between = np.maximum(np.exp(log) - np.float32(log_eps), 0).astype(np.float32)
                yield start_us + round((t_us - start_us) * k / steps), between
        yield t_us, light
        held = (t_us, light)
