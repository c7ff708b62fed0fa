"""A shard of a data set: recordings of a plan simulated into one HDF5 file, and read from it again."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import shutil
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _evis, _toml, recipes
from ._dataset_spec import RecordingPlan, ShardPlan, deal, digest
from ._evis import ConfigError, EvisError, FormatError
from ._files import RecordedView, Recording, Writer, load
from ._packets import CAUSE, Packet
from ._scene import Scene
from ._sensor import Sensor
from ._simulator import Simulator

#: Version of the layout of shards and manifests.
LAYOUT = 1

_PACKET_US = 20_000
_PIECE_US = 500_000

_COLUMNS = (("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1"))
"""Columns of events, and the types as which they are hashed."""


def single_threaded() -> None:
    """Keep the engine and the software driver to one thread each; before their first use in a process."""
    for name in ("RAYON_NUM_THREADS", "LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"


def versions() -> dict[str, str]:
    """Return the versions on which columns may depend."""
    return {
        "evis": _evis.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
    }


class _Hashes:
    """SHA-256 of the columns of one recording, fed piece by piece."""

    def __init__(self) -> None:
        self._by_name: dict[str, Any] = {}

    def feed(self, name: str, array: npt.NDArray[Any], dtype: str) -> None:
        made = self._by_name.setdefault(name, hashlib.sha256())
        made.update(np.ascontiguousarray(array, dtype))

    def events(self, camera: str, events: npt.NDArray[np.void], causes: npt.NDArray[np.uint8] | None) -> None:
        for column, dtype in _COLUMNS:
            self.feed(f"{camera}/events/{column}", events[column], dtype)
        if causes is not None:
            self.feed(f"{camera}/events/cause", causes, "u1")

    def label(self, camera: str, kind: str, t_us: int, other_us: int, image: npt.NDArray[Any]) -> None:
        self.feed(f"{camera}/labels/{kind}", np.array([t_us, other_us]), "<i8")
        self.feed(f"{camera}/labels/{kind}", image, image.dtype.newbyteorder("<").str)

    def packet(self, packet: Packet) -> None:
        for view in packet.views:
            name = view.camera.name
            self.events(name, view.events.to_numpy(), view.causes)
            for kind, labels in view.labels.items():
                times = zip(labels.t_us.tolist(), labels.t_other_us.tolist(), labels.images, strict=True)
                for t_us, other_us, image in times:
                    self.label(name, kind, t_us, other_us, image)
            self.poses(name, view.poses.t_us, view.poses.position, view.poses.rotation)

    def poses(self, camera: str, t_us: Any, position: Any, rotation: Any) -> None:
        self.feed(f"{camera}/poses/t_us", t_us, "<i8")
        self.feed(f"{camera}/poses/position", position, "<f8")
        self.feed(f"{camera}/poses/rotation_xyzw", rotation, "<f8")

    def digests(self) -> dict[str, str]:
        return {name: made.hexdigest() for name, made in sorted(self._by_name.items())}


def hashes_of(recording: Recording) -> dict[str, str]:
    """Return the SHA-256 of every decoded column of a recording, by camera and name.

    Events as little-endian int64 ``t``, uint16 ``x`` and ``y``, uint8 ``p``; labels of a kind as, for each
    image, both its times (int64) and its values; poses as int64 and float64.
    """
    made = _Hashes()
    for name, view in recording.items():
        made.events(name, view.events.to_numpy(), view.causes)
        for kind, images in view.labels.items():
            for index in range(len(images)):
                made.label(name, kind, *images.interval_us(index), images[index])
        poses = view.poses
        made.poses(name, poses.t_us, poses.position, poses.rotation)
    return made.digests()


def hash_of_hashes(recordings: Iterable[Mapping[str, Any]]) -> str:
    """Return one hash for all columns of a shard."""
    return digest([[each["id"], each["sha256"]] for each in recordings])


# Writing.


def scene_of(settings: Mapping[str, Any], base: Path) -> Scene:
    """Make the scene of a recording's settings."""
    own = settings["scene"]
    if own["kind"] == "builtin":
        return Scene.builtin(own["what"], seed=own["seed"])
    if own["kind"] == "file":
        return Scene.load(base / own["what"])
    given = dict(own["settings"])
    if part := given.pop("part", None):
        split, shares, seed = part
        files = {path.name: path for path in recipes.pictures(base / given["images"])}
        dealt = deal(sorted(files), shares, seed)
        # A split without a share of its own is one that a scene was put into by hand.
        names = [name for name in files if dealt[name] == split]
        if not names:
            raise ConfigError(
                f"{given['images']} has {len(files)} pictures, none of them for the split {split}; "
                "add pictures, or give the split a share in [split]"
            )
        given["images"] = [files[name] for name in names]
    return recipes.RECIPES[own["what"]](own["seed"], **given)


def simulator_of(plan: RecordingPlan, base: Path) -> Simulator:
    """Make the simulator of a recording."""
    settings = plan.settings
    scene = scene_of(settings, base)
    if settings["speed"] != 1.0:
        scene = scene.at_speed(settings["speed"])
    motion = settings["trajectory"]["motion"]
    given = dict(settings["simulator"])
    if motion is not None:
        given["camera_motion"] = base / motion if settings["trajectory"]["sha256"] else motion
        if motion != "none":
            given["camera_speed"] = settings["trajectory"]["speed_px_per_s"]
    simulator = Simulator(
        scene,
        sensor=Sensor.from_toml(settings["sensor_toml"] or "\n"),
        start=settings["start_s"],
        seed=settings["seed"],
        **given,
    )
    if simulator.environments != 1:
        raise ConfigError(
            f"the scene has {simulator.environments} environments; a recording has one: leave "
            "[[environments]] out"
        )
    return simulator


def write(
    shard: ShardPlan, folder: Path, base: Path, recorded: Callable[[int], None] | None = None
) -> dict[str, Any]:
    """Simulate a shard, and return what is kept of it beside its file.

    The file is written under another name, read back, compared, and then renamed, so that a file under its
    own name is whole. Its description, ``NAME.json``, comes last: without it a shard is not finished.

    Parameters
    ----------
    shard : ShardPlan
        What to simulate.
    folder : Path
        Where shards lie.
    base : Path
        Folder at which relative paths of the specification start.
    recorded : callable, optional
        Called after each recording with its number of events.
    """
    drafts = folder / f"{shard.name}.{uuid.uuid4().hex[:12]}.part"
    drafts.mkdir()
    begun, worked = time.monotonic(), time.process_time()
    try:
        described: list[dict[str, Any]] = []
        device: dict[str, Any] = {}
        for index, plan in enumerate(shard.recordings):
            with _named_errors(plan), warnings.catch_warnings():
                # Advice for who looks at a single run; a check before the first one gives it once.
                warnings.simplefilter("ignore")
                simulator = simulator_of(plan, base)
                described.append(_simulate(simulator, plan, drafts / f"{index}.h5"))
                device = asdict(simulator.device)
            if recorded is not None:
                recorded(described[-1]["events"])
        draft = drafts / f"{shard.name}.h5"
        _join(shard, drafts, draft, described)
        _read_back(draft, described)
        _opened.cache_clear()
        with draft.open("r+b") as file:
            os.fsync(file.fileno())
        text = {
            "layout": LAYOUT,
            "name": shard.name,
            "file": f"{shard.name}.h5",
            "split": shard.split,
            "key": shard.key(_evis.__version__),
            "bytes": draft.stat().st_size,
            "events": sum(each["events"] for each in described),
            "seconds": {"wall": time.monotonic() - begun, "cpu": time.process_time() - worked},
            "versions": versions(),
            "device": {name: device[name] for name in ("name", "backend", "kind", "driver")},
            "recordings": described,
        }
        draft.replace(folder / f"{shard.name}.h5")
        write_json(folder / f"{shard.name}.json", text)
        return text
    finally:
        shutil.rmtree(drafts, ignore_errors=True)


def write_json(path: Path, value: Any) -> None:
    """Write a file under another name and rename it."""
    draft = path.with_name(f"{path.name}.{uuid.uuid4().hex[:12]}.part")
    try:
        draft.write_text(json.dumps(value, indent=1) + "\n", "utf-8")
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def _simulate(simulator: Simulator, plan: RecordingPlan, path: Path) -> dict[str, Any]:
    """Simulate one recording into a file of its own, and describe it."""
    hashes, count = _Hashes(), 0
    duration_us: int = plan.settings["duration_us"]
    stream = simulator.stream(duration=duration_us / 1e6, packet_us=_PACKET_US)
    with Writer(path, simulator, duration_us=duration_us) as writer, stream:
        for packet in stream:
            writer.write(packet)
            hashes.packet(packet)
            count += packet.report.events
    return {
        "id": plan.id,
        "events": count,
        "duration_us": duration_us,
        "seed": plan.settings["seed"],
        "drawn": {
            "speed": plan.settings["speed"],
            "start_s": plan.settings["start_s"],
            "camera_speed_px_per_s": plan.settings["trajectory"]["speed_px_per_s"],
        },
        "sensor_toml": plan.settings["sensor_toml"],
        "cameras": [asdict(camera) for camera in simulator.cameras],
        "labels": list(simulator.labels),
        "method": simulator.method,
        "settings_toml": simulator.config_toml,
        "sha256": hashes.digests(),
    }


def _join(shard: ShardPlan, drafts: Path, path: Path, described: Sequence[Mapping[str, Any]]) -> None:
    """Copy the recordings of a shard into one file."""
    kinds = {tuple(each["labels"]) for each in described}
    if len(kinds) > 1:
        raise ConfigError(
            f"shard {shard.name} has recordings with the labels {sorted(kinds)}; they must be equal"
        )
    cameras = [
        {**camera, "name": camera_name(index, camera["name"])}
        for index, each in enumerate(described)
        for camera in each["cameras"]
    ]
    writer = _evis.Writer(
        path,
        cameras=cameras,
        seed=0,
        method=described[0]["method"],
        environment=0,
        config_toml="\n".join(_settings(index, each) for index, each in enumerate(described)),
        duration_us=max(each["duration_us"] for each in described),
        t_offset_us=0,
        labels=list(described[0]["labels"]),
        overwrite=True,
    )
    try:
        number = 0
        for index, each in enumerate(described):
            for view in load(drafts / f"{index}.h5").values():
                _copy(view, each["duration_us"], writer, number)
                number += 1
        writer.finish("{}")
    except BaseException:
        writer.abandon()
        raise


def _settings(index: int, described: Mapping[str, Any]) -> str:
    """Return the settings of a recording as its shard keeps them: TOML within TOML."""
    text = described["settings_toml"]
    literal = f"'''\n{text}'''" if "'''" not in text else _toml.value("settings", text)
    return f"[recordings.r{index:04d}]\nid = {_toml.value('id', described['id'])}\nsettings = {literal}\n"


def _copy(view: RecordedView, duration_us: int, writer: _evis.Writer, camera: int) -> None:
    """Copy one camera, its events piece by piece."""
    causes, done = view.causes, 0
    for begin in range(0, duration_us, _PIECE_US):
        events = view.slice_time(begin, begin + _PIECE_US).to_numpy()
        own = None if causes is None else np.ascontiguousarray(causes[done : done + len(events)])
        writer.write_events(camera, events, own)
        done += len(events)
    for kind, images in view.labels.items():
        for index, image in enumerate(images):
            writer.write_label(camera, kind, *images.interval_us(index), image)
    poses = view.poses
    writer.write_poses(camera, poses.t_us, poses.position, poses.rotation)


def _read_back(path: Path, described: Iterable[Mapping[str, Any]]) -> None:
    for index, recording in enumerate(described):
        if wrong := differences(recording["sha256"], hashes_of(part_of(path, index, recording))):
            raise FormatError(
                f"{path} does not hold what was written: {', '.join(wrong)} of recording {recording['id']}; "
                "check the disk"
            )


def differences(kept: Mapping[str, str], found: Mapping[str, str]) -> list[str]:
    """Return the columns whose hashes differ, or that one side lacks."""
    return sorted(name for name in kept.keys() | found.keys() if kept.get(name) != found.get(name))


@contextlib.contextmanager
def _named_errors(plan: RecordingPlan) -> Iterator[None]:
    """Name the recording in what goes wrong with it."""
    try:
        yield
    except EvisError as error:
        raise type(error)(f"recording {plan.id}: {error}") from error
    except TypeError as error:
        raise ConfigError(
            f"recording {plan.id}: [simulator] cannot be used: {error}; see evis.Simulator"
        ) from error


# Reading.


def camera_name(index: int, camera: str) -> str:
    """Return what the file calls a camera of its recording ``index``."""
    return f"r{index:04d}.{camera}"


@lru_cache(maxsize=64)
def _opened(path: Path, process: int, place: tuple[int, int]) -> _evis.Recording:
    return _evis.Recording(path)


class _PartSource:
    """One recording of a shard, opened when it is first read; open files are shared within a process."""

    environment = 0
    t_offset_us = 0

    def __init__(self, path: Path, index: int, described: Mapping[str, Any]) -> None:
        self._path, self._index = path, index
        self.cameras: list[dict[str, Any]] = list(described["cameras"])
        self.labels: list[str] = list(described["labels"])
        self.seed: int = described["seed"]
        self.method: str = described["method"]
        self.config_toml: str = described["settings_toml"]

    @property
    def _file(self) -> _evis.Recording:
        state = self._path.stat()
        # A shard that is made again has another place on the disk.
        return _opened(self._path, os.getpid(), (state.st_ino, state.st_mtime_ns))

    @cached_property
    def _numbers(self) -> list[int]:
        names = [camera["name"] for camera in self._file.cameras]
        wanted = [camera_name(self._index, camera["name"]) for camera in self.cameras]
        if missing := [name for name in wanted if name not in names]:
            raise FormatError(f"{self._path} has no camera {', '.join(missing)}; make the data set again")
        return [names.index(name) for name in wanted]

    def is_complete(self) -> bool:
        return True

    def report_json(self) -> None:
        return None

    def event_count(self, camera: int) -> int:
        return self._file.event_count(self._numbers[camera])

    def events(self, camera: int, limits: tuple[int, int] | None) -> npt.NDArray[np.void]:
        return self._file.events(self._numbers[camera], limits)

    def causes(self, camera: int, limits: tuple[int, int] | None) -> npt.NDArray[np.uint8] | None:
        return self._file.causes(self._numbers[camera], limits) if CAUSE in self.labels else None

    def label_times(self, camera: int, kind: str) -> npt.NDArray[np.int64]:
        return self._file.label_times(self._numbers[camera], kind)

    def label(self, camera: int, kind: str, index: int) -> _evis.Label:
        return self._file.label(self._numbers[camera], kind, index)

    def poses(
        self, camera: int
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        return self._file.poses(self._numbers[camera])


class ShardRecording(Recording):
    """A recording that shares its file with others; pickles by the file's path."""

    def __init__(self, path: Path, index: int, described: Mapping[str, Any]) -> None:
        self._made_of = (path, index, {**described, "sha256": {}})
        super().__init__(_PartSource(path, index, described))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by path: the file is opened again."""
        return ShardRecording, self._made_of


def part_of(path: Path, index: int, described: Mapping[str, Any]) -> ShardRecording:
    """Return recording ``index`` of a shard."""
    return ShardRecording(path.absolute(), index, described)
