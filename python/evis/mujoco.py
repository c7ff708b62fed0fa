"""Event cameras for MuJoCo: an ``mjModel`` as a scene, and a renderer of events beside ``mujoco.Renderer``.

Needs the package ``mujoco`` (``pip install "evis[mujoco]"``), 3.1 or later; no OpenGL. World and cameras are
MuJoCo's: metres, +Z up, cameras look along their -Z with +Y up. ``docs/mujoco.md`` has the table of what
becomes of materials and lights.
"""

from __future__ import annotations

import difflib
import math
import tempfile
import warnings
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

try:
    import mujoco
except ImportError as error:
    raise ImportError("evis.mujoco needs MuJoCo; install it: pip install 'evis[mujoco]'") from error

from . import _check, _shapes
from ._builder import SceneBuilder
from ._events import EventArray, EventCD
from ._evis import ConfigError, srgb_table
from ._glb import Glb
from ._packets import CameraInfo, Packet
from ._scene import EventCamera, Scene
from ._sensor import Sensor
from ._shapes import Triangles
from ._simulator import Simulator
from .motion import Placement

__all__ = ["EventRenderer", "scene"]

Array: TypeAlias = npt.NDArray[np.float64]
CameraChoice: TypeAlias = Any
"""Name or index of a camera of the model, -1 for a free camera, or an ``mujoco.MjvCamera``."""

#: How far, in pixels, a pose between two knots may be from where the integrator has it.
_TOLERANCE_PX = 0.05
#: A step is halved so often at most.
_MOST_HALVINGS = 6
#: How far a step's end may be from what its velocity says (radians, metres): else it is no plain step.
_SAME_STATE = 1e-7
#: The longest portion of events that renderers choose by themselves, in microseconds.
_LONGEST_STEP_US = 20_000
#: Largest alpha of what is left out; MuJoCo blends, the engine draws all or nothing.
_TRANSPARENT = 0.5
#: Cells along an edge of a plane without end.
_PLANE_CELLS = 8
#: Rows of the panorama that a sky box becomes.
_SKY_ROWS = 256

_OBJECT = mujoco.mjtObj
_GEOM = mujoco.mjtGeom


def _check_vectors() -> None:
    """Refuse bindings for NumPy 1 beside NumPy 2: they read every vector as its first number."""
    probe = mujoco.MjvCamera()
    probe.lookat[:] = (1.0, 2.0, 3.0)
    if list(probe.lookat) != [1.0, 2.0, 3.0]:
        raise ImportError(
            f"MuJoCo {mujoco.__version__} reads vectors wrongly beside NumPy {np.__version__}: install "
            "mujoco>=3.2, or numpy<2"
        )


_check_vectors()


def scene(
    model: Any,
    data: Any = None,
    *,
    geom_groups: Iterable[int] = (0, 1, 2),
    site_groups: Iterable[int] = (0, 1, 2),
    tendon_groups: Iterable[int] = (0, 1, 2),
    skybox: bool = False,
    size: tuple[int, int] | None = None,
) -> Scene:
    """Read an ``mjModel`` as a scene.

    Bodies become the nodes ``body/NAME`` (``body/INDEX`` without a name), cameras keep their names, lights
    become ``light/NAME``: `evis.Simulator` takes them as ``poses=[...]``. Everything stands where `data` has
    it. A model without cameras gets one, ``free``, where MuJoCo's own free camera begins.

    What is not drawn, such as flexes and skins, is named by one warning. Later changes of the model are not
    seen.

    Parameters
    ----------
    model : mujoco.MjModel
        What to read.
    data : mujoco.MjData, optional
        The state; that of ``qpos0`` where not given. It is not changed.
    geom_groups, site_groups, tendon_groups : iterable of int
        Groups of geoms, sites and tendons that are drawn, 0 to 5; as MuJoCo, 0 to 2 where not given.
    skybox : bool
        Whether the model's sky box is seen behind everything; it then lights the scene too, which it does not
        in MuJoCo. Without it the background has the mean colour of the sky box.
    size : (int, int), optional
        Width and height of every camera in pixels; its ``resolution``, or 640x480, where not given.

    Returns
    -------
    Scene
        In MuJoCo's world: metres, +Z up.

    Raises
    ------
    ConfigError
        If it is no model, holds values that are not finite, or shows nothing.
    """
    reading = _ModelReader(model, data, geom_groups, site_groups, tendon_groups, size)
    cameras = [i for i in range(model.ncam) if not _is_orthographic(model, i)] or [-1]
    return reading.build(cameras, skybox)


class EventRenderer:
    """An event camera in a MuJoCo simulation, used as ``mujoco.Renderer`` is.

    Parameters
    ----------
    model : mujoco.MjModel
        What to render; read once.
    height, width : int
        Size of the picture in pixels.
    camera : str, int, mujoco.MjvCamera or sequence of these
        Cameras: a name or an index of the model's, -1 for MuJoCo's free camera, or a free or tracking
        ``MjvCamera``, which may move with each `update_scene`.
    sensor : Sensor, str or mapping by camera, optional
        As `evis.Simulator` takes it.
    quality : str, optional
        As `evis.Simulator` takes it.
    environments : int
        How many ``mjData`` of the model are rendered side by side; `observe` then takes as many.
    geom_groups, site_groups, tendon_groups : iterable of int
        Groups that are drawn.
    skybox : bool
        Whether the sky box is seen, and lights: see `scene`.
    pose_step_us : int, optional
        Events come in portions of so many microseconds, a multiple of the time between two samples; in longer
        portions tiles that rest are sampled less often. Where not given, the shortest that ends with physics
        steps and samples, if that is at most 20 ms; else one millisecond, or the time between two samples.
    **settings
        Whatever else `evis.Simulator` takes: ``rate_hz``, ``labels``, ``seed``, ``device``, …

    Raises
    ------
    ConfigError
        If a camera does not exist (names the nearest), or a value cannot be used.

    Examples
    --------
    >>> import mujoco  # doctest: +SKIP
    >>> import evis.mujoco  # doctest: +SKIP
    >>> with evis.mujoco.EventRenderer(model, height=260, width=346) as renderer:  # doctest: +SKIP
    ...     while data.time < 1.0:
    ...         mujoco.mj_step(model, data)
    ...         renderer.observe(data)
    ...         events = renderer.render()
    """

    def __init__(
        self,
        model: Any,
        height: int = 240,
        width: int = 320,
        *,
        camera: CameraChoice | Sequence[CameraChoice] = -1,
        sensor: Sensor | str | Mapping[str, Sensor | str] | None = None,
        quality: Any = None,
        environments: int = 1,
        geom_groups: Iterable[int] = (0, 1, 2),
        site_groups: Iterable[int] = (0, 1, 2),
        tendon_groups: Iterable[int] = (0, 1, 2),
        skybox: bool = False,
        pose_step_us: int | None = None,
        **settings: Any,
    ) -> None:
        size = _check.size((width, height))
        reading = _ModelReader(model, None, geom_groups, site_groups, tendon_groups, size)
        chosen = list(camera) if isinstance(camera, (list, tuple)) else [camera]
        if not chosen:
            raise ConfigError("camera is empty; give a name, an index, or -1 for the free camera")
        self._model = model
        self._count = _check.whole("environments", environments, 1, 65536)
        self._reading = reading
        self._views = [reading.view(choice) for choice in chosen]
        if len(set(self._views)) < len(self._views):
            raise ConfigError(f"camera names one twice: {chosen!r}; each may be there once")
        self._free = next((c for c in chosen if isinstance(c, mujoco.MjvCamera)), None)
        made = reading.build(self._views, skybox, self._count, self._free)
        self._names = [reading.camera_name(view) for view in self._views]
        self._frames = reading.frames(self._views)
        step = _step_us(model, settings.get("rate_hz")) if pose_step_us is None else pose_step_us
        driven = [frame.name for frame in self._frames]
        self._arguments: dict[str, Any] = {
            **settings,
            "sensor": sensor,
            "quality": quality,
            "cameras": self._names,
            "poses": driven,
            "pose_step_us": step if driven else None,
        }
        self._scene = made
        self._step_us = _check.whole("pose_step_us", step, 1)
        self._data = [mujoco.MjData(model) for _ in range(self._count)]
        self._shown = 0
        self._closed = False
        self._simulator = Simulator(made, **self._arguments)
        self._begin()

    def _begin(self) -> None:
        self._start_s = math.nan
        self._knots: deque[_Knot] = deque()
        self._last: list[_State] = []
        self._moved: Array | None = None
        self._packet: Packet | None = None

    @property
    def model(self) -> Any:
        """The model."""
        return self._model

    @property
    def height(self) -> int:
        """Height of the picture in pixels."""
        return self._simulator.cameras[0].height

    @property
    def width(self) -> int:
        """Width of the picture in pixels."""
        return self._simulator.cameras[0].width

    @property
    def simulator(self) -> Simulator:
        """The simulator that renders."""
        return self._simulator

    @property
    def scene(self) -> Scene:
        """The model as a scene."""
        return self._scene

    @property
    def cameras(self) -> tuple[CameraInfo, ...]:
        """The rendered cameras with their intrinsics."""
        return self._simulator.cameras

    @property
    def instances(self) -> npt.NDArray[np.int32]:
        """Object and type of each number in ``labels["instance"]``, int32 (N, 2).

        ``renderer.instances[instance]`` is what MuJoCo's segmentation shows: an index and an
        ``mujoco.mjtObj``, -1 and -1 where nothing is.
        """
        return np.array([(-1, -1), *self._reading.objects], np.int32)

    @property
    def packet(self) -> Packet | None:
        """Everything that the last `render` made: all cameras and environments, labels and poses.

        Its times count from the first observation. None before anything was rendered.
        """
        return self._packet

    def observe(self, data: Any, *, camera: Any = None) -> None:
        """Take in a state: time, qpos, qvel and mocap poses are copied.

        Call it after each ``mj_step``: between two states bodies move as the integrator moved them.

        Parameters
        ----------
        data : mujoco.MjData or sequence of these
            One per environment, all at the same time.
        camera : mujoco.MjvCamera, optional
            Where the free camera is now.

        Raises
        ------
        ConfigError
            If it is of another model, holds a value that is not finite, or its time lies before that of an
            earlier one (`reset` begins again). Then nothing has changed.
        """
        self._open()
        states = [self._state(item) for item in self._each(data)]
        times = {state.time for state in states}
        if len(times) > 1:
            raise ConfigError(f"data have the times {sorted(times)} s; environments must go in step")
        if self._free is not None and camera is None:
            camera = self._free
        if camera is not None and not isinstance(camera, mujoco.MjvCamera):
            raise ConfigError(f"camera is {_check.shown(camera)}; observe takes an mujoco.MjvCamera")
        start_s = states[0].time if not self._last else self._start_s
        t_us = round((states[0].time - start_s) * 1e6)
        if self._last:
            self._follow(states, t_us, camera)
            return
        poses = self._poses(states, camera)
        self._start_s = start_s
        self._knots.append(_Knot(t_us, poses, None))
        self._last = states

    def update_scene(self, data: Any, camera: CameraChoice = None) -> None:
        """Take in a state, as `observe`; `camera` is the one that `render` shows from now on.

        Parameters
        ----------
        data : mujoco.MjData or sequence of these
            One per environment.
        camera : str, int or mujoco.MjvCamera, optional
            One of the cameras of this renderer; an ``MjvCamera`` also says where the free camera is now.

        Raises
        ------
        ConfigError
            As `observe`; and if this renderer has no such camera.
        """
        self._open()
        moved = camera if isinstance(camera, mujoco.MjvCamera) else None
        shown = self._shown
        if camera is not None:
            view = -1 if moved is not None and self._free is not None else self._reading.view(camera)
            if view not in self._views:
                have = ", ".join(repr(name) for name in self._names)
                raise ConfigError(
                    f"camera is {_check.shown(camera)}, which this renderer does not have; it has {have}: "
                    "name it when the renderer is made, camera=[...]"
                )
            shown = self._views.index(view)
        self.observe(data, camera=moved)
        self._shown = shown

    def render(self) -> Any:
        """Return the events since the last `render`; none the first time.

        They reach to the last whole portion (`pose_step_us`) of what was observed; what follows comes with
        the next call.

        Returns
        -------
        EventArray or list of EventArray
            Events of the camera that is shown, as `evis.Packet.events`: t in microseconds since the first
            observation. With several environments a list of one for each.

        Raises
        ------
        DeviceError
            If the device failed.
        """
        self._open()
        now_us = self._simulator.now_us
        until_us = 0 if not self._knots else self._knots[-1].t_us // self._step_us * self._step_us
        if until_us <= now_us:
            camera = self._simulator.cameras[self._shown]
            none = EventArray(np.zeros(0, EventCD), width=camera.width, height=camera.height)
            return none if self._count == 1 else [none] * self._count
        times, poses = self._until(until_us, now_us)
        given = {frame.name: poses[:, :, i] for i, frame in enumerate(self._frames)}
        if given:
            packet = self._simulator.step(until_us, given, pose_times_us=times)
        else:
            packet = self._simulator.step(until_us)
        while len(self._knots) > 1 and self._knots[1].t_us <= until_us:
            self._knots.popleft()
        self._packet = packet
        name = self._names[self._shown]
        events = [environment[name].events for environment in packet]
        return events[0] if self._count == 1 else events

    def reset(self) -> None:
        """Forget everything, the pixels' memory included; the next observation begins a new stream."""
        self._open()
        self._simulator = Simulator(self._scene, **self._arguments)
        self._begin()

    def close(self) -> None:
        """Let go of the device; a closed renderer takes nothing more. Closing twice does nothing."""
        if not self._closed:
            self._closed = True
            del self._simulator
            self._begin()

    def __enter__(self) -> EventRenderer:
        """Return the renderer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def _open(self) -> None:
        if self._closed:
            raise ConfigError("this EventRenderer is closed; make a new one")

    def _each(self, data: Any) -> list[Any]:
        items = list(data) if isinstance(data, (list, tuple)) else [data]
        if len(items) != self._count:
            raise ConfigError(
                f"data holds {len(items)} states; this renderer has {self._count} environment(s), "
                "environments=... of the renderer"
            )
        return items

    def _state(self, data: Any) -> _State:
        if not isinstance(data, mujoco.MjData):
            raise ConfigError(f"data is {_check.shown(data)}; it must be an mujoco.MjData")
        model = self._model
        state = _State(
            float(data.time),
            np.array(data.qpos),
            np.array(data.qvel),
            np.array(data.mocap_pos),
            np.array(data.mocap_quat),
        )
        have = (state.qpos.size, state.qvel.size, state.mocap_pos.shape[0])
        want = (model.nq, model.nv, model.nmocap)
        if have != want:
            raise ConfigError(f"data has nq, nv, nmocap {have}, the model {want}; it is of another model")
        values = (np.array([state.time]), state.qpos, state.qvel, state.mocap_pos, state.mocap_quat)
        if not all(np.isfinite(value).all() for value in values):
            raise ConfigError(
                f"data holds values that are not finite at {state.time} s: the simulation has diverged; "
                "give a good state, or reset() after mj_resetData"
            )
        return state

    def _follow(self, states: list[_State], t_us: int, camera: Any) -> None:
        """Append the knots from the last state to these."""
        last = self._knots[-1]
        if t_us < last.t_us:
            raise ConfigError(
                f"data has the time {states[0].time} s, before the {self._last[0].time} s of the last one; "
                "time cannot go back: reset() begins a new stream"
            )
        poses = self._poses(states, camera)
        if t_us == last.t_us:
            if np.array_equal(poses, last.poses):
                return
            if len(self._knots) > 1 or (self._packet is not None and t_us <= self._simulator.now_us):
                raise ConfigError(
                    f"data has another state at {states[0].time} s than before; time must go on, or reset() "
                    "begins a new stream"
                )
            # Nothing has been rendered: it begins here.
            self._knots[-1] = _Knot(t_us, poses, None)
            self._last = states
            return
        path = self._path(states, last.t_us, t_us)
        knots = [_Knot(t_us, poses, path)]
        moved = _difference(last.poses, poses)
        if path is not None:
            previous = self._moved
            bend = math.inf if previous is None else float(np.abs(moved - previous).max(initial=0.0))
            if bend > 0.0:
                reach = self._reach(poses)
                if previous is None or self._pixels(moved - previous, reach) / 8 > _TOLERANCE_PX:
                    knots = [*self._between(last, knots[0], path, reach, _MOST_HALVINGS), *knots]
        self._knots.extend(knots)
        self._moved = moved
        self._last = states

    def _path(self, states: list[_State], from_us: int, to_us: int) -> _Path | None:
        """How the integrator went from the last states to these; None where that is not known."""
        model = self._model
        seconds = states[0].time - self._last[0].time
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            return None
        for old, new in zip(self._last, states, strict=True):
            end = old.qpos.copy()
            mujoco.mj_integratePos(model, end, new.qvel, seconds)
            if np.abs(end - new.qpos).max(initial=0.0) > _SAME_STATE:
                return None
        return _Path(from_us, to_us, seconds, self._last, states)

    def _at(self, path: _Path, t_us: int) -> Array:
        """Poses on the way, as the integrator has them."""
        share = (t_us - path.from_us) / (path.to_us - path.from_us)
        states = []
        for old, new in zip(path.old, path.new, strict=True):
            qpos = old.qpos.copy()
            mujoco.mj_integratePos(self._model, qpos, new.qvel, share * path.seconds)
            mocap = _interpolated(
                np.concatenate([old.mocap_pos, old.mocap_quat], axis=1),
                np.concatenate([new.mocap_pos, new.mocap_quat], axis=1),
                share,
            )
            states.append(_State(new.time, qpos, new.qvel, mocap[:, :3], mocap[:, 3:]))
        return self._poses(states, None)

    def _between(self, first: _Knot, last: _Knot, path: _Path, reach: Array, halvings: int) -> list[_Knot]:
        """Knots between two, so many that what lies between runs as even motion has it, to 0.05 px."""
        middle_us = (first.t_us + last.t_us) // 2
        if middle_us <= first.t_us or halvings == 0:
            return []
        poses = self._at(path, middle_us)
        share = (middle_us - first.t_us) / (last.t_us - first.t_us)
        off = _difference(_interpolated(first.poses, last.poses, share), poses)
        if self._pixels(off, reach) <= _TOLERANCE_PX:
            return []
        # A free camera moves by the caller's hand, evenly.
        poses[:, self._free_cameras] = _interpolated(first.poses, last.poses, share)[:, self._free_cameras]
        knot = _Knot(middle_us, poses, path)
        return [
            *self._between(first, knot, path, reach, halvings - 1),
            knot,
            *self._between(knot, last, path, reach, halvings - 1),
        ]

    @property
    def _free_cameras(self) -> list[int]:
        return [i for i, frame in enumerate(self._frames) if frame.kind == _FREE]

    def _until(self, until_us: int, now_us: int) -> tuple[list[int], Array]:
        """Return times and poses, (E, T, N, 7), from now to the end of a step."""
        knots = list(self._knots)
        times, poses = [], []
        for older, knot in zip([None, *knots[:-1]], knots, strict=True):
            t_us, here = knot.t_us, knot.poses
            if t_us > until_us:
                if older is None or older.t_us >= until_us:
                    break
                t_us = until_us
                share = (until_us - older.t_us) / (knot.t_us - older.t_us)
                here = _interpolated(older.poses, knot.poses, share)
                if knot.path is not None:
                    exact = self._at(knot.path, until_us)
                    exact[:, self._free_cameras] = here[:, self._free_cameras]
                    here = exact
            if t_us > now_us or (t_us == 0 and self._packet is None):
                times.append(t_us)
                poses.append(here)
        return times, np.stack(poses, axis=1)

    def _poses(self, states: list[_State], camera: Any) -> Array:
        """World-from-node of every frame, (E, N, 7)."""
        poses = np.empty((self._count, len(self._frames), 7))
        for own, data, state in zip(poses, self._data, states, strict=True):
            data.time = state.time
            data.qpos[:], data.qvel[:] = state.qpos, state.qvel
            data.mocap_pos[:], data.mocap_quat[:] = state.mocap_pos, state.mocap_quat
            _place(self._model, data)
            for i, frame in enumerate(self._frames):
                own[i] = frame.pose(self._model, data, camera)
        return poses

    def _reach(self, poses: Array) -> Array:
        """Pixels per metre and per radian that an error of each frame makes, (2, N), bounds from above."""
        focal = max(max(info.fx, info.fy) for info in self._simulator.cameras)
        near = self._model.vis.map.znear * self._model.stat.extent
        reach = np.zeros((2, len(self._frames)))
        for data, own in zip(self._data, poses, strict=True):
            eyes = self._reading.eyes(self._views, data, own, self._frames)
            for eye, carrier in eyes:
                nearest = max(self._reading.nearest(data, eye, carrier), near)
                for i, frame in enumerate(self._frames):
                    if (frame.kind == _BODY and frame.index != carrier) or frame.kind == _TENDON:
                        depth = max(float(np.linalg.norm(own[i, :3] - eye)) - frame.radius, near)
                        found = focal / depth, focal * frame.radius / depth
                    elif frame.kind == _LIGHT:
                        continue
                    else:
                        lever = float(np.linalg.norm(own[i, :3] - eye))
                        carries = frame.kind == _BODY or lever < 1e-9
                        found = (focal / nearest, focal * (1 + lever / nearest)) if carries else (0.0, 0.0)
                    reach[:, i] = np.maximum(reach[:, i], found)
        return reach

    @staticmethod
    def _pixels(off: Array, reach: Array) -> float:
        """How far, in pixels, differences of poses (E, N, 6) can be seen, at most."""
        metres = np.linalg.norm(off[..., :3], axis=-1)
        radians = np.linalg.norm(off[..., 3:], axis=-1)
        return float((reach[0] * metres + reach[1] * radians).max(initial=0.0))


@dataclass(frozen=True)
class _State:
    """What was observed of an ``mjData``."""

    time: float
    qpos: Array
    qvel: Array
    mocap_pos: Array
    mocap_quat: Array


@dataclass(frozen=True)
class _Path:
    """A step of an integrator that moves positions by the velocities at its end: per environment."""

    from_us: int
    to_us: int
    seconds: float
    old: list[_State]
    new: list[_State]


@dataclass(frozen=True)
class _Knot:
    """Poses (E, N, 7) at a time, and how the integrator came to them from the knot before."""

    t_us: int
    poses: Array
    path: _Path | None


_BODY, _CAMERA, _LIGHT, _FREE, _TENDON = range(5)


@dataclass(frozen=True)
class _Frame:
    """A node that the simulation moves."""

    name: str
    kind: int
    index: int
    #: Metres from its origin to the farthest that it carries.
    radius: float = 0.0
    #: Of a tendon: which of its parts, -1 - k for part k within what it wraps around; and which end.
    part: int = 0
    end: int = 0

    def pose(self, model: Any, data: Any, camera: Any) -> Array:
        """Position and quaternion (x, y, z, w) in the world."""
        if self.kind == _TENDON:
            ends = _tendon_part(data, self.index, self.part)
            way = ends[1] - ends[0]
            length = float(np.linalg.norm(way))
            return _seven(ends[self.end], _towards(-way if length > 1e-12 else np.array([0.0, 0.0, -1.0])))
        if self.kind == _BODY:
            return _seven(data.xpos[self.index], data.xquat[self.index])
        if self.kind == _CAMERA:
            return _seven(data.cam_xpos[self.index], _quaternion(data.cam_xmat[self.index]))
        if self.kind == _LIGHT:
            return _seven(data.light_xpos[self.index], _towards(data.light_xdir[self.index]))
        return _free_pose(model, data, camera)


def _seven(position: npt.ArrayLike, wxyz: npt.ArrayLike) -> Array:
    """MuJoCo's position and quaternion (w, x, y, z) as x, y, z, qx, qy, qz, qw."""
    w, x, y, z = np.asarray(wxyz, np.float64)
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return np.array([*np.asarray(position, np.float64), x / length, y / length, z / length, w / length])


def _quaternion(matrix: npt.ArrayLike) -> Array:
    """Quaternion (w, x, y, z) of a rotation matrix, row by row."""
    found = np.empty(4)
    mujoco.mju_mat2Quat(found, np.asarray(matrix, np.float64).ravel())
    return found


def _towards(direction: npt.ArrayLike) -> Array:
    """Quaternion (w, x, y, z) that turns -Z to a direction by the shortest way."""
    x, y, z = np.asarray(direction, np.float64) / max(float(np.linalg.norm(direction)), 1e-300)
    if z > 1 - 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    found = np.array([1 - z, y, -x, 0.0])
    return np.asarray(found / np.linalg.norm(found))


def _free_pose(model: Any, data: Any, camera: Any) -> Array:
    """Where an ``MjvCamera`` is: MuJoCo's default free one where None (as ``mjv_cameraFrame``)."""
    if camera is None:
        camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, camera)
    target = camera.lookat
    if camera.type == mujoco.mjtCamera.mjCAMERA_TRACKING:
        target = data.subtree_com[camera.trackbodyid]
    azimuth, elevation = math.radians(camera.azimuth), math.radians(camera.elevation)
    level = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    forward = math.cos(elevation) * level + [0, 0, math.sin(elevation)]
    up = -math.sin(elevation) * level + [0, 0, math.cos(elevation)]
    turn = np.stack([np.cross(forward, up), up, -forward], axis=1)
    return _seven(np.asarray(target) - camera.distance * forward, _quaternion(turn))


def _place(model: Any, data: Any) -> None:
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    if model.nwrap:
        mujoco.mj_tendon(model, data)


def _tendon_part(data: Any, tendon: int, part: int) -> Array:
    """Both ends of a part of a tendon, (2, 3), as MuJoCo draws it; of one that is not there its last point.

    Parts are counted along the way: those outside of what it wraps around, and apart from these those within.
    """
    start, count = int(data.ten_wrapadr[tendon]), int(data.ten_wrapnum[tendon])
    points = np.asarray(data.wrap_xpos).reshape(-1, 3)[start : start + count]
    objects = np.asarray(data.wrap_obj).ravel()[start : start + count]
    within = part < 0
    left = -1 - part if within else part
    for k in range(count - 1):
        # A pulley cuts the way.
        if -2 in objects[k : k + 2] or bool((objects[k : k + 2] >= 0).all()) != within:
            continue
        if left == 0:
            return np.array(points[k : k + 2])
        left -= 1
    real = np.flatnonzero(objects != -2)
    last = points[real[-1]] if real.size else np.zeros(3)
    return np.array([last, last])


def _multiplied(a: Array, b: Array) -> Array:
    """Product of quaternions (x, y, z, w)."""
    av, aw, bv, bw = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    vector = aw * bv + bw * av + np.cross(av, bv)
    return np.concatenate([vector, aw * bw - (av * bv).sum(axis=-1, keepdims=True)], axis=-1)


def _turn(first: Array, last: Array) -> Array:
    """Rotation vector in the world from one quaternion (x, y, z, w) to another, by the short way."""
    between = _multiplied(last, first * [-1, -1, -1, 1])
    between = between * np.where(between[..., 3:] < 0, -1.0, 1.0)
    sine = np.linalg.norm(between[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, between[..., 3:])
    return between[..., :3] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0)


def _difference(first: Array, last: Array) -> Array:
    """Metres and rotation vector from one pose to another, (…, 6)."""
    return np.concatenate([last[..., :3] - first[..., :3], _turn(first[..., 3:], last[..., 3:])], axis=-1)


def _interpolated(first: Array, last: Array, share: float) -> Array:
    """Pose between two: straight on, and an even turn."""
    way = share * _turn(first[..., 3:], last[..., 3:])
    angle = np.linalg.norm(way, axis=-1, keepdims=True)
    half = np.where(angle > 1e-12, np.sin(angle / 2) / np.maximum(angle, 1e-300), 0.5)
    turn = np.concatenate([half * way, np.cos(angle / 2)], axis=-1)
    position = first[..., :3] + share * (last[..., :3] - first[..., :3])
    return np.concatenate([position, _multiplied(turn, first[..., 3:])], axis=-1)


def _step_us(model: Any, rate_hz: Any) -> int:
    """Longest step that ends with physics steps; else one that every preset can have."""
    apart = 1000 if rate_hz is None else max(round(1e6 / _check.number("rate_hz", rate_hz)), 1)
    step_us = model.opt.timestep * 1e6
    if abs(step_us - round(step_us)) < 1e-6 and round(step_us) > 0:
        both = math.lcm(round(step_us), apart)
        if both <= _LONGEST_STEP_US:
            return both
    return apart


def _is_orthographic(model: Any, camera: int) -> bool:
    if camera < 0:
        return bool(getattr(model.vis.global_, "orthographic", 0))
    if hasattr(model, "cam_projection"):
        return bool(model.cam_projection[camera])
    return bool(model.cam_orthographic[camera]) if hasattr(model, "cam_orthographic") else False


class _ModelReader:
    """A model as a scene is made of it."""

    def __init__(
        self,
        model: Any,
        data: Any,
        geom_groups: Iterable[int],
        site_groups: Iterable[int],
        tendon_groups: Iterable[int],
        size: tuple[int, int] | None,
    ) -> None:
        if not isinstance(model, mujoco.MjModel):
            raise ConfigError(f"model is {_check.shown(model)}; it must be an mujoco.MjModel")
        self.model = model
        self.data = mujoco.MjData(model)
        if data is not None:
            if not isinstance(data, mujoco.MjData):
                raise ConfigError(f"data is {_check.shown(data)}; it must be an mujoco.MjData")
            if (data.qpos.size, data.mocap_pos.shape) != (model.nq, (model.nmocap, 3)):
                raise ConfigError("data is of another model")
            self.data.qpos[:] = data.qpos
            self.data.mocap_pos[:], self.data.mocap_quat[:] = data.mocap_pos, data.mocap_quat
        if not (np.isfinite(self.data.qpos).all() and np.isfinite(self.data.mocap_pos).all()):
            raise ConfigError("data holds values that are not finite; give a good state")
        _place(model, self.data)
        self.size = None if size is None else _check.size(size)
        self.drawn = [
            *_in_groups("geom", model.geom_group, geom_groups),
            *_in_groups("site", model.site_group, site_groups),
        ]
        chosen = {_check.whole("tendon_groups", group, 0, 5) for group in tendon_groups}
        #: Tendon, number of the part (see `_tendon_part`), and its radius.
        self.tendon_parts = list(self._parts_of_tendons(chosen))
        self.moving = _moving(model)
        self.left_out: dict[str, list[str]] = {}
        #: Of each instance: index and mjtObj, from instance 1 on.
        self.objects: list[tuple[int, int]] = []
        self._textures: dict[tuple[int, int], int] = {}
        self._materials: dict[Any, int] = {}
        self._glb = Glb()

    # Cameras

    def view(self, choice: CameraChoice) -> int:
        """Index of a camera, -1 for the free one."""
        model = self.model
        if isinstance(choice, mujoco.MjvCamera):
            if choice.type == mujoco.mjtCamera.mjCAMERA_FIXED:
                choice = int(choice.fixedcamid)
            elif choice.type == mujoco.mjtCamera.mjCAMERA_TRACKING:
                _check.whole("camera.trackbodyid", int(choice.trackbodyid), 0, model.nbody - 1)
                return -1
            elif choice.type == mujoco.mjtCamera.mjCAMERA_FREE:
                return -1
            else:
                raise ConfigError("camera is an MjvCamera of type USER; it must be FREE, TRACKING or FIXED")
        if isinstance(choice, str):
            names = [_name(model, _OBJECT.mjOBJ_CAMERA, i) for i in range(model.ncam)]
            found = names.index(choice) if choice in names else None
            if found is None and choice == self.camera_name(-1):
                found = -1
            if found is None:
                raise ConfigError(f"camera is {choice!r}; {_known(choice, names)}, or -1 for the free camera")
        else:
            try:
                found = int(choice)
            except (TypeError, ValueError):
                raise ConfigError(
                    f"camera is {_check.shown(choice)}; it must be a name, an index or an mujoco.MjvCamera"
                ) from None
            if not -1 <= found < model.ncam:
                have = f"cameras 0 to {model.ncam - 1}" if model.ncam else "no camera"
                raise ConfigError(f"camera is {found}; the model has {have}, and -1 is the free camera")
        if _is_orthographic(model, found):
            raise ConfigError(
                f"camera '{self.camera_name(found)}' is orthographic; only perspective ones work"
            )
        return found

    def camera_name(self, view: int) -> str:
        """Name in the scene."""
        if view >= 0:
            return _name(self.model, _OBJECT.mjOBJ_CAMERA, view)
        taken = {_name(self.model, _OBJECT.mjOBJ_CAMERA, i) for i in range(self.model.ncam)}
        name = "free"
        while name in taken:
            name += "_"
        return name

    def frames(self, views: list[int]) -> list[_Frame]:
        """Nodes that the simulation moves, as far as they are seen or see."""
        model = self.model
        radius: dict[int, float] = {}
        for kind, index in self._shown():
            body = int(getattr(model, f"{kind}_bodyid")[index])
            position = np.linalg.norm(getattr(model, f"{kind}_pos")[index])
            own = float(model.geom_rbound[index] if kind == "geom" else 2 * model.site_size[index].max())
            radius[body] = max(radius.get(body, 0.0), float(position) + own)
        carried = [int(model.cam_bodyid[view]) for view in views if view >= 0 and self._is_fixed("cam", view)]
        carried += [int(model.light_bodyid[i]) for i in self._lights() if self._is_fixed("light", i)]
        frames = [
            _Frame(_body(model, body), _BODY, body, radius.get(body, 0.0))
            for body in range(model.nbody)
            if self.moving[body] and (body in radius or body in carried)
        ]
        for view in views:
            if view < 0:
                frames.append(_Frame(self.camera_name(view), _FREE, -1))
            elif not self._is_fixed("cam", view):
                frames.append(_Frame(self.camera_name(view), _CAMERA, view))
        frames += [
            _Frame(f"{self._part_name(tendon, part)}/{end}", _TENDON, tendon, width, part, end)
            for tendon, part, width in self.tendon_parts
            for end in range(2)
        ]
        lights = [index for index in self._lights() if not self._is_fixed("light", index)]
        return frames + [_Frame(_light_name(model, index), _LIGHT, index) for index in lights]

    def _is_fixed(self, kind: str, index: int) -> bool:
        mode = getattr(self.model, f"{kind}_mode")[index]
        return bool(mode == mujoco.mjtCamLight.mjCAMLIGHT_FIXED)

    def eyes(
        self, views: list[int], data: Any, poses: Array, frames: list[_Frame]
    ) -> list[tuple[Array, int | None]]:
        """Where cameras are, and the moving body that carries each."""
        found: list[tuple[Array, int | None]] = []
        for view in views:
            if view < 0:
                at = next(i for i, frame in enumerate(frames) if frame.kind == _FREE)
                found.append((poses[at, :3], None))
            else:
                body = int(self.model.cam_bodyid[view])
                carried = self._is_fixed("cam", view) and self.moving[body]
                found.append((np.array(data.cam_xpos[view]), body if carried else None))
        return found

    def nearest(self, data: Any, eye: Array, carrier: int | None) -> float:
        """Metres to the nearest that a camera may see, from below."""
        model = self.model
        geoms = np.array([i for kind, i in self._shown() if kind == "geom"], np.int64)
        if carrier is not None:
            geoms = geoms[model.geom_bodyid[geoms] != carrier]
        off = eye - data.geom_xpos[geoms]
        planes = model.geom_type[geoms] == int(_GEOM.mjGEOM_PLANE)
        away = np.linalg.norm(off, axis=1) - model.geom_rbound[geoms]
        above = np.abs((off * data.geom_xmat[geoms].reshape(-1, 3, 3)[:, :, 2]).sum(axis=1))
        return float(np.where(planes, above, away).min(initial=math.inf))

    # The scene

    def build(self, views: list[int], skybox: bool, environments: int = 1, free: Any = None) -> Scene:
        """Make the scene, with these cameras."""
        model = self.model
        self._meshes()
        self._omit_unsupported()
        ambient = np.zeros(3)
        lights = self._lights()
        head = model.vis.headlight
        if head.active:
            ambient += head.ambient
        for index in lights:
            ambient += model.light_ambient[index]
        sky = self._sky()
        background = None if sky is None or skybox else tuple(_mean(sky))
        builder = SceneBuilder("mujoco", ambient=tuple(_linear(ambient)), background=background)
        builder.gltf("mujoco/model", "model.glb")
        for view in views:
            builder.camera(self._camera(view, free))
        for index in lights:
            self._light(builder, index)
        if head.active and max(head.diffuse) > 0:
            color = _linear(np.asarray(head.diffuse, np.float64))
            builder.light(
                "light/headlight/",
                kind="directional",
                intensity=math.pi * float(color.max()),
                color=tuple(color / color.max()),
                pose=Placement(parent=self.camera_name(views[0])),
            )
        panorama = None
        if skybox and sky is not None:
            panorama = _radiance(sky)
            builder.environment_map("sky.hdr")
        if environments > 1:
            builder.environments(environments)
        for what, names in self.left_out.items():
            shown = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
            warnings.warn(f"{what}: {shown}", stacklevel=3)
        return _made(builder.toml(), self._glb.to_bytes(), panorama)

    def _shown(self) -> list[tuple[str, int]]:
        """Return what of the drawn groups can be seen."""
        return [(kind, i) for kind, i in self.drawn if self._appearance(kind, i)[1][3] >= _TRANSPARENT]

    def _appearance(self, kind: str, index: int) -> tuple[int, tuple[float, ...]]:
        """Material, -1 for none, and colour with alpha: the object's own if it is not the default."""
        model = self.model
        material = int(getattr(model, f"{kind}_matid")[index])
        rgba = getattr(model, f"{kind}_rgba")[index]
        if material >= 0 and np.array_equal(rgba, np.array([0.5, 0.5, 0.5, 1.0], np.float32)):
            rgba = model.mat_rgba[material]
        return material, tuple(float(v) for v in rgba)

    def _meshes(self) -> None:
        """Bodies as nodes, and what they show as nodes on them."""
        model, glb = self.model, self._glb
        on: dict[int, list[tuple[str, int]]] = {}
        for kind, index in self.drawn:
            _, rgba = self._appearance(kind, index)
            if 0 < rgba[3] < _TRANSPARENT:
                self._omit("transparent, not drawn (alpha below 0.5)", kind, index)
            elif rgba[3] > 0:
                on.setdefault(int(getattr(model, f"{kind}_bodyid")[index]), []).append((kind, index))
        for body in range(model.nbody):
            pose = _seven(self.data.xpos[body], self.data.xquat[body])
            node = glb.add_node(_body(model, body), pose[:3], pose[3:])
            for kind, index in on.get(body, []):
                parts = self._parts(kind, index)
                if not parts:
                    continue
                which = _OBJECT.mjOBJ_GEOM if kind == "geom" else _OBJECT.mjOBJ_SITE
                name = f"{kind}/{_name(model, which, index)}"
                pose = _seven(getattr(model, f"{kind}_pos")[index], getattr(model, f"{kind}_quat")[index])
                glb.add_node(name, pose[:3], pose[3:], mesh=glb.add_mesh(name, parts), parent=node)
                self.objects.append((index, int(which)))
        self._tendons()
        if not self.objects:
            raise ConfigError(
                "the model shows nothing: no geom, site or tendon of the drawn groups is visible"
            )

    def _parts_of_tendons(self, groups: set[int]) -> Iterable[tuple[int, int, float]]:
        model = self.model
        wrapping = {int(mujoco.mjtWrap.mjWRAP_SPHERE), int(mujoco.mjtWrap.mjWRAP_CYLINDER)}
        for tendon in range(model.ntendon):
            start, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
            kinds = np.asarray(model.wrap_type[start : start + count])
            alpha = float(self._appearance("tendon", tendon)[1][3])
            group = min(max(int(model.tendon_group[tendon]), 0), 5)
            if int(mujoco.mjtWrap.mjWRAP_SITE) not in kinds or alpha < _TRANSPARENT or group not in groups:
                continue
            around = int(np.isin(kinds, list(wrapping)).sum())
            sites = int((kinds == int(mujoco.mjtWrap.mjWRAP_SITE)).sum())
            width = float(model.tendon_width[tendon])
            # Each wrapping geom may cut a part in two, and adds one within.
            yield from ((tendon, part, width) for part in range(sites - 1 + around))
            yield from ((tendon, -1 - part, width / 2) for part in range(around))

    def _part_name(self, tendon: int, part: int) -> str:
        number = str(part) if part >= 0 else f"within/{-1 - part}"
        return f"tendon/{_name(self.model, _OBJECT.mjOBJ_TENDON, tendon)}/{number}"

    def _tendons(self) -> None:
        """Capsules between the points of tendons: each end of one follows a joint of its skin."""
        quality = self.model.vis.quality
        slices, stacks = max(int(quality.numslices), 3), max(int(quality.numstacks), 2)
        for tendon, part, width in self.tendon_parts:
            name = self._part_name(tendon, part)
            material, rgba = self._appearance("tendon", tendon)
            shape = _shapes.capsule(width, 1.0, slices, stacks // 2, 1)
            mesh = self._glb.add_mesh(
                name, [(shape, self._material(material, rgba, None, False))], two_joints=True
            )
            joints = []
            for end in range(2):
                frame = _Frame(f"{name}/{end}", _TENDON, tendon, width, part, end)
                pose = frame.pose(self.model, self.data, None)
                joints.append(self._glb.add_node(frame.name, pose[:3], pose[3:]))
            skin = self._glb.add_skin(joints, np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]))
            self._glb.add_node(name, mesh=mesh, skin=skin)
            self.objects.append((tendon, int(_OBJECT.mjOBJ_TENDON)))
            if self._hangs(tendon):
                self._omit_named("drawn straight, not as it hangs", name.rsplit("/", 1)[0])

    def _hangs(self, tendon: int) -> bool:
        """Whether MuJoCo draws a tendon as a catenary where it is slack."""
        model = self.model
        low, high = (float(v) for v in model.tendon_range[tendon])
        free = all(
            not np.any(np.asarray(getattr(model, f"tendon_{what}")[tendon]))
            for what in ("stiffness", "damping", "frictionloss")
        )
        return (
            bool(model.tendon_num[tendon] == 2 and model.tendon_limited[tendon] and free) and low == 0 < high
        )

    def _parts(self, kind: str, index: int) -> list[tuple[Triangles, int]]:
        """Triangles of a geom or site by material."""
        model = self.model
        material, rgba = self._appearance(kind, index)
        size = np.asarray(getattr(model, f"{kind}_size")[index], np.float64)
        which = int(getattr(model, f"{kind}_type")[index])
        texture = self._texture_of(material)
        repeat, uniform = np.ones(2), False
        if texture is not None:
            repeat = np.asarray(model.mat_texrepeat[material], np.float64)
            uniform = bool(model.mat_texuniform[material])
        cube = texture is not None and model.tex_type[texture] != int(mujoco.mjtTexture.mjTEXTURE_2D)
        found = self._shape(kind, index, which, size, cube)
        if found is None or not len(found[0].positions):
            return []
        shape, own_uvs = found
        two_sided = which == int(_GEOM.mjGEOM_PLANE)
        if texture is None:
            return [(shape, self._material(material, rgba, None, two_sided))]
        if cube:
            # OpenGL reads a cube map by the coordinates of the unit shape, of a mesh by its own.
            unit = np.ones(3) if _is_mesh(which) else np.where(size > 0, size, 1.0)
            if which == int(_GEOM.mjGEOM_SPHERE):
                unit = np.full(3, size[0])
            elif which in (int(_GEOM.mjGEOM_CAPSULE), int(_GEOM.mjGEOM_CYLINDER)):
                unit = np.array([size[0], size[0], size[1]])
            stretch = (np.where(size > 0, size, 1.0) if uniform else 1.0) / unit
            cut = _shapes.cube_mapped(shape, shape.positions * stretch)
            return [(part, self._material(material, rgba, (texture, face), two_sided)) for face, part in cut]
        if own_uvs:
            scale = np.where(repeat > 0, repeat, 1.0)
            scale = scale * np.where(uniform & (size[:2] > 0), size[:2], 1.0)
            uvs = shape.uvs * scale
            if which == int(_GEOM.mjGEOM_PLANE) and (size[:2] <= 0).any():
                uvs = uvs - 0.5
        else:
            # OpenGL's generated coordinates: from x and y.
            scale = repeat * (1.0 if uniform else 1 / np.maximum(size[:2], 1e-15))
            uvs = 0.5 * scale * shape.positions[..., :2] * [1, -1] - 0.5
        textured = Triangles(shape.positions, shape.normals, uvs)
        return [(textured, self._material(material, rgba, (texture, -1), two_sided))]

    def _shape(
        self, kind: str, index: int, which: int, size: Array, fine: bool
    ) -> tuple[Triangles, bool] | None:
        """Triangles as MuJoCo draws them, by its ``quality``; and whether they have texture coordinates."""
        model, quality = self.model, self.model.vis.quality
        slices, stacks = max(int(quality.numslices), 3), max(int(quality.numstacks), 2)
        cells = max(int(quality.numquads), 1) if fine else 1
        if which == int(_GEOM.mjGEOM_PLANE):
            return self._plane(size), True
        if which == int(_GEOM.mjGEOM_SPHERE):
            return _shapes.sphere(slices, stacks).scaled((size[0],) * 3), True
        if which == int(_GEOM.mjGEOM_ELLIPSOID):
            return _shapes.sphere(slices, stacks).scaled(size), True
        if which == int(_GEOM.mjGEOM_CAPSULE):
            return _shapes.capsule(size[0], size[1], slices, stacks // 2, stacks if fine else 1), True
        if which == int(_GEOM.mjGEOM_CYLINDER):
            shape = _shapes.cylinder(slices, stacks if fine else 1, stacks // 2 if fine else 1)
            return shape.scaled((size[0], size[0], size[1])), True
        if which == int(_GEOM.mjGEOM_BOX):
            return _shapes.box(cells).scaled(size), True
        data = int(model.geom_dataid[index]) if kind == "geom" else -1
        if which == int(_GEOM.mjGEOM_HFIELD) and data >= 0:
            start, rows, columns = (
                int(v[data]) for v in (model.hfield_adr, model.hfield_nrow, model.hfield_ncol)
            )
            heights = np.asarray(model.hfield_data[start : start + rows * columns], np.float64)
            field_size = model.hfield_size[data]
            return _shapes.height_field(heights.reshape(rows, columns), field_size, 1), False
        if _is_mesh(which) and data >= 0:
            return self._mesh(data)
        self._omit("not drawn, its shape is unknown", kind, index)
        return None

    def _plane(self, size: Array) -> Triangles:
        """Make a plane; one without end reaches as far as MuJoCo sees."""
        model = self.model
        far = 1.05 * float(model.vis.map.zfar * model.stat.extent)
        half = np.where(size[:2] > 0, size[:2], far)
        shape = _shapes.square(_PLANE_CELLS if (size[:2] <= 0).any() else 1).scaled((*half, 1))
        endless = 0.5 * shape.positions[..., :2] * [1, -1]
        return Triangles(shape.positions, shape.normals, np.where(size[:2] > 0, shape.uvs, endless))

    def _mesh(self, mesh: int) -> tuple[Triangles, bool]:
        """Make a mesh, whose normals and texture coordinates have indices of their own."""
        model = self.model
        faces = slice(int(model.mesh_faceadr[mesh]), int(model.mesh_faceadr[mesh] + model.mesh_facenum[mesh]))
        positions = np.asarray(model.mesh_vert[model.mesh_vertadr[mesh] + model.mesh_face[faces]], np.float64)
        normals = np.asarray(
            model.mesh_normal[model.mesh_normaladr[mesh] + model.mesh_facenormal[faces]], np.float64
        )
        start = int(model.mesh_texcoordadr[mesh])
        if start >= 0:
            uvs = np.asarray(model.mesh_texcoord[start + model.mesh_facetexcoord[faces]], np.float64)
            return Triangles(positions, normals, uvs), True
        # As MuJoCo does: a sharp edge of a mesh without texture coordinates stays sharp.
        own = _shapes.face_normals(positions)[:, None]
        normals = np.where((normals * own).sum(axis=-1, keepdims=True) < 0.8, own, normals)
        return Triangles(positions, normals, np.zeros((*positions.shape[:2], 2))), False

    def _texture_of(self, material: int) -> int | None:
        """Return the texture that colours a material."""
        model = self.model
        if material < 0:
            return None
        own = np.atleast_1d(model.mat_texid[material])
        texture = int(own[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] if own.size > 1 else own[0])
        return texture if texture >= 0 and self._pixels(texture).shape[2] >= 3 else None

    def _pixels(self, texture: int) -> npt.NDArray[np.uint8]:
        """Return a texture's picture (H, W, channels)."""
        model = self.model
        values = model.tex_data if hasattr(model, "tex_data") else model.tex_rgb
        channels = int(model.tex_nchannel[texture]) if hasattr(model, "tex_nchannel") else 3
        shape = (int(model.tex_height[texture]), int(model.tex_width[texture]), channels)
        start = int(model.tex_adr[texture])
        found = np.asarray(values[start : start + math.prod(shape)], np.uint8).reshape(shape)
        linear = int(mujoco.mjtColorSpace.mjCOLORSPACE_LINEAR) if hasattr(model, "tex_colorspace") else -1
        if linear >= 0 and model.tex_colorspace[texture] == linear:
            found = np.searchsorted(np.array(srgb_table()), found / 255, side="left").astype(np.uint8)
        return found

    def _face(self, texture: int, face: int) -> npt.NDArray[np.uint8]:
        """Return a face of a cube map; a square picture is there six times."""
        pixels = self._pixels(texture)[:, :, :3]
        edge = pixels.shape[1]
        return pixels if pixels.shape[0] == edge else pixels[face * edge : (face + 1) * edge]

    def _material(
        self, material: int, rgba: tuple[float, ...], texture: tuple[int, int] | None, two_sided: bool
    ) -> int:
        """Add a material; `texture`: which, and which face of a cube map, -1 for a picture."""
        key = (material, rgba, texture, two_sided)
        if key not in self._materials:
            self._materials[key] = self._glb.add_material(self._gltf_material(*key))
        return self._materials[key]

    def _gltf_material(
        self, material: int, rgba: tuple[float, ...], texture: tuple[int, int] | None, two_sided: bool
    ) -> dict[str, Any]:
        model = self.model
        # What a geom without a material has in MuJoCo.
        specular, shininess, emission, metallic, roughness = 0.5, 0.5, 0.0, -1.0, -1.0
        if material >= 0:
            specular, shininess = float(model.mat_specular[material]), float(model.mat_shininess[material])
            emission = float(model.mat_emission[material])
            if hasattr(model, "mat_metallic"):
                metallic = float(model.mat_metallic[material])
                roughness = float(model.mat_roughness[material])
            if float(model.mat_reflectance[material]) > 0:
                self._omit_named("mirror images are not drawn (reflectance)", self._material_name(material))
        if roughness < 0:
            roughness = _roughness(128 * shininess) if specular > 0 else 1.0
        color = np.array(rgba[:3])
        made: dict[str, Any] = {
            "name": self._material_name(material),
            "pbrMetallicRoughness": {
                "baseColorFactor": [*(float(v) for v in _linear(color)), 1.0],
                "metallicFactor": min(max(metallic, 0.0), 1.0),
                "roughnessFactor": min(max(roughness, 0.0), 1.0),
            },
            "doubleSided": two_sided,
        }
        reference = None
        if texture is not None:
            if texture not in self._textures:
                index, face = texture
                pixels = self._pixels(index)[:, :, :3] if face < 0 else self._face(index, face)
                self._textures[texture] = self._glb.add_texture(pixels, clamp=face >= 0)
            reference = {"index": self._textures[texture]}
            made["pbrMetallicRoughness"]["baseColorTexture"] = reference
        if emission > 0:
            light = _linear(emission * color)
            strength = max(float(light.max()), 1.0)
            made["emissiveFactor"] = [float(v) for v in light / strength]
            made["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
            if reference is not None:
                made["emissiveTexture"] = reference
        return made

    def _material_name(self, material: int) -> str:
        return "none" if material < 0 else _name(self.model, _OBJECT.mjOBJ_MATERIAL, material)

    def _camera(self, view: int, free: Any) -> EventCamera:
        model = self.model
        near = float(model.vis.map.znear * model.stat.extent)
        name = self.camera_name(view)
        if view < 0:
            pose = _free_pose(model, self.data, free)
            width, height = self.size or (640, 480)
            return EventCamera(
                name=name,
                width=width,
                height=height,
                fov_y_degrees=float(model.vis.global_.fovy),
                near=near,
                pose=Placement(position=pose[:3], rotation=pose[3:]),
            )
        width, height = self.size or (int(v) for v in model.cam_resolution[view])
        if min(width, height) <= 1:
            width, height = 640, 480
        lens: dict[str, Any] = {}
        sensor = np.asarray(model.cam_sensorsize[view], np.float64)
        if sensor[1] > 0:
            focal_x, focal_y, x, _ = (float(v) for v in model.cam_intrinsic[view])
            lens["fx"], lens["fy"] = focal_x / sensor[0] * width, focal_y / sensor[1] * height
            lens["cx"] = width * (0.5 - x / sensor[0])
            lens["cy"] = height * self._above(view)
        else:
            lens["fov_y_degrees"] = float(model.cam_fovy[view])
        if self._is_fixed("cam", view):
            place = _seven(model.cam_pos[view], model.cam_quat[view])
            parent = _body(model, int(model.cam_bodyid[view]))
        else:
            place = _seven(self.data.cam_xpos[view], _quaternion(self.data.cam_xmat[view]))
            parent = None
        placed = Placement(position=place[:3], rotation=place[3:], parent=parent)
        return EventCamera(name=name, width=width, height=height, near=near, pose=placed, **lens)

    def _above(self, view: int) -> float:
        """Share of the picture above the axis of a lens; its sign has changed between MuJoCo 3 and 4."""
        camera = mujoco.MjvCamera()
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, view
        shown = mujoco.MjvScene(self.model, maxgeom=1)
        mujoco.mjv_updateCamera(self.model, self.data, camera, shown)
        top, bottom = float(shown.camera[0].frustum_top), float(shown.camera[0].frustum_bottom)
        return top / (top - bottom)

    def _lights(self) -> list[int]:
        """Lights that shine."""
        model = self.model
        return [i for i in range(model.nlight) if model.light_active[i] and self._light_kind(i) is not None]

    def _light_kind(self, index: int) -> Any:
        model = self.model
        if not hasattr(model, "light_type"):
            directional = bool(model.light_directional[index])
        else:
            kind = int(model.light_type[index])
            if kind == int(mujoco.mjtLightType.mjLIGHT_IMAGE):
                return None
            if kind == int(mujoco.mjtLightType.mjLIGHT_POINT):
                return "point"
            directional = kind == int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
        if directional:
            return "directional"
        return "point" if float(model.light_cutoff[index]) > 90 else "spot"

    def _light(self, builder: SceneBuilder, index: int) -> None:
        model = self.model
        color = _linear(np.asarray(model.light_diffuse[index], np.float64))
        peak = float(color.max())
        if peak <= 0:
            return
        kind = self._light_kind(index)
        intensity = math.pi * peak
        if kind != "directional":
            # The engine's light falls with the square of distance: it equals MuJoCo's at the model's centre.
            away = float(np.linalg.norm(self.data.light_xpos[index] - model.stat.center))
            away = max(away, 0.1 * float(model.stat.extent))
            constant, linear, square = (float(v) for v in model.light_attenuation[index])
            intensity *= away * away / max(constant + linear * away + square * away * away, 1e-9)
        if self._is_fixed("light", index):
            place = _seven(model.light_pos[index], _towards(model.light_dir[index]))
            parent = _body(model, int(model.light_bodyid[index]))
        else:
            place = _seven(self.data.light_xpos[index], _towards(self.data.light_xdir[index]))
            parent = None
        cone: dict[str, Any] = {}
        if kind == "spot":
            outer = min(max(float(model.light_cutoff[index]), 0.1), 89.9)
            cone["outer_degrees"] = outer
            # Without an exponent a spot is even up to its edge.
            cone["inner_degrees"] = 0.0 if float(model.light_exponent[index]) > 0 else 0.99 * outer
        builder.light(
            _light_name(model, index),
            kind=kind,
            intensity=intensity,
            color=tuple(color / peak),
            casts_shadow=bool(model.light_castshadow[index]) and kind != "point",
            pose=Placement(position=place[:3], rotation=place[3:], parent=parent),
            **cone,
        )

    def _sky(self) -> Array | None:
        """Return the first sky box as a panorama of linear light (H, W, 3); None without one."""
        model = self.model
        boxes = np.flatnonzero(np.asarray(model.tex_type) == int(mujoco.mjtTexture.mjTEXTURE_SKYBOX))
        if not boxes.size or self._pixels(int(boxes[0])).shape[2] < 3:
            return None
        rows, columns = _SKY_ROWS, 2 * _SKY_ROWS
        elevation = (0.5 - (np.arange(rows) + 0.5) / rows)[:, None] * np.pi
        azimuth = ((np.arange(columns) + 0.5) / columns - 0.5)[None, :] * 2 * np.pi
        # The engine's panoramas have +Y up and +X in the middle.
        x, y, z = np.broadcast_arrays(
            np.cos(azimuth) * np.cos(elevation), np.sin(elevation), np.sin(azimuth) * np.cos(elevation)
        )
        # MuJoCo reads a sky box turned by 90 degrees about x.
        face, uv = _shapes.cube_texels(np.stack([x, z, -y], axis=-1))
        faces = np.stack([self._face(int(boxes[0]), i) for i in range(6)])
        edge = faces.shape[2]
        at = np.minimum((uv * edge).astype(np.int64), edge - 1)
        return np.asarray(np.array(srgb_table(), np.float64)[faces[face, at[..., 1], at[..., 0]]])

    # What is not drawn

    def _omit(self, why: str, kind: str, index: int) -> None:
        which = {"geom": _OBJECT.mjOBJ_GEOM, "site": _OBJECT.mjOBJ_SITE}[kind]
        self._omit_named(why, f"{kind} '{_name(self.model, which, index)}'")

    def _omit_named(self, why: str, name: str) -> None:
        names = self.left_out.setdefault(why, [])
        if name not in names:
            names.append(name)

    def _omit_unsupported(self) -> None:
        model = self.model
        not_drawn = "not drawn"
        for what, count, kind in (
            ("flex", getattr(model, "nflex", 0), getattr(_OBJECT, "mjOBJ_FLEX", None)),
            ("skin", model.nskin, _OBJECT.mjOBJ_SKIN),
        ):
            for index in range(count):
                self._omit_named(not_drawn, f"{what} '{_name(model, kind, index)}'")
        for index in range(model.ntendon):
            if 0 < self._appearance("tendon", index)[1][3] < _TRANSPARENT:
                name = _name(model, _OBJECT.mjOBJ_TENDON, index)
                self._omit_named("transparent, not drawn (alpha below 0.5)", f"tendon '{name}'")
        for index in range(model.ncam):
            if _is_orthographic(model, index):
                self._omit_named("orthographic, left out", f"camera '{self.camera_name(index)}'")
        for index in range(model.nlight):
            if model.light_active[index] and self._light_kind(index) is None:
                self._omit_named("image lights do not shine", _light_name(model, index))
        for index in range(model.nmat):
            roles = np.atleast_1d(model.mat_texid[index])
            others = np.flatnonzero(roles >= 0)
            if roles.size > 1 and (others != int(mujoco.mjtTextureRole.mjTEXROLE_RGB)).any():
                self._omit_named("textures of other roles than RGB are not read", self._material_name(index))
            rgb = int(roles[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] if roles.size > 1 else roles[0])
            if rgb >= 0 and self._texture_of(index) is None:
                self._omit_named(
                    "textures of fewer than three channels are not read", self._material_name(index)
                )


def _in_groups(kind: str, groups: Any, drawn: Iterable[int]) -> list[tuple[str, int]]:
    chosen = {_check.whole(f"{kind}_groups", group, 0, 5) for group in drawn}
    return [(kind, i) for i, group in enumerate(groups) if min(max(int(group), 0), 5) in chosen]


def _moving(model: Any) -> list[bool]:
    """Of each body whether a joint or the user moves it, or one that carries it."""
    moving = [False] * model.nbody
    for body in range(1, model.nbody):
        own = model.body_jntnum[body] > 0 or model.body_mocapid[body] >= 0
        moving[body] = bool(own) or moving[int(model.body_parentid[body])]
    return moving


def _is_mesh(which: int) -> bool:
    return which in (int(_GEOM.mjGEOM_MESH), int(_GEOM.mjGEOM_SDF))


def _name(model: Any, kind: Any, index: int) -> str:
    return mujoco.mj_id2name(model, int(kind), index) or str(index)


def _body(model: Any, index: int) -> str:
    return f"body/{_name(model, _OBJECT.mjOBJ_BODY, index)}"


def _light_name(model: Any, index: int) -> str:
    return f"light/{_name(model, _OBJECT.mjOBJ_LIGHT, index)}"


def _known(name: str, names: list[str]) -> str:
    """Say which name is the nearest, or all of them."""
    near = difflib.get_close_matches(name, names, 1, 0.5)
    if near:
        return f"did you mean {near[0]!r}? The model has {', '.join(map(repr, names))}"
    return f"the model has {', '.join(map(repr, names)) or 'none'}"


def _linear(color: Array) -> Array:
    """Linear light of sRGB numbers (IEC 61966-2-1), which may lie beyond 1."""
    values = np.maximum(np.asarray(color, np.float64), 0)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _roughness(exponent: float) -> float:
    """Perceptual roughness whose highlight is as wide as Blinn and Phong's: alpha^2 = 2 / (n + 2).

    Walter et al., Microfacet Models for Refraction through Rough Surfaces (2007), section 5.2.
    """
    return float((2 / (max(exponent, 0.0) + 2)) ** 0.25)


def _mean(panorama: Array) -> Array:
    """Mean light of a panorama over the sphere."""
    rows = len(panorama)
    weight = np.cos((0.5 - (np.arange(rows) + 0.5) / rows) * np.pi)
    return np.asarray((panorama.mean(axis=1) * weight[:, None]).sum(axis=0) / weight.sum())


def _radiance(light: Array) -> bytes:
    """Linear RGB (H, W, 3) as a Radiance file of plain RGBE (Ward, Real Pixels, Graphics Gems II)."""
    _, exponent = np.frexp(light.max(axis=-1))
    scale = np.where(light.max(axis=-1) > 1e-32, np.ldexp(256.0, -exponent), 0.0)
    texels = np.zeros((*light.shape[:2], 4), np.uint8)
    texels[..., :3] = np.minimum(light * scale[..., None], 255)
    texels[..., 3] = np.where(scale > 0, exponent + 128, 0)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {light.shape[0]} +X {light.shape[1]}\n"
    return head.encode() + texels.tobytes()


def _made(text: str, model: bytes, sky: bytes | None) -> Scene:
    """Make the scene of a scene file and the files that it names; what is unpickled is made so again."""
    with tempfile.TemporaryDirectory(prefix="evis-mujoco-") as folder:
        (Path(folder) / "model.glb").write_bytes(model)
        if sky is not None:
            (Path(folder) / "sky.hdr").write_bytes(sky)
        raw = Scene.from_toml(text, base=folder)._raw
    return Scene(raw, (_made, (text, model, sky)))
