"""Columns of events as PyTorch tensors; PyTorch is imported when they are made."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def tensors_of_columns(events: npt.NDArray[np.void]) -> dict[str, Any]:
    """Return t, x, y and p as strided views of the events' memory; of read-only ones, of a copy."""
    try:
        import torch
    except ImportError as error:
        raise ImportError("tensors need PyTorch; install it: pip install 'evis[torch]'") from error
    if not events.flags.writeable:
        events = events.copy()
    return {name: torch.from_numpy(events[name]) for name in "txyp"}
