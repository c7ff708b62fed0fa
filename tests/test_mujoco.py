"""MuJoCo's models as scenes, and events of its simulations."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import evis
from evis._rotations import difference, interpolated

mujoco = pytest.importorskip("mujoco")

import evis.mujoco  # noqa: E402

WIDTH, HEIGHT = 160, 120
VIEW = """<visual><map znear="0.01" zfar="50"/><quality offsamples="0"/></visual>"""

EVERYTHING = f"""
<mujoco>
  {VIEW}
  <statistic center="0 0 0.3" extent="2"/>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.4 0.6 0.8" width="32" height="32"/>
    <texture name="grid" type="2d" builtin="checker" rgb1="0.2 0.3 0.4" rgb2="0.1 0.2 0.3" width="64"
      height="64"/>
    <texture name="cube" type="cube" builtin="flat" mark="cross" rgb1="0.8 0.3 0.2" rgb2="0.2 0.4 0.8"
      markrgb="1 1 1" width="32" height="32"/>
    <material name="floor" texture="grid" texrepeat="2 2" texuniform="true"/>
    <material name="cubed" texture="cube"/>
    <material name="uniform" texture="cube" texuniform="true"/>
    <material name="checked" texture="grid" texrepeat="3 3"/>
    <material name="glow" rgba="0.1 0.8 0.2 1" emission="1"/>
    <mesh name="tetra" vertex="0 0 0  0.3 0 0  0 0.3 0  0 0 0.3"/>
    <hfield name="hills" nrow="4" ncol="5" size="0.3 0.25 0.2 0.05"/>
  </asset>
  <worldbody>
    <light name="sun" pos="0 0 3" dir="0.3 0.2 -1" directional="true"/>
    <light name="lamp" pos="1 -1 2" dir="-0.5 0.5 -1" cutoff="40"/>
    <camera name="front" pos="0.2 -2.6 1.3" xyaxes="1 0.05 0 0 0.4 1" fovy="50"/>
    <camera name="lens" pos="-1.8 -1.8 1.6" xyaxes="1 -1 0 0.4 0.4 1" sensorsize="0.0064 0.0048"
      focal="0.005 0.005" principal="0.0005 -0.0003" resolution="640 480"/>
    <geom name="floor" type="plane" size="0 0 0.05" material="floor"/>
    <geom name="card" type="plane" size="0.25 0.2 0.05" pos="-1 0.8 0.5" euler="90 0 20" material="checked"/>
    <geom name="hills" type="hfield" hfield="hills" pos="0.9 0.7 0.1" rgba="0.4 0.6 0.3 1"/>
    <geom name="ghost" type="box" size="1 1 1" pos="0 0 1" rgba="1 1 1 0"/>
    <geom name="hidden" type="box" size="0.4 0.4 0.4" pos="0 -1 0.4" group="3"/>
    <body name="things" pos="0 0 0.3">
      <freejoint/>
      <geom name="sphere" type="sphere" size="0.15" pos="-0.6 0 0" material="cubed"/>
      <geom name="capsule" type="capsule" size="0.08 0.15" pos="-0.25 0 0" euler="20 30 0"/>
      <geom name="ellipsoid" type="ellipsoid" size="0.1 0.15 0.2" euler="0 20 40" pos="0.1 0 0"
        material="glow"/>
      <geom name="cylinder" type="cylinder" size="0.1 0.12" pos="0.4 0 0" euler="40 0 0" material="checked"/>
      <geom name="box" type="box" size="0.1 0.15 0.12" pos="0.75 0 0" euler="10 20 30" material="uniform"/>
      <geom name="mesh" type="mesh" mesh="tetra" pos="-0.2 -0.5 0.1" euler="0 0 30" material="checked"/>
      <site name="mark" type="box" size="0.05 0.05 0.05" pos="0.3 -0.5 0" rgba="1 0 1 1"/>
    </body>
  </worldbody>
</mujoco>
"""

ARM = f"""
<mujoco>
  {VIEW}
  <statistic center="0 0 0.4" extent="1"/>
  <option timestep="0.002" integrator="implicitfast" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1" directional="true"/>
    <camera name="look" pos="0 -2 0.8" xyaxes="1 0 0 0 0.3 1"/>
    <geom name="floor" type="plane" size="2 2 0.1" rgba="0.3 0.3 0.35 1"/>
    <body name="shoulder" pos="0 0 0.1">
      <joint name="turn" axis="0 0 1"/>
      <geom type="cylinder" size="0.1 0.1" rgba="0.8 0.8 0.8 1"/>
      <body name="upper" pos="0 0 0.1" euler="0 40 0">
        <joint name="lift" axis="0 1 0"/>
        <geom type="capsule" size="0.05 0.2" pos="0 0 0.2" rgba="0.9 0.4 0.1 1"/>
        <body name="lower" pos="0 0 0.4" euler="0 60 0">
          <joint name="bend" axis="0 1 0"/>
          <geom type="capsule" size="0.04 0.15" pos="0 0 0.15" rgba="0.1 0.4 0.9 1"/>
          <camera name="wrist" pos="0 0 0.35" euler="180 0 0"/>
          <geom name="tip" type="box" size="0.03 0.02 0.05" pos="0.05 0 0.35" rgba="0.2 0.9 0.2 1"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


TENDONS = f"""
<mujoco>
  {VIEW}
  <statistic center="0 0 0.5" extent="1.5"/>
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <worldbody>
    <light pos="0 0 3" dir="0.2 0.3 -1" directional="true"/>
    <camera name="look" pos="0 -2.4 0.7" xyaxes="1 0 0 0 0.1 1"/>
    <geom name="floor" type="plane" size="2 2 0.1" rgba="0.3 0.3 0.35 1"/>
    <site name="a" pos="-0.9 0 1.1" size="0.04" type="sphere" rgba="0.9 0.9 0.2 1"/>
    <site name="b" pos="0.9 0 1.1" size="0.03 0.05 0.02" type="ellipsoid" rgba="0.9 0.2 0.2 1"/>
    <site name="c" pos="-0.9 0 0.3" size="0.03 0.06" type="cylinder"/>
    <site name="d" pos="0.9 0 0.3" size="0.03 0.06" type="capsule"/>
    <site name="unseen" pos="0 -1 0.5" size="0.2" rgba="1 1 1 0"/>
    <site name="other" pos="0.3 -1 0.5" size="0.2" group="4"/>
    <body name="ball" pos="0 0 1.1">
      <joint name="up" type="slide" axis="0 0 1"/><joint name="over" type="slide" axis="1 0 0"/>
      <geom name="pulley" type="sphere" size="0.25" rgba="0.4 0.6 0.4 1"/>
      <site name="top" pos="0 0 0.4" size="0.01"/>
      <site name="hook" pos="0 0 -0.3" size="0.02"/>
    </body>
    <body name="drum" pos="0 0 0.3" euler="90 0 0">
      <joint name="along" type="slide" axis="0 1 0"/>
      <geom name="drum" type="cylinder" size="0.15 0.2" rgba="0.4 0.4 0.7 1"/>
      <site name="side" pos="0 0.3 0" size="0.01"/>
    </body>
  </worldbody>
  <tendon>
    <spatial name="over" width="0.03" rgba="0.9 0.5 0.1 1">
      <site site="a"/><geom geom="pulley" sidesite="top"/><site site="b"/>
    </spatial>
    <spatial name="under" width="0.02" rgba="0.1 0.7 0.9 1">
      <site site="c"/><geom geom="drum" sidesite="side"/><site site="d"/>
      <pulley divisor="2"/><site site="hook"/><site site="side"/>
    </spatial>
    <spatial name="hidden" width="0.1" group="3"><site site="a"/><site site="d"/></spatial>
  </tendon>
</mujoco>
"""

LEG = """
      <body name="{name} thigh" pos="{x} {y} 0">
        <joint name="{name} hip" axis="0 1 0" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 {back} {out} -0.2" size="0.035" rgba="0.8 0.5 0.2 1"/>
        <body name="{name} shank" pos="{back} {out} -0.2">
          <joint name="{name} knee" axis="0 1 0" range="-90 90"/>
          <geom type="capsule" fromto="0 0 0 {front} 0 -0.2" size="0.025" rgba="0.3 0.3 0.8 1"/>
          <geom type="sphere" pos="{front} 0 -0.2" size="0.03" rgba="0.1 0.1 0.1 1"/>
        </body>
      </body>"""

LEGS = "".join(
    LEG.format(name=f"{end} {side}", x=x, y=y, out=y / 5, back=-0.08, front=0.1)
    for end, x in (("front", 0.25), ("hind", -0.25))
    for side, y in (("left", 0.12), ("right", -0.12))
)

QUADRUPED = f"""
<mujoco>
  {VIEW}
  <statistic center="0 0 0.3" extent="1.5"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <asset><hfield name="hills" nrow="12" ncol="14" size="1.2 1 0.12 0.05"/></asset>
  <worldbody>
    <light pos="0 0 3" dir="0.2 0.1 -1" directional="true"/>
    <camera name="look" pos="0.5 -1.9 0.9" xyaxes="1 0.25 0 -0.05 0.25 1"/>
    <geom name="ground" type="hfield" hfield="hills" rgba="0.4 0.5 0.3 1"/>
    <body name="torso" pos="0 0 0.5">
      <freejoint/>
      <geom name="torso" type="capsule" fromto="-0.28 0 0 0.28 0 0" size="0.09" rgba="0.7 0.7 0.7 1"/>
      <geom name="head" type="capsule" fromto="0.33 0 0.08 0.45 0 0.1" size="0.05" rgba="0.9 0.3 0.2 1"/>
      <camera name="eye" pos="1.1 0.1 0.2" xyaxes="0 1 0 -0.2 0 1"/>
      {LEGS}
    </body>
  </worldbody>
</mujoco>
"""


def model_of(name: str):
    if name == "skydio":
        assets = os.environ.get("EVIS_ASSETS")
        if assets is None:
            pytest.skip("EVIS_ASSETS names no folder with models")
        path = Path(assets) / "mujoco" / "skydio_x2" / "scene.xml"
        if not path.is_file():
            pytest.fail(f"there is no {path}: EVIS_ASSETS names the folder of the assets")
        model = mujoco.MjModel.from_xml_path(str(path))
        model.vis.quality.offsamples = 0
        return model
    texts = {"everything": EVERYTHING, "arm": ARM, "tendons": TENDONS, "quadruped": QUADRUPED}
    model = mujoco.MjModel.from_xml_string(texts[name])
    # MuJoCo 3.1 has no heights in the file.
    model.hfield_data[:] = np.random.default_rng(5).random(len(model.hfield_data))
    return model


def make_orthographic(model, camera: int, height: float) -> None:
    """Let `camera` be orthographic, `height` metres high."""
    kinds = getattr(model, "cam_projection", getattr(model, "cam_orthographic", None))
    if kinds is None:
        pytest.skip("cameras of this MuJoCo are never orthographic")
    kinds[camera] = 1
    model.cam_fovy[camera] = height
    model.cam_sensorsize[camera] = 0


def renderer_of(model, device: evis.Device, **more: object):
    config = {"height": HEIGHT, "width": WIDTH, "rate_hz": 1000.0, "samples": 1, **more}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return evis.mujoco.EventRenderer(model, device=device, **config)


def run(renderer, model, data, steps: int, *, every: int = 1) -> np.ndarray:
    found = []
    for step in range(1, steps + 1):
        mujoco.mj_step(model, data)
        renderer.observe(data)
        if step % every == 0:
            found.append(renderer.render())
    return np.concatenate(found)


def own_pictures(model, camera: int, tmp_path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Depth and (object, type), by MuJoCo's software OpenGL, or its rays."""
    path, out = tmp_path / "model.mjb", tmp_path / "own.npz"
    mujoco.mj_saveModel(model, str(path), None)
    script = Path(__file__).with_name("mujoco_oracle.py")
    command = [sys.executable, str(script), str(path), str(camera), str(WIDTH), str(HEIGHT), str(out)]
    if subprocess.run(command, capture_output=True, check=False, timeout=300).returncode == 0:
        own = np.load(out)
        return own["depth"], own["segmentation"]
    if evis.mujoco._is_orthographic(model, camera):
        pytest.skip("rays of this test are a pinhole's; OSMesa draws parallel ones (Debian's libosmesa6)")
    if np.unique(model.geom_type).size > 6:
        # Of all types, planes end where they are drawn, and round ones are triangles.
        pytest.skip("rays do not hit what MuJoCo draws of all types; OSMesa does (Debian's libosmesa6)")
    return by_rays(model, camera)


def by_rays(model, camera: int) -> tuple[np.ndarray, np.ndarray]:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer_camera = evis.mujoco.scene(model, size=(WIDTH, HEIGHT))
    name = mujoco.mj_id2name(model, int(mujoco.mjtObj.mjOBJ_CAMERA), camera)
    info = next(c for c in evis.Simulator(renderer_camera, cameras=[name]).cameras)
    turn = data.cam_xmat[camera].reshape(3, 3)
    depth = np.full((HEIGHT, WIDTH), 1e9)
    found = np.full((HEIGHT, WIDTH, 2), -1)
    groups, hit = np.array([1, 1, 1, 0, 0, 0], np.uint8), np.zeros(1, np.int32)
    for y in range(HEIGHT):
        for x in range(WIDTH):
            way = np.array([(x + 0.5 - info.cx) / info.fx, -(y + 0.5 - info.cy) / info.fy, -1.0])
            length = np.linalg.norm(way)
            away = mujoco.mj_ray(model, data, data.cam_xpos[camera], turn @ way / length, groups, 1, -1, hit)
            if away >= 0:
                depth[y, x] = away / length
                found[y, x] = hit[0], int(mujoco.mjtObj.mjOBJ_GEOM)
    return depth, found


def agree(own: tuple[np.ndarray, np.ndarray], depth, objects, far: float) -> tuple[float, float]:
    """Shares of pixels whose depth is within 1 mm, and that show the same object."""
    nothing = own[1][..., 1] < 0
    beyond = nothing & ((objects[..., 1] < 0) | (depth > 0.999 * far))
    same = (objects == own[1]).all(axis=-1)
    return float((beyond | (np.abs(depth - own[0]) < 1e-3)).mean()), float((beyond | same).mean())


@pytest.mark.parametrize(
    ("name", "camera", "height"),
    [
        ("everything", 0, None),
        ("everything", 1, None),
        ("everything", 1, 2.2),
        ("arm", 0, None),
        ("skydio", 0, None),
        ("skydio", 0, 1.0),
        ("tendons", 0, None),
        ("quadruped", 0, None),
        ("quadruped", 1, None),
        ("quadruped", 0, 1.4),
    ],
)
def test_depth_and_segmentation_are_mujocos_own(
    name: str, camera: int, height: float | None, device: evis.Device, tmp_path: Path
):
    model = model_of(name)
    if height is not None:
        make_orthographic(model, camera, height)
    data = mujoco.MjData(model)
    renderer = renderer_of(model, device, camera=camera, labels=["depth", "instance"], label_rate_hz=1000)
    renderer.observe(data)
    data.time = 0.02
    renderer.observe(data)
    renderer.render()
    labels = renderer.packet.labels
    depth, objects = labels["depth"].data[0], renderer.instances[labels["instance"].data[0]]
    own = own_pictures(model, camera, tmp_path)
    far = model.vis.map.zfar * model.stat.extent
    shares = agree(own, depth, objects, far)
    assert min(shares) > 0.99
    assert len(np.unique(objects[..., 0])) > (8 if name == "everything" else 1)
    # Canary: a picture that lies two pixels aside.
    aside = agree(own, np.roll(depth, 2, axis=1), np.roll(objects, 2, axis=1), far)
    assert max(aside) < 0.99


def test_orthographic_cameras_fire_at_any_depth(device: evis.Device):
    text = """
    <mujoco>
      <option gravity="0 0 0"/>
      <worldbody>
        <light pos="0 0 9" dir="0 0 -1" directional="true"/>
        <camera name="above" pos="0 0 {away}"/>
        <geom type="plane" size="4 4 0.1" rgba="0.1 0.1 0.1 1"/>
        <body name="ball" pos="-0.4 0 0.3"><freejoint/><geom size="0.2" rgba="0.9 0.9 0.9 1"/></body>
      </worldbody>
    </mujoco>
    """
    found = {}
    for away in (2, 6):
        model = mujoco.MjModel.from_xml_string(text.format(away=away))
        make_orthographic(model, 0, 1.5)
        data = mujoco.MjData(model)
        data.qvel[0] = 8.0
        with evis.mujoco.EventRenderer(model, 48, 64, camera="above", device=device) as renderer:
            assert renderer.simulator.cameras[0].name == "above"
            renderer.observe(data)
            found[away] = run(renderer, model, data, 40, every=4)
    # The ball's diameter of 0.4 m has 12.8 px, and it goes 20 px.
    near, far = found[2], found[6]
    assert np.ptp(near["x"]) in range(30, 36)
    assert np.ptp(near["y"]) in range(10, 15)
    assert len(near) > 500
    # What rays see is the same from anywhere on the axis.
    counts = [np.histogram2d(e["y"], e["x"], bins=(48, 64))[0] for e in (near, far)]
    assert np.abs(counts[0] - counts[1]).sum() < 0.05 * len(near)


def test_bindings_that_read_vectors_wrongly_are_refused(monkeypatch: pytest.MonkeyPatch):
    class Camera:
        lookat = np.lib.stride_tricks.as_strided(np.zeros(1), (3,), (0,))

    evis.mujoco._check_vectors()
    monkeypatch.setattr(mujoco, "MjvCamera", Camera)
    with pytest.raises(ImportError, match=r"mujoco>=3\.2, or numpy<2"):
        evis.mujoco._check_vectors()


def test_a_known_rotation():
    """MuJoCo's quaternions are w, x, y, z: a quarter turn about x takes y to z."""
    half = np.sqrt(0.5)
    pose = evis.mujoco._seven([1, 2, 3], [half, half, 0, 0])
    assert np.allclose(pose, [1, 2, 3, half, 0, 0, half])
    x, y, z, w = pose[3:]
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert np.allclose(turn @ [0, 1, 0], [0, 0, 1])
    for way in ([0, 0, -1], [0, 0, 1], [1, 2, -3], [0.5, 0, 0.1]):
        found = np.empty(3)
        mujoco.mju_rotVecQuat(found, np.array([0.0, 0.0, -1.0]), evis.mujoco._towards(way))
        assert np.allclose(found, np.array(way) / np.linalg.norm(way))


def test_the_free_camera_is_mujocos():
    model = model_of("everything")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.azimuth, camera.elevation = 37, -21
    shown = mujoco.MjvScene(model, maxgeom=100)
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, 7, shown)
    eyes = shown.camera
    pose = evis.mujoco._free_pose(model, data, camera)
    assert np.allclose(pose[:3], (np.array(eyes[0].pos) + eyes[1].pos) / 2, atol=1e-6)
    for axis, own in ((np.array([0.0, 0, -1]), eyes[0].forward), (np.array([0.0, 1, 0]), eyes[0].up)):
        found = np.empty(3)
        mujoco.mju_rotVecQuat(found, axis, pose[[6, 3, 4, 5]])
        assert np.allclose(found, own, atol=1e-6)


@pytest.mark.parametrize("integrator", ["mjINT_EULER", "mjINT_IMPLICITFAST"])
def test_poses_within_steps_end_where_the_integrator_does(integrator: str, device: evis.Device):
    model = model_of("arm")
    model.opt.integrator = getattr(mujoco.mjtIntegrator, integrator)
    model.opt.timestep = 0.01
    data = mujoco.MjData(model)
    data.qvel[:] = [20, 15, -25]
    renderer = renderer_of(model, device, camera="look", height=48, width=64)
    renderer.observe(data)
    halved = 0
    for _ in range(8):
        mujoco.mj_step(model, data)
        renderer.observe(data)
        before, last = list(renderer._seen)[-2:]
        halved += len(last.within.get(0, []))
        assert last.followed.all()
        end = renderer._at(before, last, np.zeros(1, np.int64), np.array([last.t_us]))
        assert np.abs(end - last.poses).max() < 1e-12
        body = renderer._frames[1]
        assert np.allclose(last.poses[0, 1, :3], renderer._kinematics._data.xpos[body.index])
    # So fast an arm leaves the straight way by more than 0.05 px; a slow one does not.
    assert halved > 0
    data.qvel[:] = [0.1, 0.1, -0.1]
    mujoco.mj_step(model, data)
    mujoco.mj_step(model, data)
    slow = renderer_of(model, device, camera="look", height=48, width=64)
    slow.observe(data)
    for _ in range(4):
        mujoco.mj_step(model, data)
        slow.observe(data)
    assert len(slow._seen) == 5
    assert not any(seen.within for seen in slow._seen)


def test_runge_kutta_is_interpolated(device: evis.Device):
    model = model_of("arm")
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qvel[:] = [20, 15, -25]
    renderer = renderer_of(model, device, camera="look", height=48, width=64)
    renderer.observe(data)
    mujoco.mj_step(model, data)
    renderer.observe(data)
    assert len(renderer._seen) == 2
    assert not renderer._seen[-1].followed.any()
    assert not renderer._seen[-1].within


def test_events_come_since_the_last_render(device: evis.Device):
    model = model_of("arm")
    data = mujoco.MjData(model)
    data.qvel[:] = [3, 0, -2]
    with renderer_of(model, device, camera="look", height=48, width=64) as renderer:
        renderer.update_scene(data, "look")
        first = renderer.render()
        assert (first.dtype, len(first)) == (evis.EventCD, 0)
        events = run(renderer, model, data, 10)
        assert len(events) > 100
        assert (np.diff(events["t"]) >= 0).all()
        assert events["t"].min() >= 0
        assert 18_000 < events["t"].max() < 20_000
        assert len(renderer.render()) == 0
    with pytest.raises(evis.ConfigError, match="closed"):
        renderer.observe(data)
    # Portions change nothing, and neither does how often render is called.
    again = mujoco.MjData(model)
    again.qvel[:] = [3, 0, -2]
    other = renderer_of(model, device, camera="look", height=48, width=64)
    other.observe(again)
    assert np.array_equal(run(other, model, again, 10, every=5), events)


def test_nothing_moves_and_nothing_fires(device: evis.Device):
    model = model_of("arm")
    data = mujoco.MjData(model)
    renderer = renderer_of(model, device, camera=["look", "wrist"], height=48, width=64)
    renderer.observe(data)
    assert len(run(renderer, model, data, 5)) == 0
    assert renderer.packet.end_us == 10_000
    data.qvel[0] = 5
    assert len(run(renderer, model, data, 5)) > 10


def test_several_cameras_and_environments(device: evis.Device):
    model = model_of("arm")
    one, two = mujoco.MjData(model), mujoco.MjData(model)
    two.qvel[:] = [4, 0, 0]
    renderer = renderer_of(model, device, camera=["look", "wrist", -1], environments=2, height=48, width=64)
    renderer.observe([one, two])
    for _ in range(5):
        mujoco.mj_step(model, one)
        mujoco.mj_step(model, two)
        renderer.observe([one, two])
    still, moved = renderer.render()
    assert len(still) == 0
    assert len(moved) > 10
    assert set(renderer.packet[1]) == {"look", "wrist", "free"}
    renderer.update_scene([one, two], "wrist")
    with pytest.raises(evis.ConfigError, match="2 environment"):
        renderer.observe(one)
    mujoco.mj_step(model, two)
    with pytest.raises(evis.ConfigError, match="in step"):
        renderer.observe([one, two])


def batch_of(
    device: evis.Device,
    steps: int,
    *,
    reset: dict[int, list[int]],
    broken: dict[int, int] | None = None,
    read=lambda view: view.events.to_numpy(),
    keep: tuple[str, ...] = ("look", "wrist"),
    **more,
):
    """Run arms that swing at speeds of their own; `reset` and `broken`: environments by step.

    `read`: what is kept of each view of each packet, of the cameras `keep`.
    """
    model = model_of("arm")
    states = [mujoco.MjData(model) for _ in range(3)]
    renderer = renderer_of(
        model, device, camera=["look", "wrist"], environments=3, height=48, width=64, **more
    )
    for k, data in enumerate(states):
        data.qvel[:] = [4 + 3 * k, 2, -3]
    renderer.observe(states)
    found: list[dict[str, list[np.ndarray]]] = [{name: [] for name in keep} for _ in states]
    for step in range(1, steps + 1):
        begun = reset.get(step, [])
        for environment in begun:
            mujoco.mj_resetData(model, states[environment])
            states[environment].qpos[:] = [1.0, -0.5, 0.7]
            # Begins in motion, to see that it is followed.
            states[environment].qvel[:] = [-6, 1, 0]
        if begun:
            renderer.reset(begun)
        for environment, data in enumerate(states):
            if broken and broken.get(environment) == step:
                data.qpos[0] = np.nan
                data.time += model.opt.timestep
            elif environment not in begun and np.isfinite(data.qpos).all():
                mujoco.mj_step(model, data)
        renderer.observe(states)
        if step % 3 == 0:
            renderer.render()
            for environment, of in enumerate(found):
                for name, own in of.items():
                    own += [read(packet[environment][name]) for packet in renderer.packets]
    return renderer, [np.concatenate([each for own in of.values() for each in own]) for of in found]


def test_one_environment_begins_again_without_firing_and_neighbours_do_not_change(device: evis.Device):
    _, alone = batch_of(device, 12, reset={})
    renderer, found = batch_of(device, 12, reset={7: [0]})
    # Its clock was set back; the stream's goes on.
    assert renderer.packet.end_us == 24_000
    for environment in (1, 2):
        assert len(alone[environment]) > 500
        assert np.array_equal(found[environment], alone[environment])
    # Up to the reset it is the same; then nothing fires by the jump, and its motion does.
    before = found[0]["t"] < 12_000
    assert np.array_equal(found[0][before], alone[0][alone[0]["t"] < 12_000])
    assert not ((found[0]["t"] >= 12_000) & (found[0]["t"] < 14_000)).any()
    assert (found[0]["t"] >= 14_000).sum() > 100
    # Canary: without reset the jump fires, in one step.
    model = model_of("arm")
    data, other = mujoco.MjData(model), mujoco.MjData(model)
    jumps = renderer_of(model, device, camera="look", environments=2, height=48, width=64)
    jumps.observe([data, other])
    data.qpos[:] = [1.0, -0.5, 0.7]
    data.time = other.time = 0.002
    jumps.observe([data, other])
    assert len(jumps.render()[0]) > 500


def test_an_episode_after_a_reset_is_that_of_a_renderer_of_its_own(device: evis.Device):
    _, found = batch_of(device, 12, reset={6: [0, 2]})
    model = model_of("arm")
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = [1.0, -0.5, 0.7], [-6, 1, 0]
    alone = renderer_of(model, device, camera=["look", "wrist"], height=48, width=64)
    alone.observe(data)
    run(alone, model, data, 3, every=3)
    events = np.concatenate([alone.packet[name].events.to_numpy() for name in ("look", "wrist")])
    assert len(events) > 500
    for environment in (0, 2):
        own = found[environment]
        own = own[(own["t"] >= 12_000) & (own["t"] < 18_000)].copy()
        own["t"] -= 12_000
        assert np.array_equal(own, events)


@pytest.mark.parametrize("kind", ["counts", "voxel_grid"])
def test_dense_arrays_are_those_of_the_events_after_a_reset_too(device: evis.Device, kind: str):
    made = evis.representations.Dense(kind, **({"bins": 4} if kind == "voxel_grid" else {}))
    dense = {"dense": made, "dense_window_us": 2000, "read": lambda view: np.stack(view.dense.arrays)}
    # A reset lies between windows.
    with pytest.raises(evis.ConfigError, match=r"multiple of dense_window_us \(3000 us\)"):
        batch_of(device, 6, reset={4: [2]}, **{**dense, "dense_window_us": 3000})
    resets = {4: [2], 7: [0, 1]}
    _, alone = batch_of(device, 12, reset={}, **dense)
    _, arrays = batch_of(device, 12, reset=resets, **dense)
    for begin, camera in ((0, "look"), (12, "wrist")):
        _, events = batch_of(device, 12, reset=resets, keep=(camera,))
        for environment in range(3):
            whole = evis.EventArray(events[environment], width=64, height=48)
            assert len(whole) > 200
            windows = list(whole.windows(edges=range(0, 24_001, 2000)))
            assert len(windows) == 12
            for window, found in zip(windows, arrays[environment][begin : begin + 12], strict=True):
                np.testing.assert_allclose(found, made(window), atol=1e-4)
    assert all(len(own) == 2 * 12 for own in arrays), "two cameras, 24 ms"
    # Canaries: resets change what they are of, from their time on, and there is something in the arrays.
    assert np.array_equal(arrays[0][:5], alone[0][:5])
    assert not np.array_equal(arrays[0], alone[0])
    assert all(np.abs(own).sum() > 400 for own in arrays)
    # `render` returns the windows of the camera that is shown.
    model = model_of("arm")
    one = renderer_of(model, device, height=48, width=64, camera="look", dense=made, dense_window_us=3000)
    data = mujoco.MjData(model)
    assert len(one.render()) == 0
    data.qvel[:] = [4, 2, -3]
    one.observe(data)
    run(one, model, data, 3, every=3)
    assert one.packet.view.dense.end_us.tolist() == [3000, 6000]
    for _ in range(3):
        mujoco.mj_step(model, data)
        one.observe(data)
    windows = one.render()
    assert windows.end_us.tolist() == [9000, 12000]
    assert np.array_equal(windows[1], one.packet.view.dense[1])


def test_resets_within_portions_and_of_all(device: evis.Device):
    # Portions of 8 ms, of which the reset at 14 ms leaves 6 unrendered.
    _, alone = batch_of(device, 12, reset={}, pose_step_us=8000)
    _, found = batch_of(device, 12, reset={7: [1], 9: [1]}, pose_step_us=8000)
    for environment in (0, 2):
        assert np.array_equal(found[environment], alone[environment])
    renderer, _ = batch_of(device, 12, reset={7: [0, 1, 2]})
    # Nobody knows how much time has passed at the reset: the stream stands for that step.
    assert renderer.packet.end_us == 22_000
    # Before anything was rendered it begins there.
    model = model_of("arm")
    data = mujoco.MjData(model)
    one = renderer_of(model, device, camera="look", height=48, width=64)
    one.observe(data)
    data.qpos[0], data.time = 1.0, 7.5
    one.reset([0])
    one.observe(data)
    assert len(one.render()) == 0
    for _ in range(3):
        mujoco.mj_step(model, data)
        one.observe(data)
    assert len(one.render()) == 0
    assert one.packet.end_us == 6000
    assert len(one.packets) == 1


def test_resets_name_environments_that_are_there_once(device: evis.Device):
    model = model_of("arm")
    renderer = renderer_of(model, device, camera="look", environments=2, height=48, width=64)
    for ids, message in (
        ([2], "env_ids is 2; it must be between 0 and 1"),
        (-1, "env_ids is -1"),
        ([1, 1], "environment 1 twice"),
        (True, "whole number"),
        ([0.0], "whole number"),
        ("01", "sequence"),
        (1.5, "sequence"),
    ):
        with pytest.raises(evis.ConfigError, match=message):
            renderer.reset(ids)
    assert not renderer._pending.any()
    for ids in ([], np.array([1]), np.int64(0), (0, 1)):
        renderer.reset(ids)
    assert renderer._pending.all()


def test_an_environment_that_diverges_is_held_and_its_neighbours_go_on(device: evis.Device):
    _, alone = batch_of(device, 12, reset={})
    with pytest.warns(UserWarning, match=r"environment 1 has diverged.*reset\(\[1\]\)") as warned:
        renderer, found = batch_of(device, 12, reset={}, broken={1: 5})
    assert sum("diverged" in str(warning.message) for warning in warned) == 1
    assert renderer.held.tolist() == [False, True, False]
    with pytest.raises(ValueError, match="read-only"):
        renderer.held[0] = True
    for environment in (0, 2):
        assert np.array_equal(found[environment], alone[environment])
    before = alone[1][alone[1]["t"] < 8000]
    assert np.array_equal(found[1], before)
    assert 100 < len(before) < len(alone[1])
    # It goes on in a new episode.
    with pytest.warns(UserWarning, match="diverged"):
        renderer, found = batch_of(device, 12, reset={8: [1]}, broken={1: 5})
    assert not renderer.held.any()
    for environment in (0, 2):
        assert np.array_equal(found[environment], alone[environment])
    assert not ((found[1]["t"] >= 8000) & (found[1]["t"] < 16_000)).any()
    assert (found[1]["t"] >= 16_000).sum() > 100


def test_an_environment_that_mujoco_resets_itself_is_held(
    device: evis.Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    # MuJoCo writes its log to where it is.
    monkeypatch.chdir(tmp_path)
    model = model_of("arm")
    states = [mujoco.MjData(model), mujoco.MjData(model)]
    renderer = renderer_of(model, device, camera="look", environments=2, height=48, width=64)
    renderer.observe(states)
    for step in range(6):
        if step == 3:
            states[0].qpos[0] = np.nan
        for data in states:
            mujoco.mj_step(model, data)
        assert np.isfinite(states[0].qpos).all()
        if step == 3:
            with pytest.warns(UserWarning, match="environment 0 has diverged"):
                renderer.observe(states)
        else:
            renderer.observe(states)
    assert renderer.held.tolist() == [True, False]
    assert [len(events) for events in renderer.render()] == [0, 0]
    assert renderer.packet.end_us == 12_000
    # From the first state on.
    states[1].qpos[0] = np.inf
    states[1].time = 0.0
    mujoco.mj_resetData(model, states[0])
    renderer.reset()
    with pytest.warns(UserWarning, match="environment 1 has diverged"):
        renderer.observe(states)
    assert renderer.held.tolist() == [False, True]
    # Each environment warns once.
    renderer.reset([1])
    assert not renderer.held.any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        renderer.observe(states)
    assert renderer.held.tolist() == [False, True]


def test_environments_do_not_depend_on_each_other(device: evis.Device):
    model = model_of("arm")
    model.opt.timestep = 0.01
    states = [mujoco.MjData(model) for _ in range(3)]
    renderer = renderer_of(model, device, camera="look", environments=3, height=48, width=64)
    alone = [renderer_of(model, device, camera="look", height=48, width=64) for _ in states]
    for data, speed in zip(states, (0.5, 20.0, 0.4), strict=True):
        data.qvel[:] = speed
    divided = set()
    for step in range(5):
        if step == 3:
            # No plain step: even motion.
            states[2].qpos[0] += 0.1
        renderer.observe(states)
        for own, data in zip(alone, states, strict=True):
            own.observe(data)
            mujoco.mj_step(model, data)
        if step > 1:
            divided |= set(renderer._seen[-1].within)
    # The fast one alone leaves the straight way.
    assert divided == {1}
    for events, own in zip(renderer.render(), alone, strict=True):
        expected = own.render()
        assert len(expected) > 20
        assert np.array_equal(events.to_numpy(), expected.to_numpy())


def test_a_free_camera_that_is_moved_adds_no_poses_within_steps(device: evis.Device):
    model = model_of("arm")
    data = mujoco.MjData(model)
    data.qvel[:] = 0.01
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.azimuth += 40
    renderer = renderer_of(model, device, camera=camera, height=48, width=64)
    renderer.update_scene(data, camera)
    for _ in range(3):
        mujoco.mj_step(model, data)
        renderer.update_scene(data, camera)
    assert not any(seen.within for seen in renderer._seen)


def test_rotations_and_what_lies_between_poses():
    rng = np.random.default_rng(0)
    first, last = (rng.normal(size=(5, 3, 7)) for _ in range(2))
    for poses in (first, last):
        poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    whole = difference(first, last)
    assert np.allclose(interpolated(first, last, 0.0), first)
    end = interpolated(first, last, 1.0)
    assert np.allclose(np.abs((end[..., 3:] * last[..., 3:]).sum(axis=-1)), 1)
    assert np.allclose(difference(first, interpolated(first, last, 0.25)), 0.25 * whole)
    for a, b, turn in zip(first.reshape(-1, 7), last.reshape(-1, 7), whole.reshape(-1, 6), strict=True):
        own = np.empty(3)
        # MuJoCo's difference is in the first one's own axes.
        mujoco.mju_subQuat(own, b[[6, 3, 4, 5]], a[[6, 3, 4, 5]])
        world = np.empty(3)
        mujoco.mju_rotVecQuat(world, own, a[[6, 3, 4, 5]])
        assert np.allclose(world, turn[3:])


def test_a_free_camera_moves_with_update_scene(device: evis.Device):
    model = model_of("arm")
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    renderer = renderer_of(model, device, camera=camera, height=48, width=64)
    renderer.update_scene(data, camera)
    for _ in range(5):
        mujoco.mj_step(model, data)
        camera.azimuth += 0.5
        renderer.update_scene(data, camera)
    assert len(renderer.render()) > 10


def test_bad_input(device: evis.Device):
    model = model_of("arm")
    for camera, message in (
        ("wirst", "did you mean 'wrist'"),
        (7, "cameras 0 to 1, and -1"),
        ([], "camera is empty"),
        (["look", 0], "twice"),
        (1.5j, "must be a name"),
        (1.5, "camera is 1.5; it must be a name"),
        (True, "camera is True; it must be a name"),
        (np.bool_(True), "must be a name"),
    ):
        with pytest.raises(evis.ConfigError, match=message):
            evis.mujoco.EventRenderer(model, camera=camera)
    with pytest.raises(evis.ConfigError, match="MjModel"):
        evis.mujoco.scene("arm.xml")
    with pytest.raises(evis.ConfigError, match="geom_groups"):
        evis.mujoco.scene(model, geom_groups=[9])
    with pytest.raises(evis.ConfigError, match="shows nothing"):
        evis.mujoco.scene(model, geom_groups=[5])
    data = mujoco.MjData(model)
    renderer = renderer_of(model, device, camera="look", height=48, width=64)
    assert len(renderer.render()) == 0
    renderer.observe(data)
    mujoco.mj_step(model, data)
    renderer.observe(data)
    broken = mujoco.MjData(model)
    broken.time, broken.qpos[0] = 0.004, np.nan
    with pytest.raises(evis.ConfigError, match="not finite"):
        renderer.observe(broken)
    with pytest.raises(evis.ConfigError, match="another model"):
        renderer.observe(mujoco.MjData(model_of("everything")))
    with pytest.raises(evis.ConfigError, match="MjData"):
        renderer.observe(None)
    data.qpos[0] += 1
    with pytest.raises(evis.ConfigError, match="time must go on"):
        renderer.observe(data)
    data.time = 0.0
    with pytest.raises(evis.ConfigError, match="cannot go back"):
        renderer.observe(data)
    with pytest.raises(evis.ConfigError, match="does not have"):
        renderer.update_scene(data, "wrist")
    with pytest.raises(evis.ConfigError, match="must be a name"):
        renderer.update_scene(data, False)
    # It goes on after each of them, and from the start after reset.
    data.time = 0.004
    renderer.observe(data)
    renderer.render()
    assert renderer.packet.end_us == 4000
    data.time = 0.0
    renderer.reset()
    renderer.observe(data)
    assert len(renderer.render()) == 0


def test_what_is_not_drawn_is_named_once():
    text = """
    <mujoco>
      <asset><material name="mirror" reflectance="0.5"/></asset>
      <worldbody>
        <geom name="glass" size="0.1" rgba="1 1 1 0.2"/>
        <geom name="ball" size="0.1" pos="1 0 0" material="mirror"/>
        <body><joint/><geom size="0.1"/><site name="a"/></body>
        <site name="b" pos="0 0 1"/>
      </worldbody>
      <tendon>
        <spatial name="rope" limited="true" range="0 2"><site site="a"/><site site="b"/></spatial>
        <spatial name="rod"><site site="a"/><site site="b"/></spatial>
        <spatial name="clear" rgba="1 1 1 0"><site site="a"/><site site="b"/></spatial>
        <spatial name="deep" group="3"><site site="a"/><site site="b"/></spatial>
      </tendon>
    </mujoco>
    """
    with pytest.warns(UserWarning, match=r"geom .glass.|mirror|tendon/rope") as found:
        scene = evis.mujoco.scene(mujoco.MjModel.from_xml_string(text))
    said = [str(warning.message) for warning in found]
    assert len(said) == 3
    assert sum("rope" in text for text in said) == 1
    assert scene.cameras == ("free",)
    assert "geom/glass" not in scene.nodes
    assert "geom/ball" in scene.nodes
    tendons = {name.split("/")[1] for name in scene.nodes if name.startswith("tendon/")}
    assert tendons == {"rope", "rod"}
    again = pickle.loads(pickle.dumps(scene))
    assert again.nodes == scene.nodes


def test_flexes_skins_and_rangefinders_are_named_once():
    text = """
    <mujoco>
      <worldbody>
        <body name="ball"><joint/><geom size="0.1"/></body>
        <site name="eye" pos="0 0 1"/>
        <flexcomp name="cloth" type="grid" count="3 3 1" spacing="0.1 0.1 0.1" dim="2" radius="0.01"
          pos="1 0 0"><edge equality="true"/></flexcomp>
      </worldbody>
      <deformable>
        <skin name="coat" vertex="0 0 0  1 0 0  0 1 0" face="0 1 2">
          <bone body="ball" bindpos="0 0 0" bindquat="1 0 0 0" vertid="0 1 2" vertweight="1 1 1"/>
        </skin>
      </deformable>
      <sensor><rangefinder name="ray" site="eye"/><rangefinder site="eye"/><gyro site="eye"/></sensor>
    </mujoco>
    """
    with pytest.warns(UserWarning, match="drawn") as found:
        evis.mujoco.scene(mujoco.MjModel.from_xml_string(text))
    assert sorted(str(warning.message) for warning in found) == [
        "not drawn: flex 'cloth', skin 'coat'",
        "rays of rangefinders are not drawn: sensor 'ray', sensor '1'",
    ]


def test_tendons_are_where_mujoco_draws_them_while_bodies_move(device: evis.Device, tmp_path: Path):
    model = model_of("tendons")
    data = mujoco.MjData(model)
    # The ball falls beside its tendon, which goes round it at first.
    data.qvel[:] = [-6.0, 2.0, -3.0]
    renderer = renderer_of(model, device, camera=0, labels=["depth", "instance"], label_rate_hz=1000)
    renderer.observe(data)
    events = []
    wraps = set()
    for _ in range(60):
        mujoco.mj_step(model, data)
        renderer.observe(data)
        events.append(len(renderer.render()))
        wraps.add(int(data.ten_wrapnum[0]))
    assert sum(events) > 500
    assert wraps == {2, 4}, "the ball comes off its tendon"
    # Where the simulation was at a label of the last packet.
    t_us = int(renderer.packet.labels["instance"].t_us[0])
    steps = t_us // 2000
    assert (t_us % 2000, steps) == (0, 59)
    other = mujoco.MjData(model)
    other.qvel[:] = [-6.0, 2.0, -3.0]
    for _ in range(steps):
        mujoco.mj_step(model, other)
    mujoco.mj_kinematics(model, other)
    posed = model_of("tendons")
    # Joints slide bodies of the world.
    posed.body_pos[:] = other.xpos
    own = own_pictures(posed, 0, tmp_path)
    labels = renderer.packet.labels
    depth, objects = labels["depth"].data[0], renderer.instances[labels["instance"].data[0]]
    far = model.vis.map.zfar * model.stat.extent
    assert min(agree(own, depth, objects, far)) > 0.99
    tendon = int(mujoco.mjtObj.mjOBJ_TENDON)
    for index in (0, 1):
        mine, theirs = ((of == [index, tendon]).all(axis=-1) for of in (objects, own[1]))
        assert theirs.sum() > 100
        assert (mine & theirs).sum() > 0.85 * (mine | theirs).sum()


def test_sky_box_as_environment(device: evis.Device):
    model = model_of("everything")
    seen = []
    for skybox in (False, True):
        renderer = renderer_of(
            model, device, camera=0, skybox=skybox, labels=["hdr"], label_rate_hz=1000, height=48, width=64
        )
        data = mujoco.MjData(model)
        renderer.observe(data)
        data.time = 0.02
        renderer.observe(data)
        renderer.render()
        seen.append(renderer.packet.labels["hdr"].data[0][0, 0])
    assert (seen[0] > 0.01).all()
    # Near the horizon a gradient's colour is about its mean.
    assert np.abs(np.log(seen[0] / seen[1])).max() < 1.0
    assert not np.array_equal(seen[0], seen[1])
