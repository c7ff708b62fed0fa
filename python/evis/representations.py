"""Dense arrays of events, as networks take them, of any array of events.

What EVIS makes has them as methods, such as ``packet.voxel_grid(bins=5)``; the functions here do the same for
arrays of other programs. ``events`` is one of

- an `EventArray`, a packet, a view, a recording, which know the size of their sensor;
- a structured array with the fields x, y, p and t, of any integer types;
- a mapping with the keys x, y, p and t, or a tuple (t, x, y, p), of arrays of integers,

sorted by time, with t in microseconds, and polarities 1 for ON and 0 (or -1) for OFF. ``sensor_size`` is
(width, height), or (width, height, 2) as tonic has it, and needed where the events do not know it. Every
other parameter, the shapes, the formulas and their sources are those of the method of the same name; see
`EventArray`.

>>> import numpy as np
>>> import evis
>>> columns = {"t": [0, 10, 20], "x": [3, 3, 4], "y": [0, 0, 1], "p": [1, 0, 1]}
>>> evis.representations.voxel_grid(columns, sensor_size=(640, 480), bins=5).shape
(5, 480, 640)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check
from ._events import EventArray, _from_columns, as_event_cd
from ._evis import ConfigError, EvisError
from ._represent import Decay, Limits, Measure, Polarity, Raw, Representable

__all__ = [
    "Dense",
    "averaged_timestamps",
    "bina_rep",
    "binary_stack",
    "counts",
    "event_frame",
    "event_spike_tensor",
    "time_surface",
    "to_torch",
    "voxel_grid",
]

AnyEvents: TypeAlias = (
    Representable
    | npt.NDArray[np.void]
    | Mapping[str, npt.ArrayLike]
    | tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike, npt.ArrayLike]
)
"""Events of EVIS, a structured array, columns by name, or columns (t, x, y, p)."""

_DENSE = (
    "event_frame",
    "counts",
    "voxel_grid",
    "time_surface",
    "event_spike_tensor",
    "averaged_timestamps",
    "binary_stack",
    "bina_rep",
)

SensorSize: TypeAlias = Sequence[int] | None
"""(width, height) or (width, height, 2)."""


class _Columns(Representable):
    """Events of another program."""

    __slots__ = ("_events", "_size")

    def __init__(self, events: npt.NDArray[np.void], size: tuple[int, int]) -> None:
        self._events = events
        self._size = size

    def _raw(self, limits: Limits) -> Raw:
        return self._events, self._size, False


class _Resized(Representable):
    """Events of EVIS on a sensor of another size."""

    __slots__ = ("_events", "_size")

    def __init__(self, events: Representable, size: tuple[int, int]) -> None:
        self._events = events
        self._size = size

    def _raw(self, limits: Limits) -> Raw:
        events, _, is_sorted = self._events._raw(limits)
        return events, self._size, is_sorted


def _held(events: AnyEvents, sensor_size: SensorSize) -> Representable:
    size = None if sensor_size is None else _size(sensor_size)
    if isinstance(events, Representable):
        return events if size is None else _Resized(events, size)
    if size is None:
        raise ConfigError(
            "sensor_size is not given; arrays do not say it, so give it: sensor_size=(640, 480)"
        )
    if isinstance(events, Mapping):
        missing = [name for name in "txyp" if name not in events]
        if missing:
            raise ConfigError(
                f"events has the keys {_check.shown(list(events))}; it must have t, x, y and p, an array each"
            )
        return _Columns(_from_columns(events["t"], events["x"], events["y"], events["p"]), size)
    if isinstance(events, (tuple, list)):
        if len(events) != 4:
            raise ConfigError(
                f"events is a sequence of {len(events)}; it must have four arrays: t, x, y and p"
            )
        return _Columns(_from_columns(*events), size)
    return _Columns(as_event_cd(events), size)


def _size(sensor_size: Any) -> tuple[int, int]:
    sides = _check.items("sensor_size", sensor_size, "(640, 480)")
    # tonic counts polarities as a third side.
    if len(sides) == 3 and sides[2] in (1, 2):
        sides = sides[:2]
    return _check.size(sides, 65536, "sensor_size")


def event_frame(
    events: AnyEvents,
    *,
    sensor_size: SensorSize = None,
    start_us: int | None = None,
    end_us: int | None = None,
) -> npt.NDArray[np.int32]:
    """Sum polarities, int32 (H, W): see `EventArray.event_frame`."""
    return _held(events, sensor_size).event_frame(start_us=start_us, end_us=end_us)


def counts(
    events: AnyEvents,
    *,
    sensor_size: SensorSize = None,
    start_us: int | None = None,
    end_us: int | None = None,
) -> npt.NDArray[np.int32]:
    """Count events per polarity and pixel, int32 (2, H, W): see `EventArray.counts`."""
    return _held(events, sensor_size).counts(start_us=start_us, end_us=end_us)


def voxel_grid(
    events: AnyEvents,
    bins: int = 5,
    *,
    sensor_size: SensorSize = None,
    polarity: Polarity = "signed",
    normalize: bool = False,
    start_us: int | None = None,
    end_us: int | None = None,
) -> npt.NDArray[np.float32]:
    """Make a voxel grid, float32 (bins, H, W) or (2, bins, H, W): see `EventArray.voxel_grid`."""
    return _held(events, sensor_size).voxel_grid(
        bins, polarity=polarity, normalize=normalize, start_us=start_us, end_us=end_us
    )


def time_surface(
    events: AnyEvents,
    tau_us: float,
    *,
    sensor_size: SensorSize = None,
    at_us: int | Sequence[int] | npt.NDArray[np.integer[Any]] | None = None,
    decay: Decay = "exponential",
    start_us: int | None = None,
    end_us: int | None = None,
) -> npt.NDArray[np.float32]:
    """Make time surfaces, float32 (2, H, W) or (T, 2, H, W): see `EventArray.time_surface`."""
    return _held(events, sensor_size).time_surface(
        tau_us, at_us=at_us, decay=decay, start_us=start_us, end_us=end_us
    )


def event_spike_tensor(
    events: AnyEvents,
    bins: int = 9,
    *,
    sensor_size: SensorSize = None,
    measure: Measure = "time",
    start_us: int | None = None,
    end_us: int | None = None,
) -> npt.NDArray[np.float32]:
    """Make the event spike tensor, float32 (2, bins, H, W): see `EventArray.event_spike_tensor`."""
    return _held(events, sensor_size).event_spike_tensor(
        bins, measure=measure, start_us=start_us, end_us=end_us
    )


def averaged_timestamps(
    events: AnyEvents,
    *,
    sensor_size: SensorSize = None,
    empty: float = 0.0,
    start_us: int | None = None,
    end_us: int | None = None,
) -> npt.NDArray[np.float32]:
    """Average the times of pixels and polarities, float32 (2, H, W): see `EventArray.averaged_timestamps`."""
    return _held(events, sensor_size).averaged_timestamps(empty=empty, start_us=start_us, end_us=end_us)


def binary_stack(
    events: AnyEvents,
    bins: int = 8,
    *,
    sensor_size: SensorSize = None,
    start_us: int | None = None,
    end_us: int | None = None,
) -> npt.NDArray[np.uint8]:
    """Tell which pixels fired in each part of time, uint8 (bins, 2, H, W): see `EventArray.binary_stack`."""
    return _held(events, sensor_size).binary_stack(bins, start_us=start_us, end_us=end_us)


def bina_rep(
    events: AnyEvents,
    frames: int = 1,
    bits: int = 8,
    *,
    sensor_size: SensorSize = None,
    start_us: int | None = None,
    end_us: int | None = None,
) -> npt.NDArray[np.float32]:
    """Make Bina-Rep frames, float32 (frames, 2, H, W): see `EventArray.bina_rep`."""
    return _held(events, sensor_size).bina_rep(frames, bits, start_us=start_us, end_us=end_us)


class Dense:
    """A representation with its parameters, to hand on to data sets and environments; pickles.

    Called with events of EVIS it makes the array, of their interval where they know one (a window, a packet).

    Parameters
    ----------
    name : str
        Name of a function here: ``event_frame``, ``counts``, ``voxel_grid``, ``time_surface``,
        ``event_spike_tensor``, ``averaged_timestamps``, ``binary_stack`` or ``bina_rep``.
    **parameters
        Its parameters, but ``start_us`` and ``end_us``, which are those of the window.

    Raises
    ------
    ConfigError
        If there is no such function, or it does not take the parameters.

    Examples
    --------
    >>> import evis
    >>> from evis.representations import Dense
    >>> events = evis.EventArray.from_columns([5, 6, 35], [0, 1, 2], [0, 0, 0], [1, 0, 1], width=3, height=1)
    >>> [int(Dense("counts")(window).sum()) for window in events.windows(time_us=20)]
    [2, 1]
    """

    def __init__(self, name: str, **parameters: Any) -> None:
        if name not in _DENSE:
            raise ConfigError(f"representation is {_check.shown(name)}; it must be {_check.one_of(_DENSE)}")
        fixed = sorted({"start_us", "end_us", "at_us", "sensor_size"} & set(parameters))
        if fixed:
            raise ConfigError(f"{name} is given {', '.join(fixed)}; the window says it: leave it away")
        self.name = name
        self.parameters = parameters
        self.empty(1, 1)

    def __call__(self, events: Representable) -> npt.NDArray[Any]:
        """Make the array of ``events``."""
        interval = {name: getattr(events, name, None) for name in ("start_us", "end_us")}
        try:
            made: npt.NDArray[Any] = getattr(events, self.name)(**self.parameters, **interval)
        except TypeError as error:
            raise ConfigError(f"{self!r} cannot be made: {error}") from None
        return made

    def empty(self, width: int, height: int) -> npt.NDArray[Any]:
        """Return the array of no events on a sensor of ``width`` x ``height`` pixels."""
        none = np.empty(0, np.int64)
        nothing = EventArray.from_columns(none, none, none, none, width=width, height=height)
        return self(next(nothing.windows(edges=[0, 1])))

    def __eq__(self, other: object) -> bool:
        """Compare name and parameters."""
        if not isinstance(other, Dense):
            return NotImplemented
        return (self.name, self.parameters) == (other.name, other.parameters)

    __hash__ = None  # type: ignore[assignment]  # parameters may be changed

    def __repr__(self) -> str:
        """Show the call that makes it."""
        return f"Dense({', '.join([repr(self.name), *(f'{k}={v!r}' for k, v in self.parameters.items())])})"


def dense(representation: Any) -> Callable[[Any], npt.NDArray[Any]]:
    """Return what makes an array of a window: a name becomes a `Dense`, a callable stays."""
    if isinstance(representation, str):
        return Dense(representation)
    if not callable(representation):
        raise ConfigError(
            f"representation is {_check.shown(representation)}; it must be a name, such as 'counts', "
            "evis.representations.Dense('voxel_grid', bins=5), or a function of a window"
        )
    made: Callable[[Any], npt.NDArray[Any]] = representation
    return made


def to_torch(array: npt.NDArray[Any], *, device: Any = None) -> Any:
    """Return an array as a PyTorch tensor; on the CPU it shares the array's memory, through DLPack.

    Parameters
    ----------
    array : numpy.ndarray
        What any function here returns.
    device : torch.device or str, optional
        Where the tensor shall be; the CPU where not given.

    Returns
    -------
    torch.Tensor
        Of the same shape and type.

    Raises
    ------
    EvisError
        If PyTorch is not installed.
    """
    try:
        from torch.utils.dlpack import from_dlpack
    except ImportError as error:
        raise EvisError("PyTorch is not installed; install it: pip install torch") from error
    tensor = from_dlpack(array)
    return tensor if device is None else tensor.to(device)
