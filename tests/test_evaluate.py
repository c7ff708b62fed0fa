"""Evaluation by networks: measures have closed forms, controls fail, and a blind network is found.

Most networks here are Python functions behind a stand-in of onnxruntime, so that nothing need be installed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evis
from evis import _commands, _networks, evaluate

BINS, SIDE = 5, (96, 128)
ASSETS = Path(os.environ.get("EVIS_ASSETS", "/no/such/folder")) / "networks"


# Networks.


def tensor(name: str, *shape: int | str, kind: str = "tensor(float)") -> types.SimpleNamespace:
    return types.SimpleNamespace(name=name, shape=list(shape), type=kind)


Made = tuple[list[types.SimpleNamespace], list[types.SimpleNamespace], Callable[..., list[Any]]]
GRID = tensor("voxel", "batch", BINS, "H", "W")
IMAGE = tensor("image", "batch", 1, "H", "W")
STATE = tensor("state", "batch", 1, "H", "W")


def integrate(voxel: Any, state: Any) -> list[Any]:
    """Add up events, forgetting slowly: what a network that sees them does at least."""
    state = np.float32(0.9) * state + voxel.sum(axis=1, keepdims=True)
    return [np.float32(0.5) + np.float32(0.1) * state, state]


def checkered(voxel: Any) -> list[Any]:
    """Show the same picture whatever the events are."""
    y, x = np.mgrid[0 : voxel.shape[2], 0 : voxel.shape[3]]
    return [((x // 8 + y // 8) % 2)[None, None].astype(np.float32)]


def same_places(one: Any, other: Any) -> list[Any]:
    """Match every pixel of a picture with the same pixel of the other."""
    y, x = np.mgrid[0 : SIDE[0], 0 : SIDE[1]]
    places = np.stack([x.ravel(), y.ravel()], axis=1)
    return [places, places]


def cells(picture: Any) -> list[Any]:
    """Answer as XFeat does: a cell's 64 grey values as its feature, and as the scores of its places."""
    _, _, height, width = picture.shape
    planes = picture[0, 0].reshape(height // 8, 8, width // 8, 8).transpose(1, 3, 0, 2)
    planes = planes.reshape(1, 64, height // 8, width // 8)
    scores = np.concatenate([8 * planes, np.zeros_like(planes[:, :1])], axis=1)
    return [planes - planes.mean(axis=1, keepdims=True), scores, np.ones_like(planes[:, :1])]


PAIR = [tensor("one", 1, 1, *SIDE), tensor("other", 1, 1, *SIDE)]
NETWORKS: dict[str, Made] = {
    "integrator": ([GRID, STATE], [IMAGE, STATE], integrate),
    "blind": ([GRID], [IMAGE], checkered),
    "still": (
        [GRID],
        [tensor("flow", 1, 2, "H", "W")],
        lambda v: [np.zeros((1, 2, *v.shape[2:]), np.float32)],
    ),
    "framed": ([tensor("voxel", 1, 2, 112, 136)], [tensor("image", 1, 2, 112, 136)], lambda v: [v]),
    "before": ([GRID, tensor("next", *GRID.shape)], [IMAGE], lambda old, new: [old[:, :1] - new[:, 1:2]]),
    "pair": (PAIR, [tensor("a", "n", 2), tensor("b", "n", 2)], same_places),
    "cells": (
        [tensor("picture", 1, 1, "H", "W")],
        [tensor("f", 1, 64, "h", "w"), tensor("s", 1, 65, "h", "w"), tensor("r", 1, 1, "h", "w")],
        cells,
    ),
    "difference": (
        [tensor("a", 1, 3, "H", "W"), tensor("b", 1, 3, "H", "W")],
        [tensor("d", 1)],
        lambda a, b: [np.abs(a - b).mean()],
    ),
    "open state": ([GRID, tensor("state", 1, 16, "rows", "columns")], [IMAGE, STATE], integrate),
    "no picture": ([GRID, STATE], [STATE], lambda v, s: [s]),
    "small": ([tensor("voxel", 1, BINS, 16, 16)], [IMAGE], checkered),
    "whole numbers": ([tensor("voxel", 1, BINS, "H", "W", kind="tensor(int64)")], [IMAGE], checkered),
    "many": ([tensor("voxel", 4, BINS, "H", "W")], [IMAGE], checkered),
    "flat": ([GRID], [tensor("image", 1, 3)], lambda v: [np.zeros((1, 3), np.float32)]),
}


class Session:
    """Runs one of `NETWORKS`, whose name is the file's content."""

    def __init__(self, content: bytes, options: Any, providers: list[str]) -> None:
        if content.decode() not in NETWORKS:
            raise RuntimeError("no such protobuf")
        self._inputs, self._outputs, self._function = NETWORKS[content.decode()]

    def get_inputs(self) -> list[Any]:
        return self._inputs

    def get_outputs(self) -> list[Any]:
        return self._outputs

    def run(self, names: None, arrays: dict[str, Any]) -> list[Any]:
        assert list(arrays) == [each.name for each in self._inputs]
        assert all(array.dtype == np.float32 for array in arrays.values())
        return self._function(*arrays.values())


@pytest.fixture
def network(network_files: Callable[[type], Callable[[str], Path]]) -> Callable[[str], Path]:
    """Give the path of a network by its name."""
    return network_files(Session)


@pytest.fixture(scope="module")
def recording(device: evis.Device, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras, 100 mm apart, on a scene that moves, with labels."""
    path = tmp_path_factory.mktemp("evaluate") / "spinner.h5"
    right = evis.EventCamera(name="right", pose=evis.motion.Placement(parent="camera", position=(0.1, 0, 0)))
    sim = evis.Simulator(
        evis.Scene.builtin("spinner"),
        cameras=["camera", right],
        size=SIDE[::-1],
        quality="draft",
        labels=["depth", "flow", "hdr"],
        label_rate_hz=50,
    )
    evis.save(path, sim.stream(duration=0.52))
    return path


# Measures.


def test_ncc_is_pearsons_correlation():
    rng = np.random.default_rng(0)
    picture = rng.random((20, 30))
    assert evaluate.ncc(3 * picture + 7, picture) == pytest.approx(1)
    assert evaluate.ncc(1 - picture, picture) == pytest.approx(-1)
    other = rng.random((20, 30))
    assert evaluate.ncc(picture, other) == pytest.approx(np.corrcoef(picture.ravel(), other.ravel())[0, 1])
    assert evaluate.ncc(np.ones((4, 4)), np.eye(4)) == 0
    assert evaluate.ncc(np.roll(picture, 1, axis=1), picture) < 0.2, "canary: a shifted picture"
    for wrong in (picture[:5], np.where(picture > 0.5, np.nan, picture)):
        with pytest.raises(evis.ConfigError, match="one shape and finite"):
            evaluate.ncc(wrong, picture)


def test_the_local_part_of_a_picture_is_without_its_gradient():
    ramp = np.tile(np.linspace(0, 1, 120, dtype=np.float32), (100, 1))
    inner = evaluate._local(ramp)[:, 20:-20]
    assert np.abs(inner).max() < 1e-6
    dot = ramp.copy()
    dot[50, 60] += 1
    found = evaluate._local(dot) - evaluate._local(ramp)
    assert found[50, 60] == pytest.approx(1 - 1 / 41**2)
    assert found[50, 61] == pytest.approx(-1 / 41**2)


def test_tone_map_shows_the_mean_logarithm_as_the_key():
    shown = evaluate.tone_map(np.array([5.0, 5.0, 5.0]))
    assert shown == pytest.approx(1.055 * 0.18 ** (1 / 2.4) - 0.055)
    # The unit of light does not matter, and what is dark is on the curve's line.
    light = np.array([1.0, 1e-6, 4.0, 0.0])
    assert evaluate.tone_map(1000 * light) == pytest.approx(evaluate.tone_map(light))
    key = 0.18 / (4e-6) ** (1 / 3)
    assert evaluate.tone_map(light) == pytest.approx([1, 12.92 * 1e-6 * key, 1, 0], rel=1e-4)
    for wrong in ([-1.0, 2.0], [0.0, 0.0], [np.inf, 1.0], []):
        with pytest.raises(evis.ConfigError, match="luminance"):
            evaluate.tone_map(wrong)


def test_pictures_are_normalized_between_extremes_or_percentiles():
    picture = np.linspace(-2, 3, 101, dtype=np.float32)
    assert evaluate._post(picture, "none") == pytest.approx(np.clip(picture, 0, 1))
    assert evaluate._post(picture, "standard") == pytest.approx((picture + 2) / 5, abs=1e-6)
    robust = evaluate._post(picture, "robust")
    assert robust == pytest.approx(np.clip((picture + 1.95) / 4.9, 0, 1), abs=1e-6)
    low, high = np.exp(-1.95), np.exp(2.95)
    expected = np.clip((np.exp(picture) - low) / (high - low), 0, 1)
    assert evaluate._post(picture, "exprobust") == pytest.approx(expected, abs=1e-4)


def edge(columns: int = 10, *, polarity: int = 1) -> evis.EventArray:
    """An edge that goes right by a pixel per millisecond, over 20 rows of 40 pixels."""
    t = np.repeat(np.arange(columns) * 1000, 20)
    y = np.tile(np.arange(20), columns)
    return evis.EventArray.from_columns(t, 5 + t // 1000, y, np.full(len(t), polarity), width=40, height=20)


def test_fwl_of_an_edge_has_a_closed_form():
    flow = np.zeros((20, 40, 2), np.float32)
    during = {"start_us": 0, "end_us": 10_000}
    assert evaluate.fwl(edge(), flow, **during) == 1
    flow[..., 0] = 10
    # All events of a row in one of W pixels, in place of one in each of k: k (W - 1) / (W - k).
    assert evaluate.fwl(edge(), flow, **during) == pytest.approx(10 * 39 / 30)
    assert evaluate.fwl(edge(polarity=0), flow, **during) == pytest.approx(10 * 39 / 30)
    assert evaluate.fwl(edge(), -flow, **during) < 1.1, "canary: flow the wrong way"
    mask = np.zeros((20, 40), bool)
    assert np.isnan(evaluate.fwl(edge(), flow, **during, mask=mask))
    mask[:10] = True
    # Half the rows: all sums are halved, squares of means are quartered.
    k, w = 10, 40
    half = (k * k / w / 2 - (k / w / 2) ** 2) / (k / w / 2 - (k / w / 2) ** 2)
    assert evaluate.fwl(edge(), flow, **during, mask=mask) == pytest.approx(half)
    with pytest.raises(evis.ConfigError, match=r"flow has shape \(20, 40\)"):
        evaluate.fwl(edge(), flow[..., 0], **during)
    flow[3, 3] = np.nan
    with pytest.raises(evis.ConfigError, match="mask"):
        evaluate.fwl(edge(), flow, **during)


def test_events_go_back_to_where_flow_is_anchored():
    """An expansion p -> 1.1 p twice, from 0 to 20 ms: at 15 ms, what was at p is at 1.1 * 1.05 p."""
    y, x = np.mgrid[0:60, 0:80].astype(np.float32)
    field, known = np.stack([x, y], axis=2) * np.float32(0.1), np.ones((60, 80), bool)
    pieces = [(field, known, 0, 10_000), (field, known, 10_000, 20_000)]
    start = np.array([[3.0, 4.0], [40.0, 50.0], [61.5, 12.25]])
    there = start * 1.1 * 1.05
    found = np.stack(evaluate._carried(*there.T, np.full(3, 15_000), pieces)[:2], axis=1)
    assert found == pytest.approx(start, abs=0.02)
    naive = there - there * 0.15
    assert np.abs(naive - start).max() > 0.2, "canary: flow read where the event is"
    known[:, :50] = False
    assert evaluate._carried(*there.T, np.full(3, 15_000), pieces)[2].tolist() == [False, False, True]


def test_area_under_the_curve_of_poses():
    assert evaluate.pose_auc([0.0, 0.0], 5) == 1
    assert evaluate.pose_auc([np.inf, 7.0], 5) == 0
    assert evaluate.pose_auc([2.5], 5) == pytest.approx(0.75)
    assert evaluate.pose_auc([2.5, np.inf], 5) == pytest.approx(0.375)
    assert np.isnan(evaluate.pose_auc([], 5))
    assert evaluate.pose_auc([4.0], 5) < evaluate.pose_auc([1.0], 5)  # canary


def test_points_go_to_the_other_camera_by_depth():
    lens = np.array([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]])
    depth = np.full(SIDE, 4.0, np.float32)
    depth[:, :20] = 2.0
    here, right = evaluate._Place(lens, np.eye(4), depth), np.eye(4)
    right[0, 3] = 0.1
    moved = here.moved(
        evaluate._Place(lens, right, depth), np.array([[50.5, 10.5], [5.5, 10.5], [20.0, 9.0]])
    )
    # Disparity is f b / z, and y stays.
    assert moved[0] == pytest.approx(np.tile([50.5 - 2.5, 10.5], (9, 1)))
    assert moved[1] == pytest.approx(np.tile([5.5 - 5.0, 10.5], (9, 1)))
    assert sorted(set(moved[2, :, 0].round(6))) == [15.0, 17.5], "an outline belongs to both sides"
    behind = np.diag([-1.0, 1, -1, 1])
    assert np.isinf(here.moved(evaluate._Place(lens, behind, depth), np.array([[50.5, 10.5]]))).all()


def test_poses_come_back_from_exact_matches():
    pytest.importorskip("cv2")
    lens = np.array([[200.0, 0, 160], [0, 200, 120], [0, 0, 1]])
    depth = np.random.default_rng(0).uniform(2, 8, (240, 320)).astype(np.float32)
    # A turn by 5 degrees about y, and a step to the right and ahead.
    turn, moved = np.radians(5), np.eye(4)
    moved[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    moved[:3, 3] = [0.5, 0.1, -0.3]
    here, there = evaluate._Place(lens, np.eye(4), depth), evaluate._Place(lens, moved, depth)
    one = np.random.default_rng(1).uniform([40, 40], [280, 200], (200, 2)).round() + 0.5
    other = here.moved(there, one)[:, 4]
    assert evaluate._pose_error(one, other, here, there) < 0.1
    moved = moved.copy()
    moved[:3, 3] = [-0.1, 0.5, -0.3]
    wrong = evaluate._Place(lens, moved, depth)
    assert evaluate._pose_error(one, other, here, wrong) > 30, "canary: another pose"
    assert evaluate._pose_error(one[:4], other[:4], here, there) == np.inf


def test_rendered_flow_is_that_of_depth_and_poses(recording: Path):
    view = evis.load(recording)["camera"]
    places = evaluate._places(view)
    y, x = np.mgrid[0 : SIDE[0], 0 : SIDE[1]]
    centres = np.stack([x.ravel(), y.ravel()], axis=1) + 0.5
    still = ~evaluate._moving(view, 3).ravel() & view.labels["flow_forward_valid"][3].astype(bool).ravel()
    assert 0.05 < still.mean() < 1, "the scene has parts that move, and parts that do not"
    flow = view.labels["flow_forward"][3].reshape(-1, 2)
    moved = places[3].moved(places[4], centres)[:, 4] - centres
    assert np.abs(moved - flow)[still].max() < 0.1
    wrong = places[4].moved(places[3], centres)[:, 4] - centres
    assert np.abs(wrong - flow)[still].max() > 0.5, "canary: the poses exchanged"


def test_controls_change_one_thing_each():
    events = edge()
    made = dict(evaluate._streams(events, evaluate.CONTROLS))
    assert list(made) == ["events", *evaluate.CONTROLS]
    t, x, y, p = events.columns
    flipped, mirrored, anywhere, late = (made[name] for name in evaluate.CONTROLS)
    assert np.array_equal(flipped.p, 1 - p)
    assert np.array_equal(flipped.x, x)
    assert np.array_equal(mirrored.x, 39 - x)
    assert np.array_equal(mirrored.y, y)
    assert np.array_equal(late.t, t + 40_000)
    assert len(anywhere) == len(events)
    assert len(set(zip(anywhere.x.tolist(), anywhere.y.tolist(), strict=True))) > 150
    assert (anywhere.t[0] >= t[0], anywhere.t[-1] <= t[-1]) == (True, True)


# Plumbing.


def test_grids_are_padded_and_pictures_cut(network: Callable[[str], Path]):
    grid = np.random.default_rng(0).random((2, *SIDE), np.float32)
    model = _networks.VoxelNetwork(network("framed"), *SIDE)
    assert np.array_equal(model.run(grid)[0][0], grid)
    whole, where = _networks._padded(grid, 112, 136)
    assert whole.shape == (2, 112, 136)
    assert whole.sum() == pytest.approx(grid.sum(), rel=1e-5)
    assert (where[0].start, where[1].start) == (8, 4)


def test_states_are_handed_on_and_reset(network: Callable[[str], Path]):
    model = _networks.VoxelNetwork(network("integrator"), 10, 12)
    grid = np.ones((BINS, 10, 12), np.float32)
    first, second = model.run(grid)[0], model.run(grid)[0]
    assert first.shape == (1, 1, 10, 12)
    assert first == pytest.approx(np.full((1, 1, 10, 12), 1.0))
    assert second == pytest.approx(np.full((1, 1, 10, 12), 0.5 + 0.1 * (0.9 * 5 + 5)))
    model.reset()
    assert np.array_equal(model.run(grid)[0], first)


def test_a_second_grid_is_the_window_before(network: Callable[[str], Path]):
    model = _networks.VoxelNetwork(network("before"), 8, 8)
    assert model.grids == 2
    grids = np.random.default_rng(0).random((2, BINS, 8, 8), np.float32)
    assert np.array_equal(model.run(grids[1], grids[0])[0][0, 0], grids[0, 0] - grids[1, 1])
    assert np.array_equal(model.run(grids[1])[0][0, 0], -grids[1, 1])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("open state", r"leaves the size of its state state open: \[1, 16, 'rows', 'columns'\]"),
        ("no picture", "1 states and 1 outputs"),
        ("small", "takes pictures of 16x16; the events are 128x96"),
        ("whole numbers", r"takes voxel as tensor\(int64\)"),
        ("many", r"takes voxel as \[4, 5"),
        ("flat", r"gives \(1, 3\); it must give pictures"),
        ("unknown", "no network that onnxruntime reads: no such protobuf"),
    ],
)
def test_networks_that_do_not_fit_are_refused(
    network: Callable[[str], Path], recording: Path, name: str, message: str
):
    with pytest.raises((evis.ConfigError, evis.FormatError), match=message):
        evaluate.reconstruct(recording, network(name), skip=2)


def test_wrong_arguments_are_named(network: Callable[[str], Path], recording: Path, tmp_path: Path):
    path = network("integrator")
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"windows_us": [30_000]}, "a window is 30000 us; it must be a multiple"),
        ({"windows_us": []}, "windows_us is empty"),
        ({"windows_us": 20_000}, "windows_us is 20000; it must be a sequence"),
        ({"skip": 99}, "99 are skipped; record at least 2.02 s"),
        ({"post": "best"}, "post is 'best'"),
        ({"controls": ["upside down"]}, "controls has 'upside down'"),
        ({"camera": "left"}, "left"),
    ]
    for settings, message in wrong:
        with pytest.raises(evis.ConfigError, match=message):
            evaluate.reconstruct(recording, path, **settings)
    with pytest.raises(evis.ConfigError, match="a network is 7"):
        evaluate.reconstruct(recording, 7)  # type: ignore[arg-type]
    with pytest.raises(evis.ConfigError, match="source is 7"):
        evaluate.reconstruct(7, path)  # type: ignore[arg-type]
    with pytest.raises(FileNotFoundError):
        evaluate.reconstruct(recording, tmp_path / "none.onnx")
    evis.save(tmp_path / "bare.npz", edge())
    with pytest.raises(evis.ConfigError, match="has no frame or hdr images; record it with"):
        evaluate.reconstruct(tmp_path / "bare.npz", path)


def test_without_onnxruntime_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, recording: Path, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(evis.ConfigError, match=r"pip install 'evis\[evaluate\]'"):
        evaluate.reconstruct(recording, "any.onnx")
    # Of a scene, before it is simulated.
    monkeypatch.setattr(evaluate, "record", lambda *_, **__: pytest.fail("simulated in vain"))
    with pytest.raises(evis.ConfigError, match=r"pip install 'evis\[evaluate\]'"):
        evaluate.ladder("reconstruct", evis.Scene.builtin("spinner"), "any.onnx")
    assert _commands.run_evaluate(["reconstruct", "spinner", "--network", "any.onnx"]) == 2
    assert "pip install 'evis[evaluate]'" in capsys.readouterr().err


# The three questions.


def test_an_integrator_reconstructs_and_controls_fail(network: Callable[[str], Path], recording: Path):
    found = evaluate.reconstruct(
        recording, network("integrator"), normalize=False, skip=5, lpips=network("difference")
    )
    assert found.controls_fail is True, str(found)
    for setting in ("20 ms", "40 ms"):
        own = found.row("events", setting)
        assert own.scores["ncc"] > 0.3
        assert found.row("flipped polarity", setting).scores["ncc"] < -0.3
        # The stand-in of LPIPS sees pictures from -1 to 1.
        assert 0 < own.scores["lpips"] < 1
    stored = json.loads(found.to_json())
    assert (stored["task"], stored["controls_fail"]) == ("reconstruct", True)
    assert len(stored["rows"]) == 10
    assert stored["rows"][1]["fails"] is True
    assert "flipped polarity" in str(found)
    with pytest.raises(evis.ConfigError, match="no row of 'nothing'"):
        found.row("nothing")


def test_a_blind_network_is_found(network: Callable[[str], Path], recording: Path):
    """Canary of the controls: a network that does not see events does as well with any."""
    found = evaluate.reconstruct(recording, network("blind"), windows_us=[20_000], skip=5)
    assert found.controls_fail is False
    assert "DOES NOT FAIL" in str(found)
    alone = evaluate.reconstruct(recording, network("blind"), windows_us=[20_000], skip=5, controls=())
    assert alone.controls_fail is None
    assert len(alone.rows) == 1


def test_exact_flow_sharpens_and_controls_fail(network: Callable[[str], Path], recording: Path):
    found = evaluate.flow(recording, network("still"), windows_us=[40_000, 100_000], skip=1)
    slow, own = found.row("events", "40 ms"), found.row("events", "100 ms")
    assert own.scores["fwl"] > slow.scores["fwl"] > 1
    assert own.scores["fwl"] > 1.1
    assert found.row("mirrored x", "100 ms").scores["fwl"] < own.scores["fwl"] - 0.1
    assert slow.scores["increments"] > 0.3
    assert found.row("flipped polarity", "40 ms").scores["increments"] < -0.3
    assert all(row.fails for row in found.rows if row.setting == "40 ms" and row.stream in evaluate.CONTROLS)
    # A network without motion: nothing sharpens, nothing is gained, and no control fails.
    still = found.row("events", "network")
    assert still.scores["fwl"] == 1
    assert still.scores["gain"] == 0
    assert still.scores["epe"] == still.scores["epe_zero"] > 0.1
    assert found.row("flipped polarity", "network").fails is False
    assert "increments" in str(found)
    with pytest.raises(evis.ConfigError, match="3: record longer"):
        evaluate.flow(recording, windows_us=[200_000])


def test_matches_are_held_against_depth(network: Callable[[str], Path], recording: Path):
    """Of a network that says everything stays where it is, disparity tells how much is right."""
    pytest.importorskip("cv2")
    found = evaluate.match(recording, network("pair"), apart_us=100_000, pairs=2, skip=2)
    view = evis.load(recording)["camera"]
    chosen = np.unique(np.linspace(3, len(view.labels["depth"]) - 1, 2).round().astype(int))
    lens = [camera.fx for camera in evis.load(recording).cameras]
    assert lens[0] == pytest.approx(lens[1])
    for limit in (1, 3, 5):
        shares = []
        for k in chosen:
            disparity = np.pad(lens[0] * 0.1 / np.minimum(view.labels["depth"][k], 1e6), 1, mode="edge")
            near = np.lib.stride_tricks.sliding_window_view(disparity, (3, 3)).min(axis=(2, 3))
            shares.append((near < limit)[~evaluate._moving(view, k)].mean())
        assert found.row("events", "stereo").scores[f"precision_{limit}px"] == pytest.approx(
            np.mean(shares), abs=0.01
        )
    assert found.row("events", "stereo").scores["precision_1px"] < 1
    assert found.controls_fail is False, "canary: this network does not look at pictures"
    assert {row.setting for row in found.rows} == {"100 ms apart", "stereo"}


def test_key_points_are_matched_where_they_are(network: Callable[[str], Path]):
    pytest.importorskip("cv2")
    picture = np.random.default_rng(2).random((64, 96), np.float32)
    model = _networks.MatchNetwork(network("cells"), 64, 96)
    one, other = model.match(model.prepare(picture), model.prepare(np.roll(picture, (8, 16), axis=(0, 1))))
    assert len(one) > 20
    inside = ((one > 16) & (one < [76, 48])).all(axis=1)
    right = np.abs(other - one - [16, 8]).max(axis=1) < 1e-6
    assert inside.sum() > 10
    assert right[inside].mean() > 0.9
    # Canary: another picture has no such matches.
    noise = np.random.default_rng(3).random((64, 96), np.float32)
    one, other = model.match(model.prepare(picture), model.prepare(noise))
    assert (np.abs(other - one - [16, 8]).max(axis=1) < 3).mean() < 0.1


# The command.


def test_the_command_prints_tables_and_json(
    network: Callable[[str], Path], recording: Path, capsys: pytest.CaptureFixture[str]
):
    common = [str(recording), "--network", str(network("integrator")), "--no-normalize", "--skip", "5"]
    assert _commands.run_evaluate(["reconstruct", *common, "--windows-ms", "20"]) == 0
    assert "flipped polarity" in capsys.readouterr().out
    assert _commands.run_evaluate(["reconstruct", *common, "--windows-ms", "20,40", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {row["setting"] for row in found["rows"]} == {"20 ms", "40 ms"}
    assert found["settings"]["normalize"] is False
    blind = ["reconstruct", str(recording), "--network", str(network("blind")), "--skip", "5"]
    assert _commands.run_evaluate(blind) == 1
    assert "these controls do not fail: delayed by 40 ms" in capsys.readouterr().err
    assert _commands.run_evaluate([*blind, "--no-controls"]) == 0
    assert _commands.run_evaluate([*blind, "--windows-ms", "30"]) == 2
    assert "error: a window is 30000 us" in capsys.readouterr().err
    assert _commands.run_evaluate(["flow", "/no/such/file.h5"]) == 2
    for wrong in (["reconstruct", str(recording)], [*blind, "--windows-ms", "x"], ["guess"]):
        with pytest.raises(SystemExit, match="2"):
            _commands.run_evaluate(wrong)


RUNGS = {"draft": {"quality": "draft"}, "60 Hz": {"method": "native", "rate_hz": 60.0}}


def test_a_ladder_evaluates_one_scene_by_several_settings(
    network: Callable[[str], Path], device: evis.Device, tmp_path: Path
):
    options = {
        "duration_s": 0.5,
        "size": SIDE[::-1],
        "normalize": False,
        "skip": 2,
        "windows_us": [20_000, 40_000],
    }
    scene = evis.Scene.builtin("spinner")
    found = evaluate.ladder("reconstruct", scene, network("integrator"), rungs=RUNGS, **options)
    assert list(found.evaluations) == list(found.events) == list(RUNGS)
    assert found.controls_fail is True
    draft, slow = found.evaluations.values()
    assert draft.row().scores["ncc"] > slow.row().scores["ncc"], "a low rate costs what the ladder shows"
    # The same as recording and evaluating by hand.
    path = tmp_path / "spinner.h5"
    recording = evaluate.record(scene, path, "reconstruct", duration_s=0.5, size=SIDE[::-1])
    assert len(recording.events) == found.events["draft"]
    alone = evaluate.reconstruct(
        path, network("integrator"), normalize=False, skip=2, windows_us=[20_000, 40_000]
    )
    assert alone == draft
    lines = str(found).splitlines()
    assert [line.split("  ")[0] for line in lines[2:]] == ["20 ms", "20 ms", "40 ms", "40 ms"]
    assert all("4 of 4 fail" in line for line in lines[2:])
    held = json.loads(found.to_json())
    assert [each["name"] for each in held["ladder"]] == list(RUNGS)
    with pytest.raises(evis.ConfigError, match="task is 'guess'"):
        evaluate.ladder("guess", scene)  # type: ignore[arg-type]
    with pytest.raises(evis.ConfigError, match="rungs is empty"):
        evaluate.ladder("flow", scene, rungs={})

    pytest.importorskip("matplotlib")
    axes = found.figure().axes
    assert axes[0].get_ylim()[0] > axes[0].get_ylim()[1], "the first settings are at the top"
    assert [each.get_xlabel() for each in axes] == ["ssim", "ncc"]
    bars = [bar.get_width() for bar in axes[1].patches]
    assert bars == [
        each.row(setting=setting).scores["ncc"] for setting in ("20 ms", "40 ms") for each in (draft, slow)
    ]


def test_the_ladder_has_the_settings_of_the_paper(device: evis.Device):
    assert [name for name in evaluate.LADDER if name.startswith("paper")] == [
        "paper 1000 Hz", "paper 250 x 4", "paper 125 x 8", "paper 40 x 8", "paper 30 x 8"
    ]  # fmt: skip
    methods = {
        name: evis.Simulator(evis.Scene.builtin("spinner"), size=(32, 24), **settings).method
        for name, settings in evaluate.LADDER.items()
    }
    assert methods["native 1000 Hz"] == methods["paper 1000 Hz"] == "native"
    assert methods["paper 30 x 8"] == "evis-paper"


def test_the_command_takes_scenes(
    network: Callable[[str], Path],
    recording: Path,
    device: evis.Device,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    options = ["--size", "96x72", "--duration", "0.2", "--windows-ms", "40"]
    assert _commands.run_evaluate(["flow", "spinner", *options]) == 0
    assert capsys.readouterr().out.startswith("flow of spinner.h5")
    monkeypatch.setattr(evaluate, "LADDER", RUNGS)
    monkeypatch.setitem(evaluate.ladder.__kwdefaults__, "rungs", RUNGS)
    assert _commands.run_evaluate(["flow", "spinner", *options, "--ladder", "--json"]) == 0
    assert [each["name"] for each in json.loads(capsys.readouterr().out)["ladder"]] == list(RUNGS)
    for wrong, told in (
        (["flow", str(recording), "--size", "96x72"], "are for scenes"),
        (["flow", str(recording), "--ladder"], "is no scene"),
        (["flow", "spinner", "--figure", "a.png"], "add --ladder"),
        (["flow", "spinner", "--ladder", "--figure", "a.xyz"], "it must end with"),
        (["flow", "spinner", "--ladder", "--quality", "draft"], "leave --quality out"),
        (["flow", "spiner"], "one of the scenes warehouse, spinner"),
    ):
        assert _commands.run_evaluate(wrong) == 2
        assert told in capsys.readouterr().err


def test_help_tells_of_the_command():
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-m", "evis", *arguments], capture_output=True, text=True)

    assert "evaluate" in run("--help").stdout
    assert "reconstruct" in run("evaluate", "--help").stdout
    assert "--reconstructor" in run("evaluate", "match", "--help").stdout
    assert run("evaluate").returncode == 2


# onnxruntime itself.


def test_onnx_files_give_what_their_functions_give(recording: Path, tmp_path: Path):
    pytest.importorskip("onnxruntime")
    onnx = pytest.importorskip("onnx")
    make, kind = onnx.helper, onnx.TensorProto.FLOAT
    size = ["batch", 1, "H", "W"]
    values = {
        name: make.make_tensor(name, kind, [], [value])
        for name, value in {"keep": 0.9, "grey": 0.5, "gain": 0.1}.items()
    }
    graph = make.make_graph(
        [
            make.make_node("ReduceSum", ["voxel", "axis"], ["sum"], keepdims=1),
            make.make_node("Mul", ["state", "keep"], ["kept"]),
            make.make_node("Add", ["kept", "sum"], ["next"]),
            make.make_node("Mul", ["next", "gain"], ["scaled"]),
            make.make_node("Add", ["scaled", "grey"], ["image"]),
        ],
        "integrator",
        [
            make.make_tensor_value_info("voxel", kind, ["batch", BINS, "H", "W"]),
            make.make_tensor_value_info("state", kind, size),
        ],
        [make.make_tensor_value_info(name, kind, size) for name in ("image", "next")],
        [*values.values(), make.make_tensor("axis", onnx.TensorProto.INT64, [1], [1])],
    )
    path = tmp_path / "integrator.onnx"
    onnx.save(make.make_model(graph, opset_imports=[make.make_opsetid("", 17)], ir_version=8), path)
    model = _networks.VoxelNetwork(path, *SIDE)
    state = np.zeros((1, 1, *SIDE), np.float32)
    events = evis.load(recording)["camera"].events
    for start in (0, 20_000, 40_000):
        grid = events.voxel_grid(BINS, start_us=start, end_us=start + 20_000)
        expected, state = integrate(grid[None], state)
        assert np.abs(model.run(grid)[0] - expected).max() < 1e-5
    assert np.ptp(expected) > 0.1
    with pytest.raises(evis.ConfigError, match="does not run on voxel"):
        model.network.run([state, state])
    (tmp_path / "broken.onnx").write_bytes(path.read_bytes()[:40])
    with pytest.raises(evis.FormatError, match="no network that onnxruntime reads"):
        _networks.Network(tmp_path / "broken.onnx")


@pytest.mark.skipif(not ASSETS.is_dir(), reason="EVIS_ASSETS names no folder with networks")
def test_published_networks_accept_events(recording: Path):
    pytest.importorskip("onnxruntime")
    pytest.importorskip("cv2")
    found = evaluate.reconstruct(recording, ASSETS / "firenet.onnx", windows_us=[20_000], skip=5)
    assert found.row().scores["ncc"] > 0.4
    assert found.controls_fail is True, str(found)
    picture = np.kron(np.random.default_rng(0).random((24, 32), np.float32), np.ones((10, 10), np.float32))
    model = _networks.MatchNetwork(ASSETS / "xfeat.onnx", 240, 320)
    one, other = model.match(model.prepare(picture[:-8, :-12].copy()), model.prepare(picture[8:, 12:].copy()))
    assert len(one) > 50
    assert (np.abs(one - other - [12, 8]).max(axis=1) < 3).mean() > 0.8
