"""Data sets for PyTorch: the same items whatever the workers, exact windows, tensors that share memory."""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_readme import blocks, run_code

import evis
from evis.representations import Dense

torch = pytest.importorskip("torch", reason="PyTorch is not installed: make test-torch")

from torch.utils.data import DataLoader  # noqa: E402

from evis.torch import (  # noqa: E402
    EventDataset,
    SimulatedDataset,
    collate_packed,
    collate_padded,
    event_tensors,
    tensor_of,
)

ROOT = Path(__file__).parent.parent
SIZE = (32, 24)


def random_events(seed: int, count: int = 3000, span_us: int = 50_000) -> evis.EventArray:
    """Sorted events, many at the same microsecond."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, span_us // 50, count) * 50)
    x, y, p = (rng.integers(0, most, count) for most in (*SIZE, 2))
    return evis.EventArray.from_columns(t, x, y, p, width=SIZE[0], height=SIZE[1])


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("recordings")
    return [evis.save(folder / f"{k}.h5", random_events(k, 2000 + 500 * k))[0] for k in range(2)]


def small(seed: int) -> evis.Simulator:
    """What runs simulate; a function of a module, as spawned workers need it."""
    return evis.Simulator(
        evis.Scene.builtin("spinner").at_speed(5.0),
        sensor=evis.Sensor(threshold_on=0.1 + 0.1 * (seed % 7) / 7, threshold_off=0.1),
        size=SIZE,
        rate_hz=500.0,
        samples=1,
        labels=["depth"],
        seed=seed,
    )


def equal(one: Any, other: Any) -> bool:
    """Whether two batches, of tensors, mappings and sequences, are equal."""
    if isinstance(one, torch.Tensor):
        return isinstance(other, torch.Tensor) and one.dtype == other.dtype and torch.equal(one, other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(equal, one, other))
    return bool(np.all(one == other))


def loaded(dataset: Any, workers: int, context: str = "spawn", **options: Any) -> list[Any]:
    context_or_none = context if workers else None
    return list(DataLoader(dataset, num_workers=workers, multiprocessing_context=context_or_none, **options))


def test_windows_by_time_hold_every_event_once(files: list[Path]) -> None:
    dataset = EventDataset(files, time_us=7000)
    assert dataset.sensor_size == (*SIZE, 2)
    assert dataset.ordering == ("x", "y", "t", "p")
    for index, path in enumerate(files):
        recorded = evis.load(path).events
        items = [k for k in range(len(dataset)) if dataset.windows[k, 0] == index]
        joined = np.concatenate([dataset[k][0] for k in items])
        for name in "txyp":
            assert np.array_equal(joined[name], recorded.to_numpy()[name])
        for k in items:
            events, target = dataset[k]
            assert events.dtype == dataset.dtype
            assert (events["t"] >= target["start_us"]).all()
            assert (events["t"] < target["end_us"]).all()
    assert len(EventDataset(files, time_us=7000, drop_last=True)) == len(dataset) - len(files)


def test_windows_by_count_part_events_of_one_microsecond(files: list[Path]) -> None:
    recorded = evis.load(files[0]).events
    dataset = EventDataset(files[0], count=7)
    assert [len(dataset[k][0]) for k in range(len(dataset))] == [len(w) for w in recorded.windows(count=7)]
    joined = np.concatenate([events for events, _ in dataset])
    assert np.array_equal(joined["x"], recorded.x)
    rows = dataset.windows
    assert (rows[1:, 1] < rows[:-1, 2]).any(), "no window shares a microsecond with the one before: no test"
    late = EventDataset(files[0], count=7, start_us=20_010, drop_last=True)
    expected = recorded.slice_time(20_010, 10**9)
    joined = np.concatenate([events for events, _ in late])
    assert np.array_equal(joined["x"], expected.x[: len(joined)])
    assert 0 <= len(expected) - len(joined) < 7


def test_a_recording_is_one_window_where_none_is_asked_for(files: list[Path]) -> None:
    dataset = EventDataset(files, targets=["left", "right"])
    assert [len(events) for events, _ in dataset] == [2000, 2500]
    assert [target for _, target in dataset] == ["left", "right"]
    assert len(dataset[-1][0]) == 2500
    with pytest.raises(IndexError, match="2 items"):
        dataset[2]


@pytest.mark.parametrize("ending", [".raw", ".npz", ".aedat4", ".dat"])
def test_other_formats_give_the_same_items(ending: str, files: list[Path], tmp_path: Path) -> None:
    other = evis.save(tmp_path / f"events{ending}", evis.load(files[0]).events)[0]
    one = EventDataset(files[0], time_us=7000, representation=Dense("voxel_grid", bins=3))
    two = EventDataset(
        other, time_us=7000, representation=Dense("voxel_grid", bins=3), width=SIZE[0], height=SIZE[1]
    )
    same = [torch.equal(one[k][0], two[k][0]) for k in range(len(one))]
    assert len(two) == len(one) > 5
    assert all(same)
    assert not torch.equal(one[0][0], two[1][0]), "canary: another window differs"


def test_dense_windows_count_from_their_own_start(files: list[Path]) -> None:
    recorded = evis.load(files[0]).events
    for made, method in [
        ("counts", recorded.counts),
        (Dense("voxel_grid", bins=4), partial(recorded.voxel_grid, 4)),
        (Dense("time_surface", tau_us=3e3), partial(recorded.time_surface, 3e3)),
    ]:
        dataset = EventDataset(files[0], time_us=10_000, representation=made)
        data, _ = dataset[2]
        assert np.array_equal(data.numpy(), method(start_us=20_000, end_us=30_000))
        assert not np.array_equal(data.numpy(), method(start_us=20_000, end_us=30_050)), "canary"


def test_labels_are_those_at_the_end_of_a_window(device: evis.Device, tmp_path: Path) -> None:
    sim = evis.Simulator(
        evis.Scene.builtin("spinner"), size=SIZE, rate_hz=250.0, samples=1, labels=["hdr"], device=device
    )
    (path,) = evis.save(tmp_path / "a.h5", sim.stream(duration=0.06))
    dataset = EventDataset(path, time_us=20_000, labels=["hdr"], start_us=0, end_us=60_000)
    hdr = evis.load(path).labels["hdr"]
    assert hdr.t_us.tolist()[:3] == [0, 20_000, 40_000]
    assert np.array_equal(dataset[0][1]["hdr"].numpy(), hdr[1])
    assert not np.array_equal(dataset[0][1]["hdr"].numpy(), hdr[0]), "canary"
    with pytest.raises(evis.ConfigError, match="normals"):
        EventDataset(path, time_us=20_000, labels=["normals"])


@pytest.mark.parametrize("collate", [collate_packed, collate_padded])
def test_items_do_not_depend_on_workers(files: list[Path], collate: Any) -> None:
    dataset = EventDataset(files, time_us=7000)
    options = {"batch_size": 3, "collate_fn": collate}
    alone, shared = loaded(dataset, 0, **options), loaded(dataset, 2, **options)
    assert equal(alone, shared)
    assert not equal(alone, shared[::-1]), "canary"
    dataset = EventDataset(files, time_us=7000, representation="counts")
    assert equal(loaded(dataset, 0, batch_size=4), loaded(dataset, 2, batch_size=4))


def test_collation_keeps_every_event(files: list[Path]) -> None:
    dataset = EventDataset(files, time_us=7000)
    batch = [dataset[k] for k in (0, 3, 5)]
    packed, targets = collate_packed(batch)
    padded, _ = collate_padded(batch)
    assert targets["start_us"].tolist() == [0, 21_000, 35_000]
    for b, (events, _) in enumerate(batch):
        part = slice(*packed["offsets"][b : b + 2].tolist())
        assert padded["lengths"][b] == len(events) == padded["mask"][b].sum()
        for name in "txyp":
            assert np.array_equal(packed[name][part].numpy(), events[name])
            assert np.array_equal(padded[name][b][padded["mask"][b]].numpy(), events[name])
            assert not padded[name][b][~padded["mask"][b]].any()
    empty = np.empty(0, dataset.dtype)
    packed, _ = collate_packed([(empty, 0), (empty, 1)])
    assert packed["offsets"].tolist() == [0, 0, 0]
    assert collate_padded([(empty, 0)])[0]["t"].shape == (1, 0)
    with pytest.raises(evis.ConfigError, match="item 0 of the batch is 'Tensor'"):
        collate_packed([(torch.zeros(3), 0)])


def test_simulated_items_do_not_depend_on_workers(device: evis.Device) -> None:
    for batch_size in (1, 2):
        dataset = SimulatedDataset(
            small,
            runs=4,
            duration_us=20_000,
            time_us=10_000,
            representation="counts",
            seed=3,
            batch_size=batch_size,
        )
        alone = loaded(dataset, 0, batch_size=batch_size)
        shared = loaded(dataset, 2, batch_size=batch_size)
        assert equal(alone, shared)
        runs = [run for _, target in alone for run in target["run"].tolist()]
        seeds = {seed for _, target in alone for seed in target["seed"].tolist()}
        assert runs == [0, 1, 2, 3]
        assert len(seeds) == 4
        data, target = alone[0]
        assert tuple(data.shape) == (batch_size, 2, 2, SIZE[1], SIZE[0])
        assert int(data.sum()) > 100
        assert tuple(target["depth"].shape) == (batch_size, 1, SIZE[1], SIZE[0])
        # Another epoch has other seeds, and other events.
        dataset.set_epoch(1)
        other = loaded(dataset, 0, batch_size=batch_size)
        assert not equal(alone, other), "canary"


FORK = """
import sys
import evis
sys.path.insert(0, {tests!r})
from test_torch import SimulatedDataset, loaded, small
dataset = SimulatedDataset(small, runs=2, duration_us=10_000, representation="counts")
forked = loaded(dataset, 1, "fork", batch_size=None)
print(len(forked), int(forked[0][0].sum()) > 0)
evis.devices()
small(0)
try:
    loaded(dataset, 1, "fork", batch_size=None)
except evis.EvisError as error:
    print("spawn" in str(error))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems spawn")
def test_forked_workers_work_until_the_parent_opens_a_device(device: evis.Device, tmp_path: Path) -> None:
    script = FORK.format(tests=str(Path(__file__).parent))
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stdout.split() == ["2", "True", "True"], done.stdout + done.stderr


def test_columns_share_the_memory_of_events() -> None:
    events = random_events(5)
    tensors = events.to_torch()
    assert [tensors[name].dtype for name in "txyp"] == [torch.int64, torch.uint16, torch.uint16, torch.int16]
    for name in "txyp":
        column = events.to_numpy()[name]
        assert np.array_equal(tensors[name].numpy(), column)
        assert tensors[name].data_ptr() == column.__array_interface__["data"][0]
    fixed = events.to_numpy().copy()
    fixed.flags.writeable = False
    assert event_tensors(fixed)["t"].data_ptr() != fixed.__array_interface__["data"][0]
    grid = events.voxel_grid(3)
    assert tensor_of(grid).data_ptr() == grid.__array_interface__["data"][0]
    grid.flags.writeable = False
    assert tensor_of(grid).data_ptr() != grid.__array_interface__["data"][0]


def test_packets_become_tensors(device: evis.Device) -> None:
    packet = small(1).step(20_000)
    tensors = packet.to_torch()
    assert len(tensors["t"]) == len(packet.events) > 50
    assert tensors["x"].data_ptr() == packet.x.__array_interface__["data"][0]


def test_transforms_of_tonic_take_events(files: list[Path]) -> None:
    transforms = pytest.importorskip("tonic.transforms", reason="tonic is not installed")
    plain = EventDataset(files, time_us=20_000)
    made = EventDataset(
        files,
        time_us=20_000,
        transform=transforms.Compose(
            [transforms.RandomFlipLR(plain.sensor_size, p=1.0), transforms.ToImage(plain.sensor_size)]
        ),
    )
    expected = plain.window(1).counts()[:, :, ::-1]
    assert np.array_equal(made[1][0], expected)
    assert not np.array_equal(made[0][0], expected), "canary"
    frames = EventDataset(
        files, transform=transforms.ToFrame(sensor_size=plain.sensor_size, time_window=10_000)
    )
    assert frames[0][0].shape[1:] == (2, SIZE[1], SIZE[0])


def test_transforms_are_applied(files: list[Path]) -> None:
    made = EventDataset(
        files,
        time_us=20_000,
        representation="counts",
        transform=lambda data: data.float(),
        target_transform=lambda target: target["recording"],
    )
    assert made[0][0].dtype == torch.float32
    assert made[len(made) - 1][1] == 1
    both = EventDataset(files, time_us=20_000, transforms=lambda data, target: (len(data), target["end_us"]))
    assert both[0] == (len(made.window(0)), 20_000)


def test_data_sets_pickle_without_open_files(files: list[Path]) -> None:
    dataset = EventDataset(files, count=100, representation=Dense("voxel_grid", bins=2))
    again = pickle.loads(pickle.dumps(dataset))
    assert torch.equal(again[7][0], dataset[7][0])
    of_recordings = EventDataset([evis.load(path) for path in files], count=100)
    assert len(pickle.loads(pickle.dumps(of_recordings))) == len(dataset)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"time_us": 100, "count": 3}, "time_us and count"),
        ({"time_us": 0}, "above 0"),
        ({"time_us": 100, "representation": "voxels"}, "'voxels'"),
        ({"time_us": 100, "representation": 3}, "representation is 3"),
        ({"time_us": 100, "targets": [1, 2]}, "one per recording: 1"),
        ({"time_us": 100, "targets": [1], "labels": ["depth"]}, "one of the two"),
        ({"time_us": 100, "labels": ["depth"]}, "no label in it"),
        ({"time_us": 100, "transform": len, "transforms": max}, "in place of"),
    ],
)
def test_what_cannot_be_used_is_refused(settings: dict[str, Any], message: str, files: list[Path]) -> None:
    with pytest.raises(evis.ConfigError, match=re.escape(message)):
        EventDataset(files[0], **settings)


def test_sources_that_cannot_be_used_are_refused(files: list[Path], tmp_path: Path) -> None:
    with pytest.raises(evis.ConfigError, match="empty"):
        EventDataset([])
    with pytest.raises(OSError, match="nothing"):
        EventDataset(tmp_path / "nothing.h5")
    wide = evis.EventArray(np.zeros(3, evis.EventCD), width=40, height=24)
    (path,) = evis.save(tmp_path / "wide.h5", wide)
    with pytest.raises(evis.ConfigError, match=r"32x24.*40x24"):
        EventDataset([files[0], path])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"make": 3}, "make is 3"),
        ({"runs": 0}, "runs is 0"),
        ({"time_us": 100}, "without a representation"),
        ({"time_us": 3000, "representation": "counts"}, "without a rest"),
        ({"seed": -1}, "seed is -1"),
        ({"make": str}, "make returned"),
    ],
)
def test_simulations_that_cannot_be_used_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(evis.ConfigError, match=message):
        next(iter(SimulatedDataset(**{"make": small, "runs": 1, "duration_us": 10_000, **settings})))


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("voxel_grid", {"bin": 3}, "bin"),
        ("voxel_grid", {"bins": 0}, "bins is 0"),
        ("time_surface", {}, "tau_us"),
        ("counts", {"start_us": 3}, "the window says it"),
    ],
)
def test_representations_are_checked_when_they_are_named(
    name: str, parameters: dict[str, Any], message: str
) -> None:
    with pytest.raises(evis.ConfigError, match=message):
        Dense(name, **parameters)


def test_code_of_the_document_runs(device: evis.Device, tmp_path: Path) -> None:
    codes = blocks(ROOT / "docs/torch.md", "python")
    assert len(codes) >= 3
    for code in codes:
        done = run_code(code, tmp_path)
        assert done.returncode == 0, done.stderr
        assert len(done.stdout.splitlines()) >= 2
