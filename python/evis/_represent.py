"""Dense arrays of events, as methods of everything that holds events of one camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._evis import ConfigError
from ._tensors import tensors_of_columns

Polarity: TypeAlias = Literal["signed", "split"]
"""What becomes of polarities in a voxel grid: ON minus OFF, or a grid each."""

Measure: TypeAlias = Literal["time", "count", "polarity"]
"""What an event is worth in an event spike tensor."""

Decay: TypeAlias = Literal["exponential", "linear"]
"""How a time surface falls with age."""

Raw: TypeAlias = tuple[npt.NDArray[np.void], tuple[int, int], bool]
"""`EventCD` (N,), width and height, and whether the events are known to be sorted by time."""

Limits: TypeAlias = tuple[int | None, int | None]
"""First microsecond, and one past the last, where there are such."""

Source: TypeAlias = tuple[npt.NDArray[np.void], tuple[int, int], Limits, bool]
"""What the engine takes: `Raw`, with limits."""


class Representable:
    """Dense arrays of the events of one camera.

    All of them count the events with ``start_us <= t < end_us``, all where a limit is not given, and raise
    `ConfigError` where an event lies outside of the sensor, has another polarity than 1 and 0 (or -1), or is
    earlier than the one before it; the message names its index and value. Polarities are planes of their own,
    OFF first: ``array[..., 0, :, :]`` are OFF events.
    """

    __slots__ = ()

    def _raw(self, limits: Limits) -> Raw:
        """Return the events, of which those outside of ``limits`` may be left away."""
        raise NotImplementedError

    def _for_engine(self, start_us: int | None, end_us: int | None) -> Source:
        limits = _time_or_none("start_us", start_us), _time_or_none("end_us", end_us)
        events, size, is_sorted = self._raw(limits)
        return events, size, limits, is_sorted

    def event_frame(self, *, start_us: int | None = None, end_us: int | None = None) -> npt.NDArray[np.int32]:
        """Sum polarities: per pixel, ON events minus OFF events.

        Parameters
        ----------
        start_us, end_us : int, optional
            First microsecond, and one past the last.

        Returns
        -------
        numpy.ndarray
            int32 (H, W), events.

        Raises
        ------
        ConfigError
            If an event or a limit cannot be used.

        Notes
        -----
        The image of event polarities in table 1 of D. Gehrig et al., "End-to-end learning of representations
        for asynchronous event-based data", ICCV 2019, after H. Rebecq et al., "Real-time visual-inertial
        odometry for event cameras using keyframe-based nonlinear optimization", BMVC 2017, without its motion
        compensation.

        Examples
        --------
        >>> import evis
        >>> columns = [0, 5, 9], [1, 1, 2], [0, 0, 0], [1, 1, 0]
        >>> events = evis.EventArray.from_columns(*columns, width=4, height=1)
        >>> events.event_frame().tolist()
        [[0, 2, -1, 0]]
        """
        return _evis.event_frame(self._for_engine(start_us, end_us))

    def counts(self, *, start_us: int | None = None, end_us: int | None = None) -> npt.NDArray[np.int32]:
        """Count events per polarity and pixel.

        Parameters
        ----------
        start_us, end_us : int, optional
            First microsecond, and one past the last.

        Returns
        -------
        numpy.ndarray
            int32 (2, H, W), events; OFF first. As tonic's ``ToImage``.

        Raises
        ------
        ConfigError
            If an event or a limit cannot be used.

        Notes
        -----
        A. Z. Zhu et al., "EV-FlowNet: self-supervised optical flow estimation for event-based cameras", RSS
        2018; A. I. Maqueda et al., "Event-based vision meets deep learning on steering prediction for
        self-driving cars", CVPR 2018.

        Examples
        --------
        >>> import evis
        >>> columns = [0, 5, 9], [1, 1, 2], [0, 0, 0], [1, 1, 0]
        >>> events = evis.EventArray.from_columns(*columns, width=4, height=1)
        >>> events.counts().tolist()
        [[[0, 0, 1, 0]], [[0, 2, 0, 0]]]
        """
        return _evis.counts(self._for_engine(start_us, end_us))

    def voxel_grid(
        self,
        bins: int = 5,
        *,
        polarity: Polarity = "signed",
        normalize: bool = False,
        start_us: int | None = None,
        end_us: int | None = None,
    ) -> npt.NDArray[np.float32]:
        """Make a voxel grid, bilinear in time.

        Each event is shared between the two bins nearest in time: bin b gets ``max(0, 1 - |b - t*|)`` of it,
        with ``t* = (bins - 1) (t - t0) / (t1 - t0)``. t0 is ``start_us``, or the first event's time where
        that is not given; t1 is ``end_us``, or the last event's time. A single instant is all in the first
        bin.

        Parameters
        ----------
        bins : int
            Bins of time; the first is at t0, the last at t1.
        polarity : {"signed", "split"}
            ``signed``: ON events count as 1, OFF events as -1. ``split``: a grid each, in which events count
            as 1.
        normalize : bool
            Shift and scale the values that are not 0 to mean 0 and variance 1, as E2VID does; values that are
            all alike are shifted only.
        start_us, end_us : int, optional
            First microsecond, and one past the last.

        Returns
        -------
        numpy.ndarray
            float32 (bins, H, W), or (2, bins, H, W) if split, OFF first; in events, unless normalized.

        Raises
        ------
        ConfigError
            If an event, a limit or a parameter cannot be used, or the grid does not fit the memory limit.

        Notes
        -----
        A. Z. Zhu et al., "Unsupervised event-based learning of optical flow, depth, and egomotion", CVPR
        2019; H. Rebecq et al., "High speed and high dynamic range video with an event camera" (E2VID), TPAMI
        2021, and its code. tonic's ``ToVoxelGrid`` scales by B in the place of B - 1: its B bins are the
        first B of B + 1.

        Examples
        --------
        >>> import evis
        >>> columns = [0, 1, 4], [0, 1, 1], [0, 0, 0], [1, 1, 0]
        >>> events = evis.EventArray.from_columns(*columns, width=2, height=1)
        >>> events.voxel_grid(bins=3).tolist()
        [[[1.0, 0.5]], [[0.0, 0.5]], [[0.0, -1.0]]]
        """
        bins = _check.whole("bins", bins, 1)
        _choice("polarity", polarity, Polarity)
        if not isinstance(normalize, (bool, np.bool_)):
            raise ConfigError(f"normalize is {_check.shown(normalize)}; it must be True or False")
        return _evis.voxel_grid(self._for_engine(start_us, end_us), bins, polarity, bool(normalize))

    def time_surface(
        self,
        tau_us: float,
        *,
        at_us: int | Sequence[int] | npt.NDArray[np.integer[Any]] | None = None,
        decay: Decay = "exponential",
        start_us: int | None = None,
        end_us: int | None = None,
    ) -> npt.NDArray[np.float32]:
        """Make time surfaces: how long ago each pixel fired.

        A pixel whose last event of a polarity is ``age`` microseconds before a surface's time is ``exp(-age /
        tau_us)``, or ``max(0, 1 - age / tau_us)`` with linear decay; 0 where it has had none. Events after
        that time do not count, one at it is worth 1.

        Parameters
        ----------
        tau_us : float
            Microseconds.
        at_us : int or sequence of int, optional
            Times of the surfaces, ascending; ``end_us`` where not given, or the last event's time.
        decay : {"exponential", "linear"}
            How surfaces fall.
        start_us, end_us : int, optional
            First microsecond, and one past the last; of events before it, none has fired.

        Returns
        -------
        numpy.ndarray
            float32 (2, H, W), or (T, 2, H, W) for a sequence of T times; OFF first, 0 to 1.

        Raises
        ------
        ConfigError
            If an event, a limit or a parameter cannot be used, or the surfaces do not fit the memory limit.

        Notes
        -----
        X. Lagorce et al., "HOTS: a hierarchy of event-based time-surfaces for pattern recognition", TPAMI
        2017, over the whole sensor. Linear: S. Afshar et al., "Investigation of event-based surfaces for
        high-speed detection, unsupervised feature extraction, and object recognition", Frontiers in
        Neuroscience 12, 2019. tonic's ``ToTimesurface`` counts the events before a time, and not those at it.

        Examples
        --------
        >>> import evis
        >>> events = evis.EventArray.from_columns([0, 60], [0, 1], [0, 0], [1, 0], width=3, height=1)
        >>> events.time_surface(160, at_us=80, decay="linear").tolist()
        [[[0.0, 0.875, 0.0]], [[0.5, 0.0, 0.0]]]
        """
        tau_us = _check.number("tau_us", tau_us, " microseconds")
        _choice("decay", decay, Decay)
        source = self._for_engine(start_us, end_us)
        single = at_us is None or (hasattr(at_us, "__index__") and np.ndim(at_us) == 0)
        if at_us is None:
            at_us = _last_us(source)
        times = [at_us] if single else _check.items("at_us", at_us, "[10_000, 20_000]")
        surfaces = _evis.time_surfaces(
            source, [_check.time_us("at_us", time) for time in times], tau_us, decay
        )
        return surfaces[0] if single else surfaces

    def event_spike_tensor(
        self,
        bins: int = 9,
        *,
        measure: Measure = "time",
        start_us: int | None = None,
        end_us: int | None = None,
    ) -> npt.NDArray[np.float32]:
        """Make the event spike tensor (EST) with its trilinear kernel.

        ``V(p, b, y, x)`` is the sum of ``f max(0, 1 - |t* (bins - 1) - b|)`` over the events of polarity p at
        pixel (x, y), with ``t* = (t - t0) / (t1 - t0)``; t0 and t1 are those of `voxel_grid`.

        Parameters
        ----------
        bins : int
            Bins of time, at least 2.
        measure : {"time", "count", "polarity"}
            f: t* as in the paper's code, 1, or 1 for ON and -1 for OFF.
        start_us, end_us : int, optional
            First microsecond, and one past the last.

        Returns
        -------
        numpy.ndarray
            float32 (2, bins, H, W), OFF first; ``tensor.reshape(2 * bins, H, W)`` has the code's order of
            channels.

        Raises
        ------
        ConfigError
            If an event, a limit or a parameter cannot be used, or the tensor does not fit the memory limit.

        Notes
        -----
        D. Gehrig, A. Loquercio, K. G. Derpanis, D. Scaramuzza, "End-to-end learning of representations for
        asynchronous event-based data", ICCV 2019. The kernel is the one that the learned kernel starts from.
        The paper's code divides times by the last one: ``start_us=0`` does so.

        Examples
        --------
        >>> import evis
        >>> columns = [0, 1, 4], [0, 1, 1], [0, 0, 0], [1, 1, 0]
        >>> events = evis.EventArray.from_columns(*columns, width=2, height=1)
        >>> events.event_spike_tensor(bins=3)[1].tolist()
        [[[0.0, 0.125]], [[0.0, 0.125]], [[0.0, 0.0]]]
        """
        bins = _check.whole("bins", bins, 2)
        _choice("measure", measure, Measure)
        return _evis.event_spike_tensor(self._for_engine(start_us, end_us), bins, measure)

    def averaged_timestamps(
        self, *, empty: float = 0.0, start_us: int | None = None, end_us: int | None = None
    ) -> npt.NDArray[np.float32]:
        """Average the times of each polarity and pixel, 0 at t0 and 1 at t1.

        t0 and t1 are those of `voxel_grid`.

        Parameters
        ----------
        empty : float
            Value where nothing fired; NaN tells it from what fired at t0.
        start_us, end_us : int, optional
            First microsecond, and one past the last.

        Returns
        -------
        numpy.ndarray
            float32 (2, H, W), parts of the interval; OFF first.

        Raises
        ------
        ConfigError
            If an event, a limit or a parameter cannot be used.

        Notes
        -----
        A. Z. Zhu et al., "Unsupervised event-based learning of optical flow, depth, and egomotion", CVPR
        2019: the image of average timestamps, of events that are not moved.

        Examples
        --------
        >>> import evis
        >>> columns = [0, 2, 4], [0, 1, 1], [0, 0, 0], [1, 1, 1]
        >>> events = evis.EventArray.from_columns(*columns, width=2, height=1)
        >>> events.averaged_timestamps()[1].tolist()
        [[0.0, 0.75]]
        """
        return _evis.averaged_timestamps(self._for_engine(start_us, end_us), _check.number("empty", empty))

    def binary_stack(
        self, bins: int = 8, *, start_us: int | None = None, end_us: int | None = None
    ) -> npt.NDArray[np.uint8]:
        """Tell which pixels fired in each of ``bins`` equal parts of time.

        Part b is ``[t0 + b d, t0 + (b + 1) d)`` with ``d = (t1 - t0) / bins``; t0 is ``start_us`` or the
        first event's time, t1 is ``end_us`` or a microsecond after the last event.

        Parameters
        ----------
        bins : int
            Parts of time.
        start_us, end_us : int, optional
            First microsecond, and one past the last.

        Returns
        -------
        numpy.ndarray
            uint8 (bins, 2, H, W), 1 or 0; OFF first.

        Raises
        ------
        ConfigError
            If an event, a limit or a parameter cannot be used, or the stack does not fit the memory limit.

        Notes
        -----
        S. Barchid, J. Mennesson, C. Djéraba, "Bina-Rep event frames: a simple and effective representation
        for event-based cameras", ICIP 2022.

        Examples
        --------
        >>> import evis
        >>> columns = [0, 1, 7], [0, 0, 1], [0, 0, 0], [1, 1, 1]
        >>> events = evis.EventArray.from_columns(*columns, width=2, height=1)
        >>> events.binary_stack(bins=2)[:, 1].tolist()
        [[[1, 0]], [[0, 1]]]
        """
        return _evis.binary_stack(self._for_engine(start_us, end_us), _check.whole("bins", bins, 1))

    def bina_rep(
        self,
        frames: int = 1,
        bits: int = 8,
        *,
        start_us: int | None = None,
        end_us: int | None = None,
    ) -> npt.NDArray[np.float32]:
        """Make Bina-Rep frames: numbers whose bits are binary frames.

        The bits of a frame are ``bits`` parts of a `binary_stack` of ``frames * bits`` parts, the first of
        them the most significant one; values are divided by ``2**bits - 1``.

        Parameters
        ----------
        frames : int
            Frames.
        bits : int
            Bits of a frame, 1 to 24.
        start_us, end_us : int, optional
            First microsecond, and one past the last.

        Returns
        -------
        numpy.ndarray
            float32 (frames, 2, H, W), 0 to 1; OFF first. As tonic's ``ToBinaRep`` of the same binary frames.

        Raises
        ------
        ConfigError
            If an event, a limit or a parameter cannot be used, or the frames do not fit the memory limit.

        Notes
        -----
        S. Barchid, J. Mennesson, C. Djéraba, "Bina-Rep event frames: a simple and effective representation
        for event-based cameras", ICIP 2022.

        Examples
        --------
        >>> import evis
        >>> columns = [0, 1, 7], [0, 0, 1], [0, 0, 0], [1, 1, 1]
        >>> events = evis.EventArray.from_columns(*columns, width=2, height=1)
        >>> (3 * events.bina_rep(frames=1, bits=2)[0, 1]).tolist()
        [[2.0, 1.0]]
        """
        frames, bits = _check.whole("frames", frames, 1), _check.whole("bits", bits, 1, 24)
        return _evis.bina_rep(self._for_engine(start_us, end_us), frames, bits)

    def to_torch(self) -> dict[str, Any]:
        """Return the columns as PyTorch tensors, without a copy; needs the extra ``torch``.

        Returns
        -------
        dict of str to torch.Tensor
            ``t`` int64 (microseconds), ``x`` and ``y`` uint16, ``p`` int16 (ON = 1, OFF = 0), each (N,):
            strided views of the events' memory, see `evis.torch.event_tensors`.

        Raises
        ------
        ImportError
            If PyTorch is not installed.
        """
        return tensors_of_columns(self._raw((None, None))[0])


def _time_or_none(what: str, value: int | None) -> int | None:
    return None if value is None else _check.time_us(what, value)


def _choice(what: str, value: str, kinds: Any) -> None:
    if not isinstance(value, str) or value not in get_args(kinds):
        raise ConfigError(f"{what} is {_check.shown(value)}; it must be {_check.one_of(get_args(kinds))}")


def _last_us(source: Source) -> int:
    """Return the time of a surface where none is given."""
    events, _, (start_us, end_us), _ = source
    if end_us is not None:
        return end_us
    # Where nothing has fired, surfaces of all times are alike.
    return int(events["t"][-1]) if len(events) else start_us or 0
