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
from ._packets import CameraInfo, DenseWindows, Packet
from ._poses import NodePoses
from ._rotations import difference, interpolated
from ._scene import EventCamera, Scene
from ._sensor import Sensor
from ._shapes import Triangles
from ._simulator import Simulator
from .motion import Placement

__all__ = ["EventRenderer", "scene"]

Array: TypeAlias = npt.NDArray[np.float64]
Flags: TypeAlias = npt.NDArray[np.bool_]
Indices: TypeAlias = npt.NDArray[np.int64]
CameraChoice: TypeAlias = Any
"""Name or index of a camera of the model, -1 for a free camera, or an ``mujoco.MjvCamera``."""

#: How far, in pixels, a pose between two knots may be from where the integrator has it.
_TOLERANCE_PX = 0.05
#: A step is halved so often at most.
_MOST_HALVINGS = 6
#: How far a step's end may be from what its velocity says (radians, metres): else it is no plain step.
_SAME_STATE = 1e-7
#: How far clocks of environments that go in step may be apart.
_SAME_TIME_S = 1e-6
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
_DIVERGED = (
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
)


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
    return reading.build(list(range(model.ncam)) or [-1], skybox)


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
        self._kinematics = _Kinematics(model, reading, self._views, self._frames)
        #: Shapes of poses and of eyes, per environment.
        self._shapes = (len(self._frames), 7), (len(self._views), 3)
        self._shown = 0
        self._closed = False
        self._simulator = Simulator(made, **self._arguments)
        self._begin()

    def _begin(self) -> None:
        count = self._count
        self._seen: deque[_Seen] = deque()
        #: What each environment's clock shows at stream time 0, in seconds; in which order they were set.
        self._start_s, self._since = np.zeros(count), np.zeros(count, np.int64)
        self._elapsed_s = 0.0
        #: How each environment moved in its last step, (E, N, 6), where that is known.
        self._moved, self._has_moved = np.zeros((count, len(self._frames), 6)), np.zeros(count, bool)
        self._pending, self._held, self._warned = (np.zeros(count, bool) for _ in range(3))
        #: The data that were observed last, and views of their arrays.
        self._given: list[Any] = [None] * count
        self._arrays: list[tuple[Array, Array, Array, Array]] = [(np.zeros(0),) * 4] * count
        self._waiting: list[Packet] = []
        self._packets: tuple[Packet, ...] = ()

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

        Its times count from the first observation. None before anything was rendered. Where environments were
        reset in between, the last one of `packets`.
        """
        return self._packets[-1] if self._packets else None

    @property
    def packets(self) -> tuple[Packet, ...]:
        """What the last `render` made, in order: one packet, and one more per reset of environments."""
        return self._packets

    @property
    def held(self) -> npt.NDArray[np.bool_]:
        """Which environments rest at their last pose since a state was not finite, bool (E,), read-only.

        ``reset([i])`` lets environment i go on.
        """
        held: Flags = self._held.copy()
        held.flags.writeable = False
        return held

    def observe(self, data: Any, *, camera: Any = None) -> None:
        """Take in a state: time, qpos, qvel and mocap poses are copied.

        Call it after each ``mj_step``: between two states bodies move as the integrator moved them. The first
        state after ``reset([i])`` begins the new episode of environment i; what was observed before is then
        rendered up to the last whole portion.

        One of several environments whose state is not finite, or which MuJoCo has reset by itself since it
        diverged, stays at its last pose, with a warning: see `held`.

        Parameters
        ----------
        data : mujoco.MjData or sequence of these
            One per environment. Their times go on by the same amount, but for environments that were reset.
        camera : mujoco.MjvCamera, optional
            Where the free camera is now.

        Raises
        ------
        ConfigError
            If it is of another model, the one environment's state is not finite, its time lies before that of
            an earlier one (`reset` begins again), or environments are not in step. Then nothing has changed.
        DeviceError
            If the device failed while environments were reset.
        """
        self._open()
        items = self._each(data)
        new = self._read(items)
        if self._free is not None and camera is None:
            camera = self._free
        if camera is not None and not isinstance(camera, mujoco.MjvCamera):
            raise ConfigError(f"camera is {_check.shown(camera)}; observe takes an mujoco.MjvCamera")
        bad = ~self._held & ~new.finite()
        self._refuse_one(bad, new)
        last = self._seen[-1] if self._seen else None
        elapsed_s = self._agreed(items, new, bad)
        new.t_us = round(elapsed_s * 1e6)
        self._pose(new, last, bad, camera)
        goes_on = ~(self._held | bad | self._pending)
        begun = self._pending & ~bad
        again = last is not None and new.t_us == last.t_us
        other = np.zeros(self._count, bool)
        if last is not None and again:
            other = goes_on & (new.poses != last.poses).any(axis=(1, 2))
            if other.any() and (len(self._seen) > 1 or self._simulator.now_us > 0):
                raise ConfigError(
                    f"data has another state at {new.time[other][0]} s than before; time must go on, or "
                    "reset() begins a new stream"
                )
        elif last is not None:
            self._follow(last, new, goes_on)
        # Nothing is refused from here on.
        self._hold(bad, new)
        if last is None:
            self._start_s[:] = new.time
            self._seen.append(new)
            self._pending[:] = False
            return
        self._elapsed_s = elapsed_s
        poses = new.poses
        if not again:
            if begun.any():
                # A reset environment rests where it was until it jumps.
                new.poses = np.where(begun[:, None, None], last.poses, poses)
            self._seen.append(new)
        elif other.any():
            # Nothing has been rendered: it begins with the newer state.
            last.take(new, other)
        if begun.any():
            self._jump(np.flatnonzero(begun), poses, new)

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
            observation. With several environments a list of one for each. With ``dense=`` among the
            settings, `evis.packets.DenseWindows` in the place of each: the windows that ended since then.

        Raises
        ------
        DeviceError
            If the device failed.
        """
        self._open()
        until_us = 0 if not self._seen else self._seen[-1].t_us // self._step_us * self._step_us
        if until_us > self._simulator.now_us:
            self._waiting.append(self._advance(until_us))
        dense = self._simulator.dense is not None
        if not self._waiting:
            camera = self._simulator.cameras[self._shown]
            none = (
                _joined_windows([])
                if dense
                else EventArray(np.zeros(0, EventCD), width=camera.width, height=camera.height)
            )
            return none if self._count == 1 else [none] * self._count
        self._packets, self._waiting = tuple(self._waiting), []
        name = self._names[self._shown]
        views = [[packet[each][name] for packet in self._packets] for each in range(self._count)]
        made: list[Any] = [
            _joined_windows([view.dense for view in own if view.dense is not None])
            if dense
            else _joined([view.events for view in own])
            for own in views
        ]
        return made[0] if self._count == 1 else made

    def reset(self, env_ids: int | Sequence[int] | npt.NDArray[np.integer[Any]] | None = None) -> None:
        """Forget everything, or begin new episodes of some environments.

        Without `env_ids` the next observation begins a new stream, at time 0, and the pixels' memory is gone.

        With it, the stream goes on, and so do the other environments, whose events do not change by a byte.
        The next `observe` takes the state of each of these as the first of an episode, whatever its time:
        its pixels see it as at a stream's start, from the last whole portion (`pose_step_us`) on, and the
        jump fires nothing. What it did since that portion gives no events. `held` lets go of it.

        Parameters
        ----------
        env_ids : int or sequence of int, optional
            Environments that ``mj_resetData`` or the like has set back; none of them where it is empty.

        Raises
        ------
        ConfigError
            If an environment does not exist or is named twice. Then nothing has changed.
        """
        self._open()
        if env_ids is None:
            self._simulator = Simulator(self._scene, **self._arguments)
            self._begin()
            return
        environments = self._environments(env_ids)
        self._pending[environments] = True
        self._held[environments] = False

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

    def _environments(self, env_ids: Any) -> list[int]:
        alone = hasattr(env_ids, "__index__") and np.ndim(env_ids) == 0
        given = [env_ids] if alone else _check.items("env_ids", env_ids, "[0, 1]")
        found = [_check.whole("env_ids", each, 0, self._count - 1) for each in given]
        if len(set(found)) < len(found):
            twice = next(each for each in found if found.count(each) > 1)
            raise ConfigError(f"env_ids names environment {twice} twice; each may be there once")
        return found

    def _read(self, items: list[Any]) -> _Seen:
        """Copy the states."""
        count, model = self._count, self._model
        for environment, item in enumerate(items):
            # Asking a model or data for an array takes longer than copying a small one.
            if item is not self._given[environment]:
                self._arrays[environment] = self._arrays_of(item)
                self._given[environment] = item
        mocap = np.empty((count, model.nmocap, 7))
        if mocap.size:
            for own, (_, _, position, rotation) in zip(mocap, self._arrays, strict=True):
                own[:, :3], own[:, 3:] = position, rotation
        return _Seen(
            time=np.array([item.time for item in items], np.float64),
            qpos=np.concatenate([arrays[0] for arrays in self._arrays]).reshape(count, -1),
            qvel=np.concatenate([arrays[1] for arrays in self._arrays]).reshape(count, -1),
            mocap=mocap,
        )

    def _arrays_of(self, item: Any) -> tuple[Array, Array, Array, Array]:
        """Return views of what is read of an ``mjData``."""
        if not isinstance(item, mujoco.MjData):
            raise ConfigError(f"data is {_check.shown(item)}; it must be an mujoco.MjData")
        model = self._model
        arrays = item.qpos, item.qvel, item.mocap_pos, item.mocap_quat
        have, want = (arrays[0].size, arrays[1].size, len(arrays[2])), (model.nq, model.nv, model.nmocap)
        if have != want:
            raise ConfigError(f"data has nq, nv, nmocap {have}, the model {want}; it is of another model")
        return arrays

    def _refuse_one(self, bad: Flags, new: _Seen) -> None:
        """Refuse a bad state of a single environment; of several it is held."""
        if self._count == 1 and bad.any():
            raise ConfigError(
                f"data holds values that are not finite at {new.time[0]} s: the simulation has diverged; "
                "give a good state, or reset() after mj_resetData"
            )

    def _agreed(self, items: list[Any], new: _Seen, bad: Flags) -> float:
        """Seconds since the stream began, as the environments agree; those that MuJoCo reset join `bad`."""
        good = ~(self._held | bad | self._pending)
        if not good.any():
            # Nobody knows how much time has passed.
            return self._elapsed_s
        with np.errstate(invalid="ignore"):
            since_s = new.time - self._start_s if self._seen else new.time
            clock, apart = self._clock(since_s, good)
        if apart.any():
            # MuJoCo sets a state that has diverged back to its start by itself, and counts it.
            diverged = np.array([_has_diverged(item) for item in items])
            if (good & ~diverged).any():
                clock, apart = self._clock(since_s, good & ~diverged)
                bad |= good & diverged & (np.abs(since_s - since_s[clock]) > _SAME_TIME_S)
        if apart.any():
            other = int(np.flatnonzero(apart)[0])
            raise ConfigError(
                f"data have the times {sorted(set(new.time[good].tolist()))} s: environment {other} is "
                f"{since_s[other] - since_s[clock]:+.6g} s off environment {clock}; environments must go in "
                f"step, and reset([{other}]) begins a new episode of one"
            )
        elapsed_s = float(since_s[clock]) if self._seen else 0.0
        if self._seen and round(elapsed_s * 1e6) < self._seen[-1].t_us:
            raise ConfigError(
                f"data has the time {new.time[clock]} s, before the {self._seen[-1].time[clock]} s of the "
                "last one; time cannot go back: reset() begins a new stream"
            )
        return elapsed_s

    def _clock(self, since_s: Array, good: Flags) -> tuple[int, Flags]:
        """Whose clock counts, the one that was set first, and which of `good` are not in step with it."""
        if self._count == 1:
            return 0, np.zeros(1, bool)
        chosen = np.flatnonzero(good)
        clock = int(chosen[self._since[chosen].argmin()])
        return clock, good & (np.abs(since_s - since_s[clock]) > _SAME_TIME_S)

    def _pose(self, new: _Seen, last: _Seen | None, bad: Flags, camera: Any) -> None:
        """Pose the environments; what cannot be posed joins `bad`, and stays where it was."""
        moves = ~(self._held | bad)
        if moves.all():
            new.poses, new.eyes = self._kinematics.poses(new.qpos, new.mocap, camera)
        else:
            new.poses, new.eyes = (np.zeros((self._count, *shape)) for shape in self._shapes)
            new.poses[moves], new.eyes[moves] = self._kinematics.poses(
                new.qpos[moves], new.mocap[moves], camera
            )
        bad |= ~np.isfinite(new.poses.reshape(self._count, -1)).all(axis=1)
        self._refuse_one(bad, new)
        rests = self._held | bad
        if rests.any():
            new.take(self._initial(camera) if last is None else last, rests)

    def _initial(self, camera: Any) -> _Seen:
        """Where the scene has everything."""
        data = self._reading.data
        mocap = np.concatenate([data.mocap_pos, data.mocap_quat], axis=1)
        qpos, qvel, mocap = (
            np.repeat(each[None], self._count, axis=0) for each in (data.qpos, data.qvel, mocap)
        )
        seen = _Seen(time=np.zeros(self._count), qpos=qpos, qvel=qvel, mocap=mocap)
        seen.poses, seen.eyes = self._kinematics.poses(qpos, mocap, camera)
        return seen

    def _hold(self, bad: Flags, new: _Seen) -> None:
        """Hold environments at their last pose."""
        if not bad.any():
            return
        self._held |= bad
        self._pending &= ~bad
        for environment in np.flatnonzero(bad & ~self._warned).tolist():
            warnings.warn(
                f"environment {environment} has diverged: its state at {new.t_us} us of the stream is not "
                f"finite, or MuJoCo has reset it; it rests at its last pose until reset([{environment}])",
                stacklevel=3,
            )
        self._warned |= bad

    def _jump(self, begun: Indices, poses: Array, new: _Seen) -> None:
        """Let reset environments jump to these poses, at the last whole portion."""
        until_us = self._seen[-1].t_us // self._step_us * self._step_us
        if until_us > self._simulator.now_us:
            self._waiting.append(self._advance(until_us))
        if self._simulator.now_us > 0 and begun.size:
            jumps = {frame.name: poses[begun, i] for i, frame in enumerate(self._frames)}
            self._simulator.reset(begun, poses=jumps or None)
        for seen in self._seen:
            seen.poses[begun] = poses[begun]
            seen.followed[begun] = False
            for environment in begun.tolist():
                seen.within.pop(environment, None)
        self._seen[-1].take(new, begun, but_poses=True)
        self._start_s[begun] = new.time[begun] - self._elapsed_s
        self._since[begun] = self._since.max() + 1
        self._has_moved[begun] = False
        self._pending[:] = False

    def _follow(self, last: _Seen, new: _Seen, goes_on: Flags) -> None:
        """Find out how environments came from the last states to these."""
        new.followed = self._followed(last, new, goes_on)
        had_moved, self._has_moved = self._has_moved, new.followed.copy()
        if not new.followed.any():
            return
        moved = difference(last.poses, new.poses)
        bend = moved - self._moved
        self._moved = moved
        # Of an environment that has just begun everything is asked for.
        bent = (bend != 0).any(axis=-1) | ~had_moved[:, None]
        asks = np.flatnonzero(new.followed & bent.any(axis=-1))
        if asks.size:
            focal = max(max(info.fx, info.fy) for info in self._simulator.cameras)
            reach = self._kinematics.reach(new, asks, bent[asks], focal)
            far = (self._pixels(bend[asks], reach) / 8 > _TOLERANCE_PX) | ~had_moved[asks]
            if far.any():
                self._between(last, new, asks[far], reach[far])

    def _followed(self, last: _Seen, new: _Seen, goes_on: Flags) -> Flags:
        """Of which environments the integrator went from the last states to these as it moves positions."""
        model = self._model
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            return np.zeros(self._count, bool)
        ends, seconds = last.qpos.copy(), (new.time - last.time).tolist()
        for environment in np.flatnonzero(goes_on).tolist():
            mujoco.mj_integratePos(model, ends[environment], new.qvel[environment], seconds[environment])
        off = np.abs(ends - new.qpos).max(axis=1, initial=0.0)
        return np.asarray(goes_on & (off <= _SAME_STATE))

    def _at(self, last: _Seen, new: _Seen, envs: Indices, t_us: Indices) -> Array:
        """Poses between two states, (K, N, 7), of environments at a time each, as the integrator has them."""
        share = (t_us - last.t_us) / (new.t_us - last.t_us)
        qpos = last.qpos[envs]
        seconds = (share * (new.time - last.time)[envs]).tolist()
        for own, environment, after_s in zip(qpos, envs.tolist(), seconds, strict=True):
            mujoco.mj_integratePos(self._model, own, new.qvel[environment], after_s)
        mocap = last.mocap[envs]
        if mocap.size:
            mocap = interpolated(mocap, new.mocap[envs], share[:, None, None])
        poses, _ = self._kinematics.poses(qpos, mocap, None)
        # A free camera moves by the caller's hand, evenly.
        free = self._kinematics.free
        if free:
            first, end = last.poses[envs][:, free], new.poses[envs][:, free]
            moves = not np.array_equal(first, end)
            poses[:, free] = interpolated(first, end, share[:, None, None]) if moves else first
        return poses

    def _between(self, last: _Seen, new: _Seen, envs: Indices, reach: Array) -> None:
        """Add poses within a step, so many that what lies between runs as even motion has it, to 0.05 px."""
        from_us, to_us = np.full(envs.size, last.t_us), np.full(envs.size, new.t_us)
        first, end = last.poses[envs], new.poses[envs]
        for _ in range(_MOST_HALVINGS):
            middle_us = (from_us + to_us) // 2
            poses = self._at(last, new, envs, middle_us)
            share = ((middle_us - from_us) / (to_us - from_us))[:, None, None]
            off = difference(interpolated(first, end, share), poses)
            more = (self._pixels(off, reach) > _TOLERANCE_PX) & (middle_us > from_us)
            if not more.any():
                break
            for environment, t_us, pose in zip(
                envs[more].tolist(), middle_us[more].tolist(), poses[more], strict=True
            ):
                new.within.setdefault(environment, []).append((t_us, pose))
            middle_us, poses = middle_us[more], poses[more]
            # Both halves.
            from_us, to_us = np.append(from_us[more], middle_us), np.append(middle_us, to_us[more])
            first, end = np.concatenate([first[more], poses]), np.concatenate([poses, end[more]])
            envs, reach = np.tile(envs[more], 2), np.tile(reach[more], (2, 1, 1))
        for knots in new.within.values():
            knots.sort(key=lambda knot: knot[0])

    def _advance(self, until_us: int) -> Packet:
        """Render to a whole portion."""
        simulator = self._simulator
        now_us = simulator.now_us
        if not self._frames:
            packet = simulator.step(until_us)
        else:
            packet = simulator._step_rows(until_us, self._rows(until_us, now_us))
        while len(self._seen) > 1 and self._seen[1].t_us <= until_us:
            self._seen.popleft()
        return packet

    def _rows(self, until_us: int, now_us: int) -> list[NodePoses]:
        """Return times and poses from now to the end of a step, by environment and frame."""
        times: list[int] = []
        poses: list[Array] = []
        within: dict[int, list[tuple[int, Array]]] = {}
        older = None
        for seen in self._seen:
            for environment, inner in seen.within.items():
                own = [knot for knot in inner if now_us < knot[0] <= until_us]
                if own:
                    within.setdefault(environment, []).extend(own)
            if seen.t_us > until_us and older is not None and older.t_us < until_us:
                times.append(until_us)
                poses.append(self._at_portion(older, seen, until_us))
            elif now_us < seen.t_us <= until_us or seen.t_us == now_us == 0:
                times.append(seen.t_us)
                poses.append(seen.poses)
            older = seen
        # (E, N, T, 7)
        each = np.stack(poses, axis=2)
        rows: list[NodePoses] = []
        for environment, frames in enumerate(each.tolist()):
            own_times = times
            if environment in within:
                knots = dict(within[environment])
                knots.update(zip(times, each[environment].swapaxes(0, 1), strict=True))
                own_times = sorted(knots)
                frames = np.stack([knots[t_us] for t_us in own_times], axis=1).tolist()
            rows += [(environment, i, own_times, frame, None, None) for i, frame in enumerate(frames)]
        return rows

    def _at_portion(self, older: _Seen, seen: _Seen, t_us: int) -> Array:
        """Poses between two states, (E, N, 7)."""
        share = (t_us - older.t_us) / (seen.t_us - older.t_us)
        poses = interpolated(older.poses, seen.poses, share)
        envs = np.flatnonzero(seen.followed)
        if envs.size:
            poses[envs] = self._at(older, seen, envs, np.full(envs.size, t_us))
        return poses

    @staticmethod
    def _pixels(off: Array, reach: Array) -> Array:
        """How far, in pixels, differences of poses (K, N, 6) can be seen, at most, (K,)."""
        parts = off.reshape(*off.shape[:-1], 2, 3)
        far = reach * np.sqrt(np.einsum("knpi,knpi->knp", parts, parts))
        return np.asarray((far[..., 0] + far[..., 1]).max(axis=-1, initial=0.0))


class _Seen:
    """What was observed of every environment at one time, and how they came there from the one before."""

    def __init__(self, time: Array, qpos: Array, qvel: Array, mocap: Array) -> None:
        #: Stream time.
        self.t_us = 0
        #: The environments' own clocks, in seconds (E,), and their states (E, …).
        self.time, self.qpos, self.qvel, self.mocap = time, qpos, qvel, mocap
        #: Poses of the frames, (E, N, 7).
        self.poses: Array = np.zeros((len(time), 0, 7))
        #: Where cameras are, (E, V, 3).
        self.eyes: Array = np.zeros((len(time), 0, 3))
        #: Whether the integrator moved positions by the velocities at the step's end, (E,).
        self.followed = np.zeros(len(time), bool)
        #: By environment: times and poses (N, 7) on the way, where even motion would err.
        self.within: dict[int, list[tuple[int, Array]]] = {}

    def finite(self) -> Flags:
        """Of which environments every value is finite."""
        values: Array
        if all(np.isfinite(values).all() for values in (self.time, self.qpos, self.qvel, self.mocap)):
            return np.ones(len(self.time), bool)
        finite = np.isfinite(self.time)
        for values in (self.qpos, self.qvel, self.mocap.reshape(len(self.time), -1)):
            finite &= np.isfinite(values).all(axis=1)
        return finite

    def take(self, other: _Seen, which: npt.NDArray[Any], *, but_poses: bool = False) -> None:
        """Take the states of these environments from another observation."""
        self.time[which], self.qpos[which] = other.time[which], other.qpos[which]
        self.qvel[which], self.mocap[which] = other.qvel[which], other.mocap[which]
        self.eyes[which] = other.eyes[which]
        if not but_poses:
            self.poses[which] = other.poses[which]


class _Kinematics:
    """Poses of the frames for states of many environments, and how far errors of them are seen."""

    def __init__(self, model: Any, reading: _ModelReader, views: list[int], frames: list[_Frame]) -> None:
        self._model, self._views, self._count = model, views, len(frames)
        # One for all environments: it stays in the processor's cache.
        self._data = mujoco.MjData(model)
        of_kind = {kind: [i for i, f in enumerate(frames) if f.kind == kind] for kind in range(5)}

        def indices(kind: int) -> Indices:
            return np.array([frames[i].index for i in of_kind[kind]], np.int64)

        # Bodies come first.
        self._bodies = indices(_BODY)
        self._cameras, self._camera_ids = of_kind[_CAMERA], indices(_CAMERA).tolist()
        self._lights, self._light_ids = of_kind[_LIGHT], indices(_LIGHT)
        self._tendons = of_kind[_TENDON]
        self._parts = [(frames[i].index, frames[i].part, frames[i].end) for i in self._tendons]
        #: Which frames are free cameras.
        self.free = of_kind[_FREE]
        self._default_free = _free_pose(model, None, None)
        self._named = [place for place, view in enumerate(views) if view >= 0]
        self._named_ids = np.array([views[place] for place in self._named], np.int64)
        modes = [model.cam_mode[view] for view in views if view >= 0]
        modes += [model.light_mode[index] for index in self._light_ids]
        centres = mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM, mujoco.mjtCamLight.mjCAMLIGHT_TARGETBODYCOM
        #: Whether any of them follows a centre of mass.
        self._centres = any(mode == centre for mode in modes for centre in centres)
        # What the scene shows was read once.
        self._geoms = np.array([i for kind, i in reading.shown() if kind == "geom"], np.int64)
        self._bounds = np.array(model.geom_rbound[self._geoms], np.float64)
        self._planes = np.flatnonzero(model.geom_type[self._geoms] == int(_GEOM.mjGEOM_PLANE))
        self._plane_ids = self._geoms[self._planes]
        self._radius = np.array([frame.radius for frame in frames], np.float64)
        self._is_body = np.array([frame.kind == _BODY for frame in frames], bool)
        self._seers = [self._seer(reading, view, frames) for view in views]

    def _seer(self, reading: _ModelReader, view: int, frames: list[_Frame]) -> tuple[Flags, Flags, Flags]:
        """Return which frames a camera sees from afar, which may carry it, and which geoms do not."""
        carrier = reading.carrier(view)
        afar = [(f.kind == _BODY and f.index != carrier) or f.kind == _TENDON for f in frames]
        carries = [not far and f.kind != _LIGHT for far, f in zip(afar, frames, strict=True)]
        apart = self._model.geom_bodyid[self._geoms] != (-1 if carrier is None else carrier)
        return np.array(afar, bool), np.array(carries, bool), np.asarray(apart)

    def poses(self, qpos: Array, mocap: Array, camera: Any) -> tuple[Array, Array]:
        """World-from-node of every frame, (K, N, 7), and where cameras are, (K, V, 3), for K states."""
        model, data, count = self._model, self._data, len(qpos)
        bodies, lights, tendons = self._bodies, self._lights, self._tendons
        own_qpos, xpos, xquat, cam_xpos = data.qpos, data.xpos, data.xquat, data.cam_xpos
        light_xpos, light_xdir = data.light_xpos, data.light_xdir
        # What is gathered lies together; quaternions are MuJoCo's.
        found, turn = np.empty((count, self._count, 7)), np.ones((count, self._count, 4))
        body_place, body_turn = np.empty((count, bodies.size, 3)), np.empty((count, bodies.size, 4))
        light_place, light_way = (np.empty((count, len(lights), 3)) for _ in range(2))
        named, eyes = np.empty((count, len(self._named), 3)), np.empty((count, len(self._views), 3))
        ways = np.empty((count, len(tendons), 3))
        tracks = bool(self.free) and camera is not None and camera.type == mujoco.mjtCamera.mjCAMERA_TRACKING
        wraps, moving = bool(tendons), mocap.size > 0
        shines, centres = bool(lights or self._named), self._centres or wraps or tracks
        for row, (state, row_place, row_turn) in enumerate(zip(qpos, body_place, body_turn, strict=True)):
            own_qpos[:] = state
            if moving:
                data.mocap_pos[:], data.mocap_quat[:] = mocap[row, :, :3], mocap[row, :, 3:]
            mujoco.mj_kinematics(model, data)
            xpos.take(bodies, 0, row_place, "clip")
            xquat.take(bodies, 0, row_turn, "clip")
            if centres:
                mujoco.mj_comPos(model, data)
            if shines:
                mujoco.mj_camlight(model, data)
            if self._named:
                cam_xpos.take(self._named_ids, 0, named[row], "clip")
            for i, index in zip(self._cameras, self._camera_ids, strict=True):
                found[row, i, :3] = cam_xpos[index]
                mujoco.mju_mat2Quat(turn[row, i], data.cam_xmat[index])
            if lights:
                light_xpos.take(self._light_ids, 0, light_place[row], "clip")
                light_xdir.take(self._light_ids, 0, light_way[row], "clip")
            if wraps:
                mujoco.mj_tendon(model, data)
                found[row, tendons, :3], ways[row] = _tendon_ends(data, self._parts)
            if tracks:
                found[row, self.free] = _free_pose(model, data, camera)
        found[:, : bodies.size, :3], turn[:, : bodies.size] = body_place, body_turn
        if lights:
            found[:, lights, :3], turn[:, lights] = light_place, _towards(light_way)
        if wraps:
            turn[:, tendons] = _towards(ways)
        tracked = found[:, self.free] if tracks else None
        w, x, y, z = (turn[..., k] for k in range(4))
        length = np.sqrt(w * w + x * x + y * y + z * z)[..., None]
        np.divide(turn[..., 1:], length, out=found[..., 3:6])
        np.divide(turn[..., :1], length, out=found[..., 6:])
        if tracked is not None:
            found[:, self.free] = tracked
        elif self.free:
            found[:, self.free] = self._default_free if camera is None else _free_pose(model, None, camera)
        eyes[:, self._named] = named
        if self.free:
            eyes[:, self._views.index(-1)] = found[:, self.free[0], :3]
        return found, eyes

    def reach(self, seen: _Seen, envs: Indices, bent: Flags, focal: float) -> Array:
        """Pixels per metre and per radian that an error of each frame makes, (K, N, 2), bounds from above.

        `bent`, (K, N): frames whose motion is not even. Where none of them carries a camera, what that would
        add is left out.
        """
        near = self._model.vis.map.znear * self._model.stat.extent
        reach, found = np.zeros((2, len(envs), self._count, 2))
        moves: list[Flags] = [np.asarray((bent & carries).any(axis=-1)) for _, carries, _ in self._seers]
        gathered = np.flatnonzero(np.array(moves).any(axis=0))
        geometry = self._geometry(seen, envs[gathered]) if gathered.size else None
        for place, ((afar, carries, apart), moved) in enumerate(zip(self._seers, moves, strict=True)):
            eye = seen.eyes[envs, place]
            off = seen.poses[envs, :, :3] - eye[:, None]
            lever = np.sqrt(np.einsum("kni,kni->kn", off, off))
            np.multiply(focal / np.maximum(lever - self._radius, near), afar, out=found[..., 0])
            np.multiply(found[..., 0], self._radius, out=found[..., 1])
            if geometry is not None and moved.any():
                nearest = np.full((len(envs), 1), np.inf)
                nearest[gathered, 0] = self._nearest(eye[gathered], apart, *geometry)
                np.maximum(nearest, near, out=nearest)
                on_it = moved[:, None] & carries & (self._is_body | (lever < 1e-9))
                found[..., 0] = np.where(on_it, focal / nearest, found[..., 0])
                found[..., 1] = np.where(on_it, focal * (1 + lever / nearest), found[..., 1])
            np.maximum(reach, found, out=reach)
        return reach

    def _geometry(self, seen: _Seen, envs: Indices) -> tuple[Array, Array]:
        """Where geoms are, (K, G, 3), and axes of the planes among them, (K, P, 9)."""
        model, data, geoms, planes = self._model, self._data, self._geoms, self._plane_ids
        places, axes = np.empty((envs.size, geoms.size, 3)), np.empty((envs.size, planes.size, 9))
        for environment, row_places, row_axes in zip(envs.tolist(), places, axes, strict=True):
            data.qpos[:] = seen.qpos[environment]
            if seen.mocap.size:
                data.mocap_pos[:] = seen.mocap[environment, :, :3]
                data.mocap_quat[:] = seen.mocap[environment, :, 3:]
            mujoco.mj_kinematics(model, data)
            data.geom_xpos.take(geoms, 0, row_places, "clip")
            data.geom_xmat.take(planes, 0, row_axes, "clip")
        return places, axes

    def _nearest(self, eyes: Array, apart: Flags, places: Array, axes: Array) -> Array:
        """Metres to the nearest that a camera may see, from below, (K,)."""
        off = eyes[:, None] - places
        away = np.sqrt(np.einsum("kgi,kgi->kg", off, off)) - self._bounds
        planes = self._planes
        away[:, planes] = np.abs(np.einsum("kgi,kgi->kg", off[:, planes], axes[..., 2::3]))
        return np.asarray(away[:, apart].min(axis=1, initial=math.inf))


def _has_diverged(data: Any) -> bool:
    """Whether MuJoCo has counted positions, velocities or accelerations that it could not use."""
    return any(data.warning[kind].number > 0 for kind in _DIVERGED)


def _joined(events: list[EventArray]) -> EventArray:
    """Events of one camera one after the other; those of one packet as they are."""
    if len(events) == 1:
        return events[0]
    width, height = events[0].sensor_size
    return EventArray(np.concatenate([each.to_numpy() for each in events]), width=width, height=height)


def _joined_windows(windows: list[DenseWindows]) -> DenseWindows:
    """Dense arrays of one camera one after the other."""
    none = [np.zeros(0, np.int64)]
    return DenseWindows(
        np.concatenate([*none, *(each.start_us for each in windows)]),
        np.concatenate([*none, *(each.end_us for each in windows)]),
        tuple(array for each in windows for array in each.arrays),
    )


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
    """Quaternions (w, x, y, z) that turn -Z to directions (…, 3) by the shortest way."""
    way = np.asarray(direction, np.float64)
    way = way / np.maximum(np.sqrt(np.einsum("...i,...i->...", way, way)), 1e-300)[..., None]
    found = np.zeros((*way.shape[:-1], 4))
    found[..., 0], found[..., 1], found[..., 2] = 1 - way[..., 2], way[..., 1], -way[..., 0]
    found[way[..., 2] > 1 - 1e-12] = 0.0, 1.0, 0.0, 0.0
    return np.asarray(found / np.sqrt(np.einsum("...i,...i->...", found, found))[..., None])


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


def _tendon_ends(data: Any, parts: list[tuple[int, int, int]]) -> tuple[Array, Array]:
    """Return ends of parts of tendons as MuJoCo draws them, and the ways back along them, (P, 3) each.

    `parts`: tendon, number of the part, and which end. Parts are counted along the way: from 0 on those
    outside of what the tendon wraps around, from -1 down those within. One that is not there lies in the last
    point.
    """
    starts, counts = data.ten_wrapadr, data.ten_wrapnum
    points = np.asarray(data.wrap_xpos).reshape(-1, 3)
    objects = np.asarray(data.wrap_obj).ravel().tolist()
    drawn: dict[int, tuple[dict[int, int], int]] = {}
    first, last, ends = [], [], []
    for tendon, part, end in parts:
        if tendon not in drawn:
            drawn[tendon] = _tendon_ways(objects, int(starts[tendon]), int(counts[tendon]))
        ways, rest = drawn[tendon]
        at = ways.get(part)
        first.append(rest if at is None else at)
        last.append(rest if at is None else at + 1)
        ends.append(end)
    begin, stop = (np.where(np.array(which)[:, None] < 0, 0.0, points[which]) for which in (first, last))
    back = begin - stop
    # Where there is no way it points down.
    back[np.abs(back).max(axis=1) <= 1e-12] = 0.0, 0.0, -1.0
    return np.where(np.array(ends)[:, None] == 0, begin, stop), back


def _tendon_ways(objects: list[int], start: int, count: int) -> tuple[dict[int, int], int]:
    """At which point each part of a tendon begins, and its last point, -1 for none."""
    ways: dict[int, int] = {}
    outside = within = 0
    for k in range(start, start + count - 1):
        # A pulley cuts the way.
        if objects[k] == -2 or objects[k + 1] == -2:
            continue
        if objects[k] >= 0 and objects[k + 1] >= 0:
            within += 1
            ways[-within] = k
        else:
            ways[outside] = k
            outside += 1
    real = [k for k in range(start, start + count) if objects[k] != -2]
    return ways, real[-1] if real else -1


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
        #: Tendon, number of the part (see `_tendon_ends`), and its radius.
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
            # True is an integer to Python, and a slip here.
            if isinstance(choice, (bool, np.bool_)) or not hasattr(choice, "__index__"):
                raise ConfigError(
                    f"camera is {_check.shown(choice)}; it must be a name, an index or an mujoco.MjvCamera"
                )
            found = _check.whole("camera", choice, -(2**31), 2**31 - 1)
            if not -1 <= found < model.ncam:
                have = f"cameras 0 to {model.ncam - 1}" if model.ncam else "no camera"
                raise ConfigError(f"camera is {found}; the model has {have}, and -1 is the free camera")
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
        for kind, index in self.shown():
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

    def carrier(self, view: int) -> int | None:
        """Return the moving body that carries a camera."""
        if view < 0 or not self._is_fixed("cam", view):
            return None
        body = int(self.model.cam_bodyid[view])
        return body if self.moving[body] else None

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

    def shown(self) -> list[tuple[str, int]]:
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
            at, ways = _tendon_ends(self.data, [(tendon, part, end) for end in range(2)])
            turns = _towards(ways)
            joints = [
                self._glb.add_node(f"{name}/{end}", (pose := _seven(at[end], turns[end]))[:3], pose[3:])
                for end in range(2)
            ]
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
                near=near,
                pose=Placement(position=pose[:3], rotation=pose[3:]),
                **self._lens(view, float(model.vis.global_.fovy)),
            )
        width, height = self.size or (int(v) for v in model.cam_resolution[view])
        if min(width, height) <= 1:
            width, height = 640, 480
        lens: dict[str, Any] = {}
        sensor = np.asarray(model.cam_sensorsize[view], np.float64)
        if sensor[1] > 0 and not _is_orthographic(model, view):
            focal_x, focal_y, x, _ = (float(v) for v in model.cam_intrinsic[view])
            lens["fx"], lens["fy"] = focal_x / sensor[0] * width, focal_y / sensor[1] * height
            lens["cx"] = width * (0.5 - x / sensor[0])
            lens["cy"] = height * self._above(view)
        else:
            lens = self._lens(view, float(model.cam_fovy[view]))
        if self._is_fixed("cam", view):
            place = _seven(model.cam_pos[view], model.cam_quat[view])
            parent = _body(model, int(model.cam_bodyid[view]))
        else:
            place = _seven(self.data.cam_xpos[view], _quaternion(self.data.cam_xmat[view]))
            parent = None
        placed = Placement(position=place[:3], rotation=place[3:], parent=parent)
        return EventCamera(name=name, width=width, height=height, near=near, pose=placed, **lens)

    def _lens(self, view: int, fovy: float) -> dict[str, Any]:
        """Lens of a camera without sensor size: `fovy` is in degrees, or a length if it is orthographic."""
        if not _is_orthographic(self.model, view):
            return {"fov_y_degrees": fovy}
        far = float(self.model.vis.map.zfar * self.model.stat.extent)
        return {"orthographic_height": fovy, "far": far}

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
        for index in range(model.nsensor):
            if model.sensor_type[index] == mujoco.mjtSensor.mjSENS_RANGEFINDER:
                name = _name(model, _OBJECT.mjOBJ_SENSOR, index)
                self._omit_named("rays of rangefinders are not drawn", f"sensor '{name}'")
        for index in range(model.ntendon):
            if 0 < self._appearance("tendon", index)[1][3] < _TRANSPARENT:
                name = _name(model, _OBJECT.mjOBJ_TENDON, index)
                self._omit_named("transparent, not drawn (alpha below 0.5)", f"tendon '{name}'")
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
