"""Environments that differ in lights, lenses and materials, and hosts that change these."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evis
from evis.motion import Placement

STEP_US = 10_000

SETTINGS: dict[str, dict[str, Any]] = {
    "native": {"rate_hz": 1000.0, "samples": 4, "method": "native"},
    "standard": {"quality": "standard"},
    "chain": {"quality": "standard", "sensor": "v2e"},
    "decoupled": {"method": "decoupled"},
}

#: What an environment may have otherwise.
OTHERWISE: dict[str, dict[str, dict[str, Any]]] = {
    "lights": {"lamp": {"intensity": 3.0, "color": (0.5, 1.0, 0.8)}},
    "cameras": {"eye": {"fx": 40.0, "fy": 38.0, "cx": 22.0, "cy": 14.0}},
    "materials": {"painted": {"color": (0.3, 0.5, 0.4)}},
}


def scene(
    environments: int = 3, which: int | None = None, *, intensity: float = 6.0, **lens: float
) -> evis.Scene:
    """A cube under a lamp; environment `which` is otherwise."""
    builder = evis.SceneBuilder("lit", duration=1.0, ambient=(0.1, 0.1, 0.1))
    builder.texture("checker", pattern="checker")
    builder.material("painted", texture="checker")
    builder.box("cube", size=(0.8, 0.8, 0.8), material="painted", pose=Placement(position=(-0.3, 0, 0)))
    over = Placement(position=(1, 3, 2), look_at=(0, 0, 0))
    builder.light("lamp", kind="directional", intensity=intensity, pose=over)
    eye = Placement(position=(0.2, 0.4, 2.5), look_at=(0, 0, 0))
    builder.camera(evis.EventCamera(name="eye", width=40, height=30, pose=eye, **lens))
    for index in range(environments):
        more: dict[str, Any] = OTHERWISE if index == which else {}
        builder.environments(1, **more)
    return builder.build()


def simulator(device: evis.Device, name: str, of: evis.Scene | None = None, **more: Any) -> evis.Simulator:
    settings = {**SETTINGS[name], "poses": ["cube"], "lights": ["lamp"], "reference_luminance": 0.5, **more}
    return evis.Simulator(scene() if of is None else of, device=device, seed=4, **settings)


def pose(x: float) -> list[float]:
    return [x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def run(sim: evis.Simulator, begin: int, end: int, start: int = 0) -> list[np.ndarray]:
    """Steps `begin` to `end`, of a way that began at step `start`; the events of each environment."""
    way = range(begin + 1, end + 1)
    packets = [sim.step(step * STEP_US, {"cube": pose(-0.3 + 0.02 * (step - start))}) for step in way]
    return [np.concatenate([packet[e].events for packet in packets]) for e in range(sim.environments)]


@pytest.mark.parametrize("name", SETTINGS)
def test_an_environment_that_is_otherwise_changes_no_other(device: evis.Device, name: str) -> None:
    plain, other = simulator(device, name), simulator(device, name, scene(3, 1))
    expected, got = run(plain, 0, 3), run(other, 0, 3)
    for environment in (0, 2):
        assert len(expected[environment]) > 100
        assert expected[environment].tobytes() == got[environment].tobytes()
    assert expected[1].tobytes() != got[1].tobytes()
    # Its neighbours change nothing of it.
    again = run(simulator(device, name, scene(2, 1)), 0, 3)
    assert again[1].tobytes() == got[1].tobytes()


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize(
    "lens",
    [{"fx": 40.0, "fy": 38.0, "cx": 22.0, "cy": 14.0}, {"orthographic_height": 1.6, "far": 2.6}],
    ids=["perspective", "orthographic"],
)
def test_a_reset_gives_an_environment_lights_and_lenses_of_its_own(
    device: evis.Device, name: str, lens: dict[str, float]
) -> None:
    plain, sim = simulator(device, name), simulator(device, name)
    run(plain, 0, 3)
    run(sim, 0, 3)
    sim.reset([1], poses={"cube": pose(-0.3)}, lights={"lamp": {"intensity": 3.0}}, lenses={"eye": lens})
    expected, got = run(plain, 3, 6, start=3), run(sim, 3, 6, start=3)
    for environment in (0, 2):
        assert len(expected[environment]) > 50
        assert expected[environment].tobytes() == got[environment].tobytes()
    # As a stream that begins there, of a scene that is so.
    own = run(simulator(device, name, scene(3, intensity=3.0, **lens)), 0, 3)[1]
    shifted = got[1].copy()
    shifted["t"] -= 3 * STEP_US
    if name in {"native", "standard"}:
        assert np.array_equal(shifted, own)
    else:
        # Noise, and the parts into which time is divided, follow absolute time.
        assert abs(len(shifted) - len(own)) < 0.05 * len(own)
    assert len(own) > 100
    assert not np.array_equal(got[1], expected[1]), "canary"
    fx = sim.cameras_of(1)[0].fx
    assert fx == 40.0 if "fx" in lens else np.isnan(fx)
    assert sim.cameras_of(0) == plain.cameras


def test_packets_and_files_tell_the_lens_of_their_environment(device: evis.Device, tmp_path: Path) -> None:
    sim = simulator(device, "native", scene(2, 1), labels=["depth"])
    packet = sim.step(2 * STEP_US, {"cube": pose(0.0)})
    views = packet.views
    assert [view.camera.fx == 40.0 for view in views] == [False, True]
    assert views[0].camera == sim.cameras[0]
    depth = views[1].labels["depth"].data[0]
    assert not np.array_equal(depth, views[0].labels["depth"].data[0])
    other = simulator(device, "native", scene(2, 1))
    with evis.Writer(tmp_path / "events.h5", other) as writer:
        writer.write(other.step(STEP_US))
        paths = writer.paths
    lenses = [evis.load(path).cameras[0].fx for path in paths]
    assert lenses == [pytest.approx(views[0].camera.fx), 40.0]


@pytest.mark.parametrize("name", ["native", "standard", "decoupled"])
def test_lights_change_at_the_start_of_a_step(device: evis.Device, name: str) -> None:
    sim = simulator(device, name)
    assert all(not len(view.events) for view in sim.step(STEP_US).views)
    packet = sim.step(2 * STEP_US, lights={"lamp": {"intensity": [6.0, 9.0, 6.0]}})
    assert [len(view.events) > 100 for view in packet.views] == [False, True, False]
    bright = packet[1].events
    assert set(bright["p"]) == {1}
    assert bright["t"].max() <= STEP_US + 1000
    dark = sim.step(3 * STEP_US, lights={"lamp": {"on": [False, True, False]}})
    assert [len(view.events) > 100 for view in dark.views] == [True, False, True]
    assert set(dark[0].events["p"]) == {0}
    # What was said of it holds when it shines again.
    again = sim.step(4 * STEP_US, lights={"lamp": {"on": True}})
    assert set(again[0].events["p"]) == {1}
    assert len(again[1].events) == 0


def test_a_light_moves_by_its_pose(device: evis.Device) -> None:
    sim = simulator(device, "native", poses=["cube", "lamp"])
    sim.step(STEP_US)
    turned = [0.0, 0.0, 0.0, 0.0, np.sin(0.6), 0.0, np.cos(0.6)]
    packet = sim.step(2 * STEP_US, {"lamp": [pose(0.0), turned, pose(0.0)]})
    assert len(packet[1].events) > 100


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"lights": {"lamps": {"on": True}}}, "did you mean 'lamp'"),
        ({"lights": {"lamp": {"strength": 2.0}}}, "'strength'; only"),
        ({"lights": {"lamp": {"intensity": -1.0}}}, "intensity is -1"),
        ({"lights": {"lamp": {"intensity": [1.0, 2.0]}}}, "one per environment"),
        ({"lights": {"lamp": {"on": 1}}}, "give True or False"),
        ({"lights": {"lamp": 3.0}}, "must be a mapping"),
        ({"lenses": {"eyes": {"fov_y_degrees": 50.0}}}, "'eyes'"),
        ({"lenses": {"eye": {"fov_y_degrees": 200.0}}}, "fov_y_degrees is 200"),
        ({"lenses": {"eye": {"fx": 50.0}}}, "all of"),
        ({"lenses": {"eye": {"fx": 0.0, "fy": 1.0, "cx": 1.0, "cy": 1.0}}}, "fx is 0"),
        ({"lenses": {"eye": {"focal": 50.0}}}, "'focal'; it takes"),
        ({"lenses": {"eye": {"orthographic_height": 1.0}}}, "both of"),
        ({"lenses": {"eye": {"orthographic_height": -1.0, "far": 9.0}}}, "orthographic_height is -1"),
        ({"lenses": {"eye": {"orthographic_height": 1.0, "far": 0.01}}}, "far plane at 0.01 m"),
        ({"lenses": {"eye": 50.0}}, "must be a mapping"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(
    device: evis.Device, arguments: dict[str, Any], message: str
) -> None:
    sim, plain = simulator(device, "native"), simulator(device, "native")
    with pytest.raises(evis.ConfigError, match=message):
        sim.reset(**arguments)
    if "lights" in arguments:
        with pytest.raises(evis.ConfigError, match=message):
            sim.step(STEP_US, **arguments)
    assert all(map(np.array_equal, run(sim, 0, 1), run(plain, 0, 1)))
    assert sim.cameras_of(2) == plain.cameras


def test_a_distorted_camera_has_its_lens_from_the_scene(device: evis.Device) -> None:
    builder = evis.SceneBuilder("distorted", ambient=(1.0, 1.0, 1.0))
    builder.texture("checker", pattern="checker")
    builder.material("painted", texture="checker")
    motion = evis.motion.ConstantVelocity(velocity=(1.0, 0.0, 0.0))
    builder.box("cube", size=(0.8, 0.8, 0.8), material="painted", pose=Placement(motion=motion))
    lens = evis.lens.RadialTangential(k1=-0.2)
    eye = Placement(position=(0, 0, 2.5))
    builder.camera(evis.EventCamera(name="eye", width=40, height=30, fx=40.0, distortion=lens, pose=eye))
    builder.environments(1)
    builder.environments(1, cameras={"eye": {"fx": 55.0}})
    sim = evis.Simulator(builder.build(), device=device, rate_hz=500.0, samples=1, reference_luminance=1.0)
    packet = sim.step(2 * STEP_US)
    assert [view.camera.fx for view in packet.views] == [40.0, 55.0]
    assert all(len(view.events) > 50 for view in packet.views)
    assert not np.array_equal(packet[0].events, packet[1].events)
    with pytest.raises(evis.ConfigError, match="without distortion"):
        sim.reset(lenses={"eye": {"fov_y_degrees": 50.0}})


def test_the_seed_of_an_environment_is_the_runs_and_its_offset(device: evis.Device) -> None:
    def noise(seed: int, offset: int) -> np.ndarray:
        builder = evis.SceneBuilder("still", ambient=(1.0, 1.0, 1.0))
        builder.material("grey", color=(0.5, 0.5, 0.5))
        builder.box("cube", size=(0.8, 0.8, 0.8), material="grey")
        builder.camera(evis.EventCamera(name="eye", width=40, height=30, pose=Placement(position=(0, 0, 3))))
        builder.environments(1, seed_offset=offset)
        more = {"device": device, "seed": seed, "sensor": "v2e-noisy", "rate_hz": 1000.0, "samples": 1}
        return np.asarray(evis.Simulator(builder.build(), **more, poses=["cube"]).step(50_000).events)

    assert len(noise(3, 4)) > 20
    assert np.array_equal(noise(3, 4), noise(7, 0))
    assert not np.array_equal(noise(3, 4), noise(3, 0))
