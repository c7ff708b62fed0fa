"""Gymnasium environments whose observations are events: one, and many in one batch of the simulator.

Needs the extra ``gym``. A `Task` says where things are and what they are worth; the simulator's own batch
renders all environments at once, in this process. ``docs/gym.md`` has the details.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

try:
    import gymnasium
    from gymnasium.spaces import Box
    from gymnasium.utils import seeding
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise ImportError("evis.gym needs Gymnasium; install it: pip install 'evis[gym]'") from error

from . import _check
from ._events import EventCD, EventWindow
from ._evis import ConfigError
from ._packets import Packet
from ._simulator import Simulator
from .representations import Dense, dense

__all__ = ["EventEnv", "EventVectorEnv", "InitialState", "Task", "Transition"]

_UNIT_TOLERANCE = 1e-3

# Bounds of values by representation; what is not here has none.
_BOUNDS: dict[str, tuple[float, float]] = {
    "counts": (0, np.iinfo(np.int32).max),
    "event_frame": (np.iinfo(np.int32).min, np.iinfo(np.int32).max),
    "time_surface": (0, 1),
    "binary_stack": (0, 1),
    "bina_rep": (0, 1),
}


@dataclass(frozen=True)
class Transition:
    """What a task makes of actions, of K environments.

    Attributes
    ----------
    poses : mapping of str to array
        Where nodes are at the end of the step, by name: (K, 7) as of `Simulator.step`, or (7,) for all.
    reward : array
        float (K,).
    terminated : array
        bool (K,): the episode ends with this step.
    """

    poses: Mapping[str, npt.ArrayLike]
    reward: npt.ArrayLike
    terminated: npt.ArrayLike


@dataclass(frozen=True)
class InitialState:
    """How K environments begin an episode, where more than poses is drawn for each.

    Attributes
    ----------
    poses : mapping of str to array
        Where nodes are, by name: (K, 7), or (7,) for all.
    sensor : Sensor, str, sequence or mapping of them by camera, optional
        As of `Simulator.reset`: one for all, or one of K each. The sensors stay as they are where not given.
    visible, materials, lights, lenses : mapping, optional
        As of `Simulator.reset`, with K in front.
    """

    poses: Mapping[str, npt.ArrayLike]
    sensor: Any = None
    visible: Mapping[str, npt.ArrayLike] | None = None
    materials: Mapping[str, Mapping[str, npt.ArrayLike]] | None = None
    lights: Mapping[str, Mapping[str, npt.ArrayLike]] | None = None
    lenses: Mapping[str, Mapping[str, npt.ArrayLike]] | None = None


class Task(Protocol):
    """Dynamics of a batch of environments; the state is the task's own.

    Attributes
    ----------
    action_space : gymnasium.Space
        Actions of one environment.
    """

    action_space: Any

    def reset(
        self, env_ids: npt.NDArray[np.int64], rngs: Sequence[np.random.Generator]
    ) -> Mapping[str, npt.ArrayLike] | InitialState:
        """Begin episodes of the K environments ``env_ids``, each with its generator.

        Returns poses, (K, 7), or an `InitialState` with sensors, materials, lights, lenses and what is seen,
        too.
        """
        ...

    def step(self, env_ids: npt.NDArray[np.int64], actions: Any) -> Transition:
        """Take ``actions``, K in a batch, of the environments ``env_ids``."""
        ...


class _Batch:
    """A simulator, a task, and where everything is."""

    def __init__(
        self,
        simulator: Simulator,
        task: Task,
        step_us: int,
        observation: str | Dense | Any | None,
        camera: str | None,
        max_steps: int | None,
    ) -> None:
        if not isinstance(simulator, Simulator):
            raise ConfigError(f"simulator is {_check.shown(simulator)}; it must be an evis.Simulator")
        if not isinstance(task.action_space, gymnasium.Space):
            raise ConfigError(
                f"task.action_space is {_check.shown(task.action_space)}; it must be a gymnasium.Space"
            )
        names = [each.name for each in simulator.cameras]
        if camera is None and len(names) > 1:
            raise ConfigError(
                f"there are {len(names)} cameras ({', '.join(names)}): choose one, camera='NAME'"
            )
        if camera is not None and camera not in names:
            raise ConfigError(f"camera is '{camera}'; it must be {_check.one_of(names)}")
        self.simulator, self.task = simulator, task
        self.step_us = _check.whole("step_us", step_us, 1, _check.MOST_US, " microseconds")
        self.max_steps = None if max_steps is None else _check.whole("max_steps", max_steps, 1)
        self.camera = names[0] if camera is None else camera
        self.size = next((c.width, c.height) for c in simulator.cameras if c.name == self.camera)
        observation = self._observation(observation)
        self.dense = dense(observation)
        empty = self.observe(self.nothing())
        name = observation if isinstance(observation, str) else getattr(observation, "name", "")
        low, high = _BOUNDS.get(name, (-np.inf, np.inf))
        self.space = Box(low, high, empty.shape, empty.dtype.type)
        self.count = simulator.environments
        self.poses: dict[str, npt.NDArray[np.float64]] = {}
        self.steps = np.zeros(self.count, np.int64)

    def _observation(self, observation: Any) -> Any:
        """Return what becomes an observation: what is asked for, or what the simulator makes."""
        own = self.simulator.dense
        if own is None:
            return "counts" if observation is None else observation
        if observation is not None and dense(observation) != own:
            raise ConfigError(
                f"observation is {_check.shown(observation)}, and the simulator makes {own!r} in the place "
                "of events; leave observation away, or make the simulator without dense="
            )
        window_us = self.simulator.dense_window_us
        if self.step_us != window_us or self.simulator.now_us % window_us:
            raise ConfigError(
                f"step_us is {self.step_us} from {self.simulator.now_us} us on; with dense arrays of the "
                f"simulator a step is one of their windows: step_us={window_us}, from a multiple of it on"
            )
        return own

    def restart(self) -> None:
        """Start again at time 0, so that nothing depends on what came before."""
        if self.simulator.now_us > 0:
            self.simulator = copy.copy(self.simulator)

    def nothing(self) -> EventWindow:
        """No events, now."""
        now = self.simulator.now_us
        return EventWindow._of(np.empty(0, EventCD), *self.size, now, now + self.step_us)

    def reset(
        self, env_ids: npt.NDArray[np.int64], rngs: Sequence[np.random.Generator], seeds: list[int] | None
    ) -> None:
        begun = self.task.reset(env_ids, rngs)
        if not isinstance(begun, InitialState):
            begun = InitialState(begun)
        poses = self._rows("Task.reset", begun.poses, len(env_ids))
        for name, rows in poses.items():
            bad = _unusable(rows)
            if bad.any():
                environment = int(env_ids[int(np.argmax(bad))])
                raise ConfigError(
                    f"Task.reset gave environment {environment} a pose of '{name}' that is not finite, or no "
                    "unit quaternion; give x, y, z, qx, qy, qz, qw"
                )
        self.simulator.reset(
            env_ids,
            seed=seeds,
            sensor=begun.sensor,
            poses=poses,
            visible=begun.visible,
            materials=begun.materials,
            lights=begun.lights,
            lenses=begun.lenses,
        )
        for name, rows in poses.items():
            self.poses.setdefault(name, np.tile(rows[:1], (self.count, 1)))[env_ids] = rows
        self.steps[env_ids] = 0

    def step(
        self, env_ids: npt.NDArray[np.int64], actions: Any
    ) -> tuple[
        Packet, npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], npt.NDArray[np.bool_]
    ]:
        """Take actions of the environments ``env_ids``; rewards, ends and held ones of all."""
        reward = np.zeros(self.count)
        terminated, truncated, held = (np.zeros(self.count, bool) for _ in range(3))
        if len(env_ids):
            made = self.task.step(env_ids, actions)
            poses = self._rows("Task.step", made.poses, len(env_ids))
            bad = np.zeros(len(env_ids), bool)
            for rows in poses.values():
                bad |= _unusable(rows)
            held[env_ids] = bad
            for name, rows in poses.items():
                kept = self.poses.setdefault(name, np.tile(rows[:1], (self.count, 1)))
                kept[env_ids[~bad]] = rows[~bad]
            reward[env_ids] = made.reward
            terminated[env_ids] = made.terminated
            self.steps[env_ids] += 1
            if self.max_steps is not None:
                truncated[env_ids] = self.steps[env_ids] >= self.max_steps
            truncated |= held & ~terminated
        packet = self.simulator.step(self.simulator.now_us + self.step_us, self.poses)
        return packet, reward, terminated, truncated, held

    def observed(self, packet: Packet, environment: int) -> tuple[npt.NDArray[Any], EventWindow | None]:
        """Return what an environment sees, (C, H, W), and its events, where there are any."""
        view = packet[environment][self.camera]
        if view.dense is not None:
            made = view.dense[-1]
            return made.reshape(-1, *made.shape[-2:]), None
        window = self.window(packet, environment)
        return self.observe(window), window

    def window(self, packet: Packet, environment: int) -> EventWindow:
        events = packet[environment][self.camera].events.to_numpy()
        return EventWindow._of(events, *self.size, packet.start_us, packet.end_us)

    def observe(self, window: EventWindow) -> npt.NDArray[Any]:
        """(C, H, W)."""
        made: npt.NDArray[Any] = np.asarray(self.dense(window))
        return made.reshape(-1, *made.shape[-2:])

    def _rows(
        self, what: str, poses: Mapping[str, npt.ArrayLike], count: int
    ) -> dict[str, npt.NDArray[np.float64]]:
        found = {}
        for name, value in poses.items():
            rows = np.asarray(value, np.float64)
            if rows.shape not in ((7,), (count, 7)):
                raise ConfigError(
                    f"{what} gave '{name}' poses of the shape {rows.shape}; it must be ({count}, 7), "
                    "or (7,) for all"
                )
            found[name] = np.broadcast_to(rows, (count, 7))
        return found


def _unusable(rows: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) > _UNIT_TOLERANCE
    bad: npt.NDArray[np.bool_] = off | ~np.isfinite(rows).all(axis=1)
    return bad


class EventEnv(gymnasium.Env[Any, Any]):
    """One environment, as Gymnasium has it.

    Parameters
    ----------
    simulator : Simulator
        With one environment, made with ``poses=[...]`` of what the task moves. The environment takes it over.
    task : Task
        Dynamics, rewards and ends.
    step_us : int
        Microseconds of a step, a multiple of the simulator's ``pose_step_us``.
    observation : str, Dense or callable
        What becomes of a step's events: name of a function of `evis.representations`, that function with
        parameters, or what makes an array of an `EventWindow`. Its leading axes become one: (C, H, W). Where
        not given, what the simulator makes (``dense`` of `Simulator`, whose windows are steps then), else
        ``counts``.
    camera : str, optional
        The camera, where there are several.
    max_steps : int, optional
        Steps after which an episode is truncated.

    Raises
    ------
    ConfigError
        If a parameter cannot be used; from `step` and `reset`, if the task's poses cannot be.

    Notes
    -----
    ``info["events"]`` has the events of the step, an `EventWindow`; their times go on over episodes. It is
    missing where the simulator makes dense arrays in the place of events.
    ``info["held"]`` tells that a pose was not finite or no unit quaternion: the environment then stays where
    it is, and the episode is truncated. `reset` with a seed restarts the simulator at time 0: the same
    seed and actions give the same bytes.
    """

    def __init__(
        self,
        simulator: Simulator,
        task: Task,
        *,
        step_us: int = 10_000,
        observation: str | Dense | Any = None,
        camera: str | None = None,
        max_steps: int | None = None,
    ) -> None:
        self._batch = _Batch(simulator, task, step_us, observation, camera, max_steps)
        if self._batch.count != 1:
            raise ConfigError(
                f"simulator has {self._batch.count} environments; for several use EventVectorEnv"
            )
        self.observation_space = self._batch.space
        self.action_space = task.action_space

    @property
    def simulator(self) -> Simulator:
        """The simulator in use; `reset` with a seed makes another one with the same settings."""
        return self._batch.simulator

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Begin an episode; returns an observation of no events."""
        super().reset(seed=seed)
        if seed is not None:
            self._batch.restart()
        self._batch.reset(np.zeros(1, np.int64), [self.np_random], None if seed is None else [seed])
        nothing = self._batch.nothing()
        return self._batch.observe(nothing), self._info(nothing, False)

    def step(self, action: Any) -> tuple[npt.NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Take an action; returns observation, reward, terminated, truncated and info."""
        actions = np.asarray(action)[None]
        packet, reward, terminated, truncated, held = self._batch.step(np.zeros(1, np.int64), actions)
        seen, window = self._batch.observed(packet, 0)
        info = self._info(window, bool(held[0]))
        return seen, float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def _info(self, window: EventWindow | None, held: bool) -> dict[str, Any]:
        return {"held": held} if self._batch.simulator.dense is not None else {"events": window, "held": held}


class EventVectorEnv(VectorEnv[Any, Any, Any]):
    """The environments of a simulator's batch, side by side in this process.

    Parameters
    ----------
    simulator, task, step_us, observation, camera, max_steps
        As of `EventEnv`; the simulator has N environments.
    autoreset_mode : AutoresetMode or str
        ``NEXT_STEP``: an environment whose episode has ended is reset by the next `step`, which does not take
        its action; its reward is 0, and its observation that of a step at rest. ``SAME_STEP``: it is reset by
        the step that ends the episode; ``info["final_obs"]`` and ``info["final_info"]`` are of the end.
        ``DISABLED``: the caller resets it, ``reset(options={"reset_mask": mask})``.

    Raises
    ------
    ConfigError
        If a parameter cannot be used; from `step` and `reset`, if the task's poses or the actions cannot be.

    Notes
    -----
    Observations are (N, C, H, W). ``info["events"]`` is an array of N `EventWindow`, ``info["held"]`` as of
    `EventEnv`. A reset sets the pixel memory of its environment and of no other one. Seeds: environment i has
    ``seed + i``; a reset of all with seeds restarts the simulator at time 0.
    """

    def __init__(
        self,
        simulator: Simulator,
        task: Task,
        *,
        step_us: int = 10_000,
        observation: str | Dense | Any = None,
        camera: str | None = None,
        max_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        self._batch = _Batch(simulator, task, step_us, observation, camera, max_steps)
        self.num_envs = self._batch.count
        try:
            mode = AutoresetMode(autoreset_mode)
        except ValueError:
            known = _check.one_of(str(each.value) for each in AutoresetMode)
            raise ConfigError(
                f"autoreset_mode is {_check.shown(autoreset_mode)}; it must be {known}"
            ) from None
        self.autoreset_mode = mode
        self.metadata = {"autoreset_mode": mode}
        self.single_observation_space = self._batch.space
        self.single_action_space = task.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._rngs: list[np.random.Generator] = [seeding.np_random(None)[0] for _ in range(self.num_envs)]
        self._ended = np.zeros(self.num_envs, bool)
        box = self._batch.space
        self._observations: npt.NDArray[Any] = np.zeros((self.num_envs, *box.shape), box.dtype)

    @property
    def simulator(self) -> Simulator:
        """The simulator in use; `reset` with seeds makes another one with the same settings."""
        return self._batch.simulator

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Begin episodes of all environments, or of those of ``options["reset_mask"]``, bool (N,)."""
        mask = (options or {}).get("reset_mask")
        if mask is None:
            mask = np.ones(self.num_envs, bool)
        mask = np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ConfigError(
                f"reset_mask is {_check.shown(mask)}; it must be bool ({self.num_envs},) with a True in it"
            )
        ids = np.flatnonzero(mask)
        seeds: list[int] | None = None
        if seed is not None:
            single = hasattr(seed, "__index__")
            each = (
                [seed + i for i in range(self.num_envs)]  # type: ignore[operator]
                if single
                else _check.items("seed", seed, "[0, 1]")
            )
            if len(each) != self.num_envs:
                raise ConfigError(
                    f"seed has {len(each)} entries; it must have one per environment: {self.num_envs}"
                )
            chosen = [each[i] for i in ids]
            for i in ids:
                if each[i] is not None:
                    self._rngs[i] = seeding.np_random(_check.whole("seed", each[i], 0, 2**63 - 1))[0]
            if all(one is not None for one in chosen):
                seeds = chosen
                if mask.all():
                    self._batch.restart()
        self._ended[ids] = False
        self._reset(ids, seeds)
        nothing = self._batch.nothing()
        return self._observations.copy(), self._infos(
            [nothing] * self.num_envs, np.zeros(self.num_envs, bool)
        )

    def step(
        self, actions: Any
    ) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Take a batch of actions; returns observations, rewards, terminations, truncations and infos."""
        actions = np.asarray(actions)
        if actions.shape[:1] != (self.num_envs,):
            raise ConfigError(
                f"actions has the shape {actions.shape}; it must have one per environment: {self.num_envs}"
            )
        acting = np.ones(self.num_envs, bool)
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:
            acting = ~self._ended
            if self._ended.any():
                self._reset(np.flatnonzero(self._ended), None)
        elif self._ended.any():
            raise ConfigError(
                f"episodes of the environments {np.flatnonzero(self._ended).tolist()} have ended; reset "
                "them: reset(options={'reset_mask': mask})"
            )
        ids = np.flatnonzero(acting)
        packet, reward, terminated, truncated, held = self._batch.step(ids, actions[ids])
        windows: list[EventWindow | None] = []
        for i in range(self.num_envs):
            self._observations[i], window = self._batch.observed(packet, i)
            windows.append(window)
        ended = terminated | truncated
        infos: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            nothing = self._batch.nothing()
            final_obs = np.full(self.num_envs, None, object)
            for i in np.flatnonzero(ended).tolist():
                final_obs[i] = self._observations[i].copy()
            final_info = self._infos(windows, held, ended)
            infos = {"final_obs": final_obs, "_final_obs": ended.copy()}
            infos |= {"final_info": final_info, "_final_info": ended.copy()}
            self._reset(np.flatnonzero(ended), None)
            windows = [nothing if ended[i] else window for i, window in enumerate(windows)]
            held = held & ~ended
        else:
            self._ended = ended
        infos |= self._infos(windows, held)
        return self._observations.copy(), reward, terminated, truncated, infos

    def _reset(self, ids: npt.NDArray[np.int64], seeds: list[int] | None) -> None:
        self._batch.reset(ids, [self._rngs[i] for i in ids], seeds)
        self._observations[ids] = self._batch.observe(self._batch.nothing())

    def _infos(
        self,
        windows: Sequence[EventWindow | None],
        held: npt.NDArray[np.bool_],
        present: npt.NDArray[np.bool_] | None = None,
    ) -> dict[str, Any]:
        known = np.ones(self.num_envs, bool) if present is None else present.copy()
        infos: dict[str, Any] = {"held": held.copy(), "_held": known.copy()}
        if self._batch.simulator.dense is None:
            events = np.empty(self.num_envs, object)
            for i, window in enumerate(windows):
                events[i] = window
            infos |= {"events": events, "_events": known}
        return infos
