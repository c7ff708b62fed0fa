"""The sensor on its own: frames in, events out."""

from __future__ import annotations

import json
import math
import re
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, TypeAlias, TypeVar, cast, overload

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._events import EventArray
from ._evis import ConfigError
from ._host_arrays import Copies
from ._method import Warp
from ._packets import CAUSE
from ._sensor import Sensor, sensor_of

Transfer: TypeAlias = Literal["linear", "log", "srgb", "rec709", "gamma"]
"""What a frame's numbers are: light, its logarithm, or light under a transfer curve."""

Out = TypeVar("Out", EventArray, list[EventArray])

#: Floats whose mean is so many times the reference are probably not linear light.
_MOST_MEAN = 16

_CPU = 1  # kDLCPU

#: What the engine reads. As dtypes, which are compared by identity first; types would be turned into dtypes.
_FLOAT32 = np.dtype(np.float32)
_LIGHT = (np.dtype(np.float32), np.dtype(np.uint8), np.dtype(np.uint16))


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
        Events that the readout dropped: beyond its rate limit, or where 2^18 waited for a bus.
    copies : int
        Arrays that were copied because they were not contiguous.
    """

    events: int
    unknown: int
    clamped: int
    suppressed: int
    dropped: int
    copies: int


@dataclass(frozen=True, kw_only=True, slots=True)
class KeyframeReport:
    """What became of one environment's keyframe and the gap before it.

    Attributes
    ----------
    steps : int
        Instants of the gap, the keyframe included.
    motion_px : float
        Pixels that all but a thousandth of the picture's pixels moved at most since the last keyframe.
    linked : float
        Part of the picture whose surfaces were found in the last keyframe, by motion and depth.
    unknown : int
        Pixels and instants at which no light was known: there the pixel's memory stayed.
    bad_depth : int
        Pixels with a depth that is none (0, negative, NaN): taken for nothing there.
    bad_motion : int
        Pixels with a motion vector that is none (NaN, or 16 384 pixels and more): not moved. With
        ``motion_steps``, also those whose path comes upon one or leaves the picture: its last step goes on.
    strayed : float
        Part of the picture whose paths through ``motion_steps`` end more than a pixel from where
        ``motion_vectors`` lead, as behind other surfaces: they are straight.
    cut : {"none", "start", "declared", "detected"}
        Why the gap was not warped, if it was not: there was no last keyframe, or a cut.
    warnings : tuple of str
        What to change, in words: motion too large for the rate, a cut.
    """

    steps: int
    motion_px: float
    linked: float
    unknown: int
    bad_depth: int
    bad_motion: int
    strayed: float
    cut: Literal["none", "start", "declared", "detected"]
    warnings: tuple[str, ...]


class EventEmulator(Generic[Out]):
    """Turn frames into events, for frames of another renderer or camera.

    Between two frames, the signal is straight. Events lie in ``(t0, t1]``, sorted by (t, y, x, firing order);
    with an `Exposure` they come late, and still in this order from push to push.
    Memory does not grow with the stream's length. No event depends on the number of threads, on how a stream
    is cut into pushes, or on which other environments are in the batch.

    Parameters
    ----------
    width, height : int
        Size of the sensor in pixels.
    sensor : Sensor or str, optional
        The sensor, or the name of a preset or TOML file; an ideal one if not given.
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
    labels : sequence of {"cause"}
        ``cause``: `causes` tells why each event fired.

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
        labels: Iterable[Literal["cause"]] = (),
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
        labels: Iterable[Literal["cause"]] = (),
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
        labels: Iterable[Literal["cause"]] = (),
    ) -> None:
        sensor = sensor_of(sensor)
        wanted = _check.items("labels", labels, "['cause']")
        for label in wanted:
            if label != CAUSE:
                raise ConfigError(
                    f"label is {_check.shown(label)}; it must be 'cause': images come from a Simulator"
                )
        self._sensor = sensor
        self._settings: dict[str, Any] = {
            "width": _check.whole("width", width, 1, 65536),
            "height": _check.whole("height", height, 1, 65536),
            "batch": None if batch is None else _check.whole("batch", batch, 1, 2**31),
            "seed": _check.whole("seed", seed, 0, 2**64 - 1),
            "camera": _check.whole("camera", camera),
            "reference_luminance": _check.number("reference_luminance", reference_luminance),
            "threads": _check.whole("threads", threads),
            "labels": tuple(wanted),
        }
        sensor.check()
        self._copies = (0, 0)
        # Whether frames have come since the start or a reset: the first ones are checked.
        self._begun = False
        image: tuple[int, int] = (self._settings["height"], self._settings["width"])
        self._frame: tuple[int, ...] = image if batch is None else (self._settings["batch"], *image)
        self._colours = (*self._frame, 3)
        # Kinds of warnings that were given.
        self._warned: set[str] = set()
        self._emulator = _evis.EventEmulator(
            **{name: value for name, value in self._settings.items() if name != "labels"}
            | {"batch": self._settings["batch"] or 1, "causes": CAUSE in wanted},
            sensor=sensor._json(),
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
    def causes(self) -> npt.NDArray[np.uint8] | Any:
        """Why each event of the last push fired: uint8 (N,), indices of `CAUSES`; a list with a batch.

        None where ``cause`` is not among the labels, and before the first push.
        """
        lists = self._emulator.causes()
        if not lists:
            return None
        return lists[0] if self.batch is None else lists

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
        frames : array_like or DLPack tensor
            Shape (H, W), (H, W, 3) or (H, W, 4), whose alpha is left out; with a batch (N, ...). dtype
            float32 (linear light, or its logarithm), uint8 or uint16. C-contiguous arrays of these are not
            copied; others, float16, float64, arrays with alpha and tensors on another device are, which
            `report` counts; the last are warned of once, with what a copy takes. NaN means
            unknown: the pixel keeps its state, which is warned of once and counted in `report`. A warning
            asks whether floats are 0 to 255 where the first ones are beyond 16 times
            ``reference_luminance`` on average.
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
        transfers = None if type(frames) is np.ndarray else Copies()
        array, copied = _as_array(frames, transfers=transfers)
        if array.shape == self._frame:
            channels = 1
        else:
            array, copied = _without_alpha(array, copied, self._frame)
            channels = self._channels(array)
        if transfer is None:
            transfer = "linear" if array.dtype == _FLOAT32 else "srgb"
        if not self._begun and self.now_us is None and array.dtype == _FLOAT32 and transfer == "linear":
            self._warn_of_8_bit_range(array)
        lists = self._emulator.push(
            array.reshape(-1),
            _check.time_us("t_us", t_us),
            channels=channels,
            transfer=str(transfer),
            gamma=_check.number("gamma", gamma),
        )
        self._begun = True
        if transfers is not None:
            self._warn_of(transfers)
        return self._made(lists, int(copied))

    def push_keyframe(
        self,
        hdr: Any,
        depth: Any,
        motion_vectors: Any,
        t_us: int,
        *,
        motion_steps: Any = None,
        motion_forward: Any = None,
        cut: bool | Sequence[bool] | npt.NDArray[np.bool_] = False,
        steps: int | Literal["auto"] | None = None,
        warp: Warp | Literal["splat", "evis-paper"] = "splat",
        transfer: Transfer | None = None,
        gamma: float = 2.2,
    ) -> Out:
        """Take what a renderer knows of one time; return the events since the last keyframe.

        The light between two keyframes is warped along the motion vectors from both, at as many instants as
        the motion requires, then goes through the sensor model as in `push`. Where neither keyframe knows it,
        a pixel's memory stays. Arrays are NumPy or DLPack, as in `push`, float32 but for ``hdr``, which may
        hold integers; ``(H, W)`` stands for the sensor's size, larger by ``warp.margin`` on every side, and
        for ``(N, H, W)`` with a batch.

        Parameters
        ----------
        hdr : array_like or DLPack tensor
            Linear light, before any tone curve: (H, W), (H, W, 1) or (H, W, 3). NaN means unknown. Or
            uint8 or uint16 under the curve ``transfer``: what it has clipped makes no events.
        depth : array_like or DLPack tensor, optional
            Planar z in metres, +inf where nothing is: (H, W) or (H, W, 1). 0, negative values and NaN count
            as nothing; the report counts them. None, in all keyframes of a stream: what moves farther is
            taken for nearer, as in the EVIS paper.
        motion_vectors : array_like or DLPack tensor
            (H, W, 2): where each pixel's surface was at the last keyframe, as seen from where it is now, in
            pixels, x right, y down: ``before = here + motion``. This is `flow_backward` of a `Simulator` and
            ``motion_vectors`` of Isaac Lab as they are; docs/methods.md maps others. NaN, or 16 384 pixels
            and more, means unknown. Those of an environment's first keyframe are not used. May be None
            with ``motion_steps``: it is then where these lead.
        t_us : int
            Time in microseconds, above that of the last push.
        motion_steps : array_like or DLPack tensor, optional
            (K, H, W, 2), with a batch (N, K, H, W, 2); K from 1 to 1000: motion within the gap before this
            keyframe, in pixels, the oldest first. ``motion_steps[k]`` has, for each pixel of the picture at
            ``t0 + (k + 1) / K * (t1 - t0)``, where its surface was at ``t0 + k / K * (t1 - t0)``, in the
            convention of ``motion_vectors``. Paths are integrated through these fields, as by the dense mode
            of the EVIS paper, instead of straight; K is then the default of ``steps``.
        motion_forward : array_like or DLPack tensor, optional
            (H, W, 2): the same to where it will be at the *next* keyframe: ``after = here + motion``. Without
            it, the next keyframe's vectors are turned around, and what it does not show moves on evenly.
        cut : bool or sequence of bool
            Whether this keyframe has nothing to do with the last one (a camera cut, a teleported robot), or
            per environment. That environment is reset, as by `reset`: it makes no events.
        steps : int or {"auto"}, optional
            Instants per gap, before ``warp.steps``; ``auto``: K of ``motion_steps``, or else as many as
            ``warp.step_px`` asks for.
        warp : Warp or {"splat", "evis-paper"}
            How the instants between keyframes are made.
        transfer : {"linear", "srgb", "rec709", "gamma"}, optional
            What the numbers of ``hdr`` are. If not given, linear for float32 and sRGB for integers.
        gamma : float
            Exponent where ``transfer`` is ``gamma``: light = value ** gamma.

        Returns
        -------
        EventArray or list of EventArray
            Events in ``(t0, t1]``; with a batch, one per environment. The first keyframe of an environment
            makes none. `keyframe_report` says what was done, and what to change; the first time, a
            UserWarning says it too.

        Raises
        ------
        ConfigError
            If shape, dtype, time, transfer or settings cannot be used, or light is negative or infinite.
            Nothing has changed then.

        Examples
        --------
        >>> import numpy as np
        >>> import evis
        >>> emulator = evis.EventEmulator(32, 24)
        >>> def render(x0):  # a bright edge at column x0
        ...     row = np.where(np.arange(32) < x0, 0.8, 0.2)
        ...     return np.tile(row, (24, 1)).astype(np.float32)
        >>> depth = np.full((24, 32), 2.0, np.float32)
        >>> motion = np.zeros((24, 32, 2), np.float32)
        >>> motion[..., 0] = -4  # it was 4 pixels to the left
        >>> emulator.push_keyframe(render(10), depth, motion, 0)
        EventArray(0 events, 32x24)
        >>> events = emulator.push_keyframe(render(14), depth, motion, 8000)
        >>> sorted(set(events.x.tolist())), emulator.keyframe_report.steps
        ([10, 11, 12, 13], 14)
        """
        settings = _check.plain(_warp(warp, steps))
        border = 2 * (settings["margin"] or 0)
        size_hw: tuple[int, int] = (self.height + border, self.width + border)
        shape: tuple[int, ...] = size_hw if self.batch is None else (self.batch, *size_hw)
        transfers = Copies()
        light, copies = _picture("hdr", hdr, shape, (1, 3), (np.float32, np.uint8, np.uint16), transfers)
        if transfer is None:
            transfer = "linear" if light.dtype == np.float32 else "srgb"
        depths = np.empty(0, np.float32)
        if depth is not None:
            depths, copied = _picture("depth", depth, shape, (1,), transfers=transfers)
            copies += copied
        motion = fields = forward = None
        if motion_vectors is None and motion_steps is None:
            raise ConfigError("motion_vectors is None; it must be an array where motion_steps is not given")
        if motion_vectors is not None:
            motion, copied = _picture("motion_vectors", motion_vectors, shape, (2,), transfers=transfers)
            copies += copied
        if motion_steps is not None:
            fields, copied = _motion_steps(motion_steps, shape, transfers)
            copies += copied
        if motion_forward is not None:
            forward, copied = _picture("motion_forward", motion_forward, shape, (2,), transfers=transfers)
            copies += copied
        channels = light.size // math.prod(shape)
        size = 1 if self.batch is None else self.batch
        cuts = np.atleast_1d(np.asarray(cut))
        if cuts.dtype != np.bool_ or cuts.shape not in ((1,), (size,)):
            raise ConfigError(f"cut is {cut!r}; it must be a bool, or {size} of them")
        lists = self._emulator.push_keyframe(
            light.reshape(-1),
            depths.reshape(-1),
            None if motion is None else motion.reshape(-1),
            _check.time_us("t_us", t_us),
            motion_steps=None if fields is None else fields.reshape(-1),
            motion_forward=None if forward is None else forward.reshape(-1),
            cut=np.broadcast_to(cuts, size).tolist(),
            channels=channels,
            transfer=str(transfer),
            gamma=_check.number("gamma", gamma),
            warp=json.dumps(settings),
        )
        for report in self._emulator.keyframe_reports():
            for text in report["warnings"]:
                kind = re.sub(r"[0-9.]+", "", text)
                if kind not in self._warned:
                    self._warned.add(kind)
                    warnings.warn(text, stacklevel=2)
        self._warn_of(transfers)
        return self._made(lists, copies)

    @property
    def keyframe_report(self) -> KeyframeReport | Any:
        """What became of the last keyframe: a `KeyframeReport`, with a batch a list of them, one each.

        None where the last push was none of keyframes.
        """
        reports = [
            KeyframeReport(**{**report, "warnings": tuple(report["warnings"])})
            for report in self._emulator.keyframe_reports()
        ]
        if not reports:
            return None
        return reports[0] if self.batch is None else reports

    def _warn_of(self, transfers: Copies) -> None:
        """Warn once of what is copied from another device with each push."""
        if transfers.size and "transfers" not in self._warned:
            self._warned.add("transfers")
            warnings.warn(transfers.in_words("push"), stacklevel=3)

    def _made(self, lists: list[npt.NDArray[np.void]], copies: int) -> Out:
        self._copies = (copies, self._copies[1] + copies)
        height, width = self._frame[-2:]
        # Once per frame: without a batch, no list of one is made.
        made: EventArray | list[EventArray]
        if len(self._frame) == 2:
            made = EventArray._trusted(lists[0], width, height)
        else:
            made = [EventArray._trusted(events, width, height) for events in lists]
        return cast("Out", made)

    def reset(self, env_ids: int | Sequence[int] | npt.NDArray[np.integer[Any]] | None = None) -> None:
        """Reset environments: they start with their next frame; time may start anywhere if all are reset.

        Parameters
        ----------
        env_ids : int or sequence of int, optional
            Environments; all if not given.

        Raises
        ------
        ConfigError
            If there is no such environment.
        """
        self._begun = False
        if env_ids is None:
            self._emulator.reset(None)
            return
        size = 1 if self.batch is None else self.batch
        given = np.atleast_1d(np.asarray(env_ids))
        if given.ndim != 1 or (given.size and given.dtype.kind not in "iu"):
            mask = ": np.flatnonzero(mask) for a mask" if given.dtype == np.bool_ else ""
            raise ConfigError(
                f"env_ids is {_check.shown(env_ids)}; it must be the number of an environment, or a sequence "
                f"of them{mask}"
            )
        indices = [int(index) for index in given]
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
        if not isinstance(state, bytes):
            raise ConfigError(f"state is {_check.shown(state)}; it must be the bytes that get_state returns")
        self._begun = False
        self._emulator.restore(state)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle settings and state."""
        return _unpickle, (self._sensor, self._settings, self.get_state())

    def __repr__(self) -> str:
        """Say size, batch and time."""
        batch = "" if self.batch is None else f", batch of {self.batch}"
        return f"EventEmulator({self.width}x{self.height}{batch}, now_us={self.now_us})"

    def _warn_of_8_bit_range(self, array: npt.NDArray[Any]) -> None:
        """Warn where floats seem to range from 0 to 255."""
        known = array[np.isfinite(array)]
        mean = float(known.mean(dtype=np.float64)) if known.size else 0.0
        reference = float(self._settings["reference_luminance"])
        if mean > _MOST_MEAN * reference:
            warnings.warn(
                f"frames are {mean:.3g} on average, more than {_MOST_MEAN} times reference_luminance "
                f"({reference:g}); are they 0 to 255? Floats are linear light with white at 1: push "
                "uint8, or divide by 255 and decode the curve",
                stacklevel=3,
            )

    def _channels(self, array: npt.NDArray[Any]) -> int:
        if array.shape == self._frame:
            return 1
        if array.shape == self._colours:
            return 3
        with_alpha = (*self._frame, 4)
        raise ConfigError(
            f"frames have shape {array.shape}; they must have {self._frame}, {self._colours} or {with_alpha}"
        )


def _unpickle(sensor: Sensor, settings: dict[str, Any], state: bytes) -> EventEmulator[Any]:
    settings = dict(settings)
    emulator: EventEmulator[Any] = EventEmulator(
        settings.pop("width"), settings.pop("height"), sensor, **settings
    )
    emulator.set_state(state)
    return emulator


def _warp(warp: Any, steps: int | Literal["auto"] | None) -> Warp:
    if isinstance(warp, Warp):
        chosen = warp
    elif warp == "splat":
        chosen = Warp()
    elif warp == "evis-paper":
        chosen = Warp.evis_paper()
    else:
        raise ConfigError(f"warp is {_check.shown(warp)}; it must be 'splat', 'evis-paper' or a Warp")
    if isinstance(steps, str) and steps != "auto":
        raise ConfigError(f"steps is {steps!r}; it must be a number of instants, or 'auto'")
    return chosen if steps is None else replace(chosen, steps=None if steps == "auto" else steps)


@dataclass(frozen=True, slots=True)
class MotionCheck:
    """Which convention motion vectors follow.

    Attributes
    ----------
    scale : (float, float)
        What x and y of the vectors must be multiplied by before they are pushed; (1, 1) where they are right.
    convention : str
        The convention of the vectors, in words.
    error_given : float
        Mean absolute difference of log luminance between a pixel and where the vectors as given lead from it.
    error : float
        The same with scaled vectors.
    """

    scale: tuple[float, float]
    convention: str
    error_given: float
    error: float

    @property
    def is_right(self) -> bool:
        """Whether the vectors may be pushed as they are."""
        return self.scale == (1.0, 1.0)


def check_motion(
    older_hdr: Any, hdr: Any, motion_vectors: Any, *, transfer: Transfer | None = None, gamma: float = 2.2
) -> MotionCheck:
    """Tell which convention a renderer's motion vectors follow, from two keyframes.

    Each convention (signs, parts of the picture, clip space) leads from pixels of the newer picture to places
    in the older one; the right one leads to the same light. Call it once for a renderer, with two keyframes
    between which a textured picture moves by some pixels.

    Parameters
    ----------
    older_hdr, hdr : array_like or DLPack tensor
        Light of the older and of the newer keyframe, as in `EventEmulator.push_keyframe`: (H, W), (H, W, 1)
        or (H, W, 3), linear float32, or uint8 or uint16 under ``transfer``.
    motion_vectors : array_like or DLPack tensor
        Vectors of the newer keyframe, float32 (H, W, 2).
    transfer : {"linear", "srgb", "rec709", "gamma"}, optional
        What the numbers of the pictures are. If not given, linear for float32 and sRGB for integers.
    gamma : float
        Exponent where ``transfer`` is ``gamma``: light = value ** gamma.

    Returns
    -------
    MotionCheck
        The convention, and what to multiply the vectors by.

    Raises
    ------
    ConfigError
        If shape, dtype or transfer cannot be used, or the pictures do not decide it: too few pixels that move
        by 1.5 pixels or more, or light that fits every convention or none.

    Examples
    --------
    >>> import numpy as np
    >>> import evis
    >>> x = np.arange(64, dtype=np.float32) * np.ones((48, 1), np.float32)
    >>> pictures = [0.5 + 0.4 * np.sin((x - shift) / 4) for shift in (0, 3)]
    >>> motion = np.zeros((48, 64, 2), np.float32)
    >>> motion[..., 0] = 3 / 64  # by parts of the picture, from the last keyframe to this one
    >>> evis.emulation.check_motion(*pictures, motion).scale
    (-64.0, -48.0)
    """
    vectors, _ = _as_array(motion_vectors, "motion_vectors", (np.float32,))
    if vectors.ndim != 3 or vectors.shape[2] != 2:
        raise ConfigError(f"motion_vectors has shape {vectors.shape}; it must have (H, W, 2)")
    height, width = vectors.shape[:2]
    dtypes = (np.float32, np.uint8, np.uint16)
    older, newer = (
        _picture(what, values, (height, width), (1, 3), dtypes)[0]
        for what, values in (("older_hdr", older_hdr), ("hdr", hdr))
    )

    def curve(light: npt.NDArray[Any]) -> str:
        return str(transfer or ("linear" if light.dtype == np.float32 else "srgb"))

    pixels = max(height * width, 1)
    found = _evis.check_motion(
        older.reshape(-1),
        newer.reshape(-1),
        vectors.reshape(-1),
        size=(width, height),
        channels=(older.size // pixels, newer.size // pixels),
        transfer=(curve(older), curve(newer)),
        gamma=_check.number("gamma", gamma),
    )
    return MotionCheck(**found)


def _picture(
    what: str,
    values: Any,
    shape: tuple[int, ...],
    channels: tuple[int, ...],
    dtypes: tuple[Any, ...] = (np.float32,),
    transfers: Copies | None = None,
) -> tuple[npt.NDArray[Any], int]:
    """View one picture per environment as a contiguous array; say how many copies that took."""
    array, copied = _as_array(values, what, dtypes, transfers)
    if 3 in channels:
        array, copied = _without_alpha(array, copied, shape)
    wanted = [(*shape, number) for number in channels]
    if 1 in channels:
        wanted.insert(0, shape)
    if array.shape not in wanted:
        raise ConfigError(f"{what} has shape {array.shape}; it must have {' or '.join(map(str, wanted))}")
    return array, int(copied)


def _without_alpha(
    array: npt.NDArray[Any], copied: bool, shape: tuple[int, ...]
) -> tuple[npt.NDArray[Any], bool]:
    """Leave alpha out of pictures of this shape; say whether anything was copied."""
    if array.shape == (*shape, 4):
        return np.ascontiguousarray(array[..., :3]), True
    return array, copied


def _motion_steps(values: Any, shape: tuple[int, ...], transfers: Copies) -> tuple[npt.NDArray[Any], int]:
    """View the motion fields of a gap as a contiguous array; say how many copies that took."""
    array, copied = _as_array(values, "motion_steps", (np.float32,), transfers)
    *batch, height, width = shape
    count = array.shape[-4] if array.ndim >= 4 else 0
    if count == 0 or array.shape != (*batch, count, height, width, 2):
        wanted = ", ".join(map(str, (*batch, "K", height, width, 2)))
        raise ConfigError(f"motion_steps has shape {array.shape}; it must have ({wanted}), K at least 1")
    return array, int(copied)


def _as_array(
    frames: Any,
    what: str = "frames",
    dtypes: tuple[Any, ...] = _LIGHT,
    transfers: Copies | None = None,
) -> tuple[npt.NDArray[Any], bool]:
    """View anything as a C-contiguous array of a dtype that the engine reads; say whether it was copied.

    Tensors on another device are copied to the CPU, which `transfers` counts.
    """
    # What most callers push, without the microseconds that the rest takes.
    if type(frames) is np.ndarray and frames.flags.c_contiguous and frames.dtype in dtypes:
        return frames, False
    moved = False
    if not isinstance(frames, np.ndarray) and hasattr(frames, "__dlpack_device__"):
        device = frames.__dlpack_device__()
        moved = int(device[0]) != _CPU
        if not moved:
            frames = np.from_dlpack(frames)
        elif hasattr(frames, "cpu"):
            frames = (transfers or Copies()).take(what, frames)
        else:
            raise ConfigError(
                f"{what}: on DLPack device {int(device[0])}:{int(device[1])}, and cannot be copied from "
                "there; give a tensor with cpu(), or an array on the CPU"
            )
    given: npt.NDArray[Any] = np.asarray(frames)
    array = given
    if array.dtype in (np.float16, np.float64) and np.float32 in dtypes:
        with np.errstate(over="ignore"):
            array = given.astype(np.float32)
    if array.dtype not in dtypes:
        names = [np.dtype(dtype).name for dtype in dtypes]
        if np.float32 in dtypes:
            names += ["float16", "float64"]
        *others, last = names
        wanted = f"{', '.join(others)} or {last}" if others else last
        raise ConfigError(f"dtype of {what} is {array.dtype}; it must be {wanted}")
    contiguous = np.ascontiguousarray(array)
    return contiguous, moved or not np.may_share_memory(contiguous, given)
