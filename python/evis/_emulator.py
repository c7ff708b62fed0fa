"""The sensor on its own: frames in, events out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeAlias, TypeVar, cast, overload

import numpy as np
import numpy.typing as npt

from . import _evis
from ._events import EventArray
from ._evis import ConfigError
from ._sensor import Sensor

Transfer: TypeAlias = Literal["linear", "log", "srgb", "rec709", "gamma"]
"""What a frame's numbers are: light, its logarithm, or light under a transfer curve."""

Out = TypeVar("Out", EventArray, list[EventArray])

_CPU = 1  # kDLCPU


@dataclass(frozen=True, kw_only=True, slots=True)
class EmulatorReport:
    """What happened in one push, or in all of them.

    Attributes
    ----------
    events : int
        Events that came out.
    unknown : int
        Pixel values that were NaN: those pixels kept their state.
    clamped : int
        Times that a pixel would have fired more events in one interval than it may.
    suppressed : int
        Events that were lost to the refractory period.
    dropped : int
        Events that were lost to the readout's rate limit.
    copies : int
        Arrays that were copied because they were not contiguous.
    """

    events: int
    unknown: int
    clamped: int
    suppressed: int
    dropped: int
    copies: int


class EventEmulator(Generic[Out]):
    """Turn frames into events, for light that somebody else made.

    Between two frames, the signal is straight. Events lie in ``(t0, t1]``, sorted by (t, y, x, firing order).
    Memory does not grow with the stream's length. No event depends on the number of threads, on how a stream
    is cut into pushes, or on which other environments are in the batch.

    Parameters
    ----------
    width, height : int
        Size of the sensor in pixels.
    sensor : Sensor or str, optional
        The sensor, or the name of a preset; an ideal one if not given.
    batch : int, optional
        Environments that are pushed together; `push` then takes and gives one more dimension. None: one
        camera.
    seed : int
        Seed of everything random.
    camera : int
        Number of the camera within its environment; cameras of different numbers have noise of their own.
    reference_luminance : float
        Y_ref of the sensor's formula.
    threads : int
        Threads that work on a push; 0: as many as there are cores.

    Raises
    ------
    ConfigError
        If a setting cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> import evis
    >>> emulator = evis.EventEmulator(4, 3)
    >>> emulator.push(np.full((3, 4), 0.5, np.float32), 0)
    EventArray(0 events, 4x3)
    >>> events = emulator.push(np.full((3, 4), 0.7, np.float32), 1000)
    >>> events.t[0], events.p[0], len(events)
    (np.int64(595), np.int16(1), 12)
    """

    @overload
    def __init__(
        self: EventEmulator[EventArray],
        width: int,
        height: int,
        sensor: Sensor | str | None = None,
        *,
        batch: None = None,
        seed: int = 0,
        camera: int = 0,
        reference_luminance: float = 1.0,
        threads: int = 0,
    ) -> None: ...

    @overload
    def __init__(
        self: EventEmulator[list[EventArray]],
        width: int,
        height: int,
        sensor: Sensor | str | None = None,
        *,
        batch: int,
        seed: int = 0,
        camera: int = 0,
        reference_luminance: float = 1.0,
        threads: int = 0,
    ) -> None: ...

    def __init__(
        self,
        width: int,
        height: int,
        sensor: Sensor | str | None = None,
        *,
        batch: int | None = None,
        seed: int = 0,
        camera: int = 0,
        reference_luminance: float = 1.0,
        threads: int = 0,
    ) -> None:
        if sensor is None:
            sensor = Sensor()
        elif isinstance(sensor, str):
            sensor = Sensor.preset(sensor)
        for what, value, most in (
            ("width", width, 65536),
            ("height", height, 65536),
            ("batch", 1 if batch is None else batch, 2**31),
        ):
            if not 0 < value <= most:
                raise ConfigError(f"{what} is {value}; it must be between 1 and {most}")
        for what, value in (("seed", seed), ("camera", camera), ("threads", threads)):
            limit = 64 if what == "seed" else 32
            if not 0 <= value < 2**limit:
                raise ConfigError(f"{what} is {value}; it must be at least 0 and below 2**{limit}")
        sensor.check()
        self._sensor = sensor
        self._settings: dict[str, Any] = {
            "width": int(width),
            "height": int(height),
            "batch": None if batch is None else int(batch),
            "seed": int(seed),
            "camera": int(camera),
            "reference_luminance": float(reference_luminance),
            "threads": int(threads),
        }
        self._copies = (0, 0)
        self._emulator = _evis.EventEmulator(
            **{**self._settings, "batch": 1 if batch is None else batch}, sensor=sensor._json()
        )

    @property
    def width(self) -> int:
        """Pixels per row."""
        return cast("int", self._settings["width"])

    @property
    def height(self) -> int:
        """Rows."""
        return cast("int", self._settings["height"])

    @property
    def batch(self) -> int | None:
        """Environments that are pushed together; None: one camera."""
        return cast("int | None", self._settings["batch"])

    @property
    def sensor(self) -> Sensor:
        """The sensor."""
        return self._sensor

    @property
    def now_us(self) -> int | None:
        """Time of the last frame, microseconds; None before the first one."""
        return self._emulator.now_us()

    @property
    def report(self) -> EmulatorReport:
        """What happened in the last push."""
        return EmulatorReport(**self._emulator.reports()[0], copies=self._copies[0])

    @property
    def total_report(self) -> EmulatorReport:
        """What happened in all pushes."""
        return EmulatorReport(**self._emulator.reports()[1], copies=self._copies[1])

    def push(self, frames: Any, t_us: int, *, transfer: Transfer | None = None, gamma: float = 2.2) -> Out:
        """Take the frame, or with a batch the frames, of one time; return the events since the last ones.

        Parameters
        ----------
        frames : array_like or DLPack tensor on the CPU
            Shape (H, W) or (H, W, 3); with a batch (N, H, W) or (N, H, W, 3). dtype float32 (linear light, or
            its logarithm), uint8 or uint16. C-contiguous arrays are not copied; others are, which `report`
            counts. NaN means unknown: the pixel keeps its state.
        t_us : int
            Time in microseconds, above that of the last push.
        transfer : {"linear", "log", "srgb", "rec709", "gamma"}, optional
            What the numbers are. If not given, linear for float32 and sRGB for integers; ``log`` is for
            float32 of one channel.
        gamma : float
            Exponent where ``transfer`` is ``gamma``: light = value ** gamma.

        Returns
        -------
        EventArray or list of EventArray
            Events in ``(t0, t1]``; with a batch, one per environment. The first frame of an environment makes
            none.

        Raises
        ------
        ConfigError
            If shape, dtype, time or transfer cannot be used, or light is negative or infinite. Nothing has
            changed then.
        """
        array, copied = _as_array(frames)
        channels = self._channels(array)
        if transfer is None:
            transfer = "linear" if array.dtype == np.float32 else "srgb"
        if not isinstance(t_us, (int, np.integer)) or isinstance(t_us, bool) or not -(2**62) < t_us < 2**62:
            raise ConfigError(f"t_us is {t_us!r}; it must be an integer, microseconds")
        lists = self._emulator.push(
            array.reshape(-1), int(t_us), channels=channels, transfer=str(transfer), gamma=float(gamma)
        )
        self._copies = (int(copied), self._copies[1] + int(copied))
        made = [EventArray._trusted(events, self.width, self.height) for events in lists]
        return cast("Out", made[0] if self.batch is None else made)

    def reset(self, env_ids: int | Sequence[int] | npt.NDArray[np.integer[Any]] | None = None) -> None:
        """Let environments begin anew with their next frame; time may start anywhere if all are reset.

        Parameters
        ----------
        env_ids : int or sequence of int, optional
            Environments; all if not given.

        Raises
        ------
        ConfigError
            If there is no such environment.
        """
        if env_ids is None:
            self._emulator.reset(None)
            return
        indices = [int(index) for index in np.atleast_1d(np.asarray(env_ids))]
        size = 1 if self.batch is None else self.batch
        for index in indices:
            if not 0 <= index < size:
                raise ConfigError(
                    f"environment is {index}; it must be at least 0 and below the batch of {size}"
                )
        self._emulator.reset(indices)

    def get_state(self) -> bytes:
        """Return everything that the next events depend on, apart from the settings."""
        return self._emulator.state()

    def set_state(self, state: bytes) -> None:
        """Take up where `get_state` was called, on an emulator of the same settings.

        Raises
        ------
        ConfigError
            If the state is not of such an emulator.
        """
        self._emulator.restore(state)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle settings and state."""
        return _unpickle, (self._sensor, self._settings, self.get_state())

    def __repr__(self) -> str:
        """Say size, batch and time."""
        batch = "" if self.batch is None else f", batch of {self.batch}"
        return f"EventEmulator({self.width}x{self.height}{batch}, now_us={self.now_us})"

    def _channels(self, array: npt.NDArray[Any]) -> int:
        image: tuple[int, ...] = (self.height, self.width)
        wanted: tuple[int, ...] = image if self.batch is None else (self.batch, *image)
        if array.shape == wanted:
            return 1
        if array.shape == (*wanted, 3):
            return 3
        raise ConfigError(f"frames have shape {array.shape}; they must have {wanted} or {(*wanted, 3)}")


def _unpickle(sensor: Sensor, settings: dict[str, Any], state: bytes) -> EventEmulator[Any]:
    settings = dict(settings)
    emulator: EventEmulator[Any] = EventEmulator(
        settings.pop("width"), settings.pop("height"), sensor, **settings
    )
    emulator.set_state(state)
    return emulator


def _as_array(frames: Any) -> tuple[npt.NDArray[Any], bool]:
    """View anything as a C-contiguous array of a dtype that the engine reads; say whether it was copied."""
    if not isinstance(frames, np.ndarray) and hasattr(frames, "__dlpack_device__"):
        device = frames.__dlpack_device__()
        if int(device[0]) != _CPU:
            raise ConfigError(
                f"frames are on DLPack device {int(device[0])}:{int(device[1])}; "
                "they must be on the CPU (tensor.cpu())"
            )
        frames = np.from_dlpack(frames)
    array: npt.NDArray[Any] = np.asarray(frames)
    if array.dtype not in (np.float32, np.uint8, np.uint16):
        raise ConfigError(f"frames have dtype {array.dtype}; they must have float32, uint8 or uint16")
    contiguous = np.ascontiguousarray(array)
    return contiguous, not np.may_share_memory(contiguous, array)
