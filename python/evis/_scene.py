"""Scenes and the cameras in them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from os.path import abspath
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check, _evis, _toml
from ._bodies import Bodies, Instance, bodies_of
from ._evis import ConfigError
from ._sensor import Sensor
from ._short import ShortRepr
from .lens import Distortion, Fisheye, RadialTangential
from .motion import HERE, Placement, fields_of, table_of


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class EventCamera(ShortRepr):
    """An event camera that looks along its -Z, with +Y up (glTF axes), in metres.

    The lens is a vertical field of view, intrinsics, which may have a distortion, or orthographic.

    Attributes
    ----------
    name : str
        Unique within the scene.
    width, height : int, optional
        Pixels; 640x480 where not given.
    fov_y_degrees : float, optional
        Vertical field of view; 60 where neither it nor intrinsics are given.
    fx, fy, cx, cy : float, optional
        Intrinsics in pixels, all four, for this width and height; pixel centres lie at +0.5.
    distortion : RadialTangential or Fisheye, optional
        Distortion of the lens, from `evis.lens`; a pinhole where not given. Events and labels are then those
        of distorted pixels.
    orthographic_height, far : float, optional
        Of an orthographic camera, both: what the picture shows from its lower to its upper edge, and the
        planar distance beyond which nothing is seen; metres.
    pose : Placement
        Where it is, what carries it, and how it moves; ``parent_from_camera``.
    near : float, optional
        Near plane in metres.
    threshold_on, threshold_off : float, optional
        Thresholds of this camera, where they differ from the run's.
    sensor : Sensor or str, optional
        Its sensor, or the name of a preset or TOML file: what a `Simulator` takes that is given none for it.
    """

    name: str
    width: int | None = None
    height: int | None = None
    fov_y_degrees: float | None = None
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    distortion: Distortion | None = None
    orthographic_height: float | None = None
    far: float | None = None
    pose: Placement = HERE
    near: float | None = None
    threshold_on: float | None = None
    threshold_off: float | None = None
    sensor: Sensor | str | None = None

    def table(self) -> dict[str, Any]:
        """Return the camera as a scene file has it."""
        table = fields_of(self)
        width, height = table.pop("width", None), table.pop("height", None)
        if (width is None) != (height is None):
            raise ConfigError(f"camera '{self.name}' has a width or a height alone; it takes both or none")
        if width is not None:
            table["size"] = (width, height)
        if self.distortion is not None:
            if not isinstance(self.distortion, RadialTangential | Fisheye):
                raise ConfigError(
                    f"camera '{self.name}' has the distortion {_check.shown(self.distortion)}; it must be "
                    "evis.lens.RadialTangential or evis.lens.Fisheye"
                )
            table["distortion"] = self.distortion.table()
        if isinstance(self.sensor, Sensor):
            table["sensor"] = json.loads(self.sensor._json())
        return {**table_of(self.name, table.pop("pose", None)), **table}


Source: TypeAlias = tuple[Callable[..., Any], tuple[Any, ...]]
"""What makes a scene: a function, and its arguments."""


class Scene:
    """What the world holds and where everything is at any time; immutable, shared by simulators.

    Right-handed, metres, +Y up; colours are linear (Rec. 709 primaries). Made by `builtin`, `load`,
    `from_toml` or a `SceneBuilder`. Pickles hold what made it, and make it again.
    """

    __slots__ = ("_raw", "_source")

    def __init__(self, raw: _evis.Scene, source: Source) -> None:
        self._raw = raw
        self._source = source

    def __reduce__(self) -> Source:
        """Pickle by what made it, which is made again: files must be where they were."""
        return self._source

    @classmethod
    def builtin(cls, name: str, *, seed: int = 0) -> Scene:
        """Make a built-in scene; `evis.scenes` lists them.

        Parameters
        ----------
        name : str
            ``warehouse``, ``spinner``, ``street`` or ``desk``.
        seed : int
            Varies what is random in the scene; at least 0.

        Raises
        ------
        ConfigError
            If there is no such scene; lists those that exist.
        """
        seed = _check.whole("seed", seed, 0, 2**64 - 1)
        return cls(_evis.Scene.builtin(str(name), seed), (_builtin, (str(name), seed)))

    @classmethod
    def load(cls, path: str | PathLike[str], *, animation: str | int | None = None) -> Scene:
        """Load a ``.toml``, ``.gltf`` or ``.glb`` file, or a picture: ``.png``, ``.jpg``, ``.hdr``, ``.exr``.

        A picture is a flat scene: sRGB, which is decoded to linear light, or linear light where it holds
        floats. What has neither a camera nor any motion gets a camera that moves: see `with_camera_motion`.

        Parameters
        ----------
        path : path
            The file.
        animation : str or int, optional
            Which animation of a glTF file plays, by name or by index from 0; the first where not given.

        Raises
        ------
        OSError
            If a file cannot be read.
        FormatError
            If its content is not usable; says where and why.
        ConfigError
            If the file's ending is another, the scene breaks a rule, or there is no such animation; lists
            those that exist.
        """
        if animation is not None and not isinstance(animation, str):
            animation = str(_check.whole("animation", animation, 0))
        return cls(_evis.Scene.load(path, animation), (_loaded, (Path(path).absolute(), animation)))

    @classmethod
    def from_toml(cls, text: str, *, base: str | PathLike[str] = ".") -> Scene:
        """Read a scene file's text.

        Parameters
        ----------
        text : str
            The text of a TOML scene file.
        base : path
            Folder at which relative paths in it start.

        Raises
        ------
        OSError
            If a file that it names cannot be read.
        FormatError
            If the text is not usable; an unknown key is named with the nearest known one.
        ConfigError
            If the scene breaks a rule.
        """
        return Scene._of_text(text, base, [])

    @classmethod
    def _of_text(
        cls,
        text: str,
        base: str | PathLike[str],
        pictures: list[tuple[str, npt.NDArray[np.float32]]],
    ) -> Scene:
        """Make the scene of a text, and of pictures for its textures of these names."""
        source = (Scene._of_text, (text, Path(base).absolute(), pictures))
        return cls(_evis.Scene.from_toml(text, base, pictures), source)

    def with_cameras(self, cameras: Sequence[EventCamera]) -> Scene:
        """Return this scene with more cameras; this one stays as it is.

        Parameters
        ----------
        cameras : sequence of EventCamera
            Their parents are nodes of this scene (see `nodes`).

        Raises
        ------
        ConfigError, FormatError
            If a name is taken, a parent does not exist, or a value cannot be used.
        """
        cameras = _check.items("cameras", cameras, "[evis.EventCamera(name='left')]")
        tables = []
        for camera in cameras:
            if not isinstance(camera, EventCamera):
                raise ConfigError(f"cameras has {_check.shown(camera)}; it must hold evis.EventCamera")
            if isinstance(camera.pose, Placement) and camera.pose.rigid_body is not None:
                raise ConfigError(
                    f"camera '{camera.name}' is a rigid body, and the bodies of this scene were simulated "
                    "when it was made; add the camera to the evis.SceneBuilder or the scene file"
                )
            tables.append(camera.table())
        # The parents are nodes of this scene, which the text of the cameras does not know.
        parents = [table.pop("parent", None) for table in tables]
        text = _toml.document({"cameras": tables})
        return Scene(self._raw.with_cameras(text, parents), (Scene.with_cameras, (self, tuple(cameras))))

    def at_speed(self, speed: float) -> Scene:
        """Return this scene with everything that moves, deforms or changes its light so many times as fast.

        Parameters
        ----------
        speed : float
            From 1e-6 to 1e6: 0.25 for slow motion, 4 for four times as fast as now. `duration_s` is divided
            by it.

        Raises
        ------
        ConfigError
            If it, or what several of them come to, is not a number from 1e-6 to 1e6.
        """
        speed = _check.number("speed", speed)
        return Scene(self._raw.at_speed(speed), (Scene.at_speed, (self, speed)))

    def with_camera_motion(
        self,
        motion: str | PathLike[str] | None = None,
        *,
        speed: float | None = None,
        camera: str | None = None,
        size: tuple[int, int] | None = None,
    ) -> Scene:
        """Return this scene with its cameras moved, all together, where the scene leaves them at rest.

        A `Simulator`, `chart` and `verify_scene` do the same for their cameras and sizes.

        Parameters
        ----------
        motion : {"none", "orbit", "dolly", "shake"} or path, optional
            ``orbit``: around the model's centre; ``dolly``: to and fro along the view axis, without touching
            the model; ``shake``: small, smooth turns and shifts, like a hand's or an eye's, the same in every
            run; or a file of poses of the camera in the world, rows of ``t x y z qx qy qz qw`` in seconds and
            metres. Where not given, a scene that brings neither a camera nor any motion gets ``orbit``, a
            picture ``shake``, and `warnings` says so; any other scene stays as it is.
        speed : float, optional
            Mean speed, in pixels per second, of what the camera shows in the central half of its picture; 100
            where not given. The physical speed follows from it.
        camera : str, optional
            The camera by which the motion is made; the first where not given.
        size : (int, int), optional
            Its width and height in pixels; its own where not given.

        Raises
        ------
        OSError, FormatError
            If a file of poses cannot be read; says line and column.
        ConfigError
            If a value cannot be used, a camera moves by itself, or a motion has no way to go.
        """
        word = motion_text(motion)
        moved = self._raw.with_camera_motion(
            word,
            _check.number_or_none("camera_speed", speed, " pixels per second"),
            None if camera is None else str(camera),
            None if size is None else _check.size(size),
        )
        return Scene(moved, (moved_scene, (self, word, speed, camera, size)))

    @property
    def camera_motion(self) -> str | None:
        """What moves the cameras where `with_camera_motion` did, and how fast; None where the scene does."""
        applied = self._raw.camera_motion
        return None if applied is None else f"{applied[0]}: {applied[3]}"

    @property
    def name(self) -> str:
        """Name for reports."""
        return self._raw.name

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the scene's event cameras, in the order in which they are rendered."""
        return tuple(self._raw.cameras)

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the scene's nodes, parents before children."""
        return tuple(self._raw.nodes)

    @property
    def instances(self) -> tuple[Instance, ...]:
        """The objects by their ids in images of the label ``instance``, with names and semantic ids."""
        return bodies_of(self._raw, [], 0, 0, []).instances

    @property
    def classes(self) -> dict[int, str]:
        """Names of semantic classes by their ids in images of the label ``semantic``; those that occur."""
        return bodies_of(self._raw, [], 0, 0, []).classes

    def bodies(
        self, t_us: npt.ArrayLike = (), *, cameras: Sequence[str] | None = None, environment: int = 0
    ) -> Bodies:
        """Return where objects and cameras are and how they move, exactly, at any times.

        Parameters
        ----------
        t_us : array_like of int, shape (T,)
            Scene times in microseconds.
        cameras : sequence of str, optional
            Names of cameras; all of the scene's where not given.
        environment : int
            Which environment.

        Returns
        -------
        Bodies
            Velocities are central differences over 1 ms of exact poses: at a jump, the mean over it.

        Raises
        ------
        ConfigError
            If a time is no whole number, or a camera or the environment does not exist.
        """
        times = [_check.time_us("t_us", time) for time in _check.items("t_us", t_us, "[0, 10_000]")]
        names = list(self.cameras) if cameras is None else _check.names("cameras", cameras)
        for name in names:
            if name not in self.cameras:
                hint = _check.did_you_mean(name, self.cameras)
                raise ConfigError(f"no camera named '{name}'; there is {', '.join(self.cameras)}{hint}")
        return bodies_of(self._raw, names, _check.whole("environment", environment), 0, times)

    @property
    def environments(self) -> int:
        """Environments of a batch: variants of the scene, at least 1."""
        return self._raw.environments

    @property
    def duration(self) -> float | None:
        """Seconds that the scene's motion lasts; None where it has no end."""
        return self._raw.duration_s

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the loader had to say, once each."""
        return tuple(self._raw.warnings)

    def __repr__(self) -> str:
        """Say what it holds."""
        cameras = _evis.printable(", ".join(self.cameras) or "none")
        return f"Scene({self.name!r}, {len(self.nodes)} nodes, cameras {cameras})"


def _builtin(name: str, seed: int) -> Scene:
    return Scene.builtin(name, seed=seed)


def _loaded(path: Path, animation: str | None) -> Scene:
    return Scene.load(path, animation=animation)


def moved_scene(
    scene: Scene,
    motion: str | None,
    speed: float | None,
    camera: str | None,
    size: tuple[int, int] | None,
) -> Scene:
    """Return `scene` with its cameras moved: how it is pickled."""
    return scene.with_camera_motion(motion, speed=speed, camera=camera, size=size)


def motion_text(motion: str | PathLike[str] | None) -> str | None:
    """Return a camera motion's word, or its file, which is told from a word by its folder."""
    if isinstance(motion, PathLike):
        return abspath(fspath(motion))
    return None if motion is None else str(motion)


def raw_of(scene: Any) -> _evis.Scene:
    """Return the engine's scene."""
    if not isinstance(scene, Scene):
        raise ConfigError(
            f"scene is {_check.shown(scene)}; it must be an evis.Scene, such as "
            "evis.Scene.builtin('spinner') or evis.Scene.load(path)"
        )
    return scene._raw


def scenes() -> dict[str, str]:
    """Names of the built-in scenes, and what each shows."""
    return dict(_evis.builtin_scenes())
