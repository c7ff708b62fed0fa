"""Events cross into NumPy without a copy, in the layout that other libraries read."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import evis
from evis import _evis

METAVISION = np.dtype(
    {
        "names": ["x", "y", "p", "t"],
        "formats": ["<u2", "<u2", "<i2", "<i8"],
        "offsets": [0, 2, 4, 8],
        "itemsize": 16,
    }
)


def some_events(count: int = 100) -> evis.events.Events:
    events = np.zeros(count, evis.EventCD)
    events["t"] = np.arange(count) * 10
    events["x"] = np.arange(count) % 7
    events["y"] = np.arange(count) % 5
    events["p"] = np.arange(count) % 2
    return events


def base_address(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])


def test_dtype_is_metavisions():
    assert evis.EventCD == METAVISION
    assert evis.EventCD.itemsize == 16
    packed = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
    assert evis.EventCD != packed, "canary: the packed layout is another dtype"


def test_a_rust_vector_becomes_the_array():
    events, address = _evis._probe("events")
    assert events.dtype == METAVISION
    assert base_address(events) == address
    assert not events.flags.owndata
    assert events.base is not None
    assert base_address(events.copy()) != address, "canary: a copy lies elsewhere"
    assert events["t"].tolist() == list(range(0, 10_000, 10))
    assert events["x"][7] == 7
    assert events["y"][7] == 3
    assert set(events["p"].tolist()) == {1}


def test_the_array_outlives_what_made_it():
    column = _evis._probe("events")[0]["t"]
    assert column[999] == 9990


def test_columns_are_strided_views():
    events, address = _evis._probe("events")
    array = evis.EventArray(events, width=1000, height=500)
    for column, dtype, offset in zip(array.columns, ("<i8", "<u2", "<u2", "<i2"), (8, 0, 2, 4), strict=True):
        assert column.dtype == np.dtype(dtype)
        assert column.strides == (16,)
        assert base_address(column) == address + offset


def test_columns_go_through_dlpack_without_a_copy():
    events, address = _evis._probe("events")
    array = evis.EventArray(events, width=1000, height=500)
    for column, offset in zip(array.columns, (8, 0, 2, 4), strict=True):
        taken = np.from_dlpack(column)
        assert base_address(taken) == address + offset
        assert np.array_equal(taken, column)


def test_event_array_takes_event_cd_as_it_is():
    events = some_events()
    array = evis.EventArray(events, width=7, height=5)
    assert array.to_numpy() is events or np.shares_memory(array.to_numpy(), events)
    assert np.shares_memory(np.asarray(array), events)
    assert len(array) == 100
    assert (array.width, array.height) == (7, 5)


def test_other_layouts_are_converted():
    packed = np.zeros(3, [("t", "<u8"), ("x", "<i4"), ("y", "<i4"), ("p", "?")])
    packed["t"] = [1, 2, 3]
    packed["p"] = [True, False, True]
    array = evis.EventArray(packed, width=4, height=4)
    assert array.p.tolist() == [1, 0, 1]
    assert array.to_numpy().dtype == METAVISION
    packed["x"] = 70_000
    with pytest.raises(evis.ConfigError, match="x holds a value"):
        evis.EventArray(packed, width=4, height=4)


def test_unusable_arrays_are_refused():
    with pytest.raises(evis.ConfigError, match="fields x, y, p, t"):
        evis.EventArray(np.zeros((4,)), width=4, height=4)
    with pytest.raises(evis.ConfigError, match="1-D"):
        evis.EventArray(np.zeros((4, 4)), width=4, height=4)
    with pytest.raises(evis.ConfigError, match="sorted"):
        evis.EventArray(some_events()[::-1], width=7, height=5)
    with pytest.raises(evis.ConfigError, match="width is 0"):
        evis.EventArray(some_events(), width=0, height=5)
    with pytest.raises(evis.ConfigError, match="t has dtype float64"):
        evis.EventArray.from_columns([0.5], [0], [0], [1], width=4, height=4)


def test_slices_by_time_are_half_open_views():
    array = evis.EventArray(some_events(), width=7, height=5)
    part = array.slice_time(30, 60)
    assert part.t.tolist() == [30, 40, 50]
    assert np.shares_memory(part.to_numpy(), array.to_numpy())
    assert len(array.slice_time(60, 30)) == 0
    assert len(array.slice_time(-100, 10_000)) == 100


def test_windows_tile_time_and_include_empty_ones():
    events = some_events(3)
    events["t"] = [5, 6, 35]
    array = evis.EventArray(events, width=7, height=5)
    assert [part.t.tolist() for part in array.windows(10)] == [[5, 6], [], [], [35]]
    assert [len(part) for part in array.windows(10, start_us=6, end_us=30)] == [1, 0, 0]
    assert [len(part) for part in array.windows(10, end_us=50)] == [2, 0, 0, 1, 0]
    with pytest.raises(evis.ConfigError, match="time_us is 0; it must be above 0"):
        array.windows(0)


def test_equality_sees_a_difference():
    array = evis.EventArray(some_events(), width=7, height=5)
    other = evis.EventArray(some_events(), width=7, height=5)
    assert array == other
    other.p[3] ^= 1
    assert array != other, "canary"
    assert array != evis.EventArray(some_events(), width=8, height=5)
    assert pickle.loads(pickle.dumps(array)) == array


def test_a_key_gives_a_column_an_event_or_some_events():
    raw = some_events()
    events = evis.EventArray(raw, width=7, height=5)
    assert events.sensor_size == (7, 5)
    assert events.shape == (100,)
    assert events.dtype == evis.EventCD
    for name in "txyp":
        assert np.array_equal(events[name], raw[name])
        assert np.shares_memory(events[name], raw)
    assert events[3] == raw[3]
    assert events[np.int64(-1)]["t"] == 990
    part = events[10:20]
    assert isinstance(part, evis.EventArray)
    assert part == evis.EventArray(raw[10:20], width=7, height=5)
    assert np.shares_memory(part.to_numpy(), raw)
    on = events[events.p == 1]
    assert on.t.tolist() == raw["t"][raw["p"] == 1].tolist()
    assert on.sensor_size == (7, 5)
    assert on != events, "canary"
    assert events[[2, 5]].t.tolist() == [20, 50]
    assert len(events[[]]) == 0
    assert [int(event["t"]) for event in events] == raw["t"].tolist()
    assert np.array_equal(np.concatenate([events[:50], events[50:]]), raw)
    assert events.tobytes() == raw.tobytes()
    assert np.array_equal(np.asarray(events), raw)


def test_keys_that_cannot_be_used_say_what_would_work():
    events = evis.EventArray(some_events(), width=7, height=5)
    with pytest.raises(evis.ConfigError, match="no column 'q'; there is t, x, y, p"):
        events["q"]  # type: ignore[call-overload]
    with pytest.raises(
        evis.ConfigError, match=r"mask has shape \(3,\); it must have that of the events, \(100,\)"
    ):
        events[np.ones(3, bool)]
    for unsorted in (slice(None, None, -1), np.array([5, 2])):
        with pytest.raises(evis.ConfigError, match=r"out of order.*to_numpy\(\)"):
            events[unsorted]
    with pytest.raises(evis.ConfigError, match="dtype float64"):
        events[np.array([0.5])]
    with pytest.raises(IndexError):
        events[100]
