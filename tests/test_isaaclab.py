"""Isaac Lab's event camera, on a stand-in for Isaac Lab, which does not run here.

`EVIS_ISAACLAB_WHEELS` names a folder with the wheels of 2.3.2 and 3.0.0, against which the stand-in's fields
are then held; they are parsed, not run.
"""

from __future__ import annotations

import ast
import dataclasses
import os
import re
import subprocess
import sys
import types
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from host_stand_ins import BUFFERS, FIELDS, HEIGHT, WIDTH, install, sliding

import evis
import evis.isaaclab
from evis.gbuffer import EpisodeRecorder, EventPipeline, MotionFromPoses

LIGHT = {"2.3.2": "HdrColor", "3.0.0": "rgb_hdr"}
"""The best linear buffer of a release."""


@pytest.fixture(params=sorted(FIELDS))
def release(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    install(monkeypatch, request.param)
    yield request.param
    evis.isaaclab._classes.cache_clear()


def cfg(**fields: Any) -> Any:
    given = {"prim_path": "{ENV_REGEX_NS}/Robot/head/cam", "spawn": None, "width": WIDTH, "height": HEIGHT}
    return evis.isaaclab.EventCameraCfg(**given, **{"exposure_locked": True, "data_types": [], **fields})


def camera(release: str, configuration: Any, pictures: Any = sliding) -> Any:
    """A camera that plays; each render shows the next picture."""
    made = configuration.class_type(configuration)
    shown = [0]

    def render() -> dict[str, npt.NDArray[Any]]:
        outputs = pictures(shown[0])
        shown[0] += 1
        named = {**outputs, LIGHT[release]: outputs["rgb_radiance"]}
        return {name: named[name] for name in made.cfg.data_types}

    made.render = render
    made.renders = shown
    made.play()
    return made


def tensor(value: Any) -> npt.NDArray[Any]:
    """An output as NumPy's, whatever the release makes of it."""
    found = value.torch if hasattr(type(value), "torch") else value
    return np.asarray(found)


# Without Isaac Lab.


def test_the_module_is_imported_without_isaac_lab_and_using_it_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "isaaclab", None)
    monkeypatch.setitem(sys.modules, "isaaclab.sensors", None)
    evis.isaaclab._classes.cache_clear()
    for name in ("EventCameraCfg", "EventCamera"):
        with pytest.raises(evis.EvisError, match=r"EventCameraCfg needs Isaac Lab 2\.3 or 3\.0"):
            getattr(evis.isaaclab, name)
    assert not hasattr(evis.isaaclab, "EventCam")


def test_importing_it_imports_no_framework() -> None:
    code = "import sys, evis.isaaclab; print({'torch', 'isaaclab', 'warp'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


# The configuration.


def test_the_configuration_is_the_releases_own_with_the_plugins_fields(release: str) -> None:
    sensors = sys.modules["isaaclab.sensors"]
    made = cfg(threshold=0.2, update_period=0.008)
    assert isinstance(made, sensors.CameraCfg)
    assert issubclass(made.class_type, sensors.Camera)
    assert made.class_type is evis.isaaclab.EventCamera
    names = {field.name for field in dataclasses.fields(made)}
    assert names > set(FIELDS[release])
    added = names - set(FIELDS[release])
    assert added >= {"threshold", "event_source", "noise", "motion_blur", "margin"}
    # Nothing of the host's is shadowed but what makes the sensor.
    assert not (added & set(FIELDS["2.3.2"] | FIELDS["3.0.0"]))
    assert made.update_period == 0.008
    assert made.data_types == ["distance_to_image_plane", LIGHT[release], "motion_vectors"]
    # Copies, which the host makes, ask for nothing twice; what was asked for stays.
    kept = cfg(data_types=["rgb", "motion_vectors"]).copy().copy().data_types
    assert kept == ["rgb", "motion_vectors", "distance_to_image_plane", LIGHT[release]]
    assert cfg(event_source="ldr").data_types[1] == "rgb"
    assert evis.isaaclab.EventCameraCfg().data_types[0] == "rgb", "the host's default stays"
    with pytest.raises(TypeError, match="prim_path"):
        made.class_type(evis.isaaclab.EventCameraCfg())


def test_radiance_is_asked_for_where_the_release_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "3.0.0", BUFFERS | {"rgb_radiance"})
    assert "rgb_radiance" in cfg().data_types
    assert "rgb_hdr" not in cfg().data_types
    evis.isaaclab._classes.cache_clear()


def test_fields_become_settings() -> None:
    given = dict(
        threshold=0.15, event_source="hdr", noise=None, motion_blur=0.0, margin=0, warp="splat", steps=None,
        exposure_locked=False, motion_scale=(1.0, 1.0), check_motion=True, voxel_bins=5, window=0.0,
        reference_luminance=1.0, backend="auto", seed=0,
    )  # fmt: skip

    def settings(**fields: Any) -> Any:
        return evis.isaaclab.settings_of(types.SimpleNamespace(**given | fields))

    assert settings().sensor == evis.Sensor(threshold_on=0.15, threshold_off=0.15)
    paper = settings(warp="evis-paper", steps=8)
    assert (paper.sensor.trigger, paper.sensor.log_eps, paper.steps) == ("latch", 1e-5, 8)
    noisy = settings(noise="evis", threshold=(0.3, 0.2), motion_blur=0.02, window=0.05, margin=4)
    wanted = evis.Sensor.preset("evis")
    assert noisy.sensor.noise == wanted.noise
    assert noisy.sensor.refractory == wanted.refractory
    assert (noisy.sensor.threshold_on, noisy.sensor.threshold_off) == (0.3, 0.2)
    assert noisy.sensor.exposure == evis.sensors.Exposure(time_us=20_000)
    assert (noisy.window_us, noisy.margin) == (50_000, 4)
    for fields, said in [
        ({"event_source": "rgb"}, "event_source is 'rgb'"),
        ({"threshold": (0.1, 0.2, 0.3)}, "threshold is"),
        ({"noise": True}, "noise is True"),
        ({"motion_blur": -1.0}, "motion_blur is -1"),
        ({"motion_blur": "20 ms"}, "motion_blur is '20 ms'"),
        ({"window": float("nan")}, "window is nan"),
    ]:
        with pytest.raises(evis.ConfigError, match=said):
            settings(**fields)


# The sensor.


def test_the_camera_fires_as_keyframes_that_are_pushed(release: str) -> None:
    made = camera(release, cfg(warp="evis-paper", steps=8, update_period=0.008))
    sensor = evis.Sensor(threshold_on=0.15, threshold_off=0.15, trigger="latch", log_eps=1e-5)
    direct = evis.EventEmulator(WIDTH, HEIGHT, sensor, batch=2)
    fired = 0
    for step in range(1, 34):
        made.update(0.001)
        if step % 8 != 1:
            continue
        outputs = sliding(made.renders[0] - 1)
        lists = direct.push_keyframe(*outputs.values(), 1000 * step, warp=evis.Warp.evis_paper(8))
        for env, events in enumerate(lists):
            assert np.array_equal(made.pipeline.events[env].to_numpy(), events.to_numpy())
            counts = tensor(made.data.output["event_counts"])[env]
            assert np.array_equal(counts, np.moveaxis(events.counts(), 0, -1))
        fired += len(lists[0])
    assert made.renders[0] == 5
    assert fired > 1000


def test_pictures_are_taken_at_the_render_rate_and_reading_takes_none(release: str) -> None:
    made = camera(release, cfg(update_period=0.008))
    times = []
    for _ in range(40):
        made.update(0.001)
        _ = made.data.output, made.data.output
        if made.pipeline.now_us not in times:
            times.append(made.pipeline.now_us)
    assert made.renders[0] == len(times) == 5
    assert times == [1000, 9000, 17_000, 25_000, 33_000]


def test_a_picture_that_is_read_twice_is_taken_once(release: str) -> None:
    # Isaac Lab 2.3 reads at every physics step what was rendered last, every `render_interval` steps.
    made = camera(release, cfg(), lambda read: sliding(read // 4))
    direct = EventPipeline(2, HEIGHT, WIDTH, made.pipeline.settings)
    fired = 0
    for step in range(16):
        made.update(0.002)
        if step % 4 == 0:
            lists = direct.push(made._data.output, 2000 * (step + 1))
            fired += len(lists[0])
        for one, two in zip(made.pipeline.events, direct.events, strict=True):
            assert np.array_equal(one.to_numpy(), two.to_numpy())
        assert made.pipeline.now_us == 2000 * (step // 4 * 4 + 1)
    assert fired > 1000
    # Canary: the next picture is taken.
    made.update(0.002)
    assert made.pipeline.now_us == 34_000


def test_environments_that_are_due_apart_are_read_together(release: str) -> None:
    # Motion vectors are of the gap between two renders, for all environments.
    made = camera(release, cfg(update_period=0.008))
    direct = EventPipeline(2, HEIGHT, WIDTH, made.pipeline.settings)
    fired = 0
    for step in range(1, 30):
        made.update(0.001)
        if step == 4:
            made.reset([1])
            direct.reset([1])
        if made.pipeline.now_us != direct.now_us:
            lists = direct.push(sliding(made.renders[0] - 1), 1000 * step)
            for one, two in zip(made.pipeline.events, lists, strict=True):
                assert np.array_equal(one.to_numpy(), two.to_numpy())
            fired += len(lists[0])
            assert step < 5 or len(lists[0]) > 100
    assert made.renders[0] > 5, "there were renders between those of the other environment"
    assert fired > 1000


def test_outputs_stay_the_hosts_and_terms_observe_events(release: str) -> None:
    torch = sys.modules["torch"]
    made = camera(release, cfg(data_types=["motion_vectors"], voxel_bins=3))
    for _ in range(3):
        made.update(0.008)
    output = made.data.output
    assert set(output) == {*made.cfg.data_types, "event_counts", "event_voxels"}
    assert set(made._data.output) == set(made.cfg.data_types), "the host's own are left alone"
    assert made.data.info == {}
    entity = types.SimpleNamespace(name="cam")
    env = types.SimpleNamespace(scene=types.SimpleNamespace(sensors={"cam": made}))
    counts, voxels = evis.isaaclab.event_counts(env, entity), evis.isaaclab.event_voxels(env, entity)
    assert (counts.dtype, tuple(counts.shape)) == (torch.float32, (2, HEIGHT, WIDTH, 2))
    assert (voxels.dtype, tuple(voxels.shape)) == (torch.float32, (2, HEIGHT, WIDTH, 3))
    assert counts.sum() == sum(map(len, made.pipeline.events)) > 0
    counts += 1
    assert evis.isaaclab.event_counts(env, entity).sum() < counts.sum(), "observations are copies"


def test_chosen_environments_are_reset_and_begin_with_the_next_render(release: str) -> None:
    torch = sys.modules["torch"]
    made = camera(release, cfg())
    for _ in range(2):
        made.update(0.008)
    assert all(map(len, made.pipeline.events))
    made.reset(torch.tensor([1]))
    # As after a reset in an environment's step: Isaac renders once more, at the same time.
    counts = tensor(made.data.output["event_counts"])
    assert made.renders[0] == 3
    assert counts[0].any()
    assert not counts[1].any()
    made.update(0.008)
    assert len(made.pipeline.events[0]) > 0
    assert len(made.pipeline.events[1]) == 0
    assert [report.cut for report in made.pipeline.reports] == ["none", "start"]
    made.update(0.008)
    assert all(map(len, made.pipeline.events))
    with pytest.raises((evis.ConfigError, IndexError)):
        made.reset(np.array([2]))
    made.reset()
    made.update(0.008)
    assert sum(map(len, made.pipeline.events)) == 0
    if release >= "3":
        from host_stand_ins import Mask

        made.update(0.008)
        made.reset(env_mask=Mask(np.array([True, False])))
        made.update(0.008)
        assert [len(events) > 0 for events in made.pipeline.events] == [False, True]


def test_episodes_are_recorded(release: str, tmp_path: Path) -> None:
    made = [camera(release, cfg(camera_name=name)) for name in ("left", "right")]
    with EpisodeRecorder(tmp_path) as recorder:
        for each in made:
            each.pipeline.record(recorder)
        for k in range(4):
            for each in made:
                if k == 2:
                    each.reset([0])
                each.update(0.008)
    names = {"env0000_ep0000.h5", "env0000_ep0001.h5", "env0001_ep0000.h5"}
    assert {path.name for path in recorder.paths} == names
    recording = evis.load(tmp_path / "env0001_ep0000.h5")
    assert set(recording) == {"left", "right"}
    assert len(recording["left"].events) > 500


def test_a_margin_makes_the_sensor_smaller_than_its_pictures(release: str) -> None:
    made = camera(release, cfg(margin=8))
    for _ in range(2):
        made.update(0.008)
    assert tensor(made.data.output["event_counts"]).shape == (2, HEIGHT - 16, WIDTH - 16, 2)
    assert tensor(made.data.output["motion_vectors"]).shape == (2, HEIGHT, WIDTH, 2)
    # What comes in was rendered: nothing is unknown.
    assert [report.unknown for report in made.pipeline.reports] == [0, 0]
    bare = camera(release, cfg())
    for _ in range(2):
        bare.update(0.008)
    assert all(report.unknown > 0 for report in bare.pipeline.reports), "canary"


def test_wrong_vectors_and_unlocked_exposure_stop_the_first_steps(release: str) -> None:
    def flipped(k: int) -> Any:
        outputs = sliding(k)
        return {**outputs, "motion_vectors": -outputs["motion_vectors"]}

    made = camera(release, cfg(), flipped)
    made.update(0.008)
    with pytest.raises(evis.ConfigError, match=r"cam: motion_vectors are .* set motion_scale=\(-1, -1\)"):
        made.update(0.008)
    mended = camera(release, cfg(motion_scale=(-1.0, -1.0)), flipped)
    for _ in range(2):
        mended.update(0.008)
    assert mended.pipeline.motion_checked
    unlocked = camera(release, cfg(exposure_locked=False))
    with pytest.raises(evis.ConfigError, match="exposure_locked=True"):
        unlocked.update(0.008)
    with pytest.raises(evis.EvisError, match="not initialized"):
        _ = cfg().class_type(cfg()).pipeline


class Warp3:
    """The configuration of a renderer without motion vectors, such as Newton's."""

    def supported_output_types(self) -> dict[str, None]:
        return dict.fromkeys(("rgb", "rgb_hdr", "distance_to_image_plane"))


def test_renderers_without_motion_vectors_need_a_function(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, "3.0.0")
    bare = cfg(renderer_cfg=Warp3())
    assert "motion_vectors" not in bare.data_types
    with pytest.raises(evis.ConfigError, match="MotionFromPoses"):
        bare.class_type(bare)
    # A wall at 2 m; the camera moves so that it shifts as `sliding` does: 3 and 2 pixels per picture.
    focal = 50.0
    maker = MotionFromPoses(2, [[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])

    rendered = iter(range(9))

    def motion(data: Any) -> Any:
        k = next(rendered)
        pose = [-3 * k * 2 / focal, 2 * k * 2 / focal, 0, 0, 0, 0, 1]
        return maker(data.output["distance_to_image_plane"], [pose, pose])

    made = camera("3.0.0", cfg(renderer_cfg=Warp3(), motion=motion))
    given = camera("3.0.0", cfg())
    for each in (made, given):
        for _ in range(3):
            each.update(0.008)
    assert made.pipeline.motion_checked
    assert [report.steps for report in made.pipeline.reports] == [r.steps for r in given.pipeline.reports]
    one, two = made.pipeline.events[0], given.pipeline.events[0]
    assert len(one) > 500
    assert abs(len(one) - len(two)) <= 0.01 * len(two)
    evis.isaaclab._classes.cache_clear()


def test_pictures_that_come_late_are_said(release: str) -> None:
    made = camera(release, cfg())
    made._data.info = {"motion_vectors": {"capture": {"frame": [0, 0]}}}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made.update(0.008)
    assert any("one capture late" in str(warning.message) for warning in caught)
    in_time = camera(release, cfg())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        in_time.update(0.008)


# The document.


def document_blocks() -> list[str]:
    page = Path(__file__).parent.parent / "docs" / "isaaclab.md"
    return re.findall(r"(?ms)^```python\n(.*?)^```$", page.read_text("utf-8"))


def test_code_of_the_document_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch, "3.0.0")
    simulation = types.ModuleType("isaaclab.sim")
    simulation.__dict__["PinholeCameraCfg"] = object
    monkeypatch.setitem(sys.modules, "isaaclab.sim", simulation)
    configuration, pushed = document_blocks()
    exec(configuration, {})
    assert capsys.readouterr().out == "['rgb', 'distance_to_image_plane', 'rgb_hdr', 'motion_vectors']\n"
    exec(pushed, {})
    first, second = capsys.readouterr().out.splitlines()
    assert int(first.split()[0]) > 500
    assert second == "True"
    # Canary: code that is out of date does not pass.
    with pytest.raises(TypeError, match="treshold"):
        exec(configuration.replace("threshold", "treshold"), {})
    evis.isaaclab._classes.cache_clear()


def test_the_documents_table_has_every_field_with_its_default(release: str) -> None:
    page = (Path(__file__).parent.parent / "docs" / "isaaclab.md").read_text("utf-8")
    rows = re.findall(r"(?m)^\| (`[a-z_]+`(?:, `[a-z_]+`)?) \| (.+?) \|", page.split("## What is taken")[0])
    shown: dict[str, Any] = {}
    for names, values in rows:
        given = ast.literal_eval(values.replace("`", ""))
        fields = re.findall(r"`([a-z_]+)`", names)
        shown |= dict(zip(fields, given, strict=True)) if len(fields) > 1 else {fields[0]: given}
    made = cfg()
    added = {field.name for field in dataclasses.fields(made)} - set(FIELDS[release])
    own = evis.isaaclab.EventCameraCfg()
    assert shown == {name: getattr(own, name) for name in added}


# The published sources.


def fields_of(archive: zipfile.ZipFile, ending: str, name: str) -> dict[str, str]:
    """Names and defaults, as written, of a class's own fields."""
    (path,) = [path for path in archive.namelist() if path.endswith(ending) and "/test/" not in path]
    tree = ast.parse(archive.read(path))
    (found,) = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name]
    return {
        node.target.id: ast.unparse(node.value) if node.value else ""
        for node in found.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }


@pytest.mark.parametrize("version", sorted(FIELDS))
def test_the_stand_in_has_the_fields_of_the_published_sources(version: str) -> None:
    folder = os.environ.get("EVIS_ISAACLAB_WHEELS")
    if not folder:
        pytest.skip("EVIS_ISAACLAB_WHEELS names no folder with Isaac Lab's wheels")
    (wheel,) = Path(folder).glob(f"isaaclab-{version}-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        found = fields_of(archive, "isaaclab/sensors/camera/camera_cfg.py", "CameraCfg")
        found |= fields_of(archive, "isaaclab/sensors/sensor_base_cfg.py", "SensorBaseCfg") | found
        assert set(found) == set(FIELDS[version])
        for name, default in FIELDS[version].items():
            if default is not None and default is not dataclasses.MISSING:
                assert ast.literal_eval(found[name]) == default, name
            elif default is dataclasses.MISSING:
                assert found[name] == "MISSING", name
        buffers: set[str] = set()
        for path in archive.namelist():
            if path.endswith("isaaclab/renderers/output_contract.py"):
                buffers = set(ast.literal_eval(value) for value in enum_values(archive.read(path)))
        assert buffers == (BUFFERS if version >= "3" else set())


def enum_values(source: bytes) -> list[str]:
    tree = ast.parse(source)
    (kinds,) = [
        node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "RenderBufferKind"
    ]
    return [ast.unparse(node.value) for node in kinds.body if isinstance(node, ast.Assign)]
