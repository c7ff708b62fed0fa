"""Environments of Gymnasium: the batch equals single ones, in every autoreset mode; seeds are honoured."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_readme import blocks, run_code

import evis
from evis.motion import Placement
from evis.representations import Dense

gymnasium = pytest.importorskip("gymnasium", reason="Gymnasium is not installed: pip install 'evis[gym]'")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AutoresetMode, SyncVectorEnv  # noqa: E402

from evis.gym import EventEnv, EventVectorEnv, InitialState, Transition  # noqa: E402

ROOT = Path(__file__).parent.parent
SIZE = (24, 18)
MODES = list(AutoresetMode)


class Push:
    """An action pushes a cube sideways; an episode ends where it has gone too far."""

    def __init__(self, count: int) -> None:
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.x = np.zeros(count)
        self.broken: float | None = None

    def poses(self, ids: np.ndarray) -> dict[str, np.ndarray]:
        poses = np.zeros((len(ids), 7))
        poses[:, 0], poses[:, 6] = self.x[ids], 1.0
        return {"cube": poses}

    def reset(self, ids: np.ndarray, rngs: Any) -> dict[str, np.ndarray]:
        self.x[ids] = [rng.uniform(-0.2, 0.2) for rng in rngs]
        return self.poses(ids)

    def step(self, ids: np.ndarray, actions: np.ndarray) -> Transition:
        self.x[ids] += 0.1 * actions[:, 0]
        poses = self.poses(ids)
        if self.broken is not None:
            poses["cube"][0, 0] = self.broken
        return Transition(poses, self.x[ids].copy(), np.abs(self.x[ids]) > 0.3)


def simulator(device: evis.Device, environments: int, **more: Any) -> evis.Simulator:
    builder = evis.SceneBuilder("push", duration=1.0, ambient=(1.0, 1.0, 1.0))
    builder.texture("checker", pattern="checker")
    builder.material("painted", texture="checker")
    builder.box("cube", size=(0.8, 0.8, 0.8), material="painted")
    eye = Placement(position=(0.2, 0.4, 2.5), look_at=(0, 0, 0))
    builder.camera(evis.EventCamera(name="eye", width=SIZE[0], height=SIZE[1], pose=eye))
    for _ in range(environments):
        builder.environments(1)
    config = {"rate_hz": 400.0, "samples": 1, "poses": ["cube"], "reference_luminance": 1.0, **more}
    return evis.Simulator(builder.build(), device=device, **config)


def many(device: evis.Device, count: int = 3, noisy: bool = False, **options: Any) -> EventVectorEnv:
    more = {"sensor": "v2e-noisy"} if noisy else {}
    return EventVectorEnv(simulator(device, count, **more), Push(count), **options)


def equal(one: Any, other: Any) -> bool:
    """Compare observations, rewards, terminations, truncations."""
    return all(np.array_equal(a, b) for a, b in zip(one[:4], other[:4], strict=True))


@pytest.mark.parametrize(
    "observation", ["counts", Dense("voxel_grid", bins=3), Dense("time_surface", tau_us=5e3)]
)
def test_gymnasium_accepts_the_single_environment(device: evis.Device, observation: Any) -> None:
    env = EventEnv(simulator(device, 1), Push(1), observation=observation, max_steps=10)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)
    assert env.observation_space.shape[1:] == (SIZE[1], SIZE[0])
    env.reset(seed=1)
    observation, _, _, _, info = env.step(np.array([1.0], np.float32))
    assert len(info["events"]) > 50
    assert observation.any()


@pytest.mark.parametrize("mode", MODES)
def test_the_batch_equals_single_environments(device: evis.Device, mode: AutoresetMode) -> None:
    count = 3
    batch = many(device, count, autoreset_mode=mode, max_steps=4)
    makes = [lambda: EventEnv(simulator(device, 1), Push(1), max_steps=4)] * count
    single = SyncVectorEnv(makes, autoreset_mode=mode)
    assert batch.observation_space == single.observation_space
    first, _ = batch.reset(seed=5)
    expected, _ = single.reset(seed=5)
    assert np.array_equal(first, expected)
    rng = np.random.default_rng(0)
    ends = differences = 0
    for _ in range(10):
        actions = rng.uniform(-1, 1, (count, 1)).astype(np.float32)
        one, other = batch.step(actions), single.step(actions)
        assert equal(one, other)
        assert one[0] in batch.observation_space
        ended = one[2] | one[3]
        ends += int(ended.sum())
        differences += not equal(one, [np.roll(part, 1, axis=0) for part in other[:4]])
        if mode == AutoresetMode.SAME_STEP and ended.any():
            for i in np.flatnonzero(ended):
                assert np.array_equal(one[4]["final_obs"][i], other[4]["final_obs"][i])
                assert not one[0][i].any()
        if mode == AutoresetMode.DISABLED and ended.any():
            options = {"reset_mask": ended}
            one_obs, _ = batch.reset(options=dict(options))
            other_obs, _ = single.reset(options=dict(options))
            assert np.array_equal(one_obs[ended], other_obs[ended])
    assert ends > 2
    assert differences > 5, "canary: environments are told apart"


def test_seeds_are_honoured_with_noise(device: evis.Device) -> None:
    env = many(device, 2, noisy=True)
    actions = np.full((2, 1), 0.3, np.float32)

    def episode(seed: int) -> list[Any]:
        env.reset(seed=seed)
        return [env.step(actions) for _ in range(3)]

    first, again, other = episode(1), episode(1), episode(2)
    assert all(map(equal, first, again))
    assert not all(map(equal, first, other)), "canary"
    for one, two in zip(first, again, strict=True):
        assert all(a == b for a, b in zip(one[4]["events"], two[4]["events"], strict=True))


class Drawn(Push):
    """Thresholds and colour are drawn with each episode."""

    def reset(self, ids: np.ndarray, rngs: Any) -> Any:
        sensors = [evis.Sensor(threshold_on=rng.uniform(0.1, 0.4)) for rng in rngs]
        colors = np.array([rng.uniform(0.2, 1.0, 3) for rng in rngs])
        return InitialState(
            super().reset(ids, rngs), sensor=sensors, materials={"painted": {"color": colors}}
        )


def test_sensors_and_materials_are_drawn_with_each_episode(device: evis.Device) -> None:
    def rollout(task: type[Push], seed: int) -> list[bytes]:
        batch = EventVectorEnv(
            simulator(device, 3, materials=["painted"]), task(3), max_steps=2, autoreset_mode="SameStep"
        )
        batch.reset(seed=seed)
        found = []
        for _ in range(5):
            *_, info = batch.step(np.full((3, 1), 0.5, np.float32))
            found += [window.tobytes() for window in info["events"]]
        return found

    first = rollout(Drawn, 1)
    assert first == rollout(Drawn, 1)
    assert first != rollout(Drawn, 2)
    assert first != rollout(Push, 1), "canary"


def test_events_are_those_of_the_step(device: evis.Device) -> None:
    env = many(device, 2)
    env.reset(seed=1)
    observations, _, _, _, info = env.step(np.full((2, 1), 1.0, np.float32))
    for i, window in enumerate(info["events"]):
        assert (window.start_us, window.end_us) == (0, 10_000)
        assert len(window) > 20
        assert np.array_equal(window.counts(), observations[i])
    assert info["_events"].all()


def test_a_broken_pose_holds_its_environment_until_it_is_reset(device: evis.Device) -> None:
    env = many(device, 2)
    env.reset(seed=1)
    push = np.full((2, 1), 0.3, np.float32)
    env._batch.task.broken = np.nan
    observations, _, terminated, truncated, info = env.step(push)
    assert info["held"].tolist() == [True, False]
    assert truncated.tolist() == [True, False]
    assert not terminated.any()
    assert not observations[0].any()
    assert observations[1].any()
    env._batch.task.broken = None
    env.step(push)
    observations, _, _, truncated, info = env.step(push)
    assert not info["held"].any()
    assert observations[0].any()


def test_what_cannot_be_used_is_refused(device: evis.Device) -> None:
    sim = simulator(device, 2)
    for make, message in [
        (lambda: EventEnv(sim, Push(2)), "has 2 environments"),
        (lambda: EventVectorEnv(sim, Push(2), observation="count"), "'count'"),
        (lambda: EventVectorEnv(sim, Push(2), autoreset_mode="never"), "NextStep"),
        (lambda: EventVectorEnv(sim, Push(2), camera="left"), "camera is 'left'"),
        (lambda: EventVectorEnv(sim, Push(2), step_us=0), "step_us is 0"),
        (lambda: EventVectorEnv("sim", Push(2)), "evis.Simulator"),
    ]:
        with pytest.raises(evis.ConfigError, match=re.escape(message)):
            make()
    env = many(device, 2, autoreset_mode="Disabled", max_steps=1)
    env.reset(seed=1)
    with pytest.raises(evis.ConfigError, match="one per environment"):
        env.step(np.zeros((3, 1), np.float32))
    env.step(np.zeros((2, 1), np.float32))
    with pytest.raises(evis.ConfigError, match="have ended"):
        env.step(np.zeros((2, 1), np.float32))
    with pytest.raises(evis.ConfigError, match="reset_mask"):
        env.reset(options={"reset_mask": np.zeros(2, bool)})
    with pytest.raises(evis.ConfigError, match="one per environment: 2"):
        env.reset(seed=[1])


@pytest.mark.parametrize("page", ["gym", "hosts"])
def test_code_of_the_documents_runs(device: evis.Device, page: str, tmp_path: Path) -> None:
    codes = blocks(ROOT / f"docs/{page}.md", "python")
    assert codes
    for code in codes:
        done = run_code(code, tmp_path)
        assert done.returncode == 0, done.stderr
        assert len(done.stdout.splitlines()) >= 2


def test_arrays_of_the_simulator_are_observations(device: evis.Device) -> None:
    kind = Dense("voxel_grid", bins=3)
    seen = []
    for more in ({"dense": kind}, {}):
        sim = simulator(device, 2, **more)
        env = EventVectorEnv(sim, Push(2), observation=None if more else kind)
        observations, infos = env.reset(seed=5)
        assert ("events" in infos) == (not more)
        seen.append([observations])
        for action in (0.5, -1.0, 1.0):
            observations, _, _, _, infos = env.step(np.full((2, 1), action, np.float32))
            assert ("events" in infos) == (not more)
            seen[-1].append(observations)
    for own, of in zip(*seen, strict=True):
        np.testing.assert_allclose(own, of, atol=2e-5)
    assert np.abs(seen[0]).sum() > 10
    single = EventEnv(simulator(device, 1, dense=kind), Push(1))
    assert "events" not in single.reset(seed=1)[1]
    assert single.step(np.ones(1, np.float32))[0].shape == (3, *SIZE[::-1])


def test_arrays_of_the_simulator_fix_observation_and_step(device: evis.Device) -> None:
    with pytest.raises(evis.ConfigError, match="in the place of events"):
        EventEnv(simulator(device, 1, dense="counts"), Push(1), observation="event_frame")
    with pytest.raises(evis.ConfigError, match="step_us=20000"):
        EventEnv(simulator(device, 1, dense="counts", dense_window_us=20_000), Push(1))


def test_lights_and_lenses_are_drawn_with_each_episode(device: evis.Device) -> None:
    """What an `InitialState` says of them reaches the simulator."""

    class Lit(Push):
        def reset(self, ids: np.ndarray, rngs: Any) -> Any:
            lights = {"lamp": {"intensity": [rng.uniform(1.0, 9.0) for rng in rngs]}}
            lenses = {"eye": {"fov_y_degrees": [rng.uniform(30.0, 60.0) for rng in rngs]}}
            return InitialState(super().reset(ids, rngs), lights=lights, lenses=lenses)

    builder = evis.SceneBuilder("lit", duration=1.0, ambient=(0.1, 0.1, 0.1))
    builder.texture("checker", pattern="checker")
    builder.material("painted", texture="checker")
    builder.box("cube", size=(0.8, 0.8, 0.8), material="painted")
    builder.light(
        "lamp", kind="directional", intensity=5.0, pose=Placement(position=(1, 3, 2), look_at=(0, 0, 0))
    )
    eye = Placement(position=(0.2, 0.4, 2.5), look_at=(0, 0, 0))
    builder.camera(evis.EventCamera(name="eye", width=SIZE[0], height=SIZE[1], pose=eye))
    builder.environments(2)
    settings = {
        "rate_hz": 400.0,
        "samples": 1,
        "poses": ["cube"],
        "lights": ["lamp"],
        "reference_luminance": 1.0,
    }
    batch = EventVectorEnv(evis.Simulator(builder.build(), device=device, **settings), Lit(2))
    batch.reset(seed=3)

    def focal_lengths() -> list[float]:
        # A reset of all with a seed starts another simulator.
        return [batch._batch.simulator.cameras_of(environment)[0].fx for environment in range(2)]

    first = focal_lengths()
    assert first[0] != first[1]
    *_, info = batch.step(np.full((2, 1), 0.5, np.float32))
    assert all(len(window) > 0 for window in info["events"])
    batch.reset(seed=4)
    assert focal_lengths() != first
