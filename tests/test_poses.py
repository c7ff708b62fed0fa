"""Poses that a host gives, step by step."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import evis
from evis import _poses
from evis.motion import Placement

VELOCITY = np.array([1.2, 0.3, 0.0])
END_US = 60_000
STEP_US = 10_000


def scene(*, moving: bool, environments: int = 1) -> evis.Scene:
    builder = evis.SceneBuilder("driven", duration=1.0, ambient=(1.0, 1.0, 1.0))
    builder.texture("checker", pattern="checker")
    builder.material("painted", texture="checker")
    start = (-0.3, 0.0, 0.0)
    motion = evis.motion.ConstantVelocity(velocity=tuple(VELOCITY)) if moving else None
    builder.box(
        "cube", size=(0.8, 0.8, 0.8), material="painted", pose=Placement(position=start, motion=motion)
    )
    eye = Placement(position=(0.2, 0.4, 2.5), look_at=(0, 0, 0))
    builder.camera(evis.EventCamera(name="eye", width=48, height=36, pose=eye))
    if environments > 1:
        for _ in range(environments):
            builder.environments(1)
    return builder.build()


def pose(t_us: int) -> list[float]:
    x, y, z = np.array([-0.3, 0.0, 0.0]) + VELOCITY * t_us * 1e-6
    return [x, y, z, 0.0, 0.0, 0.0, 1.0]


SETTINGS = {
    "native": {"rate_hz": 1000.0, "samples": 4, "method": "native"},
    # So small a step samples every tile at every instant, in blocks that end where steps may. A sensor with
    # more stages than thresholds takes light for straight between them; of an ideal one it runs along curves.
    "tiles": {
        "rate_hz": 1000.0,
        "samples": 4,
        "method": "native",
        "adaptive_px": 0.01,
        "sensor": evis.Sensor(refractory=evis.sensors.Refractory(period_us=1)),
    },
    "curves": {"rate_hz": 1000.0, "samples": 4, "method": "native", "adaptive_px": 0.01},
    "standard": {"quality": "standard"},
}


def driven(device: evis.Device, name: str, **more: object) -> evis.Simulator:
    config = {
        **SETTINGS[name],
        "poses": ["cube"],
        "pose_step_us": STEP_US,
        "reference_luminance": 1.0,
        **more,
    }
    return evis.Simulator(scene(moving=False), device=device, **config)


def pooled(packets: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(packets)


def agree(a: np.ndarray, b: np.ndarray, within_us: int = 20) -> float:
    """Share of events of both that the other has at the same pixel, polarity, and within ``within_us``."""
    keys = [np.stack([e["x"], e["y"], e["p"]], axis=1).astype(np.int64) for e in (a, b)]
    found = 0
    for key in np.unique(np.concatenate(keys), axis=0):
        times = [np.sort(e["t"][(k == key).all(axis=1)]) for e, k in zip((a, b), keys, strict=True)]
        n = min(map(len, times))
        if len(times[0]) == len(times[1]):
            found += int((np.abs(times[0][:n] - times[1][:n]) <= within_us).sum())
    return 2 * found / (len(a) + len(b))


@pytest.mark.parametrize("name", ["native", "tiles", "curves"])
def test_a_driven_node_fires_as_one_that_moves_by_itself(device: evis.Device, name: str):
    own = evis.Simulator(scene(moving=True), device=device, reference_luminance=1.0, **SETTINGS[name])
    expected = own.step(END_US).events
    sim = driven(device, name)
    steps = range(STEP_US, END_US + 1, STEP_US)
    got = pooled([sim.step(until, {"cube": pose(until)}).events for until in steps])
    assert len(expected) > 1000
    # Curves of tiles take their slopes from samples that a host's steps cut elsewhere.
    within_us = 500 if name == "curves" else 20
    assert agree(got, expected, within_us) > (0.95 if name == "curves" else 0.99)
    # Canary: a node that goes elsewhere fires other events.
    other = driven(device, name)
    wrong = pooled([other.step(until, {"cube": pose(until + 3_000)}).events for until in steps])
    assert agree(wrong, expected, within_us) < 0.9


def test_steps_and_times_within_them_change_no_byte(device: evis.Device):
    short = driven(device, "standard")
    steps = range(STEP_US, END_US + 1, STEP_US)
    one = pooled([short.step(until, {"cube": pose(until)}).events for until in steps])
    at_once = driven(device, "standard")
    times = list(steps)
    all_poses = {"cube": [pose(t) for t in times]}
    other = at_once.step(END_US, all_poses, pose_times_us=times).events
    assert len(one) > 1000
    assert np.array_equal(one, other)


def test_everything_before_the_end_of_a_step_is_there(device: evis.Device):
    sim = driven(device, "standard")
    packet = sim.step(2 * STEP_US, {"cube": pose(2 * STEP_US)})
    assert packet.end_us == 2 * STEP_US
    assert packet.events["t"].max() > 2 * STEP_US - 1_000
    later = sim.step(3 * STEP_US, {"cube": pose(3 * STEP_US)})
    assert later.events["t"].min() >= 2 * STEP_US


def test_a_node_without_a_pose_rests(device: evis.Device):
    sim = driven(device, "native")
    moved = sim.step(STEP_US, {"cube": pose(STEP_US)})
    still = sim.step(2 * STEP_US)
    assert len(moved.events) > 100
    assert len(still.events) == 0


def test_environments_move_apart(device: evis.Device):
    sim = evis.Simulator(
        scene(moving=False, environments=2),
        device=device,
        rate_hz=1000.0,
        samples=4,
        poses=["cube", "eye"],
        reference_luminance=1.0,
    )
    packet = sim.step(STEP_US, {"cube": np.array([pose(0), pose(STEP_US)])})
    assert len(packet[0].events) == 0
    assert len(packet[1].events) > 100


def test_velocities_bend_the_way(device: evis.Device):
    straight = driven(device, "native").step(STEP_US, {"cube": pose(STEP_US)}).events
    sim = driven(device, "native")
    bent = sim.step(
        STEP_US,
        {"cube": [pose(0), pose(STEP_US)]},
        pose_times_us=[0, STEP_US],
        velocities={"cube": [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]]},
    ).events
    assert agree(straight, bent) < 0.9


@pytest.mark.parametrize("name", ["native", "decoupled"])
def test_twists_turn_a_body_as_its_own_motion_does(device: evis.Device, name: str):
    # Faster and faster, to a fifth of a turn per step: poses alone would turn it evenly within each.
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    speed, gain = 0.02 * 2 * np.pi / 0.01, 0.04 * 2 * np.pi / 1e-4

    def made(motion: evis.motion.Keys | None) -> evis.Scene:
        builder = evis.SceneBuilder("spun", duration=1.0, ambient=(1.0, 1.0, 1.0))
        builder.texture("checker", pattern="checker")
        builder.material("painted", texture="checker")
        builder.box("cube", size=(0.8, 0.8, 0.8), material="painted", pose=Placement(motion=motion))
        eye = Placement(position=(0.0, 0.0, 2.5))
        builder.camera(evis.EventCamera(name="eye", width=40, height=30, pose=eye))
        return builder.build()

    def turned(t_s: float) -> list[float]:
        half = (speed * t_s + gain * t_s * t_s / 2) / 2
        return [*(axis * np.sin(half)), np.cos(half)]

    # The body's own motion, by rotations of every 100 us.
    times = np.arange(401) * 1e-4
    keys = evis.motion.Keys(
        times_s=times.tolist(),
        positions=np.zeros((401, 3)).tolist(),
        rotations=[turned(t) for t in times],
        interpolation="linear",
    )
    more = {"device": device, "reference_luminance": 1.0}
    more |= {"method": "decoupled"} if name == "decoupled" else {"rate_hz": 4000.0, "samples": 1}
    end_us = 4 * STEP_US
    expected = evis.Simulator(made(keys), **more).step(end_us).events

    def found(twists: bool) -> np.ndarray:
        sim = evis.Simulator(made(None), poses=["cube"], **more)
        packets = []
        for until in range(STEP_US, end_us + 1, STEP_US):
            both = [until - STEP_US, until] if until == STEP_US else [until]
            poses = [[0.0, 0.0, 0.0, *turned(t * 1e-6)] for t in both]
            rates = [axis * (speed + gain * t * 1e-6) for t in both]
            twist = {"angular_velocities": {"cube": rates}} if twists else {}
            packets.append(sim.step(until, {"cube": poses}, pose_times_us=both, **twist).events)
        return pooled(packets)

    assert len(expected) > 1000
    exact, even = agree(found(True), expected, 200), agree(found(False), expected, 200)
    assert exact > (0.97 if name == "native" else 0.85)
    assert even < exact - 0.2, "canary: poses alone"


def test_matrices_are_the_poses_they_hold():
    rng = np.random.default_rng(3)
    quaternions = rng.normal(size=(200, 4))
    quaternions[:4] = np.eye(4)
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    x, y, z, w = quaternions.T
    matrices = np.zeros((200, 4, 4))
    matrices[:, :3, :3] = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    matrices[:, :3, 3] = rng.normal(size=(200, 3))
    matrices[:, 3, 3] = 1.0
    ((_, _, _, values, _, _),) = _poses.node_poses(["n"], 1, 200, {"n": matrices}, np.arange(1, 201), None)
    values = np.array(values)
    assert np.allclose(values[:, :3], matrices[:, :3, 3])
    same = np.abs((values[:, 3:] * quaternions).sum(axis=1))
    assert np.allclose(same, 1.0)


def test_a_matrix_that_is_not_rigid_names_its_environment():
    three = np.tile(np.eye(4), (3, 1, 1))
    three[1, 0, 0] = np.nan
    for matrices, times, whose in (
        (three, None, "holds a matrix for environment 1 that is not rigid"),
        (three[:, None], [10], "for environment 1 that"),
        (np.tile(three[:, None], (1, 2, 1, 1)), [5, 10], "for environment 1 that"),
        # Three times of every environment.
        (three, [5, 8, 10], "holds a matrix that"),
        (three[1], None, "holds a matrix that"),
    ):
        with pytest.raises(evis.ConfigError, match=whose):
            _poses.node_poses(["n"], 3, 10, {"n": matrices}, times, None)
    with pytest.raises(evis.ConfigError, match="for environment 7 that"):
        _poses.node_jumps(["n"], [4, 7, 9], {"n": three})
    with pytest.raises(evis.ConfigError, match="holds a matrix that"):
        _poses.node_jumps(["n"], [7], {"n": three[1:2]})


@pytest.mark.parametrize(
    ("poses", "more", "message"),
    [
        ({"cubes": [0.0] * 7}, {}, "'cubes'"),
        ({"cube": [0.0] * 6}, {}, "shape"),
        ({"cube": [0.0] * 7}, {}, "unit quaternion"),
        ({"cube": [np.nan, 0, 0, 0, 0, 0, 1]}, {}, "not finite"),
        ({"cube": 2 * np.eye(4)}, {}, "not rigid"),
        ({"cube": "here"}, {}, "numbers"),
        ({"cube": [pose(0)] * 2}, {"pose_times_us": [9_000, 8_000]}, "order"),
        ({"cube": [pose(0)] * 2}, {"pose_times_us": [1_000, 2_000]}, "the step ends at 10000"),
        ({"cube": [pose(0)] * 3}, {"pose_times_us": [5_000, 10_000]}, "shape"),
        ({"cube": pose(0)}, {"velocities": {"eye": [0, 0, 0]}}, "'eye'"),
        ({"cube": pose(0)}, {"angular_velocities": {"eye": [0, 0, 0]}}, "'eye'"),
        ({"cube": pose(0)}, {"angular_velocities": {"cube": [0, 0]}}, "shape"),
        ({"cube": pose(0)}, {"angular_velocities": {"cube": [0, np.nan, 0]}}, "not finite"),
        ({"cube": pose(0)}, {"angular_velocities": {"cube": [0, 0, 1e3]}}, "1.59 turns since"),
        (None, {"velocities": {"cube": [0, 0, 0]}}, "without poses"),
    ],
)
def test_poses_that_cannot_be_used_are_refused_and_change_nothing(
    device: evis.Device, poses: dict, more: dict, message: str
):
    sim = driven(device, "native")
    with pytest.raises(evis.EvisError, match=message):
        sim.step(STEP_US, poses, **more)
    assert sim.now_us == 0
    assert len(sim.step(STEP_US, {"cube": pose(STEP_US)}).events) > 100


def test_what_needs_later_poses_is_refused(device: evis.Device):
    for more, message in [
        ({"method": "evis-paper"}, "come later"),
        ({"frame_rate_hz": 30.0}, "exposures"),
        ({"pose_step_us": 333, "method": "native"}, "multiple"),
        ({"poses": ["nobody"]}, "nobody"),
        ({"poses": [], "pose_step_us": 10_000}, "poses"),
    ]:
        config = {"poses": ["cube"], "device": device, **more}
        with pytest.raises(evis.EvisError, match=message):
            evis.Simulator(scene(moving=False), **config)
    sim = driven(device, "native")
    with pytest.raises(evis.EvisError, match="step"):
        sim.stream(duration=0.1)
    with pytest.raises(evis.EvisError, match="pose_step_us"):
        driven(device, "standard").step(10_500, {"cube": pose(0)})


def test_a_simulator_without_driven_nodes_takes_no_poses(device: evis.Device):
    sim = evis.Simulator(scene(moving=True), device=device, rate_hz=500.0, samples=1)
    with pytest.raises(evis.EvisError, match="no host moves"):
        sim.step(STEP_US, {"cube": pose(0)})


def test_a_driven_simulator_is_pickled_by_its_settings(device: evis.Device):
    sim = driven(device, "native")
    again = pickle.loads(pickle.dumps(sim))
    assert len(again.step(STEP_US, {"cube": pose(STEP_US)}).events) > 100
