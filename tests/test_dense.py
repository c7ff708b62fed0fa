"""Dense arrays in the place of events: those of the events that the same simulator has without them."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evis
from evis.representations import Dense

KINDS = [
    Dense("event_frame"),
    Dense("counts"),
    Dense("voxel_grid", bins=5, polarity="split"),
    Dense("voxel_grid", bins=4, normalize=True),
    Dense("time_surface", tau_us=3000.0, decay="linear"),
]
METHODS = [{"method": "native", "rate_hz": 700.0, "samples": 2}, {"method": "decoupled"}]


def simulator(device: evis.Device, **more: Any) -> evis.Simulator:
    scene = evis.Scene.builtin("spinner")
    return evis.Simulator(scene, size=(64, 48), reference_luminance=0.5, device=device, **more)


@pytest.mark.parametrize("kind", KINDS, ids=repr)
@pytest.mark.parametrize("method", METHODS, ids=lambda method: method["method"])
def test_arrays_are_those_of_the_windows_events(
    device: evis.Device, kind: Dense, method: dict[str, Any]
) -> None:
    fired = simulator(device, **method).step(20_000)
    sim = simulator(device, dense=kind, dense_window_us=5_000, **method)
    arrays = []
    for packet in sim.stream(duration=0.02, packet_us=10_000):
        made = packet.dense
        assert made is not None
        assert len(made) == 2
        assert made.start_us.tolist() == [packet.start_us, packet.start_us + 5_000]
        assert made.end_us.tolist() == [packet.start_us + 5_000, packet.end_us]
        arrays += list(made)
        stacked = packet.stack_dense()
        assert stacked.shape == (1, *made[-1].shape)
        assert (stacked[0] == made[-1]).all()
    expected = [kind(window) for window in fired.view.windows(edges=range(0, 20_001, 5_000))]
    for own, of in zip(arrays, expected, strict=True):
        assert (own.shape, own.dtype) == (of.shape, of.dtype)
        np.testing.assert_allclose(own, of, atol=2e-5 if kind.name == "voxel_grid" else 0)
        assert np.abs(of).sum() > 1
    assert not np.allclose(expected[0], expected[1]), "canary: windows differ"


def test_packets_have_no_events(device: evis.Device, tmp_path: Path) -> None:
    sim = simulator(device, method="native", dense="counts")
    packet = sim.step(10_000)
    assert packet.report.events == packet.stack_dense().sum() > 0
    for use in (
        lambda: packet.events,
        lambda: packet.view.t,
        lambda: packet.voxel_grid(),
        lambda: packet.packed(),
        lambda: list(packet.view.windows(time_us=1000)),
    ):
        with pytest.raises(evis.EvisError, match=r"view\.dense"):
            use()
    with (
        pytest.raises(evis.EvisError, match=r"view\.dense"),
        evis.Writer(tmp_path / "none.h5", sim) as writer,
    ):
        writer.write(packet)
    with pytest.raises(evis.ConfigError, match="1 windows end"):
        packet.stack_dense(7)
    assert "dense arrays" in repr(packet.view)
    assert simulator(device, method="native").step(10_000).dense is None
    with pytest.raises(evis.ConfigError, match="dense='counts'"):
        simulator(device, method="native").step(10_000).stack_dense()


def test_settings_are_kept_and_checked(device: evis.Device) -> None:
    sim = simulator(device, dense=Dense("voxel_grid", bins=3), dense_window_us=20_000)
    again = pickle.loads(pickle.dumps(sim))
    assert (again.dense, again.dense_window_us) == (Dense("voxel_grid", bins=3), 20_000)
    assert len(sim.step(19_000).dense or ()) == 0
    assert len(sim.step(20_000).dense or ()) == 1
    for wrong, message in [
        ({"dense": "bina_rep"}, "'counts'"),
        ({"dense": 5}, "'counts'"),
        ({"dense": Dense("voxel_grid", bins=500)}, "bins is 500"),
        ({"dense": "counts", "dense_window_us": 10}, "dense_window_us is 10"),
        ({"dense": "counts", "dense_window_us": 2.5}, "dense_window_us"),
        ({"dense": "counts", "labels": ["cause"]}, "cause"),
        ({"dense_window_us": 5_000}, "given with dense"),
    ]:
        with pytest.raises(evis.ConfigError, match=message):
            simulator(device, **wrong)  # type: ignore[arg-type]
