"""Files that EVIS writes, read back by other people's packages, value for value.

h5py is in the usual set; the others come with ``evis[readers]`` and run by ``make test-readers``.
"""

import importlib
import os

import numpy as np
import pytest
from readers import ENDINGS, LATEST_US, READERS

import evis

WIDTH, HEIGHT = 1280, 720
PAIRS = [(format, reader) for format, readers in READERS.items() for reader in readers]


def stream(latest_us: int) -> evis.EventArray:
    """Return rows, scattered events and silences, from 0 to ``latest_us``, sorted by (t, y, x)."""
    rng = np.random.default_rng(7)
    t = np.sort(rng.integers(0, latest_us, 20_000))
    t[-3000:] = np.sort(rng.integers(latest_us - 1000, latest_us, 3000))
    x, y, p = rng.integers(0, WIDTH, t.size), rng.integers(0, HEIGHT, t.size), rng.integers(0, 2, t.size)
    # A row of neighbours of one polarity now and then: EVT 3.0 writes vectors.
    for at in range(500, t.size - 50, 900):
        t[at : at + 40], y[at : at + 40], p[at : at + 40] = t[at], y[at], p[at]
        x[at : at + 40] = min(x[at], WIDTH - 40) + np.arange(40)
    x[:4], y[:4] = (0, WIDTH - 1, 0, WIDTH - 1), (0, 0, HEIGHT - 1, HEIGHT - 1)
    order = np.lexsort((x, y, t))
    return evis.EventArray.from_columns(
        *(column[order] for column in (t, x, y, p)), width=WIDTH, height=HEIGHT
    )


def same(columns, events) -> bool:
    return all(np.array_equal(got, want) for got, want in zip(columns, events.columns, strict=True))


@pytest.mark.parametrize(("format", "reader"), PAIRS)
# Past the wrap of EVT 3.0, and past 2^32 us where the format can.
@pytest.mark.parametrize("latest_us", [60_000_000, 5_000_000_000])
def test_others_read_what_evis_writes(tmp_path, format, reader, latest_us):
    if reader != "h5py" or format != "hdf5":
        if not os.environ.get("EVIS_READERS"):
            pytest.skip("run by make test-readers")
        importlib.import_module(reader)
    if format == "dat" and latest_us > 1 << 32:
        with pytest.raises(evis.FormatError, match="4294967295"):
            evis.save(tmp_path / "late.dat", stream(latest_us))
        return
    if latest_us > LATEST_US.get((format, reader), latest_us):
        pytest.skip(f"a bug of {reader}: see docs/formats.md")
    events = stream(latest_us)
    path = tmp_path / f"events.{ENDINGS[format]}"
    evis.save(path, events, format=format)
    columns = READERS[format][reader](path)
    assert same(columns, events)
    wrong = [column.copy() for column in columns]
    wrong[0][5000] += 1
    assert not same(wrong, events), "canary: a microsecond must be seen"
