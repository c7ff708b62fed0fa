"""Events of many environments that stay on the device they were made on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, overload

import numpy as np

from ._events import EventArray, EventCD


class DeviceEvents(Sequence[EventArray]):
    """Events of N environments as tensors on one device, one environment after the other.

    As a sequence, it has an `EventArray` per environment; the first one that is asked for copies all events
    to the CPU. Nothing else does.

    Attributes
    ----------
    t : torch.Tensor
        Microseconds, int64 (E,); ascending within an environment, in the order (t, y, x, firing order).
    x, y : torch.Tensor
        Column and row, int32 (E,).
    p : torch.Tensor
        Polarity, int8 (E,): 1 ON, 0 OFF.
    offsets : torch.Tensor
        int64 (N + 1,): events of environment e are ``t[offsets[e]:offsets[e + 1]]``.
    width, height : int
        Size of the sensor in pixels.
    """

    def __init__(self, columns: tuple[Any, Any, Any, Any], offsets: Any, *, width: int, height: int) -> None:
        self.t, self.x, self.y, self.p = columns
        self.offsets = offsets
        self.width, self.height = width, height
        self._copied: list[EventArray] | None = None

    @property
    def device(self) -> Any:
        """Where the tensors are: a ``torch.device``."""
        return self.t.device

    @property
    def environments(self) -> Any:
        """Environment of each event, int64 (E,), on the device."""
        lengths = self.offsets.diff()
        return (lengths.new_ones(lengths.shape).cumsum(0) - 1).repeat_interleave(lengths)

    def counts(self, start_us: int | None = None) -> Any:
        """Count events per pixel and polarity on the device.

        Parameters
        ----------
        start_us : int, optional
            First microsecond that counts; all if not given.

        Returns
        -------
        torch.Tensor
            int32 (N, H, W, 2), OFF first.
        """
        shape = (len(self), self.height, self.width, 2)
        out = self.x.new_zeros(int(np.prod(shape)))
        at, ones = self._pixels() * 2 + self.p, self.x.new_ones(self.x.shape)
        if start_us is not None:
            ones = ones * (self.t >= start_us)
        return out.scatter_add_(0, at, ones).reshape(shape)

    def voxel_grid(self, bins: int, start_us: int, end_us: int) -> Any:
        """Make voxel grids of ON minus OFF events on the device, as `EventArray.voxel_grid` does.

        Parameters
        ----------
        bins : int
            Bins of time, at least 1.
        start_us, end_us : int
            First microsecond, and one past the last; events before the first one are left out.

        Returns
        -------
        torch.Tensor
            float32 (N, H, W, bins). Sums are of float32 in an order that a graphics card does not fix: there
            the last bits may differ from run to run.
        """
        span, last = max(end_us - start_us, 1), bins - 1
        place = (self.t - start_us).clamp(0, span).double() * last / span
        first = place.long()
        later = (place - first).float()
        worth = (2 * self.p - 1).float() * (self.t >= start_us)
        out = later.new_zeros(len(self) * self.height * self.width * bins)
        at = self._pixels() * bins + first
        out.scatter_add_(0, at, worth * (1 - later))
        # At the end, nothing is left for a bin that does not exist.
        out.scatter_add_(0, at + (first < last), worth * later)
        return out.reshape(len(self), self.height, self.width, bins)

    def without(self, environments: Iterable[int]) -> DeviceEvents:
        """Return the events of the other environments; these have none."""
        dropped = np.zeros(len(self), np.bool_)
        dropped[list(environments)] = True
        own = self.environments
        kept = own.new_tensor((~dropped).tolist()).bool()
        of_kept = kept[own]
        lengths = self.offsets.diff() * kept
        offsets = self.offsets.new_zeros(self.offsets.shape)
        offsets[1:] = lengths.cumsum(0)
        columns = (self.t[of_kept], self.x[of_kept], self.y[of_kept], self.p[of_kept])
        return DeviceEvents(columns, offsets, width=self.width, height=self.height)

    def __len__(self) -> int:
        """Count the environments."""
        return int(self.offsets.shape[0]) - 1

    @overload
    def __getitem__(self, index: int) -> EventArray: ...

    @overload
    def __getitem__(self, index: slice) -> list[EventArray]: ...

    def __getitem__(self, index: int | slice) -> EventArray | list[EventArray]:
        """Return events of an environment; the first time, all are copied to the CPU."""
        if self._copied is None:
            # What lies between the fields is 0 too, as in the engine's events.
            events = np.zeros(int(self.t.shape[0]), EventCD)
            for name, column in zip("txyp", (self.t, self.x, self.y, self.p), strict=True):
                events[name] = column.cpu().numpy()
            parts = np.split(events, self.offsets[1:-1].tolist())
            self._copied = [EventArray._trusted(part, self.width, self.height) for part in parts]
        return self._copied[index]

    def __repr__(self) -> str:
        """Say how many there are, and where."""
        size = f"{self.width}x{self.height}"
        return f"DeviceEvents({self.t.shape[0]} events of {len(self)} environments, {size}, {self.device})"

    def _pixels(self) -> Any:
        """Return the number of each event's pixel among those of all environments, int64 (E,)."""
        return (self.environments * self.height + self.y) * self.width + self.x
