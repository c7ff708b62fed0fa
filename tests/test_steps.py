"""Nodes that a host shows and hides, and materials that it changes, step by step."""

from __future__ import annotations

import numpy as np
import pytest

import evis
from evis.motion import Placement

pytestmark = pytest.mark.filterwarnings("ignore:nothing moves")

STEP_US = 10_000
THRESHOLD = 0.1
SIZE = (48, 36)
#: Pictures to compare with have this many pixels per pixel along each axis. Highlights are narrower than
#: a pixel, and the 64 samples of one are off by up to three thresholds there.
FINER = 4
GREY = {"color": (0.3, 0.3, 0.3)}
RED = {"color": (0.9, 0.2, 0.1)}

SETTINGS = {
    "native": {"rate_hz": 1000.0, "samples": 64, "method": "native"},
    "tiles": {"rate_hz": 1000.0, "samples": 64, "method": "native", "adaptive_px": 0.25},
    "decoupled": {"method": "decoupled"},
}
#: A change is over after the next sample, and in continuous time at once.
LAST_US = {"native": 1000, "tiles": 1000, "decoupled": 1}


def scene(
    *,
    cube: bool = True,
    model: str = "diffuse",
    environments: int = 1,
    shadow: bool = False,
    **painted: object,
) -> evis.Scene:
    """A cube and a ball before a wall, all lit from the camera's upper left."""
    builder = evis.SceneBuilder("steps", duration=1.0, ambient=(0.3, 0.3, 0.3))
    builder.texture("checker", pattern="checker")
    builder.material("wall", texture="checker")
    builder.material("painted", model=model, **{**GREY, **painted})
    builder.box("wall", size=(12.0, 10.0, 0.1), material="wall", pose=Placement(position=(0, 0, -1.0)))
    if cube:
        pose = Placement(position=(-0.4, 0.0, 0.0), rotation_degrees=(20, 30, 0))
        builder.box("cube", size=(0.8, 0.8, 0.8), material="painted", pose=pose)
    builder.sphere("ball", radius=0.3, material="painted", pose=Placement(position=(0.8, 0.2, 0.0)))
    light = Placement(position=(-2.0, 3.0, 4.0), look_at=(0, 0, 0))
    builder.light("sun", kind="directional", intensity=3.0, casts_shadow=shadow, pose=light)
    eye = Placement(position=(0.1, 0.2, 3.0), look_at=(0, 0, 0))
    builder.camera(evis.EventCamera(name="eye", width=SIZE[0], height=SIZE[1], pose=eye))
    if environments > 1:
        for _ in range(environments):
            builder.environments(1)
    return builder.build()


def simulator(device: evis.Device, name: str, of: evis.Scene | None = None, **more: object) -> evis.Simulator:
    config = {
        **SETTINGS[name],
        "sensor": evis.Sensor(threshold_on=THRESHOLD, threshold_off=THRESHOLD),
        "poses": ["cube", "ball"],
        "materials": ["painted"],
        "pose_step_us": STEP_US,
        "reference_luminance": 0.3,
        **more,
    }
    return evis.Simulator(scene() if of is None else of, device=device, **config)


def pictures(device: evis.Device, *scenes: evis.Scene) -> list[np.ndarray]:
    """Log luminance of scenes at rest, as fresh simulators of them see it with 1024 samples per pixel."""
    found = []
    for one in scenes:
        sim = evis.Simulator(
            one,
            device=device,
            size=(SIZE[0] * FINER, SIZE[1] * FINER),
            method="native",
            rate_hz=1000.0,
            samples=64,
            frame_rate_hz=100.0,
            exposure_us=2,
            reference_luminance=0.3,
            shadows="rays",
        )
        image = np.asarray(sim.step(20_000).labels["frame"].images[0], dtype=np.float64)
        found.append(np.log(image.reshape(SIZE[1], FINER, SIZE[0], FINER).mean(axis=(1, 3))))
    return found


def climbed(events: np.ndarray) -> np.ndarray:
    """How far the log luminance of each pixel went, in thresholds."""
    counts = np.zeros(SIZE[::-1])
    np.add.at(counts, (events["y"], events["x"]), np.where(events["p"] > 0, 1, -1))
    return counts


def explained(events: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Share of pixels whose events lead from one picture to another."""
    off = np.abs((after - before) / THRESHOLD - climbed(events))
    changed = np.abs(after - before) > THRESHOLD
    assert changed.mean() > 0.02
    return float((off < 1.1)[changed].mean())


@pytest.mark.parametrize("shadow", [False, True])
@pytest.mark.parametrize("name", SETTINGS)
def test_a_node_vanishes_and_comes_back_at_the_start_of_a_step(device: evis.Device, name: str, shadow: bool):
    # Maps are coarser where a host may move what throws shadows; rays are exact.
    rays = {"shadows": "rays"} if shadow and name != "decoupled" else {}
    sim = simulator(device, name, scene(shadow=shadow), **rays)
    with_cube, without = pictures(device, scene(shadow=shadow), scene(shadow=shadow, cube=False))
    assert len(sim.step(STEP_US).events) == 0
    gone = sim.step(2 * STEP_US, visible={"cube": False}).events
    away = sim.step(3 * STEP_US).events
    back = sim.step(4 * STEP_US, visible={"cube": True}).events
    assert len(away) == 0
    assert gone["t"].min() >= STEP_US
    assert gone["t"].max() <= STEP_US + LAST_US[name]
    assert back["t"].min() >= 3 * STEP_US
    # Pixels are back where they began: a threshold away to the last bit, and some reach it later.
    assert np.mean(back["t"] <= 3 * STEP_US + LAST_US[name]) > 0.995
    assert explained(gone, with_cube, without) > 0.97
    # What is left of a threshold when it vanishes counts when it comes back.
    assert np.abs(climbed(gone) + climbed(back)).max() <= 1
    assert explained(gone, without, with_cube) < 0.2, "canary"


@pytest.mark.parametrize("name", SETTINGS)
def test_what_is_hidden_from_the_first_step_on_is_as_if_it_were_not_there(device: evis.Device, name: str):
    def run(cube: bool) -> np.ndarray:
        poses = ["cube", "ball"] if cube else ["ball"]
        sim = simulator(device, name, scene(cube=cube), poses=poses)
        parts = []
        for step in range(1, 4):
            ball = [0.8 - 0.1 * step, 0.2, 0.0, 0, 0, 0, 1]
            hide = {"visible": {"cube": False}} if cube and step == 1 else {}
            parts.append(sim.step(step * STEP_US, {"ball": ball}, **hide).events)
        return np.concatenate(parts)

    hidden, absent = run(True), run(False)
    assert len(absent) > 500
    if name == "decoupled":
        # Blocks of a scene that moves otherwise may lie otherwise.
        assert abs(len(hidden) - len(absent)) <= 0.01 * len(absent)
    else:
        assert np.array_equal(hidden, absent)


@pytest.mark.parametrize("name", SETTINGS)
def test_steps_and_values_given_again_change_no_byte(device: evis.Device, name: str):
    def poses(t_us: int) -> list[float]:
        return [-0.4 + t_us * 2e-6, 0.0, 0.0, 0, 0, 0, 1]

    seen = [True, False, False, True, True]
    ends = [STEP_US * (k + 1) for k in range(len(seen))]

    def run(again: bool) -> np.ndarray:
        sim, parts, last = simulator(device, name), [], True
        for end, now in zip(ends, seen, strict=True):
            visible = {"cube": now} if again or now != last else None
            parts.append(sim.step(end, {"cube": poses(end)}, visible=visible).events)
            last = now
        return np.concatenate(parts)

    def at_once(values: list[bool]) -> np.ndarray:
        sim = simulator(device, name)
        each = {"cube": [poses(end) for end in ends]}
        return np.asarray(sim.step(ends[-1], each, pose_times_us=ends, visible={"cube": values}).events)

    expected = run(again=False)
    assert len(expected) > 500
    assert np.array_equal(expected, run(again=True))
    assert np.array_equal(expected, at_once(seen))
    assert not np.array_equal(expected, at_once([True, False, True, True, True])), "canary"


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize(
    ("model", "change"),
    [
        ("diffuse", RED),
        ("diffuse", {"emissive": (0.5, 0.4, 0.1)}),
        ("metallic_roughness", {"roughness": 0.15, "metallic": 0.9}),
        ("unlit", RED),
    ],
)
def test_a_material_changes_at_the_start_of_a_step(
    device: evis.Device, name: str, model: str, change: dict[str, object]
):
    own = {"roughness": 0.6, "metallic": 0.1} if model == "metallic_roughness" else {}
    before = scene(model=model, **own)
    was, becomes = pictures(device, before, scene(model=model, **{**own, **change}))
    sim = simulator(device, name, before)
    assert len(sim.step(STEP_US).events) == 0
    events = sim.step(2 * STEP_US, materials={"painted": change}).events
    assert events["t"].min() >= STEP_US
    assert events["t"].max() <= STEP_US + LAST_US[name]
    assert explained(events, was, becomes) > 0.97
    assert explained(events, becomes, was) < 0.2, "canary"
    again = sim.step(3 * STEP_US, materials={"painted": change})
    assert len(again.events) == 0, "the same values are no change"
    first = simulator(device, name, before)
    assert len(first.step(STEP_US, materials={"painted": change}).events) == 0, "it was never otherwise"


@pytest.mark.parametrize("name", ["native", "tiles", "decoupled"])
def test_environments_and_nodes_change_apart(device: evis.Device, name: str):
    of = scene(environments=2)
    sim = simulator(device, name, of, materials=["ball", "painted"])
    sim.step(STEP_US)
    packet = sim.step(2 * STEP_US, visible={"cube": np.array([True, False])})
    assert len(packet[0].events) == 0
    assert len(packet[1].events) > 100
    colors = np.array([RED["color"], GREY["color"]])
    packet = sim.step(3 * STEP_US, materials={"ball": {"color": colors}})
    assert len(packet[1].events) == 0
    # The ball is on the right, and the cube, of the same material, stays as it is.
    assert len(packet[0].events) > 20
    assert packet[0].events["x"].min() > SIZE[0] // 2
    packet = sim.step(4 * STEP_US, materials={"painted": RED})
    assert len(packet[0].events) > 50
    assert packet[0].events["x"].max() < 0.7 * SIZE[0]


def test_labels_show_what_is_there(device: evis.Device):
    sim = simulator(device, "native", labels=["instance", "flow"], label_rate_hz=100.0)
    sim.step(STEP_US)
    bodies = sim.scene.bodies([0])
    cube = bodies.instance_id[bodies.names.index("cube")]
    gone = sim.step(3 * STEP_US, visible={"cube": False}).labels
    back = sim.step(6 * STEP_US, visible={"cube": True}).labels

    def images(kind: str) -> dict[int, np.ndarray]:
        pairs = (zip(labels[kind].t_us, labels[kind].images, strict=True) for labels in (gone, back))
        return {int(t_us): image for each in pairs for t_us, image in each}

    ids = images("instance")
    shown = {t_us: bool((image == cube).any()) for t_us, image in ids.items()}
    # At the time of a change things are as they were.
    assert shown == {10_000: True, 20_000: False, 30_000: False, 40_000: True, 50_000: True}
    here = ids[40_000] == cube
    looks_back, looks_ahead = images("flow_backward_valid"), images("flow_forward_valid")
    assert not looks_back[40_000][here].any()
    assert looks_back[50_000][here].all()
    assert not looks_ahead[10_000][here].any()


@pytest.mark.parametrize("name", ["native", "tiles", "decoupled"])
def test_a_reset_shows_and_paints_without_events(device: evis.Device, name: str):
    sim = simulator(device, name, scene(environments=2))
    sim.step(STEP_US, visible={"cube": False})
    sim.reset(1, visible={"cube": True}, materials={"painted": RED})
    packet = sim.step(2 * STEP_US)
    assert [len(view.events) for view in packet] == [0, 0]
    packet = sim.step(3 * STEP_US, visible={"cube": [False, False]}, materials={"painted": GREY})
    assert len(packet[0].events) == 0
    assert len(packet[1].events) > 100


def test_a_material_of_flat_shapes_is_changed_by_its_name(device: evis.Device):
    # `spinner` has a node of this name, too; its cards have a twin of the material, drawn from both sides.
    spinner = evis.Scene.builtin("spinner")
    settings = {"size": SIZE, "reference_luminance": 1.0, "pose_step_us": STEP_US, **SETTINGS["native"]}
    still = evis.Simulator(
        spinner, device=device, poses=["square", "camera"], materials=["square"], **settings
    )
    assert len(still.step(STEP_US).events) == 0
    assert len(still.step(2 * STEP_US, materials={"square": {"color": (3.0, 3.0, 3.0)}}).events) > 100


def test_materials_alone_may_be_left_to_a_host(device: evis.Device):
    sim = simulator(device, "native", poses=(), materials=["cube"])
    assert len(sim.step(STEP_US).events) == 0
    assert len(sim.step(2 * STEP_US, materials={"cube": RED}).events) > 100
    with pytest.raises(evis.ConfigError, match="step by step"):
        sim.stream(duration=0.1)


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ({"visible": {"cub": True}}, "did you mean 'cube'?"),
        ({"visible": {"cube": 1.0}}, "give True or False"),
        ({"visible": {"cube": [True, False, True]}}, "for 1 environment"),
        ({"visible": {"eye": False}}, "it carries the camera 'eye'"),
        ({"materials": {"paint": RED}}, "did you mean 'painted'?"),
        ({"materials": {"wall": RED}}, "no host changes"),
        (
            {"materials": {"painted": {"texture": "checker"}}},
            "'color' or 'metallic' or 'emissive' or 'roughness'",
        ),
        ({"materials": {"painted": {"roughness": 0.5}}}, "not seen of the diffuse material 'painted'"),
        ({"materials": {"painted": {"color": (1.0, -1.0, 0.0)}}}, "base_color"),
        ({"materials": {"painted": {"color": (1.0, 1.0)}}}, r"give \(3,\)"),
        ({"materials": {"painted": {"emissive": (np.nan, 0, 0)}}}, "emissive"),
        ({"materials": {"painted": 3}}, "must be a mapping"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(
    device: evis.Device, step: dict[str, object], message: str
):
    sim = simulator(device, "native", poses=["cube", "eye"])
    sim.step(STEP_US)
    with pytest.raises(evis.ConfigError, match=message):
        sim.step(2 * STEP_US, **step)
    assert sim.now_us == STEP_US
    assert len(sim.step(2 * STEP_US, visible={"cube": False}).events) > 100


def test_what_is_left_to_no_host_cannot_be_changed(device: evis.Device):
    sim = evis.Simulator(scene(), device=device, rate_hz=1000.0)
    with pytest.raises(evis.ConfigError, match="name them as poses"):
        sim.step(STEP_US, visible={"cube": False})
    with pytest.raises(evis.ConfigError, match="name them as materials"):
        sim.step(STEP_US, materials={"painted": RED})
    with pytest.raises(evis.ConfigError, match="did you mean 'painted'"):
        simulator(device, "native", materials=["paintd"])
