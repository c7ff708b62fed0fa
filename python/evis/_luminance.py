"""Luminance of linear light: the one place in Python that has its weights."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

EXACT_WEIGHTS = (0.2126, 0.7152, 0.0722)
"""Of red, green and blue: Rec. ITU-R BT.709-6, item 3.2; as in `evis_core::luminance`."""

WEIGHTS = np.array(EXACT_WEIGHTS, np.float32)
"""The same in float32."""

_VALUE = np.arange(256) / 255

SRGB_LIGHT = np.where(_VALUE <= 0.04045, _VALUE / 12.92, ((_VALUE + 0.055) / 1.055) ** 2.4)
"""Linear light of 8-bit codes under the sRGB curve (IEC 61966-2-1), float64 (256,)."""


def luminance(light: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Return luminance, float32 (H, W), of linear light, (H, W) or (H, W, 3)."""
    return np.ascontiguousarray(light @ WEIGHTS if light.ndim == 3 else light, np.float32)
