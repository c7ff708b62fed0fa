"""Scenes by name, by file, by text and by Python."""

from __future__ import annotations

import base64
import json
import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest
import tomllib

import evis
from evis import _builder, _toml
from evis.motion import (
    Ballistic,
    Chain,
    ConstantVelocity,
    FigureEight,
    Keys,
    Placement,
    RigidBody,
    Spin,
    Waveform,
)

TEXT = """
name = "pair"
ambient = [1, 1, 1]
duration_s = 2
materials = [{ name = "grey", color = [0.5, 0.5, 0.5] }]
primitives = [{ name = "cube", shape = "box", size = [1, 1, 1], material = "grey" }]
cameras = [
  { name = "left", position = [-0.1, 0, 3], size = [64, 48] },
  { name = "right", position = [0.1, 0, 3], size = [64, 48] },
]
environments = [{ count = 3, time_step_s = 0.5 }]
"""


def everything() -> evis.SceneBuilder:
    """A scene that uses every kind of table but files."""
    builder = evis.SceneBuilder("everything", duration=2.0, background="#102030", ambient=(0.1, 0.1, 0.1))
    builder.texture("pixels", np.zeros((8, 4), np.uint8), wrap="clamp", filter="nearest")
    builder.texture("bricks", pattern="bricks", size=64, seed=3, colors=((0.5, 0.5, 0.5), "#ffffff"))
    builder.material(
        "screen", model="unlit", texture="pixels", waveform=Waveform(shape="sine", frequency_hz=50.0)
    )
    builder.material("wall", texture="bricks", emissive=(1, 1, 1), emissive_strength=0.1, double_sided=True)
    builder.material("metal", model="metallic_roughness", color="#808080", metallic=1.0, roughness=0.3)
    builder.plane("floor", size=(10, 10), material="wall", uv_repeat=(4, 4))
    builder.card("screen", size=(1, 1), material="screen", pose=Placement(motion=Spin(degrees_per_s=90.0)))
    builder.box("box", size=(1, 1, 1), material="wall", semantic_id=2)
    fall = Ballistic(velocity=np.array([1.0, 3.0, 0.0]), launch_s=0.1)
    builder.sphere("ball", radius=0.2, material="metal", segments=(16, 8), pose=Placement(motion=fall))
    turn = Chain(motions=[Placement(motion=Spin(degrees_per_s=10.0)), Placement(position=(1, 0, 0))])
    builder.cylinder("pole", radius=0.1, height=2.0, material="metal", pose=Placement(motion=turn))
    keys = Keys(times_s=[0.0, 1.0], positions=np.eye(2, 3), interpolation="catmull_rom")
    builder.capsule("pill", radius=0.1, height=1.0, material="metal", pose=Placement(motion=keys, scale=2.0))
    eight = FigureEight(size=(1, 0.5), period_s=4.0, look_at=(0, 0, 0))
    builder.node("rig", pose=Placement(position=(0, 1, 3), motion=eight))
    builder.dynamics(gravity=(0, -1.6, 0), rate_hz=2000)
    thrown = RigidBody(velocity=(1, 2, 0), spin_degrees_per_s=90.0, mass=2.0, restitution=0.5, shape="hull")
    builder.box("die", size=(0.1, 0.1, 0.1), material="wall", pose=Placement(rigid_body=thrown))
    drift = Placement(parent="rig", motion=ConstantVelocity(velocity=(0, 0, 0.1)))
    builder.camera(evis.EventCamera(name="eye", width=64, height=48, pose=drift, threshold_on=0.3))
    builder.camera(evis.EventCamera(name="other", width=64, height=48, fx=50.0, fy=50.0, cx=32.0, cy=24.0))
    sun = Placement(position=(0, 5, 0), look_at=(0, 0, 1))
    flicker = Waveform(shape="pwm", frequency_hz=100.0, duty=0.25)
    builder.light("sun", kind="directional", intensity=3.0, casts_shadow=True, pose=sun)
    builder.light("lamp", kind="spot", intensity=10.0, outer_degrees=30.0, waveform=flicker, pose=sun)
    builder.environments(2, time_step_s=0.1, offsets={"box": Placement(position=(0, 0, 0.1))})
    return builder


def test_text_gives_cameras_and_environments():
    scene = evis.Scene.from_toml(TEXT)
    assert (scene.name, scene.cameras, scene.environments, scene.duration) == (
        "pair",
        ("left", "right"),
        3,
        2.0,
    )
    assert "cube" in scene.nodes


def test_a_file_is_the_same_as_its_text(tmp_path: Path):
    (tmp_path / "pair.toml").write_text(TEXT)
    assert repr(evis.Scene.load(tmp_path / "pair.toml")) == repr(evis.Scene.from_toml(TEXT))


def test_an_unknown_key_is_named_with_the_nearest():
    with pytest.raises(evis.FormatError, match="duration_s"):
        evis.Scene.from_toml(TEXT.replace("duration_s", "durations"))
    with pytest.raises(evis.FormatError):
        evis.Scene.from_toml("name = ")


def test_one_of_several_animations_plays(tmp_path: Path):
    """A triangle that one animation moves along x, the other along y."""
    columns = ([0, 0, 0, 1, 0, 0, 0, 1, 0], [0, 1], [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0])
    data = np.concatenate(columns).astype("<f4").tobytes()
    starts, kinds = (0, 36, 44, 68), (("VEC3", 3), ("SCALAR", 2), ("VEC3", 2), ("VEC3", 2))
    sizes = (36, 8, 24, 24)
    target = {"node": 0, "path": "translation"}
    document = {
        "asset": {"version": "2.0"},
        "buffers": [
            {
                "byteLength": len(data),
                "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode(),
            }
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": size}
            for start, size in zip(starts, sizes, strict=True)
        ],
        "accessors": [
            {"bufferView": view, "componentType": 5126, "type": kind, "count": count}
            for view, (kind, count) in enumerate(kinds)
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"name": "arrow", "mesh": 0}],
        "animations": [
            {
                "name": name,
                "samplers": [{"input": 1, "output": output}],
                "channels": [{"sampler": 0, "target": target}],
            }
            for name, output in (("along", 2), ("up", 3))
        ],
    }
    path = tmp_path / "arrow.gltf"
    path.write_text(json.dumps(document))

    def reached(animation: str | int | None) -> list[float]:
        scene = evis.Scene.load(path, animation=animation)
        again = pickle.loads(pickle.dumps(scene))
        where = scene.bodies([1_000_000], cameras=[]).position[0, 0]
        assert np.array_equal(again.bodies([1_000_000], cameras=[]).position[0, 0], where)
        return where.tolist()

    assert reached(None) == reached("along") == reached(0) == [1, 0, 0]
    assert reached("up") == reached(1) == [0, 1, 0]
    with pytest.raises(
        evis.ConfigError, match=r"no animation named 'upp'; there is along, up.*did you mean 'up'"
    ):
        evis.Scene.load(path, animation="upp")
    # Recordings store which one plays.
    ups = evis.Simulator(evis.Scene.load(path, animation="up"), size=(16, 12), quality="draft")
    stored = tomllib.loads(ups.config_toml)
    assert (stored["scene"], stored["animation"], stored["speed"]) == ("arrow", "up", 1.0)
    settings = tmp_path / "settings.toml"
    settings.write_text(ups.config_toml)
    for animation, warned in (("up", False), ("along", True)):
        scene = evis.Scene.load(path, animation=animation)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            evis.Simulator(scene, settings=settings)
        assert any("plays animation 'up', and the scene 'along'" in str(w.message) for w in told) == warned
    text = tmp_path / "still.toml"
    text.write_text(TEXT)
    with pytest.raises(evis.ConfigError, match=r"animation is 'up', but .*still\.toml is no \.gltf"):
        evis.Scene.load(text, animation="up")


def test_a_camera_inside_a_model_is_warned_of(device: evis.Device):
    builder = evis.SceneBuilder("inside", ambient=(1, 1, 1))
    builder.material("white")
    builder.box("crate", size=(2, 2, 2), material="white", pose=Placement(motion=Spin(degrees_per_s=9)))
    builder.camera(evis.EventCamera(name="eye", width=32, height=24))
    with pytest.warns(UserWarning, match="camera 'eye' starts inside 'crate'"):
        evis.Simulator(builder.build(), rate_hz=100.0, samples=1, device=device)


def test_the_builder_knows_the_whole_vocabulary():
    scene = everything().build()
    assert scene.cameras == ("eye", "other")
    assert scene.environments == 2
    assert {"floor", "screen", "ball", "pole", "pill", "rig", "sun", "lamp"} <= set(scene.nodes)
    assert repr(evis.Scene.from_toml(everything().toml())) == repr(scene)


def test_the_builder_passes_errors_on():
    builder = everything()
    builder.box("bad", size=(1, 1, 1), material="no such material")
    with pytest.raises(evis.EvisError, match="no such material"):
        builder.build()
    builder = everything()
    builder.box("bad", size=(1, 1, 1), material="wall", semantics=3)
    with pytest.raises(evis.FormatError, match="semantic_id"):
        builder.build()
    with pytest.raises(evis.ConfigError, match="exactly one"):
        builder.texture("both", np.zeros((4, 4)), pattern="bricks")
    with pytest.raises(evis.ConfigError, match="shape"):
        builder.texture("flat", np.zeros(4))
    with pytest.raises(evis.ConfigError, match="outside"):
        builder.texture("dark", np.full((4, 4), -1.0))
    with pytest.raises(evis.ConfigError, match="width or a height"):
        builder.camera(evis.EventCamera(name="half", width=64))


def test_pixels_become_linear_light():
    grey = np.full((2, 3), 188, np.uint8)
    # IEC 61966-2-1: code 188 is 0.5029 of full light.
    assert np.allclose(_builder.linear_rgba("x", grey, None)[..., 0], 0.50289, atol=1e-4)
    assert np.allclose(_builder.linear_rgba("x", grey, "linear")[..., 0], 188 / 255)
    light = np.random.default_rng(0).random((2, 3, 4)).astype(np.float32)
    assert np.array_equal(_builder.linear_rgba("x", light, None), light)
    assert _builder.linear_rgba("x", light[..., :3], None)[..., 3].tolist() == [[1, 1, 1], [1, 1, 1]]


def test_pixels_reach_the_screen(device: evis.Device):
    """A card that fills the picture shows its four colours where they belong: upright and not mirrored."""
    pixels = np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0], [1.0, 1.0, 0.0]]], np.float32)
    builder = evis.SceneBuilder("card")
    builder.texture("quad", pixels, filter="nearest")
    builder.material("quad", model="unlit", texture="quad")
    builder.card("card", size=(4, 4), material="quad")
    pose = Placement(position=(0, 0, 1))
    builder.camera(evis.EventCamera(name="eye", width=32, height=32, fov_y_degrees=90.0, pose=pose))
    sim = evis.Simulator(builder.build(), labels=["hdr"], samples=1)
    image = sim.step(1_000).labels["hdr"].images[0]
    corners = image[[8, 8, 24, 24], [8, 24, 8, 24]]
    assert np.allclose(corners, pixels.reshape(4, 3), atol=1e-3)


def test_an_orthographic_camera_shows_one_scale_at_any_depth(device: evis.Device):
    builder = evis.SceneBuilder("cards")
    for name, x, z, color in (
        ("near", -0.5, 0.0, (1, 0, 0)),
        ("far", 0.5, -4.0, (0, 1, 0)),
        ("beyond", 0, -9, (0, 0, 1)),
    ):
        builder.material(name, model="unlit", color=color)
        builder.card(name, size=(0.5, 0.5), material=name, pose=Placement(position=(x, 0, z)))
    eye = {"name": "eye", "width": 40, "height": 20, "pose": Placement(position=(0, 0, 2))}
    builder.camera(evis.EventCamera(orthographic_height=1.0, far=8.0, **eye))
    scene = builder.build()
    sim = evis.Simulator(scene, labels=["hdr", "depth"], samples=1, device=device)
    assert np.isnan(sim.cameras[0].fx)
    labels = sim.step(1_000).labels
    image, depth = labels["hdr"].images[0], labels["depth"].data[0]
    for column, plane, away in ((5, 0, 2.0), (25, 1, 6.0)):
        shown = np.argwhere(image[..., plane] > 0.5)
        assert shown.min(0).tolist() == [5, column]
        assert shown.max(0).tolist() == [14, column + 9]
        assert np.allclose(depth[10, column + 5], away, rtol=1e-5)
    assert not (image[..., 2] > 0).any()
    for method in ("splat", "evis-paper"):
        with pytest.raises(evis.ConfigError, match="'eye' is orthographic"):
            evis.Simulator(scene, method=method, device=device).step(1_000)
    for wrong, message in (
        ({"orthographic_height": 1.0}, "'far' is missing"),
        ({"orthographic_height": 1.0, "far": 8.0, "fov_y_degrees": 40.0}, "exclude each other"),
        ({"far": 8.0}, "without orthographic_height"),
    ):
        with pytest.raises(evis.EvisError, match=message):
            scene.with_cameras([evis.EventCamera(**{**eye, "name": "other"}, **wrong)])


def test_cameras_hang_on_nodes():
    scene = everything().build()
    more = scene.with_cameras([evis.EventCamera(name="third", pose=Placement(parent="rig"))])
    assert more.cameras == ("eye", "other", "third")
    assert scene.cameras == ("eye", "other")
    with pytest.raises(evis.ConfigError, match="no node named 'arm'"):
        scene.with_cameras([evis.EventCamera(name="third", pose=Placement(parent="arm"))])
    with pytest.raises(evis.ConfigError, match="'eye' already"):
        scene.with_cameras([evis.EventCamera(name="eye")])


@pytest.mark.parametrize(
    ("item", "text"),
    [
        (True, "true"),
        (np.bool_(False), "false"),
        (3, "3"),
        (np.uint8(3), "3"),
        (0.1, "0.1"),
        (1e300, "1e+300"),
        (float("inf"), "inf"),
        ('a "b"\n\x7f', '"a \\"b\\"\\n\\u007f"'),
        ("\U0001f600", '"\U0001f600"'),
        (Path("a") / "b.glb", '"a/b.glb"'),
        ((1, 2.5), "[1, 2.5]"),
        (np.eye(2), "[[1.0, 0.0], [0.0, 1.0]]"),
        ({"a": 1, "b c": [], "d": None}, '{ a = 1, "b c" = [] }'),
    ],
)
def test_python_values_become_toml(item: object, text: str):
    assert _toml.value("item", item) == text


def test_other_values_are_refused():
    with pytest.raises(evis.ConfigError, match="item is <object"):
        _toml.value("item", object())


def test_a_rigid_body_falls_bounces_and_is_refused_with_a_motion():
    builder = evis.SceneBuilder("drop", duration=1.0, ambient=(1, 1, 1))
    builder.material("grey")
    builder.plane("floor", size=(2, 2), material="grey", pose=Placement(rigid_body=RigidBody(fixed=True)))
    body = RigidBody(restitution=0.8, launch_s=0.1)
    builder.sphere("ball", radius=0.1, material="grey", pose=Placement(position=(0, 1.1, 0), rigid_body=body))
    scene = builder.build()
    ball = scene.nodes.index("ball")
    height = scene.bodies([0, 100_000, 300_000, 1_000_000]).position[:, ball, 1]
    assert height[0] == height[1] == 1.1
    assert abs(height[2] - (1.1 - 0.5 * 9.81 * 0.2 * 0.20025)) < 1e-6
    assert 0.1 < height[3] < 1.1
    both = Placement(rigid_body=body, motion=Spin(degrees_per_s=1.0))
    builder.box("both", size=(1, 1, 1), material="grey", pose=both)
    with pytest.raises(evis.FormatError, match="'both': it has a motion and is a rigid body"):
        builder.build()
    with pytest.raises(evis.ConfigError, match=r"it must be an evis\.motion\.RigidBody"):
        Placement(rigid_body="ball").table()  # type: ignore[arg-type]
    with pytest.raises(evis.ConfigError, match="camera 'eye' is a rigid body"):
        scene.with_cameras([evis.EventCamera(name="eye", pose=Placement(rigid_body=body))])


def test_the_bodies_of_a_built_in_scene_move():
    scene = evis.Scene.builtin("tumble", seed=1)
    poses = scene.bodies([0, 500_000]).position
    assert (np.linalg.norm(poses[1] - poses[0], axis=-1) > 0.1).sum() >= 8
