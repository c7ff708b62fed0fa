"""Single environments are reset with their pixel memory; the bytes of the others do not change."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import evis
from evis.motion import Placement

STEP_US = 10_000
ENVIRONMENTS = 3

SETTINGS: dict[str, dict[str, Any]] = {
    "native": {"rate_hz": 1000.0, "samples": 4, "method": "native"},
    "standard": {"quality": "standard"},
    "chain": {"quality": "standard", "sensor": "v2e-noisy"},
    "wire": {
        "rate_hz": 500.0,
        "samples": 1,
        "sensor": evis.Sensor(readout=evis.sensors.Readout(latency_us=3000.0)),
    },
    "host": {"rate_hz": 500.0, "samples": 1, "sensor": "davis346"},
}


def scene(environments: int = ENVIRONMENTS) -> evis.Scene:
    builder = evis.SceneBuilder("reset", duration=1.0, ambient=(1.0, 1.0, 1.0))
    builder.texture("checker", pattern="checker")
    builder.material("painted", texture="checker")
    builder.box("cube", size=(0.8, 0.8, 0.8), material="painted", pose=Placement(position=(-0.3, 0, 0)))
    eye = Placement(position=(0.2, 0.4, 2.5), look_at=(0, 0, 0))
    builder.camera(evis.EventCamera(name="eye", width=40, height=30, pose=eye))
    for _ in range(environments):
        builder.environments(1)
    return builder.build()


def simulator(
    device: evis.Device, name: str, environments: int = ENVIRONMENTS, **more: Any
) -> evis.Simulator:
    config = {**SETTINGS[name], "poses": ["cube"], "reference_luminance": 1.0, "seed": 4, **more}
    return evis.Simulator(scene(environments), device=device, **config)


def pose(x: float) -> list[float]:
    return [x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def way(step: int) -> float:
    return -0.3 + 0.02 * step


def run(sim: evis.Simulator, begin: int, end: int, start: int = 0) -> list[np.ndarray]:
    """Steps `begin` to `end`, of a way that began at step `start`; the events of each environment."""
    packets = [
        sim.step(step * STEP_US, {"cube": pose(way(step - start))}) for step in range(begin + 1, end + 1)
    ]
    return [
        np.concatenate([packet[e].events for packet in packets]) for e in range(len(packets[0].environments))
    ]


def shifted(events: evis.EventArray | np.ndarray, by_us: int) -> np.ndarray:
    moved = np.asarray(events).copy()
    moved["t"] -= by_us
    return moved


@pytest.mark.parametrize("name", SETTINGS)
def test_other_environments_do_not_change(device: evis.Device, name: str) -> None:
    plain, sim = simulator(device, name), simulator(device, name)
    before, also = run(plain, 0, 2), run(sim, 0, 2)
    sim.reset(1, poses={"cube": pose(0.5)}, seed=9)
    assert sim.now_us == 2 * STEP_US
    expected, got = run(plain, 2, 5), run(sim, 2, 5)
    for environment in (0, 2):
        assert np.array_equal(before[environment], also[environment])
        assert len(expected[environment]) > 100
        assert expected[environment].tobytes() == got[environment].tobytes()
    # The one that jumped and was given another seed has other events.
    assert not np.array_equal(expected[1], got[1]), "canary"


@pytest.mark.parametrize("name", ["native", "standard"])
def test_a_reset_is_as_a_stream_that_begins_there(device: evis.Device, name: str) -> None:
    sim, fresh = simulator(device, name), simulator(device, name)
    run(sim, 0, 3)
    sim.reset([0, 2], poses={"cube": [pose(way(0)), pose(way(0))]})
    got = run(sim, 3, 6, start=3)
    expected = run(fresh, 0, 3)
    for environment in (0, 2):
        assert len(expected[environment]) > 100
        assert np.array_equal(shifted(got[environment], 3 * STEP_US), expected[environment])
    assert not np.array_equal(shifted(got[1], 3 * STEP_US), expected[1]), "canary: this one was not reset"


@pytest.mark.parametrize("name", SETTINGS)
def test_an_episode_of_many_steps_can_be_reset(device: evis.Device, name: str) -> None:
    sim = simulator(device, name)
    run(sim, 0, 6)
    for begin in (6, 7):
        sim.reset([1], poses={"cube": pose(way(begin))})
        events = run(sim, begin, begin + 1)
        assert all(len(own) > 10 for own in events)


def test_a_jump_fires_nothing_and_the_reference_is_what_is_seen_after_it(device: evis.Device) -> None:
    for name in ("native", "standard"):
        sim = simulator(device, name)
        run(sim, 0, 2)
        sim.reset(poses={"cube": [pose(0.4), pose(-0.4), pose(0.0)]})
        still = sim.step(3 * STEP_US)
        assert [len(view.events) for view in still.views] == [0, 0, 0]
        # Canary: a step to the same poses fires.
        other = simulator(device, "native")
        run(other, 0, 2)
        assert len(other.step(3 * STEP_US, {"cube": pose(0.4)})[0].events) > 100


def test_what_waits_for_the_bus_is_gone(device: evis.Device) -> None:
    sim, plain = simulator(device, "wire"), simulator(device, "wire")
    run(sim, 0, 2)
    run(plain, 0, 2)
    sim.reset([0])
    late, expected = sim.step(3 * STEP_US), plain.step(3 * STEP_US)
    assert len(expected[0].events) > 0, "nothing was on its way: no test"
    assert len(late[0].events) == 0
    assert np.array_equal(late[1].events, expected[1].events)


def test_a_seed_redraws_what_is_frozen_as_a_simulator_of_that_seed(device: evis.Device) -> None:
    sensor = evis.Sensor(pattern=evis.sensors.Pattern(sigma=0.05))
    sim = simulator(device, "native", sensor=sensor)
    run(sim, 0, 2)
    sim.reset([0, 1], seed=[11, 4], poses={"cube": pose(way(0))})
    got = run(sim, 2, 4, start=2)
    for environment, seed in ((0, 11), (1, 4)):
        other = simulator(device, "native", sensor=sensor, seed=seed)
        expected = run(other, 0, 2)[environment]
        assert len(expected) > 100
        assert np.array_equal(shifted(got[environment], 2 * STEP_US), expected)
    assert not np.array_equal(got[0], got[1]), "canary"


def test_a_reset_before_the_first_step_sets_poses_and_seeds(device: evis.Device) -> None:
    sim, other = simulator(device, "standard"), simulator(device, "standard")
    sim.reset(2, poses={"cube": pose(0.4)})
    first = sim.step(STEP_US)
    assert [len(view.events) for view in first.views] == [0, 0, 0]
    assert len(other.step(STEP_US, {"cube": pose(0.4)})[2].events) > 100


def test_labels_show_the_new_pose(device: evis.Device) -> None:
    more = {"labels": ["depth", "flow"], "label_rate_hz": 100.0}
    sim, other = simulator(device, "native", **more), simulator(device, "native", **more)
    run(sim, 0, 1)
    sim.reset(0, poses={"cube": pose(0.5)})
    other.reset(0, poses={"cube": pose(0.5)})
    got, expected = sim.step(2 * STEP_US), other.step(STEP_US)
    for kind in ("depth", "flow_backward"):
        assert np.allclose(got[0].labels[kind].data[0], expected[0].labels[kind].data[0], atol=1e-4)
    assert not np.array_equal(got[1].labels["depth"].data[0], expected[0].labels["depth"].data[0]), "canary"


def test_a_scene_that_moves_by_itself_is_reset_too(device: evis.Device) -> None:
    moving = evis.Scene.builtin("spinner").at_speed(4.0)
    more = {"size": (40, 30), "rate_hz": 1000.0, "samples": 1, "device": device, "reference_luminance": 1.0}
    sim = evis.Simulator(moving, **more)
    plain = evis.Simulator(moving, **more)
    late = evis.Simulator(moving, start=0.02, **more)
    sim.step(20_000)
    plain.step(20_000)
    sim.reset()
    got = sim.step(40_000).events
    assert np.array_equal(shifted(got, 20_000), late.step(20_000).events)
    assert not np.array_equal(got, plain.step(40_000).events), "canary"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"env_ids": 3}, "between 0 and 2"),
        ({"env_ids": [0, -1]}, "must not be negative"),
        ({"env_ids": [0, 0]}, "named once"),
        ({"env_ids": "0"}, "sequence"),
        ({"env_ids": 1.5}, "sequence"),
        ({"env_ids": [0, 1], "seed": [1]}, "one per environment"),
        ({"seed": -1}, "seed is -1"),
        ({"poses": {"cubes": [0.0] * 7}}, "'cubes'"),
        ({"poses": {"cube": [0.0] * 7}}, "unit quaternion"),
        ({"env_ids": [0, 1], "poses": {"cube": [pose(0)] * 3}}, "shape"),
    ],
)
def test_what_cannot_be_reset_is_refused_and_changes_nothing(
    device: evis.Device, arguments: dict[str, Any], message: str
) -> None:
    sim, plain = simulator(device, "native"), simulator(device, "native")
    run(sim, 0, 1)
    run(plain, 0, 1)
    with pytest.raises(evis.EvisError, match=message):
        sim.reset(**arguments)
    assert all(map(np.array_equal, run(sim, 1, 2), run(plain, 1, 2)))


def test_what_reaches_beyond_the_present_cannot_be_reset(device: evis.Device) -> None:
    spinner = evis.Scene.builtin("spinner")
    more = {"size": (40, 30), "device": device}
    exposure = evis.sensors.Exposure(time_us=1000, period_us=2000)
    for settings, message in [
        ({"method": "splat"}, "keyframes"),
        ({"method": "native", "sensor": evis.Sensor(exposure=exposure)}, "exposure"),
    ]:
        sim = evis.Simulator(spinner, **settings, **more)
        sim.step(10_000)
        with pytest.raises(evis.ConfigError, match=message):
            sim.reset()
    sim = evis.Simulator(spinner, rate_hz=500.0, samples=1, **more)
    sim.step(9_000)
    with pytest.raises(evis.ConfigError, match="multiple of 2000 us"):
        sim.reset()
    sim.step(10_000)
    sim.reset()
    with pytest.raises(evis.EvisError, match="no host moves"):
        sim.reset(poses={"wheel": [0, 0, 0, 0, 0, 0, 1]})


def test_events_of_all_environments_come_as_one_array(device: evis.Device) -> None:
    sim = simulator(device, "native")
    packet = sim.step(STEP_US, {"cube": [pose(0.0), pose(-0.3), pose(0.3)]})
    events, offsets = packet.packed()
    assert offsets.dtype == np.int64
    assert offsets[0] == 0
    assert events.dtype == evis.EventCD
    for e in range(ENVIRONMENTS):
        assert events[offsets[e] : offsets[e + 1]].tobytes() == packet[e].events.tobytes()
    assert len(packet[0].events) > 100
    assert packet.packed("eye")[1].tolist() == offsets.tolist()
    with pytest.raises(evis.ConfigError, match="no camera named 'left'"):
        packet.packed("left")
    one = simulator(device, "native", environments=1).step(STEP_US, {"cube": pose(0.0)})
    assert one.packed()[0] is one.events.to_numpy()


#: A simulator's sensor by settings, and what is drawn of it.
DRAWN: dict[str, tuple[evis.Sensor, dict[str, Any]]] = {
    "native": (evis.Sensor(), {"threshold_on": (0.1, 0.3), "threshold_off": (0.1, 0.3)}),
    "standard": (evis.Sensor(), {"threshold_on": (0.1, 0.3), "threshold_off": (0.1, 0.3)}),
    "chain": (
        evis.Sensor.preset("v2e"),
        {
            "threshold_on": (0.1, 0.3),
            "pattern.sigma": (0.01, 0.08),
            "photoreceptor.cutoff_hz": (30.0, 300.0),
            "noise.leak_hz": (0.1, 1.0),
            "noise.shot_hz": (1.0, 10.0),
            "refractory.period_us": (100.0, 3000.0),
        },
    ),
    "wire": (
        evis.Sensor(readout=evis.sensors.Readout(latency_us=3000.0, event_ns=1000)),
        {"readout.latency_us": (500.0, 5000.0), "threshold_on": (0.1, 0.3)},
    ),
    "host": (evis.Sensor.preset("davis346"), {"diffusion.k4": (1e-5, 5e-5)}),
}


@pytest.mark.parametrize("name", DRAWN)
def test_sensors_are_drawn_per_environment(device: evis.Device, name: str) -> None:
    base, ranges = DRAWN[name]
    drawn = [base.sample(ranges, seed) for seed in range(4)]
    sim = simulator(device, name, sensor=base)
    sim.reset(sensor=drawn[:3])
    first = run(sim, 0, 3)
    sim.reset([1], sensor=drawn[3])
    second = run(sim, 3, 6)
    for environment, sensor in enumerate(drawn[:3]):
        # The bytes of a simulator whose environments all have this sensor.
        alone = simulator(device, name, sensor=sensor)
        assert first[environment].tobytes() == run(alone, 0, 3)[environment].tobytes()
        assert len(first[environment]) > 50
        if environment != 1:
            assert second[environment].tobytes() == run(alone, 3, 6)[environment].tobytes()
    same = simulator(device, name, sensor=drawn[3])
    run(same, 0, 3)
    same.reset([1])
    assert second[1].tobytes() == run(same, 3, 6)[1].tobytes()
    # Canary: they do fire otherwise.
    plain = simulator(device, name, sensor=base)
    assert first[1].tobytes() != run(plain, 0, 3)[1].tobytes()
    assert second[1].tobytes() != run(plain, 3, 6)[1].tobytes()


def test_sensors_that_cannot_be_are_refused_and_change_nothing(device: evis.Device) -> None:
    base = evis.Sensor.preset("v2e")
    sim, same = (simulator(device, "chain", sensor=base, method="native") for _ in range(2))
    for sensor, said in (
        ("ideal", "other stages"),
        (evis.Sensor.preset("davis346"), "other stages"),
        (base.sample({"noise.leak_hz": {"choices": [0.0]}}, 0), "stay on"),
        ([base], "1 sensors for 3 environments"),
        ([base, base, None], "None"),
        ({"eyes": base}, "'eye'"),
        (evis.Sensor(threshold_on=-1.0), "threshold_on"),
        (3, "sequence"),
    ):
        with pytest.raises(evis.ConfigError, match=said):
            sim.reset(sensor=sensor, poses={"cube": pose(0.4)}, seed=9)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(run(sim, 0, 2), run(same, 0, 2), strict=True))
    ideal = simulator(device, "standard")
    with pytest.raises(evis.ConfigError, match="defined on frames"):
        ideal.reset(sensor=base)
