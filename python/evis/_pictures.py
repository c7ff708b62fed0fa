"""Pictures of events and labels as arrays of colours, for plots, films and viewers."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ._events import Events
from ._evis import ConfigError
from ._files import RecordedView, Recording
from ._luminance import luminance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Picture = npt.NDArray[np.uint8]
"""uint8 (H, W, 3), red, green, blue as screens take them (sRGB)."""

Float = npt.NDArray[np.float32]

BACKGROUND, OFF, ON = (255, 255, 255), (0, 66, 120), (230, 159, 0)
"""Colours of ``evis preview``: polarities differ in grey prints and with every common colour vision."""

DARK_OFF, DARK_ON = (60, 130, 200), (240, 228, 66)
"""The same before a dark background."""

POLARITY_COLORS = np.array([BACKGROUND, OFF, ON], np.uint8)


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure of Matplotlib, in inches."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ConfigError("plots are not drawn without Matplotlib; pip install 'evis[plot]'") from error
    # Without pyplot: no window, and nothing that outlives the figure.
    figure = Figure(figsize=(width, height), dpi=100, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.08, h_pad=0.06)
    return figure


def last_polarity(events: Events, size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """Return what each pixel fired last.

    Parameters
    ----------
    events : numpy.ndarray
        `EventCD` (N,), sorted by time.
    size : tuple of int
        (width, height) in pixels.

    Returns
    -------
    numpy.ndarray
        uint8 (H, W): 0 nothing, 1 OFF, 2 ON.
    """
    last = np.zeros(size[::-1], np.uint8)
    # Of several values for one place, the last one stays.
    last[events["y"], events["x"]] = 1 + events["p"]
    return last


def polarity_picture(events: Events, size: tuple[int, int]) -> Picture:
    """Return `last_polarity` in the colours of ``evis preview``."""
    return np.asarray(POLARITY_COLORS[last_polarity(events, size)])


def surface_picture(surface: Float) -> Picture:
    """Return a time surface in colours: the newer polarity's, the paler the older.

    Parameters
    ----------
    surface : numpy.ndarray
        float32 (2, H, W), 0 to 1, OFF first.
    """
    share = surface.max(axis=0)[..., None]
    color = POLARITY_COLORS[1:][(surface[1] >= surface[0]).astype(np.uint8)]
    return np.asarray(np.rint((1 - share) * POLARITY_COLORS[0] + share * color), np.uint8)


def srgb(linear: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Encode linear light, 0 to 1, by the curve of sRGB (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)


def reference_of(recording: Recording, image: Float) -> float:
    """Return the luminance that counts as 1: the recording's, or what brings ``image``'s log-mean to 0.18."""
    stored = re.search(r"(?m)^reference_luminance = (\d+(\.\d+)?(e[-+]?\d+)?)$", recording.config_toml)
    if stored and 0 < float(stored[1]) < np.inf:
        return float(stored[1])
    light = luminance(image)
    light = light[np.isfinite(light)]
    return float(np.exp(np.log(np.maximum(light, 1e-6)).mean()) / 0.18) if light.size else 1.0


def tone_mapped(image: Float, reference: float) -> npt.NDArray[np.uint8]:
    """Return linear light as screens show it.

    The curve of ``evis preview``: extended Reinhard per channel, ``c (1 + c / 16) / (1 + c)`` with white at 4
    (E. Reinhard et al., Photographic tone reproduction for digital images, 2002, equation 4), then sRGB.

    Parameters
    ----------
    image : numpy.ndarray
        float32 (H, W) or (H, W, 3), linear.
    reference : float
        Its value that counts as 1.

    Returns
    -------
    numpy.ndarray
        uint8 of that shape.
    """
    c = np.clip(np.nan_to_num(image / np.float32(reference), nan=0.0), 0, 4)
    return np.asarray(np.rint(255 * srgb(np.clip(c * (1 + c / 16) / (1 + c), 0, 1))), np.uint8)


def flow_picture(flow: Float, valid: npt.NDArray[np.uint8] | None, full: float) -> Picture:
    """Return optical flow in colours: hue is direction, saturation is speed.

    Right is red, down is yellow-green, left is cyan, up is violet; white rests, and what is not valid is
    black.

    Parameters
    ----------
    flow : numpy.ndarray
        float32 (H, W, 2), x right, y down.
    valid : numpy.ndarray, optional
        (H, W), 0 where the flow is not defined.
    full : float
        Length at which colours are saturated, in the unit of ``flow``.
    """
    known = np.isfinite(flow).all(axis=-1) & (True if valid is None else valid != 0)
    x, y = np.where(known, flow[..., 0], 0), np.where(known, flow[..., 1], 0)
    hue = (np.arctan2(y, x) / (2 * np.pi)) % 1
    share = np.minimum(np.hypot(x, y) / full, 1) if full > 0 else np.zeros_like(x)
    # A. R. Smith, Color gamut transform pairs, 1978: hue to red, green and blue, at full value.
    wheel = np.clip(np.abs((6 * hue[..., None] + (0, 4, 2)) % 6 - 3) - 1, 0, 1)
    colors = np.asarray(np.rint(255 * (1 - share[..., None] * (1 - wheel))), np.uint8)
    colors[~known] = 0
    return colors


def full_speed(view: RecordedView, kind: str) -> float:
    """Return the speed that `flow_picture` saturates at, pixels per second: nearly all flow is below it."""
    labels = view.labels[kind]
    speeds = []
    for index in range(0, len(labels), max(1, len(labels) // 10)):
        seconds = flow_seconds(labels.interval_us(index))
        valid = _valid(view, kind, index)
        flow = labels[index] if valid is None else labels[index][valid != 0]
        flow = flow[np.isfinite(flow).all(axis=-1)]
        if seconds > 0 and flow.size:
            speeds.append(float(np.percentile(np.hypot(flow[..., 0], flow[..., 1]), 95)) / seconds)
    return max(speeds, default=0.0)


def flow_seconds(interval_us: tuple[int, int]) -> float:
    """Return the time that a flow image spans."""
    return abs(interval_us[1] - interval_us[0]) * 1e-6


def _valid(view: RecordedView, kind: str, index: int) -> Any:
    labels = view.labels.get(f"{kind}_valid")
    return None if labels is None or index >= len(labels) else labels[index]


def flow_of(view: RecordedView, kind: str, index: int, speed: float) -> Picture:
    """Return flow image ``index`` of a recording in colours, saturated at ``speed`` pixels per second."""
    seconds = flow_seconds(view.labels[kind].interval_us(index))
    return flow_picture(view.labels[kind][index], _valid(view, kind, index), speed * seconds)
