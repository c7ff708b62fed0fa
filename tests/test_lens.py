"""Lenses against OpenCV, rigs and calibration files, inertial measurement units."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import evis
from evis.imu import ImuNoise, from_poses, simulate
from evis.lens import Fisheye, Lens, RadialTangential, distortion_of
from evis.rig import Rig, RigCamera

RADTAN = RadialTangential(k1=-0.31, k2=0.09, p1=1.1e-3, p2=-7e-4, k3=-0.01)
RATIONAL = RadialTangential(k1=0.3, k2=-0.1, p1=5e-4, p2=1e-3, k3=0.01, k4=0.55, k5=-0.03, k6=0.02)
FISHEYE = Fisheye(k1=0.02, k2=-0.011, k3=0.004, k4=-0.0007)
K = {"fx": 310.0, "fy": 305.5, "cx": 172.3, "cy": 131.9}


def points(reach: float = 0.45) -> npt.NDArray[np.float64]:
    """Points before the camera, in EVIS's axes."""
    rng = np.random.default_rng(3)
    xy = rng.uniform(-reach, reach, (500, 2))
    return np.column_stack([xy, -np.ones(500)]) * rng.uniform(0.5, 4.0, (500, 1))


@pytest.mark.parametrize(
    ("name", "distortion"), [("none", None), ("radtan", RADTAN), ("rational", RATIONAL), ("fisheye", FISHEYE)]
)
def test_projection_is_what_opencv_had(name: str, distortion: RadialTangential | Fisheye | None) -> None:
    """Where OpenCV is not installed, ten points that it projected, rounded to 1e-7 pixels."""
    table = json.loads((Path(__file__).parent / "data" / "opencv_projections.json").read_text("utf-8"))
    found = Lens(**K, distortion=distortion).project(table["points"]) - 0.5
    assert np.abs(found - table[name]).max() < 1e-6
    others = [table[other] for other in ("none", "radtan", "rational", "fisheye") if other != name]
    assert all(np.abs(found - other).max() > 0.1 for other in others), "canary"


@pytest.mark.parametrize("distortion", [None, RADTAN, RATIONAL, FISHEYE])
def test_projection_is_opencvs(distortion: RadialTangential | Fisheye | None) -> None:
    """Within a hundredth of a pixel, with pixel centres half a pixel apart, and axes turned round."""
    cv2 = pytest.importorskip("cv2")
    ours = Lens(**K, distortion=distortion)
    seen = points()
    matrix = np.array([[K["fx"], 0, K["cx"] - 0.5], [0, K["fy"], K["cy"] - 0.5], [0, 0, 1]])
    theirs_points = (seen * [1.0, -1.0, -1.0]).reshape(-1, 1, 3)
    zero = np.zeros(3)
    if isinstance(distortion, Fisheye):
        theirs, _ = cv2.fisheye.projectPoints(
            theirs_points, zero, zero, matrix, np.array(distortion.coefficients)
        )
    else:
        coefficients = np.zeros(8) if distortion is None else np.array(distortion.coefficients)
        theirs, _ = cv2.projectPoints(theirs_points, zero, zero, matrix, coefficients)
    found = ours.project(seen)
    apart = np.abs(found - 0.5 - theirs.reshape(-1, 2)).max()
    assert apart < 1e-6
    other = Lens(**K, distortion=Fisheye(k1=0.5)).project(seen)
    assert np.nanmax(np.abs(other - 0.5 - theirs.reshape(-1, 2))) > 0.01, "canary"


@pytest.mark.parametrize("distortion", [None, RADTAN, RATIONAL, FISHEYE])
def test_pixels_go_there_and_back(distortion: RadialTangential | Fisheye | None) -> None:
    """`unproject` inverts `project`, and shapes are checked."""
    lens = Lens(**K, distortion=distortion)
    pixels = lens.project(points())
    assert np.isfinite(pixels).all()
    directions = lens.unproject(pixels)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(lens.project(directions * 2.5), pixels, atol=1e-7)
    assert np.isnan(lens.project([[0.0, 0.0, 1.0]])).all() or isinstance(distortion, Fisheye)
    with pytest.raises(evis.ConfigError, match=r"\(3,\)"):
        lens.project([0.0, 0.0, 1.0])
    with pytest.raises(evis.ConfigError, match="-1"):
        Lens(fx=-1.0, fy=1.0, cx=0.0, cy=0.0).project(points())


def test_distortions_have_opencvs_order() -> None:
    """Lists of coefficients, short ones too."""
    assert distortion_of("radtan", [-0.3, 0.1, 1e-3]) == RadialTangential(k1=-0.3, k2=0.1, p1=1e-3)
    assert RADTAN.coefficients == (-0.31, 0.09, 1.1e-3, -7e-4, -0.01, 0.0, 0.0, 0.0)
    with pytest.raises(evis.ConfigError, match="'omni'"):
        distortion_of("omni", [])
    with pytest.raises(evis.ConfigError, match="5"):
        distortion_of("fisheye", [0.0] * 5)


#: The other lens of a pair; the first one is `K` with `RADTAN` or `FISHEYE`.
K_RIGHT = {"fx": 302.0, "fy": 300.0, "cx": 176.1, "cy": 127.4}
PAIRS: dict[str, tuple[RadialTangential | Fisheye | None, ...]] = {
    "none": (None, None),
    "radtan": (RADTAN, RadialTangential(k1=-0.27, k2=0.06, p1=-5e-4, p2=4e-4)),
    "fisheye": (FISHEYE, Fisheye(k1=0.01, k2=-0.02, k3=0.003, k4=0.0004)),
}
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def pair_of(
    distortions: tuple[RadialTangential | Fisheye | None, ...], right_from_left: npt.ArrayLike
) -> Rig:
    """Two cameras; the relative pose is in OpenCV's axes."""
    pose = np.eye(4)
    pose[:3] = right_from_left
    placed = FLIP @ np.linalg.inv(pose) @ FLIP
    rows = (np.eye(4), placed)
    made = (
        RigCamera(
            name=name,
            width=346,
            height=260,
            distortion=distortion,
            body_from_camera=tuple(map(tuple, row)),  # type: ignore[arg-type]
            **lens,
        )
        for name, lens, distortion, row in zip(
            ("left", "right"), (K, K_RIGHT), distortions, rows, strict=True
        )
    )
    return Rig(tuple(made))


@pytest.mark.parametrize("name", list(PAIRS))
def test_rectification_is_what_opencv_had(name: str) -> None:
    """What its stereoRectify gave, and directions that it projected into both distorted pictures."""
    table = json.loads((Path(__file__).parent / "data" / "opencv_rectification.json").read_text("utf-8"))
    theirs = table[name]
    rig = pair_of(PAIRS[name], table["right_from_left"])
    pair = rig.rectify()
    R1, R2, P1, P2, Q = pair.opencv()  # noqa: N806 - its names
    for ours, key in ((R1, "R1"), (R2, "R2")):
        np.testing.assert_allclose(ours, theirs[key], atol=1e-8)
    assert np.abs(R1 - theirs["R2"]).max() > 0.05, "canary: halves of the rotation go two ways"
    assert P2[0, 3] / P2[0, 0] == pytest.approx(theirs["P2_03"] / theirs["lens_1"][0], rel=1e-7)
    # A direction in the rectified axes, where its pictures have it, and the way back.
    slopes = np.array(table["points"])
    focal, center = P1[[0, 1], [0, 1]], P1[:2, 2]
    for camera in ("left", "right"):
        there = np.array(theirs[camera]) + 0.5
        np.testing.assert_allclose((pair.pixels(camera, there) - 0.5 - center) / focal, slopes, atol=1e-7)
        np.testing.assert_allclose(pair.sources(camera, slopes * focal + center + 0.5), there, atol=1e-5)
    wrong = pair.pixels("right", np.array(theirs["left"]) + 0.5)
    assert np.abs((wrong - 0.5 - center) / focal - slopes).max() > 0.01, "canary"
    # The lens is chosen as its stereoRectify does, but for half pixels at the borders; fisheye.stereoRectify
    # has another way.
    if name != "fisheye":
        for alpha in (0, 1):
            lens = rig.rectify(alpha=alpha).lens
            fx, fy, cx, cy = theirs[f"lens_{alpha}"]
            assert lens.fx == lens.fy == pytest.approx(fx, rel=0.01)
            assert fx == fy
            assert (lens.cx - 0.5, lens.cy - 0.5) == pytest.approx((cx, cy), abs=1.5)
    # Q is the inverse of both projections.
    x, y, d, one = Q @ [200.0, 150.0, 12.0, 1.0]
    point = np.array([x, y, d, one]) / one
    assert P1 @ point / point[2] == pytest.approx([200.0, 150.0, 1.0])
    assert P2 @ point / point[2] == pytest.approx([188.0, 150.0, 1.0])


@pytest.mark.parametrize("name", list(PAIRS))
def test_rectification_is_opencvs(name: str) -> None:
    """Where OpenCV is installed: its rotations, and its undistorted points."""
    cv2 = pytest.importorskip("cv2")
    table = json.loads((Path(__file__).parent / "data" / "opencv_rectification.json").read_text("utf-8"))
    rig = pair_of(PAIRS[name], table["right_from_left"])
    pair = rig.rectify()
    R1, R2, P1, P2, _ = pair.opencv()  # noqa: N806 - its names
    pixels = np.random.default_rng(7).uniform([0, 0], [346, 260], (200, 2))
    for camera, turn, seen in zip(rig.cameras, (R1, R2), (P1, P2), strict=True):
        matrix = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1.0]])
        distortion = np.zeros(8) if camera.distortion is None else np.array(camera.distortion.coefficients)
        undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
        theirs = (cv2.fisheye.undistortPoints if name == "fisheye" else undistort)(
            (pixels - 0.5).reshape(-1, 1, 2),
            matrix,
            distortion,
            R=turn,
            P=seen[:, :3],
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-12),
        )
        ours = pair.pixels(camera.name, pixels)
        assert np.abs(ours - 0.5 - theirs.reshape(-1, 2)).max() < 1e-5
        assert np.abs(ours - theirs.reshape(-1, 2)).min() > 0.4, "canary"


@pytest.mark.parametrize("left", list(PAIRS))
@pytest.mark.parametrize("right", list(PAIRS))
def test_rectified_points_lie_in_one_row(left: str, right: str) -> None:
    """Whatever the lenses: rows are equal, and the disparity tells the depth along the rectified axis."""
    table = json.loads((Path(__file__).parent / "data" / "opencv_rectification.json").read_text("utf-8"))
    rig = pair_of((PAIRS[left][0], PAIRS[right][1]), table["right_from_left"])
    pair = rig.rectify(alpha=0.5)
    seen = points()
    there = seen @ rig.transform("right", "left")[:3, :3].T + rig.transform("right", "left")[:3, 3]
    here, over = rig.camera("left").lens.project(seen), rig.camera("right").lens.project(there)
    both = np.isfinite(here).all(1) & np.isfinite(over).all(1)
    assert both.sum() > 400
    a, b = pair.pixels("left", here[both]), pair.pixels("right", over[both])
    depth = -(seen[both] @ pair.rectified_from_left.T)[:, 2]
    np.testing.assert_allclose(a[:, 1], b[:, 1], atol=1e-6)
    np.testing.assert_allclose(a[:, 0] - b[:, 0], pair.lens.fx * pair.baseline / depth, atol=1e-6)
    assert np.abs(here[both, 1] - over[both, 1]).max() > 5, "canary: they are not rectified"
    np.testing.assert_allclose(pair.sources("left", a), here[both], atol=1e-6)


def test_pairs_that_cannot_be_rectified_are_refused() -> None:
    """By name, value and what would work; what the lens does not see is NaN."""
    still = np.eye(3)

    def apart(rotation: npt.ArrayLike, position: npt.ArrayLike) -> Rig:
        turned = np.asarray(rotation)
        place = np.array(position)
        return pair_of(PAIRS["radtan"], np.column_stack([turned, -turned @ place]))

    def turn(degrees: float) -> npt.NDArray[np.float64]:
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])

    for rig, message in (
        (apart(still, [0, 0, 0]), "0 m apart"),
        (apart(still, [-0.1, 0, 0]), "exchange them"),
        (apart(still, [0.01, 0.1, 0]), "side by side"),
        (apart(turn(178), [0.1, 0, 0]), "look 0 and 178 degrees away"),
        (apart(turn(-178), [0.1, 0, 0]), "look 0 and 178 degrees away"),
    ):
        with pytest.raises(evis.ConfigError, match=message):
            rig.rectify()
    rig = apart(still, [0.1, 0, 0])
    with pytest.raises(evis.ConfigError, match=r"alpha is 1\.1"):
        rig.rectify(alpha=1.1)
    small = Rig((rig.cameras[0], replace(rig.cameras[1], width=320)))
    with pytest.raises(evis.ConfigError, match="346x260 and 320x260"):
        small.rectify()
    with pytest.raises(evis.ConfigError, match="left, right"):
        rig.rectify("left", "middle")
    with pytest.raises(evis.ConfigError, match="names of two cameras"):
        Rig(rig.cameras[:1]).rectify()
    pair = rig.rectify("left", "right")
    with pytest.raises(evis.ConfigError, match="'middle'"):
        pair.map("middle")
    events = evis.EventArray.from_columns([0], [3], [2], [1], width=4, height=4)
    with pytest.raises(evis.ConfigError, match="4x4"):
        pair.events("left", events)
    # A barrel that folds before the corners of the picture, where it shows nothing.
    folds = replace(rig.cameras[0], distortion=RadialTangential(k1=-1.2))
    bent = Rig((folds, replace(rig.cameras[1], distortion=folds.distortion))).rectify()
    places = bent.map("left")
    assert np.isnan(places[0, 0]).all()
    assert np.isfinite(places[130, 173]).all()
    corner = evis.EventArray.from_columns([0, 1], [0, 173], [0, 130], [1, 1], width=346, height=260)
    np.testing.assert_array_equal(bent.events("left", corner), places[[0, 130], [0, 173]])


def camera(**more: object) -> evis.EventCamera:
    """Small, with a distorted lens."""
    return evis.EventCamera(
        name="bent",
        width=64,
        height=48,
        fx=56.0,
        distortion=RADTAN,
        pose=evis.motion.Placement(position=(0, 0, 1.5)),
        **more,
    )  # type: ignore[arg-type]


def test_a_distorted_camera_streams_and_is_stored(tmp_path: Path) -> None:
    """Scene, simulator, file: the lens goes all the way, with inertial samples beside."""
    scene = evis.Scene.builtin("spinner").with_cameras([camera()])
    assert pickle.loads(pickle.dumps(scene)).cameras == scene.cameras
    sim = evis.Simulator(scene, cameras=["bent"], method="native", rate_hz=500, labels=("depth",))
    lens = sim.cameras[0].lens
    assert lens == Lens(fx=56.0, fy=56.0, cx=32.0, cy=24.0, distortion=RADTAN)
    path = tmp_path / "bent.h5"
    samples = simulate(
        scene, "bent", duration=0.02, rate_hz=1000, noise=ImuNoise(gyroscope_noise_density=1e-3)
    )
    with evis.Writer(path, sim, imus=["head"]) as writer, sim.stream(duration=0.02) as stream:
        for packet in stream:
            writer.write(packet)
        writer.write_imu("head", samples)
        with pytest.raises(evis.ConfigError, match="'tail'"):
            writer.write_imu("tail", samples)
    recording = evis.load(path)
    assert recording.cameras[0].lens == lens
    assert len(recording.events) > 50
    np.testing.assert_array_equal(recording.imus["head"].gyroscope, samples.gyroscope)
    np.testing.assert_array_equal(recording.imus["head"].t_us, np.arange(20) * 1000)


def test_what_a_distorted_camera_cannot_have_is_refused() -> None:
    """Methods and settings by name; lenses without focal lengths, and too wide ones."""
    scene = evis.Scene.builtin("spinner").with_cameras([camera()])
    with pytest.raises(evis.ConfigError, match="'bent' has a distorted lens"):
        evis.Simulator(scene, cameras=["bent"], method="splat")
    assert len(evis.Simulator(scene, cameras=["bent"], method="decoupled").step(20_000).events) > 10
    wrong = evis.EventCamera(name="wrong", fov_y_degrees=60, distortion=FISHEYE)
    with pytest.raises(evis.FormatError, match="focal"):
        evis.Scene.builtin("spinner").with_cameras([wrong])
    wide = evis.EventCamera(name="wide", width=64, height=48, fx=20.0, distortion=Fisheye())
    with pytest.raises(evis.ConfigError, match="150"):
        evis.Simulator(evis.Scene.builtin("spinner").with_cameras([wide]), cameras=["wide"], method="native")
    with pytest.raises(evis.ConfigError, match=r"evis\.lens"):
        evis.EventCamera(name="c", fx=1.0, distortion=[0.1]).table()  # type: ignore[arg-type]


def test_rigs_survive_files_and_become_cameras(tmp_path: Path) -> None:
    """Kalibr's and DSEC's files; the cameras of a scene are where the rig has them."""
    like = evis.EventCamera(
        name="c", width=64, height=48, fx=55.0, fy=56.0, cx=31.0, cy=24.5, distortion=FISHEYE
    )
    rig = Rig.stereo(0.12, like)
    for format in ("kalibr", "dsec"):
        path = tmp_path / f"{format}.yaml"
        rig.save(path, format)  # type: ignore[arg-type]
        read = Rig.load(path).cameras
        first, last = read[0], read[-1]
        assert (first.fx, first.cx, first.distortion) == (55.0, 31.0, FISHEYE)
        np.testing.assert_allclose(last.pose[:3, 3], [0.12, 0.0, 0.0], atol=1e-12)
    assert "intrinsics: [55.0, 56.0, 30.5, 24.0]" in rig.text(), "OpenCV's centre is half a pixel less"
    builder = evis.SceneBuilder("rig", ambient=(1, 1, 1))
    builder.material("white")
    builder.card("wall", size=(2, 2), material="white")
    builder.node("head", pose=evis.motion.Placement(position=(0, 0, 2), rotation_degrees=(0, 20, 0)))
    for each in rig.event_cameras("head", near=0.2):
        builder.camera(each)
    assert builder.build().cameras == ("left", "right")
    with pytest.raises(evis.ConfigError, match="baseline"):
        Rig.stereo(-1.0, like)
    with pytest.raises(evis.ConfigError, match="'ros'"):
        rig.text("ros")  # type: ignore[arg-type]
    with pytest.raises(evis.ConfigError, match="left, right"):
        rig.camera("middle")
    with pytest.raises(FileNotFoundError):
        Rig.load(tmp_path / "none.yaml")
    (tmp_path / "bad.yaml").write_text("cam0: [1, 2]\n")
    with pytest.raises(evis.FormatError, match="camchain"):
        Rig.load(tmp_path / "bad.yaml")


def test_a_unit_that_spins_measures_its_rate_and_the_centripetal_force() -> None:
    """In the axes of the node; noise by its seed."""
    builder = evis.SceneBuilder("imu")
    builder.material("white")
    builder.card("wall", size=(2, 2), material="white")
    spin = evis.motion.Spin(axis=(0, 1, 0), degrees_per_s=90)
    builder.node("arm", pose=evis.motion.Placement(motion=spin))
    builder.node("body", pose=evis.motion.Placement(position=(2, 0, 0), parent="arm"))
    builder.camera(evis.EventCamera(name="eye"))
    scene = builder.build()
    samples = simulate(scene, "body", duration=0.5, rate_hz=100)
    rate = math.pi / 2
    assert len(samples) == 50
    np.testing.assert_allclose(samples.gyroscope, np.tile([0, rate, 0], (50, 1)), atol=1e-8)
    np.testing.assert_allclose(samples.accelerometer, np.tile([-2 * rate**2, 9.80665, 0], (50, 1)), atol=1e-6)
    noise = ImuNoise(accelerometer_noise_density=0.01)
    noisy = [
        simulate(scene, "body", duration=0.5, noise=noise, seed=seed).accelerometer for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(noisy[0], noisy[1])
    assert (noisy[0] != noisy[2]).any(), "canary"
    with pytest.raises(evis.ConfigError, match="'nowhere'"):
        simulate(scene, "nowhere", duration=1.0)
    with pytest.raises(evis.ConfigError, match="-5"):
        simulate(scene, "body", duration=1.0, rate_hz=-5)


def swinging(t_s: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], ...]:
    """Poses, velocities and accelerations of a body that swings and turns at 2 rad/s about (1, 2, 3)."""
    w = np.array([7.0, 11.0, 5.0])
    phase = t_s[:, None] * w + [0.0, 1.0, 2.0]
    axis = np.array([1.0, 2.0, 3.0]) / math.sqrt(14)
    poses = np.column_stack(
        [0.3 * np.sin(phase), axis * np.sin(t_s)[:, None], np.cos(t_s)]  # half of 2 rad/s
    )
    return poses, 0.3 * w * np.cos(phase), -0.3 * w * w * np.sin(phase), 2.0 * axis


def test_a_unit_on_a_body_that_a_host_moves() -> None:
    """Against exact derivatives, and against the scene with the same motion."""
    t_us = np.arange(10_000, 410_001, 2000)
    poses, velocities, _, rate = swinging(t_us * 1e-6)
    poses[::3, 3:] *= -1.0  # the same rotations
    found = from_poses(t_us, poses, velocities=velocities, rate_hz=300, gravity=(0, -9.0, 0))
    assert (found.t_us[0], found.t_us[-1]) == (10_000, 406_667)
    at, _, acceleration, _ = swinging(found.t_us * 1e-6)
    # The inverse rotation of the world's vector, by the matrix.
    x, y, z, w = at[:, 3:].T
    rows = 2 * np.array(
        [
            [0.5 - y * y - z * z, x * y + z * w, x * z - y * w],
            [x * y - z * w, 0.5 - x * x - z * z, y * z + x * w],
            [x * z + y * w, y * z - x * w, 0.5 - x * x - y * y],
        ]
    )
    expected = np.einsum("ijn,nj->ni", rows, acceleration - [0, -9.0, 0])
    np.testing.assert_allclose(found.gyroscope, np.tile(rate, (len(found), 1)), atol=1e-9)
    assert np.abs(found.accelerometer - expected).max() < 2e-3
    without = from_poses(t_us, poses, rate_hz=300, gravity=(0, -9.0, 0))
    assert np.abs(without.accelerometer - expected)[4:-4].max() < 0.03
    wrong = from_poses(t_us, poses, velocities=velocities, rate_hz=300, gravity=(0, 9.0, 0))
    assert np.abs(wrong.accelerometer - expected).max() > 10, "canary"
    # The scene that has this motion measures the same, but near the ends.
    keys = evis.motion.Keys(
        times_s=t_us * 1e-6,
        positions=poses[:, :3],
        rotations=poses[:, 3:],
        velocities=velocities,
        interpolation="hermite",
    )
    builder = evis.SceneBuilder("body")
    builder.material("plain")
    builder.box("body", size=(1, 1, 1), material="plain", pose=evis.motion.Placement(motion=keys))
    noise = ImuNoise(accelerometer_noise_density=0.2)
    scene = simulate(builder.build(), "body", duration=0.41, rate_hz=300, noise=noise, seed=5)
    host = from_poses(t_us, poses, velocities=velocities, rate_hz=300, noise=noise, seed=5)
    both = scene.accelerometer[np.isin(scene.t_us, host.t_us)]
    assert np.abs(both - host.accelerometer)[3:-3].max() < 2e-2
    quiet = from_poses(t_us, poses, velocities=velocities, rate_hz=300)
    assert np.abs(quiet.accelerometer - host.accelerometer).max() > 1, "canary: noise"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t_us": [0, 10]}, "three ascending"),
        ({"t_us": [0, 10, 10]}, "three ascending"),
        ({"t_us": [0.0, 10.0, 20.0]}, "whole numbers"),
        ({"t_us": [-10, 10, 20]}, "begins at -10"),
        ({"poses": np.zeros((3, 6))}, r"poses has shape \(3, 6\).*\(3, 7\)"),
        ({"poses": np.full((3, 7), np.nan)}, "finite"),
        ({"poses": np.ones((3, 7))}, "length 2 in row 0"),
        ({"poses": "here"}, "poses is 'here'"),
        ({"velocities": np.zeros((2, 3))}, r"velocities has shape \(2, 3\)"),
        ({"rate_hz": 0.0}, "rate"),
    ],
)
def test_poses_that_cannot_be_measured_are_refused(change: dict[str, object], message: str) -> None:
    """By name, value and what would work."""
    given = {"t_us": [0, 10_000, 20_000], "poses": np.tile([0, 0, 0, 0, 0, 0, 1.0], (3, 1))}
    with pytest.raises(evis.ConfigError, match=message):
        from_poses(**{**given, **change})  # type: ignore[arg-type]
