"""Luminance of linear light: the one place in Python that has its weights."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

WEIGHTS = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Of red, green and blue: Rec. ITU-R BT.709-6, item 3.2; as in `evis_core::luminance`."""


def luminance(light: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Return luminance, float32 (H, W), of linear light, (H, W) or (H, W, 3)."""
    return np.ascontiguousarray(light @ WEIGHTS if light.ndim == 3 else light, np.float32)
