"""Ground truth by name: objects, boxes, poses, velocities; units of every data set; transforms of rigs."""

from __future__ import annotations

import copy
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import evis
from evis.motion import Chain, ConstantVelocity, Placement, Spin

SMALL = {"size": (64, 48), "rate_hz": 500.0, "samples": 1}


@pytest.fixture(scope="module")
def scene() -> evis.Scene:
    """A box, 2 m wide, that moves along x and spins about +Y, and a sphere that rests."""
    classes = {"container": 4, "vehicle": 9}
    builder = evis.SceneBuilder("things", ambient=(1.0, 1.0, 1.0), classes=classes)
    builder.material("white")
    moves = ConstantVelocity(velocity=(0.5, 0.0, 0.0))
    spins = Spin(axis=(0, 1, 0), degrees_per_s=90.0)
    motion = Chain(motions=[Placement(motion=moves), Placement(motion=spins)])
    builder.box(
        "crate", size=(2, 1, 0.5), material="white", pose=Placement(motion=motion), semantic_id="container"
    )
    builder.sphere("ball", radius=0.25, material="white", pose=Placement(position=(0, 1, 0)))
    builder.camera(evis.EventCamera(name="eye", width=64, height=48, pose=Placement(position=(0, 0, 6))))
    return builder.build()


def test_instances_have_names(scene: evis.Scene) -> None:
    crate, ball = scene.instances
    assert (crate.name, crate.semantic_id, ball.name, ball.semantic_id) == ("crate", 4, "ball", 0)
    assert 0 < crate.id < ball.id


def test_classes_have_names(scene: evis.Scene, tmp_path: Path) -> None:
    crate, ball = scene.instances
    assert (crate.semantic_name, ball.semantic_name) == ("container", "")
    assert scene.classes == {4: "container"}, "those that occur"
    assert scene.bodies().semantic_names == ("container", "", "")
    assert evis.Scene.builtin("spinner").classes == {2: "building", 5: "moving"}
    builder = evis.SceneBuilder("bad", classes={"container": 4})
    builder.material("white")
    builder.box("crate", size=(1, 1, 1), material="white", semantic_id="contaner")
    with pytest.raises(evis.FormatError, match=r"no class named 'contaner'.*did you mean 'container'"):
        builder.build()


def test_bodies_have_boxes_poses_and_velocities(scene: evis.Scene) -> None:
    bodies = scene.bodies([0, 500_000, 1_000_000])
    assert bodies.names == ("crate", "ball", "eye")
    assert bodies.position.shape == bodies.linear_velocity.shape == (3, 3, 3)
    assert bodies.rotation.shape == (3, 3, 4)
    assert np.allclose(bodies.box[0], [[-1, -0.5, -0.25], [1, 0.5, 0.25]])
    assert np.isnan(bodies.box[2]).all(), "a camera has none"
    assert np.allclose(bodies.position[:, 0], [[0, 0, 0], [0.25, 0, 0], [0.5, 0, 0]])
    assert np.allclose(bodies.linear_velocity[:, 0], [0.5, 0, 0])
    assert np.allclose(bodies.angular_velocity[:, 0], [0, np.pi / 2, 0])
    assert not np.allclose(bodies.angular_velocity[:, 0], [0, -np.pi / 2, 0]), "canary: the sign counts"
    assert np.allclose(bodies.linear_velocity[:, 1:], 0)
    # After a second it has turned by a quarter: its width lies along z.
    corners = bodies.corners()
    assert corners.shape == (3, 3, 8, 3)
    assert np.allclose(np.ptp(corners[0, 0], axis=0), [2, 1, 0.5])
    assert np.allclose(np.ptp(corners[2, 0], axis=0), [0.5, 1, 2])
    assert np.allclose(corners[2, 0].mean(axis=0), [0.5, 0, 0])
    assert np.array_equal(bodies.poses("eye").position, np.tile([0.0, 0.0, 6.0], (3, 1)))
    assert np.array_equal(bodies.poses("crate").t_us, [0, 500_000, 1_000_000])
    with pytest.raises(evis.ConfigError, match="no body is named 'crane'; there is crate, ball, eye"):
        bodies.poses("crane")
    with pytest.raises(evis.ConfigError, match="no camera named 'top'"):
        scene.bodies([0], cameras=["top"])
    assert repr(bodies) == "Bodies(3 bodies, 3 times, t_us 0 to 1000000)"


def test_recordings_name_and_follow_bodies(scene: evis.Scene, device: evis.Device, tmp_path: Path) -> None:
    labels = ["instance", "semantic"]
    sim = evis.Simulator(scene, labels=labels, label_rate_hz=100.0, start=0.5, device=device, **SMALL)
    evis.save(tmp_path / "a.h5", sim.stream(duration=0.025), pose_rate_hz=200.0)
    recording = evis.load(tmp_path / "a.h5")
    bodies = recording.bodies
    assert bodies is not None
    # Their own rate, and the end of the stream.
    assert bodies.t_us.tolist() == [0, 5_000, 10_000, 15_000, 20_000, 25_000]
    exact = scene.bodies(bodies.t_us + 500_000)
    for name in ("position", "rotation", "linear_velocity", "angular_velocity"):
        assert np.array_equal(getattr(bodies, name), getattr(exact, name)), name
    assert not np.array_equal(bodies.position, scene.bodies(bodies.t_us).position), "canary"
    assert np.array_equal(bodies.box, exact.box, equal_nan=True)
    assert recording.instances == scene.instances
    assert recording.classes == scene.classes == {4: "container"}
    assert set(np.unique(recording.labels["semantic"].data).tolist()) == {0, 4}
    seen = set(np.unique(recording.labels["instance"].data).tolist())
    assert seen <= {0, *(instance.id for instance in recording.instances)}
    assert len(seen) == 3
    # A copy keeps them; packets of other lengths and the command give the same.
    copied = evis.load(evis.save(tmp_path / "b.h5", recording)[0]).bodies
    assert copied is not None
    assert copied.classes == scene.classes
    assert np.array_equal(copied.position, bodies.position)
    with evis.Writer(tmp_path / "c.h5", sim, pose_rate_hz=200.0) as writer:
        for packet in sim.stream(duration=0.025, packet_us=7_000):
            writer.write(packet)
    again = evis.load(tmp_path / "c.h5").bodies
    assert again is not None
    assert np.array_equal(again.position, bodies.position)


def same_turns(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> bool:
    """Whether unit quaternions are the same rotations: q and -q are."""
    return bool(np.all(np.abs(np.sum(a * b, axis=-1)) > 1.0 - 1e-12))


def test_recordings_hold_what_a_host_moved(scene: evis.Scene, device: evis.Device, tmp_path: Path) -> None:
    """Nodes and cameras, at the times at which the host gave them; others beside them, and velocities."""
    sim = evis.Simulator(scene, poses=["ball", "eye"], start=0.5, device=device, **SMALL)
    rng = np.random.default_rng(2)

    def tumbling(count: int, z: float) -> npt.NDArray[np.float64]:
        turns = rng.normal(size=(count, 4)) * 0.1 + [0, 0, 0, 1]
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        return np.column_stack([rng.normal(size=(count, 2)) * 0.1, np.full(count, z), turns])

    times = [np.array([0, 1_500, 10_000]), np.array([20_000]), np.array([21_000, 27_003, 30_000])]
    balls = [tumbling(len(t), 0.0) for t in times]
    eyes = [tumbling(len(t), 6.0) for t in times]
    swift = rng.normal(size=(3, 3))
    with evis.Writer(tmp_path / "a.h5", sim, pose_rate_hz=50.0) as writer:
        packets = [sim.step(10_000, {"ball": balls[0], "eye": eyes[0]}, pose_times_us=times[0])]
        packets.append(sim.step(20_000, {"ball": balls[1][0], "eye": eyes[1][0]}))
        # What a simulator forgets meanwhile is in its packets.
        last = {"poses": {"ball": balls[2], "eye": eyes[2]}, "velocities": {"ball": swift}}
        packets.append(sim.step(30_000, pose_times_us=times[2], **last))  # type: ignore[arg-type]
        packets.append(sim.step(40_000))
        for packet in packets:
            writer.write(packet)
    bodies = evis.load(tmp_path / "a.h5").bodies
    assert bodies is not None
    # Those that the host gave, and 50 Hz.
    given = np.concatenate(times)
    assert bodies.t_us.tolist() == [*given.tolist(), 40_000]
    for name, rows in (("ball", balls), ("eye", eyes)):
        stored, said = bodies.poses(name), np.concatenate(rows)
        np.testing.assert_allclose(stored.position[:-1], said[:, :3], atol=1e-12)
        assert same_turns(stored.rotation[:-1], said[:, 3:])
        assert not same_turns(stored.rotation[1:-1], said[:-1, 3:]), "canary"
        np.testing.assert_allclose(stored.position[-1], said[-1, :3], atol=1e-12, err_msg="it rests")
    # Nothing moves the crate but the scene.
    exact = scene.bodies(bodies.t_us + 500_000)
    np.testing.assert_allclose(bodies.position[:, 0], exact.position[:, 0], atol=1e-12)
    np.testing.assert_allclose(bodies.linear_velocity[:, 0], exact.linear_velocity[:, 0], atol=1e-8)
    np.testing.assert_allclose(bodies.angular_velocity[:, 0], exact.angular_velocity[:, 0], atol=1e-8)
    # Velocities are those that were given where two poses have one, else the mean ones since the pose before.
    ball = bodies.linear_velocity[:, 1]
    np.testing.assert_allclose(ball[5:7], swift[1:], atol=1e-6)
    places = np.concatenate(balls)[:, :3]
    mean = np.diff(places, axis=0) / (np.diff(given) * 1e-6)[:, None]
    np.testing.assert_allclose(ball[1:5], mean[:4], atol=1e-6)
    np.testing.assert_allclose(ball[-1], 0.0, atol=1e-9)
    assert np.abs(ball[6] - mean[5]).max() > 1e-3, "canary"
    # A writer that begins later knows where nodes are.
    with evis.Writer(tmp_path / "b.h5", sim, pose_rate_hz=50.0) as writer:
        for packet in packets[2:]:
            writer.write(packet)
    later = evis.load(tmp_path / "b.h5").bodies
    assert later is not None
    assert later.t_us.tolist() == [20_000, *times[2].tolist(), 40_000]
    np.testing.assert_allclose(later.position, bodies.position[3:], atol=1e-12)
    copied = evis.load(evis.save(tmp_path / "c.h5", evis.load(tmp_path / "a.h5"))[0]).bodies
    assert copied is not None
    assert np.array_equal(copied.position, bodies.position)


def test_each_environment_has_its_own_poses_and_resets(device: evis.Device, tmp_path: Path) -> None:
    builder = evis.SceneBuilder("two", ambient=(1.0, 1.0, 1.0))
    builder.material("white")
    builder.sphere("ball", radius=0.25, material="white")
    # What hangs on it goes along.
    builder.box(
        "hat", size=(0.1, 0.1, 0.1), material="white", pose=Placement(position=(0, 1, 0), parent="ball")
    )
    builder.camera(evis.EventCamera(name="eye", pose=Placement(position=(0, 0, 3))))
    builder.environments(1)
    builder.environments(1)
    sim = evis.Simulator(builder.build(), poses=["ball"], device=device, **SMALL)
    turned = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])

    def ball(*x: float) -> dict[str, npt.NDArray[np.float64]]:
        return {"ball": np.array([[each, 0, 0, *turned] for each in x])}

    with evis.Writer(tmp_path / "a.h5", sim, pose_rate_hz=1.0) as writer:
        writer.write(sim.step(10_000, ball(0.1, 0.2)))
        sim.reset([1], poses=ball(0.9))
        writer.write(sim.step(20_000, ball(0.3, 0.8)))
    first, second = (evis.load(path).bodies for path in writer.paths)
    assert first is not None
    assert second is not None
    assert first.t_us.tolist() == [0, 10_000, 20_000]
    assert second.t_us.tolist() == [0, 10_000, 10_001, 20_000]
    np.testing.assert_allclose(first.position[1:, 0, 0], [0.1, 0.3], atol=1e-12)
    np.testing.assert_allclose(second.position[1:, 0, 0], [0.2, 0.9, 0.8], atol=1e-4)
    np.testing.assert_allclose(second.position[-1, 1], [-0.2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(second.linear_velocity[-1, 0], [-10, 0, 0], atol=1e-6)


def test_the_command_follows_bodies(device: evis.Device, tmp_path: Path) -> None:
    def run(*more: str) -> evis.packets.Bodies:
        command = ["run", "spinner", "-o", "x.h5", "--duration", "0.02", "--size", "64x48", "--force", *more]
        done = subprocess.run(
            [sys.executable, "-m", "evis", *command], cwd=tmp_path, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        bodies = evis.load(tmp_path / "x.h5").bodies
        assert bodies is not None
        return bodies

    bodies = run("--pose-rate", "100")
    assert bodies.t_us.tolist() == [0, 10_000, 20_000]
    scene = evis.Scene.builtin("spinner")
    assert np.allclose(bodies.position, scene.bodies(bodies.t_us).position)
    assert bodies.names == scene.bodies().names
    assert run().position.shape == (0, len(bodies.names), 3), "without a rate, names and boxes alone"


def test_the_command_records_inertial_measurement_units_as_python_does(
    device: evis.Device, tmp_path: Path
) -> None:
    options = "--duration 0.02 --size 64x48 --seed 5 --imu square --imu-rate 500"
    noise = "--imu-noise accelerometer_noise_density=2e-3 --imu-noise gyroscope_random_walk=1e-4"
    done = subprocess.run(
        [sys.executable, "-m", "evis", "run", "spinner", "-o", "x.h5", *options.split(), *noise.split()],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    recording = evis.load(tmp_path / "x.h5")

    def simulated(seed: int) -> evis.imu.ImuSamples:
        own = evis.imu.ImuNoise(accelerometer_noise_density=2e-3, gyroscope_random_walk=1e-4)
        scene = evis.Scene.builtin("spinner", seed=5)
        return evis.imu.simulate(scene, "square", duration=0.02, rate_hz=500, noise=own, seed=seed)

    found = recording.imus["square"]
    for column in ("t_us", "accelerometer", "gyroscope"):
        assert np.array_equal(getattr(found, column), getattr(simulated(5), column))
    assert not np.array_equal(found.gyroscope, simulated(6).gyroscope), "canary"


def test_poses_that_cannot_be_written_are_refused(scene: evis.Scene, tmp_path: Path) -> None:
    sim = evis.Simulator(scene, **SMALL)
    with pytest.raises(evis.ConfigError, match=r"\.raw holds no poses"):
        evis.Writer(tmp_path / "a.raw", sim, pose_rate_hz=10.0)
    with pytest.raises(evis.ConfigError, match="pose_rate_hz is 0"):
        evis.Writer(tmp_path / "a.h5", sim, pose_rate_hz=0.0)
    driven = evis.Simulator(scene, poses=["ball"], **SMALL)
    with evis.Writer(tmp_path / "b.h5", driven, pose_rate_hz=10.0) as writer:
        packet = driven.step(10_000, {"ball": [0, 1, 0, 0, 0, 0, 1]})
        with pytest.raises(evis.ConfigError, match="0 to 10000 us is a copy"):
            writer.write(copy.copy(packet))
        writer.write(packet)
    assert evis.load(tmp_path / "b.h5").bodies.t_us.tolist() == [0, 10_000]
    events = evis.EventArray.from_columns([0], [0], [0], [1], width=4, height=4)
    with pytest.raises(evis.ConfigError, match="for streams"):
        evis.save(tmp_path / "a.h5", events, pose_rate_hz=10.0)


def test_every_data_set_says_its_units(scene: evis.Scene, device: evis.Device, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    labels = ["depth", "flow", "instance", "semantic", "normal", "hdr", "cause"]
    sim = evis.Simulator(
        scene, labels=labels, label_rate_hz=100.0, frame_rate_hz=100.0, device=device, **SMALL
    )
    with evis.Writer(tmp_path / "a.h5", sim, imus=["imu"], pose_rate_hz=100.0) as writer:
        writer.write(sim.step(20_000))
        writer.write_imu("imu", evis.imu.simulate(scene, "crate", duration=0.02))
    evis.Truth.from_events(evis.load(tmp_path / "a.h5").events).save(tmp_path / "truth.h5")
    told: dict[str, tuple[str, str]] = {}

    def visit(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset):
            told[name] = tuple(bytes(item.attrs[key]).decode() for key in ("units", "description"))  # type: ignore[assignment]

    for file in ("a.h5", "truth.h5"):
        with h5py.File(tmp_path / file) as opened:
            opened.visititems(visit)
            if file == "a.h5":
                names = opened["eye/labels/instance_names"].asstr()[:].tolist()
                ids = opened["eye/labels/instance_ids"][:].tolist()
                classes = opened["eye/labels/semantic_names"].asstr()[:].tolist()
    assert dict(zip(ids, names, strict=True)) == {i.id: i.name for i in scene.instances}
    assert classes == ["container"]
    assert len(told) > 60
    assert told["eye/labels/depth"] == ("m", "planar z; +inf where nothing is")
    assert told["bodies/angular_velocity"][0] == "rad/s"
    assert all(re.fullmatch(r"[\w/^ .-]+", unit) and len(about) > 3 for unit, about in told.values())


def test_a_rig_tells_how_its_cameras_lie_to_each_other() -> None:
    camera = evis.EventCamera(name="camera", width=64, height=48, fx=56)
    rig = evis.rig.Rig.stereo(0.12, camera)
    # What is at the left camera's origin lies 0.12 m to the left of the right one's.
    assert np.allclose(rig.T_right_left, [[1, 0, 0, -0.12], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    turned = evis.rig.Rig.parse(KALIBR)
    assert np.allclose(turned.T_right_left, T_CN_CNM1)
    assert not np.allclose(turned.T_right_left, np.linalg.inv(T_CN_CNM1)), "canary: the direction counts"
    there = turned.transform("cam1", "cam0")
    assert np.allclose(there @ turned.transform("cam0", "cam1"), np.eye(4))
    with pytest.raises(evis.ConfigError, match="of two cameras; the rig has 1"):
        _ = evis.rig.Rig(rig.cameras[:1]).T_right_left


#: Turned by 0.1 rad about OpenCV's y axis, and shifted.
T_CN_CNM1 = np.array(
    [
        [np.cos(0.1), 0, np.sin(0.1), -0.11],
        [0, 1, 0, 0.01],
        [-np.sin(0.1), 0, np.cos(0.1), 0.02],
        [0, 0, 0, 1],
    ]
)

CAMERA = """
  camera_model: pinhole
  intrinsics: [56.0, 56.0, 31.5, 23.5]
  distortion_model: none
  distortion_coeffs: []
  resolution: [64, 48]
"""

KALIBR = f"cam0:{CAMERA}cam1:{CAMERA}  T_cn_cnm1:\n" + "".join(f"  - {row.tolist()}\n" for row in T_CN_CNM1)
