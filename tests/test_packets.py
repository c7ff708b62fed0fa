"""One camera is one line; cameras go by name, environments by index."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import evis
from evis import _packets


def view(environment: int, name: str, count: int) -> evis.packets.View:
    events = np.zeros(count, evis.EventCD)
    events["t"] = np.arange(count)
    array = evis.EventArray(events, width=64, height=48)
    camera = evis.packets.CameraInfo(name, 64, 48, 50.0, 50.0, 32.0, 24.0)
    poses = evis.packets.Poses(np.zeros(1, np.int64), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
    return evis.packets.View(environment, camera, array, {}, poses)


def packet(*views: evis.packets.View) -> evis.Packet:
    report = evis.packets.Report(
        sum(len(v.events) for v in views), 0, 0, 0, 10, *[0] * 7, [], 0, 0, 0, 0, 0, [], 0.0, 0.0, 0.0, 0.0
    )
    return evis.Packet(0, 10_000, views, report)


def test_one_camera_needs_no_name():
    single = packet(view(0, "left", 5))
    assert len(single.events) == 5
    assert single.events is single.view.events
    assert single.t.tolist() == [0, 1, 2, 3, 4]
    assert single.x.dtype == np.uint16
    assert single.y.dtype == np.uint16
    assert single.p.dtype == np.int16
    assert single["left"] is single.view
    assert single[0].events is single.events
    assert len(single.poses) == 1
    assert single.events.sensor_size == (64, 48)


def test_cameras_go_by_name():
    stereo = packet(view(0, "left", 5), view(0, "right", 3))
    assert list(stereo.events) == ["left", "right"]
    assert len(stereo.events["right"]) == 3
    assert len(stereo["right"].events) == 3
    with pytest.raises(evis.EvisError, match=r"2 cameras \(left, right\)"):
        _ = stereo.t
    with pytest.raises(evis.ConfigError, match="no camera named 'up'; there is left, right"):
        _ = stereo["up"]


def test_environments_go_by_index():
    batch = packet(*(view(k, name, k + 1) for k in range(3) for name in ("left", "right")))
    assert len(batch) == 3
    assert [len(environment["left"].events) for environment in batch] == [1, 2, 3]
    assert len(batch[2].events["right"]) == 3
    assert batch.environment(1) is batch[1]
    assert [(v.environment, v.camera.name) for v in batch.views][:2] == [(0, "left"), (0, "right")]
    with pytest.raises(evis.EvisError, match="3 environments"):
        _ = batch.events
    with pytest.raises(evis.ConfigError, match="between 0 and 2"):
        batch.environment(3)


def test_labels_are_arrays_with_times():
    class Frame:
        kind = "flow_forward"
        t_us = 20_000
        t_other_us = 40_000
        data = np.ones((48, 64, 2), np.float32)

    labels = _packets.labels_from([Frame()], ("depth", "flow_forward"), (64, 48))  # type: ignore[list-item]
    assert labels["flow_forward"].data.shape == (1, 48, 64, 2)
    assert np.shares_memory(labels["flow_forward"].data, Frame.data)
    assert labels["flow_forward"].t_other_us.tolist() == [40_000]
    assert labels["depth"].data.shape == (0, 48, 64)
    assert labels["depth"].data.dtype == np.float32
    two = _packets.labels_from([Frame(), Frame()], (), (64, 48))  # type: ignore[list-item]
    assert two["flow_forward"].data.shape == (2, 48, 64, 2)
    assert [t for t, _ in two["flow_forward"]] == [20_000, 20_000]


def labelled(environment: int, name: str, size: tuple[int, int] = (64, 48)) -> evis.packets.View:
    made = view(environment, name, 1)
    width, height = size
    pictures = tuple(np.full((height, width), 10 * environment + k, np.float32) for k in range(2))
    times = np.array([0, 5_000])
    depth = evis.packets.Labels("depth", times, times, pictures, size)
    camera = evis.packets.CameraInfo(name, width, height, 50.0, 50.0, 32.0, 24.0)
    return evis.packets.View(environment, camera, made.events, {"depth": depth}, made.poses)


def test_labels_of_all_views_come_as_one_array():
    batch = packet(*(labelled(k, name) for k in range(3) for name in ("left", "right")))
    assert batch.stack_labels("depth").shape == (6, 48, 64)
    assert batch.stack_labels("depth")[:, 0, 0].tolist() == [1, 1, 11, 11, 21, 21], (
        "environment by environment"
    )
    assert batch.stack_labels("depth", 0, camera="right")[:, 0, 0].tolist() == [0, 10, 20]
    assert batch[1].stack_labels("depth", 0)[:, 0, 0].tolist() == [10, 10]
    with pytest.raises(evis.ConfigError, match="no label 'flow'; it has depth"):
        batch.stack_labels("flow")
    with pytest.raises(evis.ConfigError, match="index is 2; this packet has 2 images of depth"):
        batch.stack_labels("depth", 2)
    with pytest.raises(evis.ConfigError, match="no camera named 'up'"):
        batch.stack_labels("depth", camera="up")
    uneven = packet(labelled(0, "left"), labelled(0, "right", (32, 48)))
    with pytest.raises(evis.ConfigError, match="left 64x48, right 32x48"):
        uneven.stack_labels("depth")
    assert uneven.stack_labels("depth", camera="right").shape == (1, 48, 32)


def test_pose_matrices_turn_and_move():
    half = np.sqrt(0.5)
    poses = evis.packets.Poses(
        np.zeros(1, np.int64), np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, half, 0.0, half]])
    )
    moved = poses.matrix[0] @ np.array([0.0, 0.0, -1.0, 1.0])
    # A quarter turn to the left about +Y: what lay ahead (-Z) lies at -X.
    assert np.allclose(moved, [0.0, 2.0, 3.0, 1.0])


def test_label_kinds_come_from_the_engine():
    assert _packets.LABEL_KINDS["depth"] == (np.dtype("<f4"), 1)
    assert _packets.LABEL_KINDS["normal"] == (np.dtype("<f4"), 3)
    assert _packets.LABEL_KINDS["instance"] == (np.dtype("<u4"), 1)
    assert _packets.LABEL_KINDS["flow_forward_valid"] == (np.dtype("u1"), 1)


def test_labels_say_what_is_at_events(device: evis.Device, tmp_path: Path) -> None:
    """The image nearest in time, at each event's pixel; in files too."""
    scene = evis.Scene.builtin("spinner")
    common = {"device": device, "size": (48, 36), "method": "native"}
    sim = evis.Simulator(scene, labels=["instance", "normal"], label_rate_hz=500, **common)
    path = tmp_path / "a.h5"
    evis.save(path, sim.stream(duration=0.02))
    recording = evis.load(path)
    events, images = recording.events, recording.labels["instance"]
    assert len(events) > 50
    values, apart = images.at_events(events)
    normals, _ = recording.labels["normal"].at_events(recording["camera"])
    assert (values.dtype, values.shape, normals.shape) == (np.uint32, (len(events),), (len(events), 3))
    for k in range(0, len(events), 17):
        distance = np.abs(images.t_us - events.t[k])
        nearest = int(np.argmin(distance))
        assert apart[k] == distance[nearest]
        assert values[k] == images[nearest][events.y[k], events.x[k]]
    assert apart.max() <= 1999, "after the last image, to the end"
    assert len(np.unique(values)) > 1, "canary"
    window = events.slice_time(0, 7000)
    assert np.array_equal(images.at_events(window)[0], values[: len(window)])
    assert images.at_events(events.slice_time(0, 0))[0].shape == (0,)
    with pytest.raises(evis.ConfigError, match="48x36"):
        images.at_events(evis.EventArray(events.to_numpy(), width=64, height=48))
    with pytest.raises(evis.ConfigError, match="it must be an EventArray"):
        images.at_events(values)
    packet = evis.Simulator(scene, labels=["depth"], label_rate_hz=10, start=0.05, **common).step(90_000)
    depth, apart = packet.labels["depth"].at_events(packet.events)
    assert depth.dtype == np.float32
    assert apart.max() > 10_000
