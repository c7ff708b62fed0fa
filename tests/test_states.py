"""What a host says of its own state stands in recordings as it was given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evis
from evis.motion import Placement

NAMES = {"arm": ["shoulder", "elbow"], "reward": ["reward"]}


def simulator(device: evis.Device, **settings: Any) -> evis.Simulator:
    scene = evis.Scene.builtin("spinner")
    return evis.Simulator(scene, size=(32, 24), method="native", rate_hz=200, device=device, **settings)


def test_states_are_stored_beside_events(device: evis.Device, tmp_path: Path) -> None:
    path, sim = tmp_path / "a.h5", simulator(device)
    rng = np.random.default_rng(0)
    arm = rng.normal(size=(3000, 2))
    arm[5, 1] = np.nan
    with evis.Writer(path, sim, states=NAMES) as writer:
        for k in range(3):
            writer.write(sim.step(10_000 * (k + 1)))
            own = slice(1000 * k, 1000 * (k + 1))
            writer.write_state("arm", np.arange(3000)[own] * 10, arm[own])
            writer.write_state("reward", 10_000 * (k + 1), [0.5 * k])
    recording = evis.load(path)
    assert set(recording.states) == set(NAMES)
    found = recording.states["arm"]
    assert found.names == ("shoulder", "elbow")
    assert len(found) == 3000
    assert np.array_equal(found.t_us, np.arange(3000) * 10)
    assert np.array_equal(found.values, arm, equal_nan=True)
    assert np.array_equal(found["elbow"], arm[:, 1], equal_nan=True)
    assert recording.states["reward"]["reward"].tolist() == [0.0, 0.5, 1.0]
    with pytest.raises(KeyError, match="wrist"):
        found["wrist"]
    assert len(recording.events) > 20
    # A copy has all of it.
    samples = evis.imu.simulate(sim.scene, "camera", duration=0.03)
    with evis.Writer(tmp_path / "c.h5", simulator(device), imus=["head"], states=NAMES) as writer:
        writer.write(simulator(device).step(10_000))
        writer.write_imu("head", samples)
        writer.write_state("reward", [1, 2], [[3.0], [4.0]])
    given = evis.load(tmp_path / "c.h5")
    evis.save(tmp_path / "d.h5", given)
    copy = evis.load(tmp_path / "d.h5")
    assert copy.states["reward"].values.tolist() == [[3.0], [4.0]]
    assert copy.states["arm"].names == ("shoulder", "elbow")
    assert np.array_equal(copy.imus["head"].accelerometer, given.imus["head"].accelerometer)
    assert copy.imus["head"].t_us.tolist() == samples.t_us.tolist()
    # A recording without any has none.
    evis.save(tmp_path / "b.h5", simulator(device).stream(duration=0.01))
    assert evis.load(tmp_path / "b.h5").states == {}


def test_every_environment_has_its_own(device: evis.Device, tmp_path: Path) -> None:
    builder = evis.SceneBuilder("two", ambient=(1.0, 1.0, 1.0))
    builder.material("plain")
    builder.box("box", size=(1, 1, 1), material="plain")
    builder.camera(evis.EventCamera(name="eye", width=16, height=12, pose=Placement(position=(0, 0, 3))))
    builder.environments(2)
    sim = evis.Simulator(builder.build(), method="native", rate_hz=200, device=device, poses=["box"])
    with evis.Writer(tmp_path / "a.h5", sim, states=NAMES) as writer:
        writer.write(sim.step(10_000, poses={"box": [0.1, 0, 0, 0, 0, 0, 1]}))
        writer.write_state("reward", 10_000, [1.0])
        writer.write_state("reward", 10_000, [2.0], environment=1)
    values = [evis.load(path).states["reward"].values.tolist() for path in writer.paths]
    assert values == [[[1.0]], [[2.0]]]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("leg", 0, [1.0]), "states has no 'leg'; it has arm, reward"),
        (("reward", 0, [1.0, 2.0]), r"values has shape \(2,\); it must have \(1,\)"),
        (("arm", [0, 10], [1.0, 2.0]), r"\(2,\); it must have \(2, 2\)"),
        (("reward", 0.5, [1.0]), "t_us is 0.5"),
        (("reward", [[0]], [[[1.0]]]), "t_us is"),
        (("reward", 0, ["much"]), "must be numbers"),
    ],
)
def test_what_cannot_be_stored_is_refused(
    device: evis.Device, tmp_path: Path, given: tuple[Any, ...], message: str
) -> None:
    sim = simulator(device)
    with evis.Writer(tmp_path / "a.h5", sim, states=NAMES) as writer:
        writer.write(sim.step(10_000))
        with pytest.raises(evis.ConfigError, match=message):
            writer.write_state(*given)
        writer.write_state("reward", 10, [1.0])
        with pytest.raises(evis.FormatError, match="at 10 us comes after that at 10 us"):
            writer.write_state("reward", 10, [1.0])
        with pytest.raises(evis.ConfigError, match="environment"):
            writer.write_state("reward", 20, [1.0], environment=1)
    assert len(evis.load(tmp_path / "a.h5").states["reward"]) == 1


@pytest.mark.parametrize(
    ("states", "message"),
    [
        (["arm"], "states is .*mapping"),
        ({"arm": "elbow"}, r"states\['arm'\] is 'elbow'"),
        ({"arm": []}, 'the state "arm" has 0 values'),
        ({"a/b": ["x"]}, "cannot name a state"),
    ],
)
def test_states_that_no_file_can_hold_are_refused(
    device: evis.Device, tmp_path: Path, states: Any, message: str
) -> None:
    sim = simulator(device)
    with (
        pytest.raises(evis.EvisError, match=message),
        evis.Writer(tmp_path / "a.h5", sim, states=states) as writer,
    ):
        writer.write(sim.step(10_000))
    with pytest.raises(evis.ConfigError, match="holds no states"):
        evis.Writer(tmp_path / "a.raw", sim, states=NAMES)
