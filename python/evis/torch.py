"""Event data sets for PyTorch: windows of recordings, collation, simulation on the fly.

Needs the extra ``torch``. `EventDataset` has tonic's attributes, so that tonic's transforms, slicers and
caches take it. ``docs/torch.md`` has a training loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

try:
    import torch
    from torch.utils.data import Dataset, IterableDataset, default_collate, get_worker_info
except ImportError as error:
    raise ImportError("evis.torch needs PyTorch; install it: pip install 'evis[torch]'") from error

from . import _check
from ._events import EventArray, EventWindow, as_event_cd
from ._evis import ConfigError
from ._files import RecordedView, Recording, load
from ._packets import Packet
from ._simulator import Simulator
from ._tensors import tensors_of_columns
from .representations import Dense, dense

__all__ = [
    "EventDataset",
    "EventDtype",
    "SimulatedDataset",
    "collate_packed",
    "collate_padded",
    "event_tensors",
    "tensor_of",
    "tonic_events",
]

EventDtype: np.dtype[np.void] = np.dtype([("x", "<i4"), ("y", "<i4"), ("t", "<i8"), ("p", "<i4")])
"""Events as tonic's data sets have them: x, y, t in microseconds, and p, ON = 1 and OFF = 0."""

Path_: TypeAlias = str | PathLike[str]

Representation: TypeAlias = str | Dense | Callable[[EventWindow], npt.NDArray[Any]]
"""Name of a function of `evis.representations`, that with parameters, or what makes an array of a window."""

# More than a recording lasts, and within what the readers take.
_EVER_US = 1 << 61


def tensor_of(array: npt.NDArray[Any]) -> torch.Tensor:
    """Return an array as a tensor on the CPU.

    Parameters
    ----------
    array : numpy.ndarray
        Of a type that PyTorch has.

    Returns
    -------
    torch.Tensor
        Of the same shape and type. It shares the array's memory, unless the array is read-only (a file mapped
        into memory, a frame of a file): that is copied, because tensors can be written to.
    """
    return torch.from_numpy(array if array.flags.writeable else array.copy())


def event_tensors(events: npt.ArrayLike) -> dict[str, torch.Tensor]:
    """Return the columns of events as tensors, without a copy.

    Parameters
    ----------
    events : array_like
        What `evis.events.as_event_cd` takes: an `EventArray`, a structured array.

    Returns
    -------
    dict of str to torch.Tensor
        ``t`` int64, ``x`` and ``y`` uint16, ``p`` int16, each (N,), strided views of the events' memory.
        PyTorch calculates little with uint16: ``x.long()`` copies. Events of another dtype than `EventCD`,
        and read-only ones, are copied once.

    Raises
    ------
    ConfigError
        If ``events`` cannot be read as events.
    """
    return tensors_of_columns(as_event_cd(events))


class EventDataset(Dataset[Any]):
    """Windows of recordings, as a map-style data set.

    Item k is ``(data, target)``. Files are opened where they are read, so that the data set crosses to
    workers of any kind (spawned ones, too), and items do not depend on how many there are. Of recordings of
    EVIS only the window is read; other formats are read whole, once per worker.

    Parameters
    ----------
    source : path, Recording, or sequence of them
        What `evis.load` opens.
    time_us : int, optional
        Windows of so many microseconds; see `EventArray.windows` for this and the next four. Without
        ``time_us``, ``count`` and ``edges`` a recording is one window.
    count : int, optional
        Windows of so many events.
    edges : sequence of int, optional
        Windows between these microseconds.
    start_us, end_us : int, optional
        Part of each recording.
    drop_last : bool
        Leave out a last window that is shorter than ``time_us``, or has fewer events than ``count``.
    representation : str, Dense or callable, optional
        What becomes of a window, as a tensor: name of a function of `evis.representations`, that function
        with parameters (``Dense("voxel_grid", bins=5)``), or what makes an array of an `EventWindow`. Events
        where not given: a structured array of dtype `EventDtype`, a copy.
    labels : sequence of str
        Label images of the recording for the target: of each kind the last one at or before the window's end.
    targets : sequence, optional
        The target of each recording, such as a class, in place of the usual one.
    transform, target_transform : callable, optional
        Applied to the data, and to the target.
    transforms : callable, optional
        Applied to both, ``data, target = transforms(data, target)``, in place of those two.
    camera : str, optional
        The camera, where recordings have several.
    width, height : int, optional
        Size of the sensor for files that do not say it.

    Attributes
    ----------
    sensor_size : tuple of int
        (width, height, 2), as tonic has it.
    dtype : numpy.dtype
        `EventDtype`, the type of events.
    ordering : tuple of str
        Names of its fields.
    windows : numpy.ndarray
        int64 (N, 3): recording, first microsecond, one past the last, of each item.

    Raises
    ------
    ConfigError
        If a parameter cannot be used, recordings differ in size, or a label is missing.
    OSError, FormatError
        If a file cannot be read.

    Notes
    -----
    The usual target is a mapping: ``recording``, ``start_us``, ``end_us``, and the label images by kind.

    Examples
    --------
    >>> import evis, numpy as np, tempfile, pathlib
    >>> from evis.torch import EventDataset
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "events.h5"
    >>> events = np.array([(3, 4, 1, 20), (5, 4, 0, 1500)], evis.EventCD)
    >>> _ = evis.save(path, evis.EventArray(events, width=16, height=8))
    >>> dataset = EventDataset(path, time_us=1000, representation="counts")
    >>> [(tuple(data.shape), int(data.sum()), target["start_us"]) for data, target in dataset]
    [((2, 8, 16), 1, 0), ((2, 8, 16), 1, 1000)]
    """

    dtype = EventDtype
    ordering = EventDtype.names

    def __init__(
        self,
        source: Path_ | Recording | Sequence[Path_ | Recording],
        *,
        time_us: int | None = None,
        count: int | None = None,
        edges: Sequence[int] | None = None,
        start_us: int | None = None,
        end_us: int | None = None,
        drop_last: bool = False,
        representation: Representation | None = None,
        labels: Sequence[str] = (),
        targets: Sequence[Any] | None = None,
        transform: Callable[[Any], Any] | None = None,
        target_transform: Callable[[Any], Any] | None = None,
        transforms: Callable[[Any, Any], tuple[Any, Any]] | None = None,
        camera: str | None = None,
        width: int | None = None,
        height: int | None = None,
    ) -> None:
        single = isinstance(source, (str, PathLike, Recording))
        items: list[Any] = [source] if single else _check.items("source", source, "['a.h5', 'b.h5']")
        # A relative path must mean the same in a worker.
        self._sources: list[Path | Recording] = [
            one if isinstance(one, Recording) else Path(one).absolute() for one in items
        ]
        if not self._sources:
            raise ConfigError("source is empty; it must name a recording at least")
        if transforms is not None and (transform is not None or target_transform is not None):
            raise ConfigError("transforms stand in place of transform and target_transform; give one kind")
        self._labels = _check.names("labels", labels)
        self._targets = None if targets is None else _check.items("targets", targets, "[0, 1]")
        if self._targets is not None and len(self._targets) != len(self._sources):
            raise ConfigError(
                f"targets has {len(self._targets)} entries; it must have one per recording: "
                f"{len(self._sources)}"
            )
        if self._targets is not None and self._labels:
            raise ConfigError("targets replaces the target that would hold labels; give one of the two")
        self.transform, self.target_transform, self.transforms = transform, target_transform, transforms
        self._representation = None if representation is None else dense(representation)
        self._camera, self._size = camera, (width, height)
        self._views: dict[int, RecordedView] = {}
        how = {"time_us": time_us, "count": count, "edges": edges, "start_us": start_us, "end_us": end_us}
        rows: list[tuple[int, int, int, int, int]] = []
        sizes: dict[tuple[int, int], str] = {}
        for index in range(len(self._sources)):
            view = self._view(index)
            sizes.setdefault((view.camera.width, view.camera.height), self._name(index))
            # Windows of time whose ends are known do not depend on the events.
            known = count is None and start_us is not None and end_us is not None
            found = _rows(view.slice_time(*((0, 0) if known else (-_EVER_US, _EVER_US))), how)
            if drop_last and found and _is_short(found[-1], time_us, count):
                found.pop()
            self._check_labels(index, found)
            rows += [(index, *row) for row in found]
        if len(sizes) > 1:
            shown = " and ".join(f"{w}x{h} ({name})" for (w, h), name in sizes.items())
            raise ConfigError(f"recordings are of {shown}; a data set has sensors of one size")
        ((width_px, height_px),) = sizes
        self.sensor_size = (width_px, height_px, 2)
        self._rows = np.array(rows, np.int64).reshape(-1, 5)

    @property
    def windows(self) -> npt.NDArray[np.int64]:
        """Recording, first microsecond, and one past the last, of each item, int64 (N, 3)."""
        return self._rows[:, :3]

    def window(self, index: int) -> EventWindow:
        """Read the events of item ``index``."""
        recording, start_us, end_us, skip, count = self._row(index)
        view = self._view(recording)
        events = view.slice_time(start_us, end_us).to_numpy()
        if count >= 0:
            # Windows of a number of events may part those of one instant.
            events = events[skip : skip + count]
        return EventWindow._of(events, view.camera.width, view.camera.height, start_us, end_us)

    def __len__(self) -> int:
        """Count the items."""
        return len(self._rows)

    def __getitem__(self, index: int) -> tuple[Any, Any]:
        """Read item ``index``: data and target."""
        recording, start_us, end_us, _, _ = self._row(index)
        window = self.window(index)
        data: Any
        if self._representation is None:
            data = tonic_events(window)
        else:
            data = tensor_of(np.asarray(self._representation(window)))
        target: Any
        if self._targets is not None:
            target = self._targets[recording]
        else:
            target = {"recording": recording, "start_us": start_us, "end_us": end_us}
            for kind in self._labels:
                images = self._view(recording).labels[kind]
                at = int(np.searchsorted(images.t_us, end_us, side="right")) - 1
                target[kind] = tensor_of(images[at])
        if self.transforms is not None:
            return self.transforms(data, target)
        if self.transform is not None:
            data = self.transform(data)
        if self.target_transform is not None:
            target = self.target_transform(target)
        return data, target

    def __getstate__(self) -> dict[str, Any]:
        """Leave open files behind."""
        return {**self.__dict__, "_views": {}}

    def __repr__(self) -> str:
        """Say how many windows of how many recordings."""
        width, height, _ = self.sensor_size
        return f"EventDataset({len(self)} windows of {len(self._sources)} recordings, {width}x{height})"

    def _row(self, index: int) -> tuple[int, ...]:
        index = _check.whole("index", index, -(2**62), 2**62)
        if not -len(self) <= index < len(self):
            raise IndexError(f"there are {len(self)} items, and no {index}")
        return tuple(self._rows[index].tolist())

    def _name(self, index: int) -> str:
        source = self._sources[index]
        return f"recording {index}" if isinstance(source, Recording) else str(source)

    def _view(self, index: int) -> RecordedView:
        if index not in self._views:
            source, (width, height) = self._sources[index], self._size
            recording = (
                source
                if isinstance(source, Recording)
                else load(source, width=width, height=height, camera=self._camera)
            )
            named = self._camera is not None and len(recording) > 1
            self._views[index] = recording[str(self._camera)] if named else recording.view
        return self._views[index]

    def _check_labels(self, index: int, rows: list[tuple[int, int, int, int]]) -> None:
        for kind in self._labels:
            known = self._view(index).labels
            if kind not in known:
                shown = _check.one_of(known) if known else "no label in it"
                raise ConfigError(f"label is '{kind}'; {self._name(index)} has {shown}")
            times = known[kind].t_us
            if rows and (not len(times) or times[0] > min(row[1] for row in rows)):
                raise ConfigError(
                    f"{self._name(index)} has no {kind} at or before the end of its first window; "
                    "give start_us"
                )


def tonic_events(events: EventArray) -> npt.NDArray[np.void]:
    """Return events as tonic's data sets give them: a structured array of dtype `EventDtype`, a copy."""
    made: npt.NDArray[np.void] = np.empty(len(events), EventDtype)
    for name, column in zip("txyp", events.columns, strict=True):
        made[name] = column
    return made


def _rows(events: EventArray, how: Mapping[str, Any]) -> list[tuple[int, int, int, int]]:
    """Of each window: first microsecond, one past the last, and which of the events between (-1: all)."""
    start_us, end_us = how["start_us"], how["end_us"]
    if how["time_us"] is how["count"] is how["edges"] is None:
        first = (min(0, int(events.t[0])) if len(events) else 0) if start_us is None else start_us
        last = (int(events.t[-1]) + 1 if len(events) else first + 1) if end_us is None else end_us
        how = {"edges": [first, last]}
    windows = events.windows(**how)
    if how.get("count") is None:
        return [(window.start_us, window.end_us, 0, -1) for window in windows]
    rows, begin = [], 0 if start_us is None else int(np.searchsorted(events.t, start_us))
    for window in windows:
        skip = begin - int(np.searchsorted(events.t, window.start_us))
        rows.append((window.start_us, window.end_us, skip, len(window)))
        begin += len(window)
    return rows


def _is_short(row: tuple[int, int, int, int], time_us: int | None, count: int | None) -> bool:
    start_us, end_us, _, found = row
    return (time_us is not None and end_us - start_us < time_us) or (count is not None and found < count)


def _columns(batch: Sequence[tuple[Any, Any]]) -> tuple[list[npt.NDArray[np.void]], npt.NDArray[np.int64]]:
    arrays = []
    for index, (events, _) in enumerate(batch):
        names = getattr(getattr(events, "dtype", None), "names", None) or ()
        if not {"x", "y", "p", "t"} <= set(names):
            raise ConfigError(
                f"item {index} of the batch is {_check.shown(type(events).__name__)}; it must be a "
                "structured array with the fields x, y, p, t (tensors collate without a function of ours)"
            )
        arrays.append(events)
    return arrays, np.array([len(events) for events in arrays], np.int64)


def collate_packed(batch: Sequence[tuple[Any, Any]]) -> tuple[dict[str, torch.Tensor], Any]:
    """Collate items of events one after the other, for ``DataLoader(collate_fn=...)``.

    Parameters
    ----------
    batch : sequence of tuple
        Items (events, target) of B windows of N_b events.

    Returns
    -------
    events : dict of str to torch.Tensor
        ``t`` (microseconds), ``x``, ``y`` and ``p``, int64 (sum of N_b,), and ``offsets``, int64 (B + 1,):
        events of item b are ``t[offsets[b]:offsets[b + 1]]``. All are copies.
    targets
        Targets, as PyTorch's ``default_collate`` does.

    Raises
    ------
    ConfigError
        If an item is no structured array of events.

    Examples
    --------
    >>> import numpy as np, evis
    >>> from evis.torch import collate_packed
    >>> one = np.array([(3, 4, 1, 20)], evis.EventCD)
    >>> two = np.array([(5, 4, 0, 10), (6, 4, 0, 12)], evis.EventCD)
    >>> events, targets = collate_packed([(one, 0), (two, 1)])
    >>> events["x"].tolist(), events["offsets"].tolist(), targets.tolist()
    ([3, 5, 6], [0, 1, 3], [0, 1])
    """
    arrays, counts = _columns(batch)
    packed = {
        name: torch.from_numpy(np.concatenate([events[name] for events in arrays]).astype(np.int64))
        for name in "txyp"
    }
    packed["offsets"] = torch.from_numpy(np.concatenate([[0], np.cumsum(counts)]).astype(np.int64))
    return packed, default_collate([target for _, target in batch])


def collate_padded(batch: Sequence[tuple[Any, Any]]) -> tuple[dict[str, torch.Tensor], Any]:
    """Collate items of events side by side, for ``DataLoader(collate_fn=...)``.

    Parameters
    ----------
    batch : sequence of tuple
        Items (events, target) of B windows of N_b events.

    Returns
    -------
    events : dict of str to torch.Tensor
        ``t`` (microseconds), ``x``, ``y`` and ``p``, int64 (B, most N_b), 0 behind the last event; ``mask``,
        bool of that shape, True where there is an event; ``lengths``, int64 (B,). All are copies.
    targets
        Targets, as PyTorch's ``default_collate`` does.

    Raises
    ------
    ConfigError
        If an item is no structured array of events.
    """
    arrays, counts = _columns(batch)
    mask = np.arange(counts.max(initial=0)) < counts[:, None]
    padded = {"mask": torch.from_numpy(mask), "lengths": torch.from_numpy(counts)}
    for name in "txyp":
        column = np.zeros(mask.shape, np.int64)
        column[mask] = np.concatenate([events[name] for events in arrays])
        padded[name] = torch.from_numpy(column)
    return padded, default_collate([target for _, target in batch])


class SimulatedDataset(IterableDataset[Any]):
    """Runs of a simulator, made while a network trains.

    An item is ``(data, target)`` of a run. A run's seed is a function of ``seed``, the epoch and the run's
    number: no two workers simulate the same, and items do not depend on how many workers there are. Neither
    does their order, where ``batch_size`` is the loader's.

    Workers that are spawned (``DataLoader(multiprocessing_context="spawn")``) work always. Forked ones work
    while the parent has opened no device; else they raise `EvisError`.

    Parameters
    ----------
    make : callable
        Makes a simulator with one camera and one environment: ``make(seed) -> Simulator``. It is called in
        the worker, once per run, and crosses to spawned ones by a pickle: a function of a module, no lambda.
    runs : int
        Runs per epoch.
    duration_us : int
        Microseconds of a run.
    time_us : int, optional
        Windows of so many microseconds, a part of ``duration_us``; where not given, a run is one window.
        Needs a representation.
    representation : str, Dense or callable, optional
        What becomes of a window, as of `EventDataset`: data is then a tensor (windows, ...), or (...) without
        ``time_us``. Events of the run where not given, a structured array of dtype `EventDtype`.
    target : callable, optional
        Makes the target of a run's `Packet`: label images, poses, whatever it has. A mapping where not given:
        ``run``, ``seed``, and the label images by kind, stacked (K, H, W) or (K, H, W, C).
    seed : int
        What runs' seeds are made of.
    batch_size : int
        Runs that the loader puts into a batch: so many in a row go to the same worker.

    Raises
    ------
    ConfigError
        If a parameter cannot be used, or, in the worker, what ``make`` returns.
    """

    def __init__(
        self,
        make: Callable[[int], Simulator],
        *,
        runs: int,
        duration_us: int,
        time_us: int | None = None,
        representation: Representation | None = None,
        target: Callable[[Packet], Any] | None = None,
        seed: int = 0,
        batch_size: int = 1,
    ) -> None:
        if not callable(make):
            raise ConfigError(f"make is {_check.shown(make)}; it must be a function: make(seed) -> Simulator")
        self._make, self._target = make, target
        self._runs = _check.whole("runs", runs, 1)
        self._duration_us = _check.whole("duration_us", duration_us, 1, _EVER_US, " microseconds")
        self._time_us = None
        if time_us is not None:
            self._time_us = _check.whole("time_us", time_us, 1, _EVER_US, " microseconds")
            if representation is None:
                raise ConfigError(
                    "time_us is given without a representation; windows of events are of many lengths: "
                    "give one, such as representation='counts'"
                )
            if self._duration_us % self._time_us:
                raise ConfigError(
                    f"time_us is {time_us}; it must divide duration_us, {duration_us}, without a rest"
                )
        self._representation = None if representation is None else dense(representation)
        self._seed = _check.whole("seed", seed, 0, 2**63 - 1)
        self._batch_size = _check.whole("batch_size", batch_size, 1)
        self._epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch, hence the seeds, of the next iteration; workers that persist do not see it."""
        self._epoch = _check.whole("epoch", epoch)

    def seed_of(self, run: int) -> int:
        """Return the seed of run ``run`` in the present epoch, 0 to 2**63 - 1."""
        words = np.random.SeedSequence([self._seed, self._epoch, run]).generate_state(1, np.uint64)
        return int(words[0] >> np.uint64(1))

    def __len__(self) -> int:
        """Count the runs of an epoch."""
        return self._runs

    def __iter__(self) -> Iterator[tuple[Any, Any]]:
        """Simulate this worker's runs, in order."""
        worker = get_worker_info()
        number, workers = (0, 1) if worker is None else (worker.id, worker.num_workers)
        for run in range(self._runs):
            if run // self._batch_size % workers == number:
                yield self._simulated(run)

    def _simulated(self, run: int) -> tuple[Any, Any]:
        seed = self.seed_of(run)
        simulator = self._make(seed)
        if not isinstance(simulator, Simulator):
            raise ConfigError(f"make returned {_check.shown(simulator)}; it must return an evis.Simulator")
        if simulator.environments * len(simulator.cameras) != 1:
            raise ConfigError(
                f"make returned {simulator!r}; it must have one camera and one environment: cameras=['NAME']"
            )
        begin_us = simulator.now_us
        packet = simulator.step(begin_us + self._duration_us)
        events = packet.view.events
        data: Any
        if self._representation is None:
            data = tonic_events(events)
        else:
            length_us = self._time_us or self._duration_us
            windows = events.windows(length_us, start_us=begin_us, end_us=packet.end_us)
            made = [np.asarray(self._representation(window)) for window in windows]
            data = tensor_of(made[0] if self._time_us is None else np.stack(made))
        if self._target is not None:
            return data, self._target(packet)
        images = {kind: tensor_of(labels.data) for kind, labels in packet.view.labels.items()}
        return data, {"run": run, "seed": seed, **images}
