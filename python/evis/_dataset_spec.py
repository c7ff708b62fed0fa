"""Specifications of data sets: a TOML file in, a plan of recordings and shards out. Nothing is simulated."""

from __future__ import annotations

import difflib
import hashlib
import itertools
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import _check, _limits, _toml, recipes
from ._evis import ConfigError, EvisError, FormatError, builtin_scenes
from ._sensor import Sensor

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SPLITS = ("train", "validation", "test")

#: Arguments of `Simulator` that a specification may give; the others follow from scenes, sensors and draws.
SIMULATOR_KEYS = (
    "quality",
    "method",
    "rate_hz",
    "adaptive_px",
    "samples",
    "antialias",
    "texture_taps",
    "shadows",
    "compute",
    "shadow_map",
    "audit",
    "cameras",
    "size",
    "labels",
    "label_rate_hz",
    "frame_rate_hz",
    "exposure_us",
    "reference_luminance",
    "device",
)

_TOP = (
    "name",
    "seed",
    "seeds",
    "duration_s",
    "recordings_per_shard",
    "licence",
    "split",
    "simulator",
    "scenes",
    "trajectories",
    "sensors",
    "randomise",
)
_SCENE = (
    "name",
    "builtin",
    "file",
    "recipe",
    "settings",
    "variants",
    "split",
    "group",
    "start_s",
    "trajectories",
    "sensors",
    "licence",
    "source",
)
_TRAJECTORY = ("name", "motion", "speed_px_per_s", "start_s")
_SENSOR = ("name", "preset", "file", "values")
_RANDOMISE = ("speed", "camera_speed_px_per_s", "start_s", "sensor")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_MOTIONS = ("own", "none", "orbit", "dolly", "shake")


def digest(value: Any) -> str:
    """Return the SHA-256 of a value that JSON can hold, in hexadecimal."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def draw(seed: int, *path: object) -> float:
    """Return a number in [0, 1) that depends on the seed and on its own path only."""
    return int(digest([seed, *map(str, path)])[:13], 16) / 16**13


def seed_of(seed: int, *path: object) -> int:
    """Return a seed, 0 to 2**63 - 1, that depends on the seed and on its own path only."""
    return int(digest([seed, *map(str, path), "seed"])[:16], 16) >> 1


@dataclass(frozen=True)
class SceneSource:
    """A scene of a specification, with its variants."""

    name: str
    kind: str
    what: str
    settings: dict[str, Any]
    variants: int
    split: str | None
    group: str
    start_s: float
    trajectories: tuple[str, ...]
    sensors: tuple[str, ...]
    licence: str | None
    source: str | None
    sha256: str | None

    def group_of(self, variant: int) -> str:
        """Return what keeps scenes in the same split: variants of a recipe share nothing but its code."""
        alone = self.kind == "recipe" and self.group == self.name
        return f"{self.group}/{variant}" if alone else self.group


@dataclass(frozen=True)
class Trajectory:
    """How cameras move."""

    name: str
    motion: str | None
    speed_px_per_s: float | None
    start_s: float | None
    sha256: str | None


@dataclass(frozen=True)
class RecordingPlan:
    """What a worker simulates: one recording.

    Attributes
    ----------
    id : str
        ``scene/variant/trajectory/sensor/seed``; its draws depend on it and on the seed of the data set.
    split : str
        ``train``, ``validation`` or ``test``.
    settings : dict
        Everything that the recording depends on, as JSON can hold it.
    """

    id: str
    split: str
    settings: dict[str, Any]


@dataclass(frozen=True)
class ShardPlan:
    """Recordings that share a file.

    Attributes
    ----------
    name : str
        Name of its files, without an ending.
    recordings : tuple of RecordingPlan
        In order.
    """

    name: str
    recordings: tuple[RecordingPlan, ...]

    @property
    def split(self) -> str:
        """Return the split of its recordings."""
        return self.recordings[0].split

    def key(self, version: str) -> str:
        """Return a hash of everything that its columns depend on, but for the device."""
        return digest([version, [[plan.id, plan.split, plan.settings] for plan in self.recordings]])


@dataclass(frozen=True)
class Spec:
    """A checked specification; `evis.dataset.read_spec` makes it.

    Attributes
    ----------
    name : str
        Name of the data set.
    seed : int
        What all draws and seeds are made of.
    duration_us : int
        Length of each recording, microseconds.
    seeds : tuple of int
        One recording of each combination per seed.
    recordings_per_shard : int
        Recordings in a file, at most.
    licence : str or None
        Licence of the data set.
    shares : dict of str to float
        Share of each split.
    simulator : dict
        Arguments of `evis.Simulator`.
    scenes, trajectories, sensors
        What is combined; sensors as TOML by name.
    ranges, sensor_ranges : dict
        What is drawn at random.
    base : Path
        Folder at which relative paths start.
    text : str
        The specification itself.
    """

    name: str
    seed: int
    duration_us: int
    seeds: tuple[int, ...]
    recordings_per_shard: int
    licence: str | None
    shares: dict[str, float]
    simulator: dict[str, Any]
    scenes: tuple[SceneSource, ...]
    trajectories: tuple[Trajectory, ...]
    sensors: dict[str, str]
    ranges: dict[str, tuple[float, float]]
    sensor_ranges: dict[str, Any]
    base: Path
    text: str = field(repr=False)

    def split_of(self) -> dict[str, str]:
        """Return the split of each group of scenes.

        Raises
        ------
        ConfigError
            If a split that has a share gets no scene.
        """
        pinned = {
            scene.group_of(variant): scene.split
            for scene in self.scenes
            for variant in range(scene.variants)
            if scene.split is not None
        }
        free = {
            scene.group_of(variant)
            for scene in self.scenes
            for variant in range(scene.variants)
            if scene.split is None
        } - pinned.keys()
        found = {**pinned, **deal(sorted(free), self.shares, self.seed)}
        for split, share in self.shares.items():
            if share > 0 and split not in found.values():
                raise ConfigError(
                    f"[split] {split} is {share:g}; {len(found)} scenes that share nothing are too few for "
                    f"it: add scenes, give a recipe more variants, write split = '{split}' in one, or leave "
                    "it out"
                )
        return found

    def recordings(self) -> list[RecordingPlan]:
        """Return all recordings, in the order of the specification."""
        splits = self.split_of()
        trajectories = {trajectory.name: trajectory for trajectory in self.trajectories}
        plans = []
        for scene in self.scenes:
            for variant, trajectory, sensor, seed in itertools.product(
                range(scene.variants), scene.trajectories, scene.sensors, self.seeds
            ):
                split = splits[scene.group_of(variant)]
                plans.append(self._plan(scene, variant, trajectories[trajectory], sensor, seed, split))
        return plans

    def _plan(
        self, scene: SceneSource, variant: int, trajectory: Trajectory, sensor: str, seed: int, split: str
    ) -> RecordingPlan:
        id_ = f"{scene.name}/{variant}/{trajectory.name}/{sensor}/{seed}"
        own = seed_of(self.seed, id_)
        drawn = {
            name: low + (high - low) * draw(own, name) for name, (low, high) in sorted(self.ranges.items())
        }
        values = Sensor.from_toml(self.sensors[sensor])
        if self.sensor_ranges:
            values = values.sample(self.sensor_ranges, own)
        start_s = scene.start_s if trajectory.start_s is None else trajectory.start_s
        settings: dict[str, Any] = {
            "scene": {
                "kind": scene.kind,
                "what": scene.what,
                "sha256": scene.sha256,
                "seed": variant if scene.kind == "builtin" else seed_of(self.seed, scene.name, variant),
                "settings": self._recipe_settings(scene, split),
            },
            "trajectory": {
                "motion": trajectory.motion,
                "sha256": trajectory.sha256,
                "speed_px_per_s": drawn.get("camera_speed_px_per_s", trajectory.speed_px_per_s)
                if trajectory.motion not in (None, "none")
                else None,
            },
            "speed": drawn.get("speed", 1.0),
            "start_s": start_s + drawn.get("start_s", 0.0),
            "sensor_toml": values.to_toml(),
            "seed": own,
            "duration_us": self.duration_us,
            "simulator": self.simulator,
        }
        return RecordingPlan(id_, split, settings)

    def _recipe_settings(self, scene: SceneSource, split: str) -> dict[str, Any]:
        if scene.kind != "recipe":
            return {}
        settings = {**scene.settings, "duration": self.duration_us / 1e6}
        if "images" in settings:
            # Pictures are dealt to the splits as scenes are, so that splits share none.
            settings["part"] = [split, self.shares, self.seed]
        return settings

    def shards(self) -> list[ShardPlan]:
        """Return the shards, split by split."""
        plans = self.recordings()
        shards = []
        for split in SPLITS:
            own = [plan for plan in plans if plan.split == split]
            step = self.recordings_per_shard
            for number, begin in enumerate(range(0, len(own), step)):
                shards.append(ShardPlan(f"{split}-{number:05d}", tuple(own[begin : begin + step])))
        return shards


def deal(names: Sequence[str], shares: Mapping[str, float], seed: int) -> dict[str, str]:
    """Deal names to splits by their shares, rounded to whole numbers, in an order that a hash gives."""
    total = sum(shares.values())
    wanted = {split: share / total * len(names) for split, share in shares.items() if share > 0}
    counts = {split: int(wanted[split]) for split in wanted}
    rest = sorted(wanted, key=lambda split: (counts[split] - wanted[split], SPLITS.index(split)))
    for split in rest[: len(names) - sum(counts.values())]:
        counts[split] += 1
    order = sorted(names, key=lambda name: (digest([seed, name]), name))
    places = iter(order)
    return {name: split for split, count in counts.items() for name in itertools.islice(places, count)}


# Reading.


def lines_of(text: str) -> dict[tuple[str | int, ...], int]:
    """Return the line, from 1, of each table and key of a TOML text."""
    found: dict[tuple[str | int, ...], int] = {}
    counts: dict[tuple[str | int, ...], int] = {}
    table: tuple[str | int, ...] = ()

    def placed(names: list[str]) -> tuple[str | int, ...]:
        path: tuple[str | int, ...] = ()
        for name in names:
            path = (*path, name)
            if path in counts:
                path = (*path, counts[path] - 1)
        return path

    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*(\[\[?)\s*([^\]]+?)\s*\]", line):
            names = [part.strip().strip("\"'") for part in header[2].split(".")]
            if header[1] == "[[":
                whole = (*placed(names[:-1]), names[-1])
                counts[whole] = counts.get(whole, 0) + 1
                table = (*whole, counts[whole] - 1)
            else:
                table = placed(names)
            found.setdefault(table, number)
        elif key := re.match(
            r"""\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*=""", line
        ):
            parts = re.findall(r"""[\w-]+|"[^"]*"|'[^']*'""", key[1])
            path = table
            for part in parts:
                path = (*path, part.strip("\"'"))
                found.setdefault(path, number)
    return found


class _Table:
    """A table of the specification; errors name the file, the line and the nearest key."""

    def __init__(
        self,
        file: str,
        lines: Mapping[tuple[str | int, ...], int],
        values: Any,
        path: tuple[str | int, ...],
        keys: Sequence[str],
    ) -> None:
        self._file, self._lines, self._path = file, lines, path
        if not isinstance(values, dict):
            raise self.error(None, f"{self._title} is {_check.shown(values)}; it must be a table")
        self.values: dict[str, Any] = values
        for key in values:
            if key not in keys:
                near = difflib.get_close_matches(key, keys, 1, 0.5)
                hint = f"did you mean '{near[0]}'?" if near else f"there is {', '.join(keys)}"
                raise self.error(key, f"{self._title} has no key '{key}'; {hint}")

    @property
    def _title(self) -> str:
        names = [part for part in self._path if isinstance(part, str)]
        if not names:
            return "the specification"
        return f"[[{'.'.join(names)}]]" if isinstance(self._path[-1], int) else f"[{'.'.join(names)}]"

    def error(self, key: str | None, message: str) -> FormatError:
        path = self._path if key is None else (*self._path, key)
        while path and path not in self._lines:
            path = path[:-1]
        line = self._lines.get(path)
        return FormatError(f"{self._file}{'' if line is None else f', line {line}'}: {message}")

    @contextmanager
    def at(self, key: str) -> Iterator[None]:
        """Put file and line before what is wrong with the value of a key."""
        try:
            yield
        except (EvisError, OSError) as error:
            raise self.error(key, str(error)) from None

    def text(self, key: str, default: str | None = None) -> str | None:
        value = self.values.get(key, default)
        if value is not None and (not isinstance(value, str) or not value):
            raise self.error(key, f"{key} is {_check.shown(value)}; it must be text")
        return value

    def choice(self, key: str, of: Sequence[str]) -> str | None:
        value = self.text(key)
        if value is not None and value not in of:
            near = difflib.get_close_matches(value, of, 1, 0.5)
            hint = f"; did you mean '{near[0]}'?" if near else f"; it must be {_check.one_of(of)}"
            raise self.error(key, f"{key} is '{value}'{hint}")
        return value

    def name(self, default: str | None = None) -> str:
        value = self.text("name", default)
        if value is None:
            raise self.error(None, 'name is missing; write a word, such as name = "cards"')
        if not _NAME.fullmatch(value):
            raise self.error(
                "name", f"name is {_check.shown(value)}; it must consist of letters, digits, '-' and '_'"
            )
        return value

    def whole(self, key: str, default: int, least: int, most: int) -> int:
        with self.at(key):
            return _check.whole(key, self.values.get(key, default), least, most)

    def number(self, key: str, default: float | None, least: float) -> float | None:
        value = self.values.get(key, default)
        if value is None:
            return None
        with self.at(key):
            value = _check.number(key, value)
            if not least <= value < 1e9:
                raise ConfigError(f"{key} is {value:g}; it must be at least {least:g} and finite")
            return value

    def names(self, key: str, of: Sequence[str]) -> tuple[str, ...]:
        """Return a list of names of others, all where it is not given."""
        value = self.values.get(key)
        if value is None:
            return tuple(of)
        if not isinstance(value, list) or not value:
            raise self.error(key, f"{key} is {_check.shown(value)}; it must be a list of names: {list(of)}")
        for name in value:
            if name not in of:
                near = difflib.get_close_matches(str(name), of, 1, 0.5)
                hint = f"did you mean '{near[0]}'?" if near else f"there is {', '.join(of)}"
                raise self.error(key, f"{key} has {_check.shown(name)}; {hint}")
        if len(set(value)) != len(value):
            raise self.error(key, f"{key} is {_check.shown(value)}; each name must stand in it once")
        return tuple(value)

    def table(self, key: str, keys: Sequence[str]) -> _Table:
        return _Table(self._file, self._lines, self.values.get(key, {}), (*self._path, key), keys)

    def tables(self, key: str, keys: Sequence[str]) -> list[_Table]:
        value = self.values.get(key, [])
        if not isinstance(value, list):
            raise self.error(key, f"{key} is {_check.shown(value)}; it must be tables: write [[{key}]]")
        return [
            _Table(self._file, self._lines, item, (*self._path, key, index), keys)
            for index, item in enumerate(value)
        ]


def parse(text: str, base: Path, file: str) -> Spec:
    """Check a specification.

    Parameters
    ----------
    text : str
        TOML.
    base : Path
        Folder at which relative paths start.
    file : str
        What errors call it.

    Raises
    ------
    FormatError
        If something is wrong; names the line, and the nearest key that exists.
    ConfigError
        If a split gets no scene.
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FormatError(f"{file} is no TOML: {error}; put that place right") from None
    top = _Table(file, lines_of(text), values, (), _TOP)
    name = top.name()
    seed = top.whole("seed", 0, 0, 2**63 - 1)
    if "duration_s" not in top.values:
        raise top.error(None, "duration_s is missing; write the seconds of a recording, duration_s = 0.5")
    with top.at("duration_s"):
        duration_us = _check.duration_us("duration_s", top.values["duration_s"])
    trajectories = _trajectories(top, base)
    sensors = _sensors(top, base)
    scenes = _scenes(top, base, [each.name for each in trajectories], list(sensors))
    ranges, sensor_ranges = _randomise(top, sensors)
    spec = Spec(
        name=name,
        seed=seed,
        duration_us=duration_us,
        seeds=_seeds(top),
        recordings_per_shard=top.whole("recordings_per_shard", 16, 1, 4096),
        licence=top.text("licence"),
        shares=_shares(top),
        simulator=top.table("simulator", SIMULATOR_KEYS).values,
        scenes=scenes,
        trajectories=trajectories,
        sensors=sensors,
        ranges=ranges,
        sensor_ranges=sensor_ranges,
        base=base,
        text=text,
    )
    if "camera_speed_px_per_s" in ranges and all(each.motion in (None, "none") for each in trajectories):
        raise top.table("randomise", _RANDOMISE).error(
            "camera_speed_px_per_s",
            "camera_speed_px_per_s moves no camera; give [[trajectories]] a motion: orbit, dolly or shake",
        )
    with top.at("split"):
        spec.split_of()
    return spec


def _seeds(top: _Table) -> tuple[int, ...]:
    value = top.values.get("seeds", 1)
    with top.at("seeds"):
        if isinstance(value, list):
            seeds = [_check.whole("seeds", each, 0, 2**63 - 1) for each in value]
            if not seeds or len(set(seeds)) != len(seeds):
                raise ConfigError(f"seeds is {_check.shown(value)}; it must hold different numbers")
            return tuple(seeds)
        return tuple(range(_check.whole("seeds", value, 1, 1_000_000)))


def _shares(top: _Table) -> dict[str, float]:
    table = top.table("split", SPLITS)
    shares = {split: table.number(split, 0.0, 0.0) or 0.0 for split in SPLITS if split in table.values}
    if not shares:
        return {"train": 1.0}
    if not sum(shares.values()) > 0:
        raise top.error(
            "split", "[split] has no share above 0; write train = 0.8, validation = 0.1, test = 0.1"
        )
    return shares


def _file_hash(path: Path) -> str:
    if path.is_dir():
        return digest([[each.name, each.stat().st_size] for each in recipes.pictures(path)])
    return hashlib.sha256(_limits.readable(path).read_bytes()).hexdigest()


def _unique(tables: Sequence[_Table], names: Sequence[str], what: str) -> None:
    for index, name in enumerate(names):
        if name in names[:index]:
            raise tables[index].error("name", f"two {what} are named '{name}'; give each its own name")


def _trajectories(top: _Table, base: Path) -> tuple[Trajectory, ...]:
    tables = top.tables("trajectories", _TRAJECTORY)
    if not tables:
        return (Trajectory("own", None, None, None, None),)
    made = []
    for table in tables:
        motion = table.text("motion", "own")
        assert motion is not None
        sha256 = None
        if motion not in _MOTIONS:
            near = difflib.get_close_matches(motion, _MOTIONS, 1, 0.6)
            if not (base / motion).is_file():
                hint = f"did you mean '{near[0]}'?" if near else f"it must be {_check.one_of(_MOTIONS)}"
                raise table.error(
                    "motion", f"motion is '{motion}'; {hint}, or a file of poses, which is not there"
                )
            sha256 = _file_hash(base / motion)
        if motion in ("own", "none") and "speed_px_per_s" in table.values:
            raise table.error(
                "speed_px_per_s", f"speed_px_per_s says nothing for motion = '{motion}'; leave it out"
            )
        made.append(
            Trajectory(
                table.name(Path(motion).stem),
                None if motion == "own" else motion,
                table.number("speed_px_per_s", None, 1e-3),
                table.number("start_s", None, 0.0),
                sha256,
            )
        )
    _unique(tables, [each.name for each in made], "trajectories")
    return tuple(made)


def _sensors(top: _Table, base: Path) -> dict[str, str]:
    tables = top.tables("sensors", _SENSOR)
    if not tables:
        return {"ideal": Sensor().to_toml()}
    names, texts = [], []
    for table in tables:
        given = [key for key in ("preset", "file", "values") if key in table.values]
        if len(given) != 1:
            raise table.error(
                None, f"a sensor has {' and '.join(given) or 'nothing'}; give preset, file or values"
            )
        preset = table.choice("preset", list(Sensor.presets()))
        file = table.text("file")
        with table.at(given[0]):
            if preset is not None:
                sensor = Sensor.preset(preset)
            elif file is not None:
                sensor = Sensor.from_toml(base / file)
            else:
                values = table.values["values"]
                if not isinstance(values, dict):
                    raise ConfigError(
                        f"values is {_check.shown(values)}; it must be a table of a sensor's keys"
                    )
                sensor = Sensor.from_toml(_toml.document(values) + "\n")
            sensor.check()
            texts.append(sensor.to_toml())
        names.append(table.name(preset or (Path(file).stem if file else None)))
    _unique(tables, names, "sensors")
    return dict(zip(names, texts, strict=True))


def _scenes(
    top: _Table, base: Path, trajectories: Sequence[str], sensors: Sequence[str]
) -> tuple[SceneSource, ...]:
    tables = top.tables("scenes", _SCENE)
    if not tables:
        raise top.error("scenes", "there is no scene; write [[scenes]] with builtin, file or recipe")
    made = []
    for table in tables:
        given = [key for key in ("builtin", "file", "recipe") if key in table.values]
        if len(given) != 1:
            raise table.error(
                None, f"a scene has {' and '.join(given) or 'nothing'}; give one of builtin, file and recipe"
            )
        kind = given[0]
        known = {
            "builtin": [name for name, _ in builtin_scenes()],
            "recipe": list(recipes.RECIPES),
            "file": [],
        }
        what = table.choice(kind, known[kind]) if known[kind] else table.text(kind)
        assert what is not None
        settings, sha256 = table.values.get("settings", {}), None
        with table.at(kind):
            if kind == "file":
                sha256 = _file_hash(base / what)
        if kind != "recipe" and settings:
            raise table.error("settings", f"settings are for recipes; leave them out of a scene with {kind}")
        if kind == "recipe":
            keys = [key for key in recipes.keys(what) if key != "duration"]
            settings = table.table("settings", keys).values
            with table.at("settings"):
                recipes.check(what, {**settings, "duration": 1.0}, base)
                if "images" in settings:
                    sha256 = _file_hash(base / settings["images"])
        variants = table.whole("variants", 1, 1, 1_000_000)
        if kind == "file" and variants > 1:
            raise table.error(
                "variants", "variants are for builtin scenes and recipes; a file is always the same"
            )
        name = table.name(Path(what).stem if kind == "file" else what)
        made.append(
            SceneSource(
                name=name,
                kind=kind,
                what=what,
                settings=settings,
                variants=variants,
                split=table.choice("split", SPLITS),
                group=table.text("group") or name,
                start_s=table.number("start_s", 0.0, 0.0) or 0.0,
                trajectories=table.names("trajectories", trajectories),
                sensors=table.names("sensors", sensors),
                licence=table.text("licence"),
                source=table.text("source"),
                sha256=sha256,
            )
        )
    _unique(tables, [each.name for each in made], "scenes")
    for table, scene in zip(tables, made, strict=True):
        others = {each.split for each in made if each.group == scene.group}
        if len(others) > 1:
            raise table.error(
                "group", f"scenes of the group '{scene.group}' are put into different splits; one split works"
            )
    return tuple(made)


def _randomise(
    top: _Table, sensors: Mapping[str, str]
) -> tuple[dict[str, tuple[float, float]], dict[str, Any]]:
    table = top.table("randomise", _RANDOMISE)
    ranges = {}
    for key in _RANDOMISE[:-1]:
        if key not in table.values:
            continue
        value = table.values[key]
        with table.at(key):
            ends = _check.numbers(key, value) if isinstance(value, list) else []
            least = 0.0 if key == "start_s" else 1e-3
            if len(ends) != 2 or not least <= ends[0] <= ends[1] < 1e9:
                raise ConfigError(
                    f"{key} is {_check.shown(value)}; it must be [low, high], from {least:g} upwards"
                )
            ranges[key] = (ends[0], ends[1])
    with table.at("sensor"):
        sensor_ranges = _flat(table.values.get("sensor", {}))
        for text in sensors.values() if sensor_ranges else ():
            sensor = Sensor.from_toml(text)
            # Several draws: most sensors that cannot be are found before anything is simulated.
            for seed in range(8):
                sensor.sample(sensor_ranges, seed)
    return ranges, sensor_ranges


def _flat(values: Any, path: str = "") -> dict[str, Any]:
    """Return nested tables by path, ``noise.leak_hz``; ``{choices = [...]}`` stays whole."""
    if not isinstance(values, dict):
        raise ConfigError(f"sensor is {_check.shown(values)}; it must be a table of ranges")
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, dict) and set(value) != {"choices"}:
            flat |= _flat(value, f"{path}{key}.")
        else:
            flat[f"{path}{key}"] = value
    return flat
