"""Shards of a data set on several processes: of this machine, or of a Ray cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import sys
import time
from collections.abc import Generator, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import TracebackType
from typing import Any

from . import _dataset_shard
from ._dataset_spec import ShardPlan
from ._evis import ConfigError, EvisError
from ._progress import Progress

#: How often a shard whose worker was lost is begun again.
RETRIES = 3

#: Of a cluster that is started here, where the user sets nothing else. Ray would report its use to its
#: makers, and its workers would be nice by 15: beside other work on the machine they get little of it.
_RAY_SETTINGS = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"}

#: Seconds between two progress lines where standard error is no terminal.
_LINE_S = 10.0


class Meter:
    """Progress and throughput, in recordings: a bar on a terminal, a line every ten seconds elsewhere."""

    def __init__(self, total: int, *, shown: bool) -> None:
        self._total, self._shown = total, shown
        self._bar = Progress(total, "recordings", shown=shown)
        self._begin = self._said = time.monotonic()
        self._done = self._events = 0

    def recorded(self, events: int) -> None:
        """Count a recording."""
        self._done += 1
        self._events += events
        now = time.monotonic()
        self._bar.advance(1, self.rates(now - self._begin))
        if self._shown and not sys.stderr.isatty() and now - self._said > _LINE_S:
            self._said = now
            self.say(self.line(now - self._begin))

    def line(self, elapsed_s: float) -> str:
        """Return what is said after so many seconds."""
        per_s = self._done / max(elapsed_s, 1e-9)
        left = round(max(self._total - self._done, 0) / max(per_s, 1e-9))
        return (
            f"{self._done} of {self._total} recordings, {self.rates(elapsed_s)}, "
            f"{left // 60}:{left % 60:02d} left"
        )

    def rates(self, elapsed_s: float) -> str:
        """Return the throughput after so many seconds."""
        seconds = max(elapsed_s, 1e-9)
        return f"{60 * self._done / seconds:.1f} a minute, {self._events / seconds:.0f} events/s"

    def say(self, text: str) -> None:
        """Print a line."""
        if self._shown:
            print(text, file=sys.stderr, flush=True)

    def __enter__(self) -> Meter:
        """Return the meter."""
        self._bar.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        self._bar.__exit__(kind, value, trace)


def here(
    shards: Sequence[ShardPlan], folder: Path, base: Path, meter: Meter
) -> Generator[dict[str, Any], None, None]:
    """Simulate shards in this process, one after the other."""
    for shard in shards:
        yield _dataset_shard.write(shard, folder, base, meter.recorded)


# Processes of this machine.


def _work(connection: Connection, folder: Path, base: Path) -> None:
    """Simulate the shards that come, until none does."""
    # The parent answers to Ctrl-C, and ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _dataset_shard.single_threaded()
    while True:
        try:
            shard = connection.recv()
        except EOFError:
            return
        if shard is None:
            return
        try:
            found = _dataset_shard.write(shard, folder, base, lambda n: connection.send(("recorded", n)))
            connection.send(("done", found))
        except (EvisError, OSError, ValueError) as error:
            connection.send(("failed", error))


class _Worker:
    def __init__(self, folder: Path, base: Path) -> None:
        spawn = multiprocessing.get_context("spawn")
        self.connection, theirs = spawn.Pipe()
        self.process = spawn.Process(target=_work, args=(theirs, folder, base), daemon=True)
        self.process.start()
        theirs.close()
        self.shard: ShardPlan | None = None

    def begin(self, shard: ShardPlan) -> None:
        self.shard = shard
        self.connection.send(shard)

    def end(self) -> None:
        if self.process.is_alive():
            self.process.terminate()
        self.process.join()
        self.connection.close()


def local(
    shards: Sequence[ShardPlan], folder: Path, base: Path, workers: int, meter: Meter
) -> Generator[dict[str, Any], None, None]:
    """Simulate shards in spawned processes of one thread each; one that is lost is replaced.

    Yields descriptions of shards in the order in which they are finished.
    """
    left, tries = list(reversed(shards)), dict.fromkeys((shard.name for shard in shards), 0)
    pool: list[_Worker] = []
    try:
        for _ in range(min(workers, len(shards))):
            pool.append(_Worker(folder, base))
            pool[-1].begin(left.pop())
        while any(worker.shard is not None for worker in pool):
            by_connection = {worker.connection: worker for worker in pool if worker.shard is not None}
            for ready in wait(list(by_connection)):
                worker = by_connection[ready]  # type: ignore[index]
                assert worker.shard is not None
                try:
                    kind, value = worker.connection.recv()
                except (EOFError, OSError):
                    pool.remove(worker)
                    pool.append(_replaced(worker, folder, base, tries, meter))
                    continue
                if kind == "recorded":
                    meter.recorded(value)
                elif kind == "failed":
                    raise value
                else:
                    worker.shard = None
                    if left:
                        worker.begin(left.pop())
                    yield value
    finally:
        for worker in pool:
            worker.end()


def _replaced(worker: _Worker, folder: Path, base: Path, tries: dict[str, int], meter: Meter) -> _Worker:
    """Begin the shard of a worker that was lost again, in a new one."""
    shard = worker.shard
    assert shard is not None
    worker.process.join()
    code = worker.process.exitcode
    worker.end()
    tries[shard.name] += 1
    if tries[shard.name] > RETRIES:
        raise EvisError(
            f"shard {shard.name} lost its worker {tries[shard.name]} times, at last with exit code {code} "
            "(-9: killed, often for want of memory); give fewer workers or fewer recordings_per_shard"
        )
    meter.say(f"a worker was lost in shard {shard.name} (exit code {code}); it is begun again")
    new = _Worker(folder, base)
    new.begin(shard)
    return new


# A Ray cluster.


def _ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise ConfigError(
            "a Ray cluster needs the package ray; install it: pip install 'evis[ray]'"
        ) from error
    return ray


def _check_address(address: str) -> None:
    """Refuse an address at which nothing listens; Ray itself would wait for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=10).close()
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"there is no Ray cluster at {address} ({error}); start one (`ray start --head`), and give "
            "the address that it prints"
        ) from None


def _remote_shard(shard: ShardPlan, folder: str, base: str) -> dict[str, Any]:
    """Simulate a shard in a worker of a Ray cluster."""
    _dataset_shard.single_threaded()
    return _dataset_shard.write(shard, Path(folder), Path(base))


def on_ray(
    shards: Sequence[ShardPlan],
    folder: Path,
    base: Path,
    address: str | None,
    workers: int | None,
    meter: Meter,
) -> Generator[dict[str, Any], None, None]:
    """Simulate shards on a Ray cluster; Ray begins those again whose worker was lost.

    Parameters
    ----------
    shards : sequence of ShardPlan
        What to simulate.
    folder, base : Path
        Must be reachable under these paths from all machines of the cluster.
    address : str, optional
        Of the cluster, such as ``auto`` or ``ray://HOST:10001``; one on this machine where not given.
    workers : int, optional
        Shards that are in work at the same time, at most; CPUs of a cluster that is started here.
    meter : Meter
        What counts the recordings of finished shards.
    """
    ray = _ray()
    begun = not ray.is_initialized()
    if begun:
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": "warning"}
        if address is None:
            # Only plans and descriptions pass through the store, whose usual size is a third of the memory.
            options |= {"num_cpus": workers, "include_dashboard": False, "object_store_memory": 100 * 2**20}
            for name, value in _RAY_SETTINGS.items():
                os.environ.setdefault(name, value)
        else:
            _check_address(address)
        try:
            ray.init(address=address, **options)
        except ConnectionError as error:
            raise ConfigError(
                f"there is no Ray cluster at {address} ({error}); start one: `ray start --head`"
            ) from None
    try:
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(_remote_shard)
        cpus = max(int(ray.cluster_resources().get("CPU", 1)), 1)
        # Twice as many as run keep every CPU busy, and an error still ends the run soon.
        most = workers if workers and address else 2 * cpus
        left = list(reversed(shards))
        in_work: dict[Any, ShardPlan] = {}
        while left or in_work:
            while left and len(in_work) < most:
                shard = left.pop()
                in_work[task.remote(shard, str(folder), str(base))] = shard
            done, _ = ray.wait(list(in_work), num_returns=1)
            shard = in_work.pop(done[0])
            try:
                found = ray.get(done[0])
            except ray.exceptions.RayTaskError as error:
                if isinstance(error.cause, (EvisError, OSError)):
                    raise error.cause from None
                raise
            except ray.exceptions.RayError as error:
                raise EvisError(
                    f"shard {shard.name} lost its worker more than {RETRIES} times ({type(error).__name__}); "
                    "look for killed workers, and give fewer recordings_per_shard or workers more memory"
                ) from error
            for recording in found["recordings"]:
                meter.recorded(recording["events"])
            yield found
    finally:
        if begun:
            ray.shutdown()


def workers_of(given: int | None) -> int:
    """Return the number of workers: one for each CPU that this process may use where none is given."""
    if given is not None:
        return given
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
