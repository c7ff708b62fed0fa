"""Throughput of ``evis dataset``: a Ray cluster on this machine beside local processes.

Both simulate the same data set with as many workers, in turns, each with its least time: the whole call,
with the start and the end of workers and cluster. Ray comes with ``evis[ray]``; without it, nothing is
measured.

Usage: benches/dataset.py [RECORDINGS [WORKERS [ROUNDS]]]
"""

from __future__ import annotations

import importlib.util
import json
import sys
import tempfile
import time
from pathlib import Path

from evis import dataset

SPEC = """
name = "bench"
duration_s = 0.2
seeds = {seeds}
recordings_per_shard = 2
[simulator]
size = [128, 96]
quality = "draft"
[[scenes]]
recipe = "objects2d"
variants = 8
settings = {{ size = [128, 96] }}
"""


def measured(spec: Path, folder: Path, workers: int, ray: bool) -> tuple[float, float, float]:
    """Return seconds of the whole call, until the last shard, and of processors within shards."""
    begun, at = time.monotonic(), time.time()
    dataset.make(spec, folder, workers=workers, ray=ray)
    whole = time.monotonic() - begun
    shards = list((folder / "shards").glob("*.json"))
    last = max(shard.stat().st_mtime for shard in shards) - at
    work = sum(json.loads(shard.read_text("utf-8"))["seconds"]["cpu"] for shard in shards)
    return whole, last, work


def main() -> None:
    """Print Markdown."""
    given = [int(text) for text in sys.argv[1:]]
    recordings, workers, rounds = given + [64, 2, 2][len(given) :]
    if not importlib.util.find_spec("ray"):
        print("Ray is not installed: pip install 'evis[ray]'", file=sys.stderr)
        return
    found: dict[bool, list[tuple[float, float, float]]] = {False: [], True: []}
    with tempfile.TemporaryDirectory() as folder:
        spec = Path(folder) / "spec.toml"
        spec.write_text(SPEC.format(seeds=max(recordings // 8, 1)), "utf-8")
        count = len(dataset.read_spec(spec).recordings())
        for round in range(rounds):
            for ray in found:
                found[ray].append(measured(spec, Path(folder) / f"{ray}{round}", workers, ray))
    print(f"{count} recordings, {workers} workers, least of {rounds}\n")
    print("| | whole call | until the last shard | processors, in shards | recordings a minute |")
    print("|---|---|---|---|---|")
    for ray, runs in found.items():
        whole, last, work = (min(column) for column in zip(*runs, strict=True))
        name = "Ray" if ray else "local processes"
        print(f"| {name} | {whole:.1f} s | {last:.1f} s | {work:.1f} s | {60 * count / whole:.1f} |")
    local, cluster = (min(run[0] for run in runs) for runs in found.values())
    print(f"\nThroughput of Ray: {local / cluster:.2f} of local processes")


if __name__ == "__main__":
    main()
