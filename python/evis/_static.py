"""Pictures of a scene that stands still: whether they do, and what changes them if not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _check
from ._evis import ConfigError
from ._luminance import SRGB_LIGHT, WEIGHTS

Float = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class StaticCheck:
    """What changed between two pictures of a scene that stands still.

    Attributes
    ----------
    share : float
        Share of the pixels whose log luminance changed by a threshold: they fire without a cause.
    change : float
        Mean absolute change of log luminance.
    suspect : {"nothing", "auto-exposure", "temporal antialiasing", "denoiser"}
        What such changes come from, mostly: all pixels alike, edges, or everywhere at random.
    """

    share: float
    change: float
    suspect: Literal["nothing", "auto-exposure", "temporal antialiasing", "denoiser"]

    @property
    def advice(self) -> str:
        """What to do, in words."""
        return _ADVICE[self.suspect]


_ADVICE = {
    "nothing": "nothing fires",
    "auto-exposure": "all of the picture changed alike, as by automatic exposure: lock the camera's exposure",
    "temporal antialiasing": "edges changed, as by the jitter of temporal antialiasing (TAA, DLSS, DLAA): "
    "switch it off",
    "denoiser": "pixels changed everywhere at random, as by a denoiser or by the noise of path tracing: "
    "switch the denoiser off, and take more samples per pixel",
}


def check_static(older_hdr: Any, hdr: Any, *, threshold: float = 0.2) -> StaticCheck:
    """Tell whether a renderer's pictures of a still scene stand still, and what changes them if not.

    Call it once for a renderer, with two keyframes, some frames apart, of a textured scene in which nothing
    moves and no light changes.

    Parameters
    ----------
    older_hdr, hdr : array_like
        Light of both, (H, W), (H, W, 1) or (H, W, 3): linear float32, or uint8 under the sRGB curve.
    threshold : float
        Change of log luminance that fires an event.

    Returns
    -------
    StaticCheck
        How many pixels fire, and what to suspect.

    Raises
    ------
    ConfigError
        If shapes or types cannot be used.
    """
    older, newer = (luminance(what, value) for what, value in (("older_hdr", older_hdr), ("hdr", hdr)))
    if older.shape != newer.shape or older.ndim != 2 or min(older.shape) < 2:
        raise ConfigError(
            f"older_hdr and hdr show {older.shape} and {newer.shape} pixels; they must be two pictures of "
            "the same size, (H, W), (H, W, 1) or (H, W, 3), at least 2x2"
        )
    if not (threshold := _check.number("threshold", threshold)) > 0:
        raise ConfigError(f"threshold is {threshold}; it must be above 0")
    return compared(older, newer, threshold)


def compared(older: Float, newer: Float, threshold: float) -> StaticCheck:
    """Compare two pictures (H, W) of luminance: what `check_static` says of them."""
    known = np.isfinite(older) & np.isfinite(newer) & (older >= 0) & (newer >= 0)
    if not known.any():
        return StaticCheck(0.0, 0.0, "nothing")
    # Relative to the picture: what is black changes by any factor and means nothing.
    floor = 1e-3 * float(older[known].mean()) + 1e-30
    before, now = (np.log(np.where(known, light, 0.0) + floor) for light in (older, newer))
    change = np.where(known, now - before, 0.0)
    size = np.abs(change)
    share, mean = float((size >= threshold)[known].mean()), float(size[known].mean())
    if share == 0.0:
        return StaticCheck(share, mean, "nothing")
    common = float(np.median(change[known]))
    alike = float((np.sign(change[known]) == np.sign(common)).mean())
    if abs(common) >= 0.5 * mean and alike >= 0.9:
        return StaticCheck(share, mean, "auto-exposure")
    slopes = np.gradient(before)
    slope = np.hypot(slopes[0], slopes[1])
    steep, flat = (known & (slope >= np.quantile(slope, 0.75))), (known & (slope <= np.quantile(slope, 0.5)))
    at_edges, elsewhere = (float(size[where].mean()) if where.any() else 0.0 for where in (steep, flat))
    return StaticCheck(share, mean, "temporal antialiasing" if at_edges > 3 * elsewhere else "denoiser")


def linear(light: npt.NDArray[Any]) -> Float:
    """Return linear light, of codes by the sRGB curve (IEC 61966-2-1)."""
    if light.dtype != np.uint8:
        return light.astype(np.float32, copy=False)
    return np.asarray(SRGB_LIGHT.astype(np.float32)[light])


def luminance(what: str, light: Any) -> Float:
    """Return linear luminance (H, W) of a picture, in an array of its own."""
    given = np.asarray(light)
    if given.dtype.kind != "f" and given.dtype != np.uint8:
        raise ConfigError(f"dtype of {what} is {given.dtype}; it must be float32 or uint8")
    array = linear(given)
    if array.ndim == 3 and array.shape[-1] == 3:
        return np.asarray(array @ WEIGHTS)
    return np.array(array[..., 0] if array.ndim == 3 and array.shape[-1] == 1 else array)
