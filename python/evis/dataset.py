"""Data sets at scale: a specification in, sharded HDF5 files with a manifest out, and a loader for them.

``evis dataset SPEC.toml -o DIR`` does the same. ``docs/dataset.md`` has every key of a specification.
"""

from __future__ import annotations

import contextlib
import json
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from . import _check, _dataset_shard, _dataset_workers, _evis, _limits
from ._dataset_spec import SPLITS, RecordingPlan, ShardPlan, Spec, parse
from ._evis import ConfigError, EvisError, FormatError
from ._files import Recording

if TYPE_CHECKING:
    from .torch import EventDataset

__all__ = [
    "SPLITS",
    "Dataset",
    "RecordingInfo",
    "RecordingPlan",
    "ShardPlan",
    "Spec",
    "load",
    "make",
    "read_spec",
    "shipped",
]

MANIFEST = "manifest.json"
SHARDS = "shards"


def shipped() -> dict[str, str]:
    """Return the texts of the specifications that come with the package, by name."""
    folder = resources.files("evis") / "specs"
    return {
        file.name.removesuffix(".toml"): file.read_text("utf-8")
        for file in sorted(folder.iterdir(), key=lambda file: file.name)
        if file.name.endswith(".toml")
    }


def read_spec(source: str | PathLike[str]) -> Spec:
    """Read and check a specification.

    Parameters
    ----------
    source : path or str
        A TOML file, or the name of one of `shipped`. Paths in it are relative to its folder; to the current
        folder for one that is shipped.

    Returns
    -------
    Spec
        ``spec.shards()`` lists what would be simulated.

    Raises
    ------
    OSError
        If the file cannot be read.
    FormatError
        If something in it is wrong: names the line and the nearest key that exists.

    Examples
    --------
    >>> from evis.dataset import read_spec
    >>> spec = read_spec("objects2d")
    >>> len(spec.recordings()), len(spec.shards())
    (1000, 65)
    """
    path = Path(source)
    if not path.exists() and (text := shipped().get(str(source))) is not None:
        return parse(text, Path.cwd(), f"the shipped specification {source}")
    try:
        return parse(_limits.readable(path).read_text("utf-8"), path.absolute().parent, str(path))
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is no UTF-8 text ({error}); give a TOML file") from None
    except FileNotFoundError:
        raise FileNotFoundError(
            f"{path} does not exist; give a TOML file, or the name of a shipped specification: "
            f"{', '.join(shipped())}{_check.did_you_mean(str(source), shipped())}"
        ) from None


def make(
    spec: Spec | str | PathLike[str],
    folder: str | PathLike[str],
    *,
    workers: int | None = None,
    ray: bool | str = False,
    overwrite: bool = False,
    progress: bool = False,
) -> Dataset:
    """Simulate a data set, or what is missing of it.

    Shards that are finished are not simulated again: after a kill the same call goes on. A shard is written
    under another name, read back, and renamed, so that a half-written one never counts. Decoded columns do
    not depend on the number of workers and their order; on other devices and drivers they may.

    Parameters
    ----------
    spec : Spec, path or str
        See `read_spec`.
    folder : path
        Where the data set goes; made where it does not exist. A Ray cluster must reach it under this path
        from every machine.
    workers : int, optional
        Processes, spawned, of one thread each; one per CPU where not given. 0 simulates in this process.
        Scripts need ``if __name__ == "__main__":``, because spawned processes import them again.
    ray : bool or str
        Simulate on a Ray cluster (extra ``ray``): True starts one on this machine, a text is the address of
        one, such as ``"auto"``. A shard whose worker is lost is begun again.
    overwrite : bool
        Simulate shards again that were made from another specification or version.
    progress : bool
        Show progress and throughput on standard error.

    Returns
    -------
    Dataset
        What was made, all splits.

    Raises
    ------
    ConfigError, FormatError
        If the specification cannot be used, or the folder holds shards of another one.
    OSError
        If the disk refuses, or another process is making the same data set.
    EvisError
        If a shard lost its worker again and again.
    """
    spec = spec if isinstance(spec, Spec) else read_spec(spec)
    folder = Path(folder).absolute()
    count = None if workers is None else _check.whole("workers", workers, 0, 4096)
    if ray is not False and ray is not True and not isinstance(ray, str):
        raise ConfigError(f"ray is {_check.shown(ray)}; it must be True, False or the address of a cluster")
    if ray and count == 0:
        raise ConfigError("workers is 0, which simulates in this process; with ray it must be 1 or more")
    shards = spec.shards()
    place = folder / SHARDS
    place.mkdir(parents=True, exist_ok=True)
    with _alone(folder):
        found = _finished(shards, place, overwrite)
        _clean(shards, place)
        left = [shard for shard in shards if shard.name not in found]
        _try_first(left, spec)
        total = sum(len(shard.recordings) for shard in left)
        with _dataset_workers.Meter(total, shown=progress) as meter:
            if len(left) < len(shards):
                meter.say(f"{len(shards) - len(left)} of {len(shards)} shards are finished already")
            if ray:
                address = ray if isinstance(ray, str) else None
                made = _dataset_workers.on_ray(left, place, spec.base, address, count, meter)
            elif count == 0:
                made = _dataset_workers.here(left, place, spec.base, meter)
            else:
                made = _dataset_workers.local(
                    left, place, spec.base, _dataset_workers.workers_of(count), meter
                )
            with contextlib.closing(made):
                for described in made:
                    found[described["name"]] = described
        # What lost workers left.
        _clean(shards, place)
        _dataset_shard.write_json(folder / MANIFEST, _manifest(spec, [found[shard.name] for shard in shards]))
    return load(folder)


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep two processes from making the same data set; the lock goes with its process."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with (folder / ".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BlockingIOError(
                f"another process is making the data set in {folder}; wait for it, or choose another folder"
            ) from None
        yield


def _finished(shards: Sequence[ShardPlan], place: Path, overwrite: bool) -> dict[str, dict[str, Any]]:
    """Return the descriptions of shards that need not be simulated."""
    found = {}
    for shard in shards:
        described = _described(place / f"{shard.name}.json")
        if described is None:
            continue
        if described.get("key") != shard.key(_evis.__version__):
            if not overwrite:
                raise ConfigError(
                    f"{place / shard.name}.h5 was made from another specification, or by another version of "
                    "EVIS; choose another folder, or overwrite it (overwrite=True)"
                )
            continue
        file = place / described["file"]
        if file.is_file() and file.stat().st_size == described["bytes"]:
            found[shard.name] = described
    return found


def _described(path: Path) -> dict[str, Any] | None:
    """Return the description of a shard, None where there is none or it is damaged: then it is made again."""
    try:
        described = json.loads(_limits.readable(path).read_text("utf-8"))
    except (FileNotFoundError, ValueError):
        return None
    whole = isinstance(described, dict) and {"key", "file", "bytes", "recordings"} <= described.keys()
    return described if whole else None


def _clean(shards: Sequence[ShardPlan], place: Path) -> None:
    """Remove what killed workers left, and shards that the specification no longer has."""
    import shutil

    for draft in place.glob("*.part"):
        if draft.is_dir():
            shutil.rmtree(draft, ignore_errors=True)
        else:
            draft.unlink(missing_ok=True)
    names = {shard.name for shard in shards}
    for file in [*place.glob("*.h5"), *place.glob("*.json")]:
        if file.stem not in names:
            file.unlink()


def _try_first(shards: Sequence[ShardPlan], spec: Spec) -> None:
    """Make each scene with each trajectory once: most of what is wrong is said before the wait."""
    tried = set()
    for plan in (plan for shard in shards for plan in shard.recordings):
        scene, trajectory = plan.id.split("/")[0], plan.id.split("/")[2]
        if (scene, trajectory) in tried:
            continue
        tried.add((scene, trajectory))
        motion, sha256 = plan.settings["trajectory"]["motion"], plan.settings["trajectory"]["sha256"]
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                made = _dataset_shard.scene_of(plan.settings, spec.base)
                if motion not in (None, "none"):
                    made.with_camera_motion(
                        spec.base / motion if sha256 else motion,
                        speed=plan.settings["trajectory"]["speed_px_per_s"],
                    )
        except EvisError as error:
            raise type(error)(
                f"scene '{scene}' with trajectory '{trajectory}': {error} (trajectories = [...] in the table "
                "of a scene chooses its trajectories)"
            ) from None


def _manifest(spec: Spec, found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    splits = spec.split_of()
    return {
        "layout": _dataset_shard.LAYOUT,
        "name": spec.name,
        "licence": spec.licence,
        "seed": spec.seed,
        "duration_us": spec.duration_us,
        "recordings": {
            split: sum(len(shard["recordings"]) for shard in found if shard["split"] == split)
            for split in SPLITS
        },
        "events": sum(shard["events"] for shard in found),
        "bytes": sum(shard["bytes"] for shard in found),
        "scenes": [
            {
                "name": scene.name,
                scene.kind: scene.what,
                "sha256": scene.sha256,
                "splits": sorted({splits[scene.group_of(variant)] for variant in range(scene.variants)}),
                "variants": scene.variants,
                "licence": scene.licence,
                "source": scene.source,
            }
            for scene in spec.scenes
        ],
        "versions": [json.loads(text) for text in sorted({json.dumps(each["versions"]) for each in found})],
        "devices": [json.loads(text) for text in sorted({json.dumps(each["device"]) for each in found})],
        "shards": [
            {name: shard[name] for name in ("name", "file", "split", "key", "bytes", "events")}
            | {
                "recordings": len(shard["recordings"]),
                "sha256": _dataset_shard.hash_of_hashes(shard["recordings"]),
            }
            for shard in found
        ],
        "spec": spec.text,
    }


# Loading.


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """What a data set says about one of its recordings.

    Attributes
    ----------
    id : str
        ``scene/variant/trajectory/sensor/seed``.
    split : str
        ``train``, ``validation`` or ``test``.
    events : int
        Its events, all cameras.
    duration_us : int
        Its length in microseconds.
    seed : int
        Seed of everything random in it.
    drawn : mapping
        What was drawn at random: ``speed``, ``start_s``, ``camera_speed_px_per_s``.
    sensor_toml : str
        Its sensor; ``evis.Sensor.from_toml`` reads it.
    settings_toml : str
        Every setting in force.
    sha256 : mapping of str to str
        Hash of each decoded column, by camera and name.
    """

    id: str
    split: str
    events: int
    duration_us: int
    seed: int
    drawn: Mapping[str, Any]
    sensor_toml: str
    settings_toml: str
    sha256: Mapping[str, str]

    @property
    def scene(self) -> str:
        """Name of its scene."""
        return self.id.split("/")[0]


class Dataset(Sequence[Recording]):
    """Recordings of a data set, in the order of its specification; files are opened where they are read.

    ``dataset[k]`` is an `evis.Recording`; ``dataset.info[k]`` tells where it comes from.

    Attributes
    ----------
    folder : Path
        Where it lies.
    manifest : mapping
        What ``manifest.json`` says: name, licence, scenes, versions, devices, shards.
    info : tuple of RecordingInfo
        One per recording.
    """

    def __init__(self, folder: Path, manifest: Mapping[str, Any], places: Sequence[tuple[str, int]]) -> None:
        self.folder, self.manifest = folder, manifest
        self._places = list(places)
        self._shards = {
            name: _read_description(folder / SHARDS / f"{name}.json")
            for name in dict.fromkeys(n for n, _ in places)
        }
        self.info = tuple(
            RecordingInfo(
                split=self._shards[name]["split"],
                **{
                    key: self._shards[name]["recordings"][index][key]
                    for key in RecordingInfo.__slots__
                    if key != "split"
                },
            )
            for name, index in self._places
        )

    def __len__(self) -> int:
        """Count the recordings."""
        return len(self._places)

    @overload
    def __getitem__(self, index: int) -> Recording: ...
    @overload
    def __getitem__(self, index: slice) -> Dataset: ...
    def __getitem__(self, index: int | slice) -> Recording | Dataset:
        """Return a recording, or a part of the data set."""
        if isinstance(index, slice):
            return Dataset(self.folder, self.manifest, self._places[index])
        try:
            name, number = self._places[index]
        except IndexError:
            raise IndexError(f"there are {len(self)} recordings, and no {index}") from None
        shard = self._shards[name]
        return _dataset_shard.part_of(
            self.folder / SHARDS / shard["file"], number, shard["recordings"][number]
        )

    def split(self, name: str) -> Dataset:
        """Return the recordings of a split: ``train``, ``validation`` or ``test``.

        Raises
        ------
        ConfigError
            If there is no such split, or nothing in it.
        """
        _check_split(name, list(dict.fromkeys(info.split for info in self.info)))
        places = [place for place, info in zip(self._places, self.info, strict=True) if info.split == name]
        return Dataset(self.folder, self.manifest, places)

    def torch(self, **options: Any) -> EventDataset:
        """Return windows of these recordings for PyTorch (extra ``torch``).

        Parameters
        ----------
        **options
            Of `evis.torch.EventDataset`: ``time_us``, ``representation``, ``labels``, ``camera``, … Windows
            reach from 0 to the end of each recording unless ``start_us`` and ``end_us`` say otherwise, and
            are cut without reading an event where ``time_us`` is given.

        Raises
        ------
        ImportError
            If PyTorch is not installed.
        ConfigError
            If an option cannot be used.
        """
        from .torch import EventDataset

        lengths = {info.duration_us for info in self.info}
        if len(lengths) == 1:
            options = {"start_us": 0, "end_us": lengths.pop(), **options}
        return EventDataset(list(self), **options)

    def check(self) -> None:
        """Read everything, and compare it with the hashes that the data set was made with.

        Raises
        ------
        FormatError
            If a column differs; names the recordings and columns.
        OSError
            If a file is missing.
        """
        wrong = []
        for index, info in enumerate(self.info):
            try:
                found = _dataset_shard.hashes_of(self[index])
            except FormatError as error:
                wrong.append(f"{info.id}: {error}")
                continue
            if columns := _dataset_shard.differences(info.sha256, found):
                wrong.append(f"{info.id}: {', '.join(columns)}")
        if wrong:
            raise FormatError(
                f"{len(wrong)} of {len(self)} recordings of {self.folder} are not what was made ("
                f"{'; '.join(wrong[:3])}{'; ...' if len(wrong) > 3 else ''}); remove these shards and make "
                "the data set again"
            )

    def __repr__(self) -> str:
        """Count recordings by split."""
        counts = ", ".join(f"{count} {split}" for split, count in Counter(i.split for i in self.info).items())
        return f"Dataset({self.manifest['name']!r}, {len(self)} recordings: {counts})"


def _read_description(path: Path) -> dict[str, Any]:
    if not path.exists():
        raise FileNotFoundError(f"{path} is missing; make the data set again: what is finished is kept")
    described = _described(path)
    if described is None:
        raise FormatError(f"{path} is damaged; make the data set again: what is finished is kept")
    return described


def load(folder: str | PathLike[str], split: str | None = None) -> Dataset:
    """Open a data set.

    Parameters
    ----------
    folder : path
        Where `make` or ``evis dataset`` put it.
    split : str, optional
        ``train``, ``validation`` or ``test``; all recordings where not given.

    Raises
    ------
    OSError
        If there is no finished data set.
    FormatError
        If its manifest is damaged, or of a newer layout.
    ConfigError
        If there is no such split.
    """
    folder = Path(folder).absolute()
    path = folder / MANIFEST
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist; evis dataset writes it once all shards are finished")
    try:
        manifest = json.loads(_limits.readable(path).read_text("utf-8"))
        layout, shards = manifest["layout"], manifest["shards"]
        places = {
            name: [
                (shard["name"], i)
                for shard in shards
                if shard["split"] == name
                for i in range(shard["recordings"])
            ]
            for name in SPLITS
        }
    except (ValueError, TypeError, KeyError) as error:
        raise FormatError(
            f"{path} is damaged ({error}); make the data set again: what is finished is kept"
        ) from None
    if layout != _dataset_shard.LAYOUT:
        raise FormatError(
            f"{path} has layout {layout}; this version reads {_dataset_shard.LAYOUT}: update EVIS"
        )
    if split is None:
        return Dataset(folder, manifest, [place for name in SPLITS for place in places[name]])
    _check_split(split, [name for name in SPLITS if places[name]])
    return Dataset(folder, manifest, places[split])


def _check_split(name: str, there: Sequence[str]) -> None:
    if name not in SPLITS:
        raise ConfigError(f"split is {_check.shown(name)}; it must be {_check.one_of(SPLITS)}")
    if name not in there:
        raise ConfigError(f"split is '{name}'; this data set has {', '.join(there)}")
