"""Readers of other programs, as functions from a file to the columns t, x, y, p.

Each imports its own package; all come from ``pip install evis[readers]``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Columns = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _columns(t: Any, x: Any, y: Any, p: Any) -> Columns:
    t, x, y = (np.asarray(values).astype(np.int64) for values in (t, x, y))
    return t, x, y, (np.asarray(p).astype(np.int64) > 0).astype(np.int64)


def _concatenated(parts: list[Any], names: tuple[str, str, str, str]) -> Columns:
    return _columns(*(np.concatenate([np.asarray(part[name]) for part in parts]) for name in names))


def read_faery(path: Path) -> Columns:
    import faery

    return _concatenated(list(faery.events_stream_from_file(path)), ("t", "x", "y", "on"))


def read_evutils(path: Path) -> Columns:
    from evutils.io import EventReader

    events = EventReader(path, mode="all", max_events=1 << 30).read_all()
    return _columns(events["t"], events["x"], events["y"], events["p"])


def _expelliarmus(encoding: str) -> Callable[[Path], Columns]:
    def read(path: Path) -> Columns:
        import expelliarmus

        events = expelliarmus.Wizard(encoding=encoding).read(path)
        return _columns(events["t"], events["x"], events["y"], events["p"])

    return read


def read_event_stream(path: Path) -> Columns:
    import event_stream

    with event_stream.Decoder(str(path)) as decoder:
        parts, height = list(decoder), decoder.height
    t, x, y, p = _concatenated(parts, ("t", "x", "y", "on"))
    # The package counts rows from the bottom, as the file does.
    return t, x, height - 1 - y, p


def read_aedat(path: Path) -> Columns:
    import aedat

    parts = [packet["events"] for packet in aedat.Decoder(str(path)) if "events" in packet]
    return _concatenated(parts, ("t", "x", "y", "on"))


def read_dv(path: Path) -> Columns:
    import dv_processing as dv

    recording = dv.io.MonoCameraRecording(str(path))
    parts = []
    while (store := recording.getNextEventBatch()) is not None:
        parts.append(store.numpy())
    return _concatenated(parts, ("timestamp", "x", "y", "polarity"))


def read_eventcv(path: Path) -> Columns:
    import eventcv

    stream = eventcv.load(str(path))
    x, y, t, p = np.asarray(stream.numpy()).T
    return _columns(np.round(t * stream.timestamp_scale_ms * 1000), x, y, p)


def read_evlib(path: Path) -> Columns:
    import evlib

    frame = evlib.load_events(str(path), sort=False).collect()
    names = ("t", "x", "y", "polarity")
    t, x, y, p = (frame[name].to_physical().to_numpy() for name in names)
    return _columns(t, x, y, p)


def read_h5py(path: Path) -> Columns:
    import h5py

    with h5py.File(path) as file:
        events = file["events"]
        return _columns(*(events[name][:] for name in "txyp"))


def read_rosbags(path: Path) -> Columns:
    """Decode with a decoder written for this test: each packet alone, from its time base."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    definition = (
        "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\n"
        "string encoding\nbool is_bigendian\nuint8[] events\n"
    )
    store.register(get_types_from_msg(definition, "event_camera_msgs/msg/EventPacket"))
    rows: list[tuple[int, int, int, int]] = []
    with AnyReader([path], default_typestore=store) as bag:
        for connection, _, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            assert message.encoding == "evt3"
            rows.extend(_evt3(message.events.view("<u2"), message.time_base // 1000))
    t, x, y, p = np.array(rows, np.int64).T
    return t, x, y, p


def _evt3(words: np.ndarray, base_us: int) -> list[tuple[int, int, int, int]]:
    rows = []
    high = low = y = base = polarity = wraps = 0
    for word in words.tolist():
        kind, value = word >> 12, word & 0xFFF
        if kind == 8:
            wraps += value < high
            high = value
        elif kind == 6:
            low = value
        elif kind == 0:
            y = value & 0x7FF
        elif kind == 2:
            t = base_us + (wraps << 24) + (high << 12) + low
            rows.append((t, value & 0x7FF, y, value >> 11))
        elif kind == 3:
            base, polarity = value & 0x7FF, value >> 11
        elif kind in (4, 5):
            width = 12 if kind == 4 else 8
            t = base_us + (wraps << 24) + (high << 12) + low
            rows += [(t, base + k, y, polarity) for k in range(width) if value >> k & 1]
            base += width
    return rows


def read_tonic(path: Path) -> Columns:
    """Tonic's loader of NumPy structures: what its transforms take."""
    import tonic.transforms

    events = np.load(path)
    assert tonic.transforms.ToImage(sensor_size=(1280, 720, 2))(events).sum() == len(events)
    return _columns(events["t"], events["x"], events["y"], events["p"])


# Format: the packages that read it right.
READERS: dict[str, dict[str, Callable[[Path], Columns]]] = {
    "evt3": {"faery": read_faery, "evutils": read_evutils, "eventcv": read_eventcv, "evlib": read_evlib},
    "evt2": {
        "faery": read_faery,
        "evutils": read_evutils,
        "expelliarmus": _expelliarmus("evt2"),
        "eventcv": read_eventcv,
        "evlib": read_evlib,
    },
    "dat": {
        "faery": read_faery,
        "evutils": read_evutils,
        "expelliarmus": _expelliarmus("dat"),
        "eventcv": read_eventcv,
    },
    "aedat4": {"faery": read_faery, "aedat": read_aedat, "dv_processing": read_dv, "eventcv": read_eventcv},
    "es": {"faery": read_faery, "event_stream": read_event_stream},
    "hdf5": {"h5py": read_h5py, "evutils": read_evutils, "eventcv": read_eventcv},
    "mcap": {"rosbags": read_rosbags},
    "npy": {"tonic": read_tonic},
}

# Latest time that a package reads right, where that is earlier than what it should.
LATEST_US = {
    # eventcv 1.0.8 guesses the unit of HDF5 times from how large they are.
    ("hdf5", "eventcv"): 1 << 32,
}

ENDINGS = {
    "evt3": "raw",
    "evt2": "raw",
    "dat": "dat",
    "aedat4": "aedat4",
    "es": "es",
    "hdf5": "h5",
    "mcap": "mcap",
    "npy": "npy",
}
