"""Data sets: the same columns whatever the workers, nothing simulated twice, nothing half-written counted."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evis
from evis import dataset
from evis._dataset_spec import deal, lines_of
from evis._dataset_workers import Meter
from evis.recipes import objects2d

SPEC = """
name = "small"
seed = 3
seeds = 2
duration_s = 0.03
recordings_per_shard = 2
licence = "CC-BY-4.0"

[split]
train = 0.5
validation = 0.25
test = 0.25

[simulator]
size = [32, 24]
rate_hz = 500.0
samples = 1
labels = ["depth"]
label_rate_hz = 50.0

[[scenes]]
builtin = "spinner"
split = "train"
licence = "MIT"

[[scenes]]
name = "cards"
recipe = "objects2d"
variants = 3

[scenes.settings]
objects = [2, 3]
size = [32, 24]

[randomise]
speed = [1.0, 3.0]

[randomise.sensor]
threshold_on = [0.1, 0.3]
noise.shot_hz = [0.0, 5.0]
"""


def spec_in(folder: Path, text: str = SPEC) -> Path:
    path = folder / "spec.toml"
    path.write_text(text, "utf-8")
    return path


def hashes(made: dataset.Dataset) -> dict[str, Any]:
    return {info.id: dict(info.sha256) for info in made.info}


def shards(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (folder / "shards").glob("*.h5")}


@pytest.fixture(scope="module")
def made(device: evis.Device, tmp_path_factory: pytest.TempPathFactory) -> dataset.Dataset:
    folder = tmp_path_factory.mktemp("made")
    return dataset.make(spec_in(folder), folder / "out", workers=0)


def test_a_data_set_holds_what_its_specification_says(made: dataset.Dataset) -> None:
    assert len(made) == 8
    assert made.manifest["recordings"] == {"train": 4, "validation": 2, "test": 2}
    assert [info.id for info in made.split("train")[:2].info] == [
        "spinner/0/own/ideal/0",
        "spinner/0/own/ideal/1",
    ]
    assert made.manifest["licence"] == "CC-BY-4.0"
    assert made.manifest["scenes"][0]["licence"] == "MIT"
    assert made.manifest["devices"][0]["name"]
    assert made.manifest["versions"][0]["evis"] == evis.__version__
    assert sum(info.events for info in made.info) == made.manifest["events"] > 0
    for info, recording in zip(made.info, made, strict=True):
        assert len(recording.events) == info.events
        assert info.duration_us == 30_000
        assert len(recording.labels["depth"]) == len(recording.poses) == 2
        assert recording.labels["depth"][0].shape == (24, 32)
        assert 1.0 <= info.drawn["speed"] <= 3.0
        assert 0.1 <= evis.Sensor.from_toml(info.sensor_toml).threshold_on <= 0.3
        assert "threshold_on" in info.settings_toml
    assert not list((made.folder / "shards").glob("*.part"))
    shard = json.loads((made.folder / "shards" / "test-00000.json").read_text("utf-8"))
    assert shard["seconds"]["wall"] > 0
    assert shard["seconds"]["cpu"] > 0


def test_recordings_are_those_of_a_simulator(made: dataset.Dataset) -> None:
    info = made.info[0]
    sim = evis.Simulator(
        evis.Scene.builtin("spinner").at_speed(info.drawn["speed"]),
        sensor=evis.Sensor.from_toml(info.sensor_toml),
        seed=info.seed,
        start=0.0,
        size=(32, 24),
        rate_hz=500.0,
        samples=1,
        labels=["depth"],
    )
    packet = sim.step(30_000)
    assert len(packet.events) > 20
    assert np.array_equal(packet.events, made[0].events.to_numpy())
    assert np.array_equal(packet.labels["depth"].data, made[0].labels["depth"].data)
    assert not np.array_equal(packet.events, made[1].events.to_numpy())  # canary: another seed


def test_splits_share_no_scene(made: dataset.Dataset) -> None:
    for split in dataset.SPLITS:
        alone = dataset.load(made.folder, split)
        assert [info.id for info in alone.info] == [info.id for info in made.split(split).info]
    with pytest.raises(evis.ConfigError, match="split is 'dev'; it must be 'train' or"):
        dataset.load(made.folder, "dev")
    by_split: dict[str, set[str]] = {}
    for info in made.info:
        by_split.setdefault(info.split, set()).add("/".join(info.id.split("/")[:2]))
    assert set(by_split) == {"train", "validation", "test"}
    assert sum(map(len, by_split.values())) == len(set.union(*by_split.values()))
    assert by_split["train"] >= {"spinner/0"}
    # Canary: a split by recordings would share scenes.
    halves = [{"/".join(i.id.split("/")[:2]) for i in made.info[k::2]} for k in range(2)]
    assert halves[0] & halves[1]


@pytest.mark.parametrize("shares", [{"train": 0.8, "test": 0.2}, {"train": 1, "validation": 1, "test": 1}])
def test_names_are_dealt_by_shares(shares: dict[str, float]) -> None:
    names = [f"n{k}" for k in range(100)]
    dealt = deal(names, shares, 5)
    assert dealt.keys() == set(names)
    for split, share in shares.items():
        count = sum(found == split for found in dealt.values())
        assert abs(count - 100 * share / sum(shares.values())) < 1
    assert dealt == deal(names, shares, 5) != deal(names, shares, 6)


def test_workers_and_their_order_do_not_matter(made: dataset.Dataset, tmp_path: Path) -> None:
    for workers in (1, 3):
        other = dataset.make(spec_in(tmp_path), tmp_path / f"{workers}", workers=workers)
        assert hashes(other) == hashes(made)
    # The other way round.
    backwards = tmp_path / "backwards"
    (backwards / "shards").mkdir(parents=True)
    spec = dataset.read_spec(spec_in(tmp_path))
    from evis import _dataset_shard

    for shard in reversed(spec.shards()):
        _dataset_shard.write(shard, backwards / "shards", spec.base)
    assert hashes(dataset.make(spec, backwards, workers=0)) == hashes(made)
    # Canary: another seed.
    text = SPEC.replace("seed = 3", "seed = 4", 1)
    assert hashes(dataset.make(spec_in(tmp_path, text), tmp_path / "other", workers=0)) != hashes(made)


def test_finished_shards_are_kept(made: dataset.Dataset, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    shutil.copytree(made.folder, folder)
    before, names = shards(folder), sorted(shards(folder))
    half, gone, undescribed = names[:3]
    # A file that is cut, one that is missing, and one whose worker was killed before it described it.
    with (folder / "shards" / half).open("r+b") as file:
        file.truncate(1000)
    (folder / "shards" / gone).unlink()
    (folder / "shards" / undescribed).with_suffix(".json").unlink()
    (folder / "shards" / "train-00000.0123.part").mkdir()
    again = dataset.make(spec_in(tmp_path), folder, workers=0)
    after = shards(folder)
    assert {name for name in names if before[name] != after[name]} == {half, gone, undescribed}
    assert hashes(again) == hashes(made)
    again.check()
    assert not list((folder / "shards").glob("*.part"))


def test_a_folder_of_another_specification_is_refused(made: dataset.Dataset, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    shutil.copytree(made.folder, folder)
    other = spec_in(tmp_path, SPEC.replace("duration_s = 0.03", "duration_s = 0.02"))
    with pytest.raises(evis.ConfigError, match=r"from another specification.*overwrite=True"):
        dataset.make(other, folder, workers=0)
    assert shards(folder).keys() == shards(made.folder).keys()
    replaced = dataset.make(other, folder, workers=0, overwrite=True)
    assert {info.duration_us for info in replaced.info} == {20_000}


def test_damage_is_found(made: dataset.Dataset, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    shutil.copytree(made.folder, folder)
    copy = dataset.load(folder)
    copy.check()
    path = folder / "shards" / "train-00000.json"
    text = json.loads(path.read_text("utf-8"))
    name = "camera/events/t"
    name = next(key for key in text["recordings"][1]["sha256"] if key.endswith("events/t"))
    text["recordings"][1]["sha256"][name] = "0" * 64
    path.write_text(json.dumps(text), "utf-8")
    with pytest.raises(evis.FormatError, match=rf"1 of 8 recordings.*spinner/0/own/ideal/1: {name}"):
        dataset.load(folder).check()
    path.write_text("{", "utf-8")
    with pytest.raises(evis.FormatError, match="damaged"):
        dataset.load(folder)
    path.unlink()
    with pytest.raises(FileNotFoundError, match="is missing; make the data set again"):
        dataset.load(folder)


def command(*arguments: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "evis", "dataset", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def children(process: int) -> list[int]:
    """Processes that simulate for ``process``, leaving out Python's own tracker of resources."""
    found = []
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            fields = dict(line.split(":\t", 1) for line in status.read_text().splitlines() if ":\t" in line)
            words = (status.parent / "cmdline").read_bytes()
        except OSError:
            continue
        if int(fields["PPid"]) == process and b"spawn_main" in words:
            found.append(int(fields["Pid"]))
    return found


LONG = SPEC.replace("duration_s = 0.03", "duration_s = 0.3").replace("variants = 3", "variants = 6")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_a_killed_run_goes_on_and_a_lost_worker_is_replaced(device: evis.Device, tmp_path: Path) -> None:
    spec_in(tmp_path, LONG)
    reference = dataset.make(tmp_path / "spec.toml", tmp_path / "reference", workers=0)
    run = command("spec.toml", "-o", "out", "--workers", "2", folder=tmp_path)
    place = tmp_path / "out" / "shards"
    until = time.monotonic() + 60
    while len(list(place.glob("*.json"))) < 1 and time.monotonic() < until:
        time.sleep(0.005)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    run.stdout.close(), run.stderr.close()  # type: ignore[union-attr]
    time.sleep(1.0)
    finished = {path.name for path in place.glob("*.json")}
    assert 1 <= len(finished) < len(list((tmp_path / "reference" / "shards").glob("*.json")))
    assert not (tmp_path / "out" / "manifest.json").exists()
    with pytest.raises(FileNotFoundError, match="once all shards are finished"):
        dataset.load(tmp_path / "out")
    kept = {name: (place / name).stat().st_mtime_ns for name in finished}

    # It goes on, and loses a worker in the middle of a shard.
    run = command("spec.toml", "-o", "out", "--workers", "2", folder=tmp_path)
    while not (found := children(run.pid)) and time.monotonic() < until:
        time.sleep(0.005)
    while not list(place.glob("*.part")) and time.monotonic() < until:
        time.sleep(0.005)
    os.kill(found[0], signal.SIGKILL)
    out, err = run.communicate(timeout=120)
    assert run.returncode == 0, err
    assert "a worker was lost in shard" in err
    assert "shards are finished already" in err
    assert "14 recordings" in out
    assert {name: (place / name).stat().st_mtime_ns for name in finished} == kept
    assert hashes(dataset.load(tmp_path / "out")) == hashes(reference)
    assert not list(place.glob("*.part"))


def ray_workers() -> list[int]:
    """Processes of Ray that simulate a shard."""
    found = []
    for words in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = words.read_bytes()
        except OSError:
            continue
        if line.startswith(b"ray::") and b"_remote_shard" in line:
            found.append(int(words.parent.name))
    return found


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_a_ray_cluster_that_loses_a_worker_makes_the_same(device: evis.Device, tmp_path: Path) -> None:
    ray = pytest.importorskip("ray", reason="Ray is not installed: make test-ray")
    spec_in(tmp_path, LONG)
    reference = dataset.make(tmp_path / "spec.toml", tmp_path / "reference", workers=0)
    ray.init(
        num_cpus=3,
        object_store_memory=80 * 2**20,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="error",
        _temp_dir=str(Path(tempfile.gettempdir()) / f"evis-ray-{os.getpid()}"),
    )
    try:
        killed: list[int] = []
        left_behind: list[Path] = []

        class Killer(Meter):
            """Kills a worker that simulates, after the first shard."""

            def recorded(self, events: int) -> None:
                super().recorded(events)
                if not killed:
                    killed.append(kill_a_worker())
                    left_behind.extend((tmp_path / "out" / "shards").glob("*.part"))

        def kill_a_worker() -> int:
            until = time.monotonic() + 30
            while time.monotonic() < until:
                for worker in ray_workers():
                    os.kill(worker, signal.SIGKILL)
                    return worker
                time.sleep(0.005)
            return 0

        from evis import _dataset_workers

        original, _dataset_workers.Meter = _dataset_workers.Meter, Killer  # type: ignore[misc]
        try:
            made = dataset.make(tmp_path / "spec.toml", tmp_path / "out", ray=True)
        finally:
            _dataset_workers.Meter = original  # type: ignore[misc]
        assert killed[0] > 0, "no worker was found to kill"
        assert not Path(f"/proc/{killed[0]}").exists()
        assert left_behind, "it was in a shard"
    finally:
        ray.shutdown()
        shutil.rmtree(Path(tempfile.gettempdir()) / f"evis-ray-{os.getpid()}", ignore_errors=True)
    assert hashes(made) == hashes(reference)
    assert not list((tmp_path / "out" / "shards").glob("*.part"))
    made.check()


def test_progress_tells_throughput_and_the_time_left() -> None:
    meter = Meter(10, shown=False)
    for events in (100, 300):
        meter.recorded(events)
    assert meter.line(4.0) == "2 of 10 recordings, 30.0 a minute, 100 events/s, 0:16 left"
    assert "20.0 a minute, 67 events/s" in meter.line(6.0)
    # A shard that is begun again counts its recordings again.
    for _ in range(10):
        meter.recorded(0)
    assert meter.line(4.0).endswith("0:00 left")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_the_command_starts_a_cluster_of_its_own(made: dataset.Dataset, tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="Ray is not installed: make test-ray")
    spec_in(tmp_path)
    run = command("spec.toml", "-o", "out", "--ray", "--workers", "2", folder=tmp_path)
    # Its workers get as much of the processors as local ones do: Ray's own are nice by 15.
    niceness: set[int] = set()
    while run.poll() is None and not niceness:
        for worker in ray_workers():
            with contextlib.suppress(OSError):
                niceness.add(os.getpriority(os.PRIO_PROCESS, worker))
        time.sleep(0.005)
    assert niceness == {os.getpriority(os.PRIO_PROCESS, 0)}
    _, err = run.communicate(timeout=180)
    assert run.returncode == 0, err
    assert hashes(dataset.load(tmp_path / "out")) == hashes(made)
    # Canary: an address at which there is no cluster is said, and nothing hangs.
    run = command("spec.toml", "-o", "none", "--ray", "127.0.0.1:1", folder=tmp_path)
    _, err = run.communicate(timeout=180)
    assert run.returncode == 2, err
    assert "127.0.0.1:1" in err


WRONG = [
    ("duration_s = 0.03", "duration_s = 0", r"line 5: duration_s is 0; it must be above 0 seconds"),
    (
        "duration_s = 0.03",
        "duration = 0.03",
        r"line 5: the specification has no key 'duration'; did you mean 'duration_s'",
    ),
    ("duration_s = 0.03\n", "", r"duration_s is missing; write the seconds"),
    ('name = "small"\n', "", r"name is missing; write a word, such as name = \"cards\""),
    ("seeds = 2", "seeds = [1, 1]", r"line 4: seeds is \[1, 1\]; it must hold different numbers"),
    ("[split]", "[splits]", r"line 9: the specification has no key 'splits'; did you mean 'split'"),
    ("test = 0.25", "tset = 0.25", r"line 12: \[split\] has no key 'tset'; did you mean 'test'"),
    (
        "rate_hz = 500.0",
        "rat_hz = 500.0",
        r"line 16: \[simulator\] has no key 'rat_hz'; did you mean 'rate_hz'",
    ),
    ('builtin = "spinner"', 'builtin = "spiner"', r"line 22: builtin is 'spiner'; did you mean 'spinner'"),
    ('builtin = "spinner"', 'licence = "x"', r"no TOML"),
    ('recipe = "objects2d"', 'file = "no.glb"', r"line 31: settings are for recipes|no.glb"),
    (
        "objects = [2, 3]",
        "objekts = [2, 3]",
        r"line 32: \[scenes.settings\] has no key 'objekts'; did you mean 'objects'",
    ),
    ("objects = [2, 3]", "objects = [3, 2]", r"line 3\d: objects is \[3, 2\]; it must be \(low, high\)"),
    ("speed = [1.0, 3.0]", "speed = [3.0, 1.0]", r"line 36: speed is \[3.0, 1.0\]; it must be \[low, high\]"),
    ("noise.shot_hz", "noise.shoot_hz", r"line 38: .*noise.shoot_hz.* path"),
    (
        "[randomise.sensor]\nthreshold_on = [0.1, 0.3]\nnoise.shot_hz = [0.0, 5.0]",
        "sensor = 3",
        r"line 38: sensor is 3; it must be a table of ranges",
    ),
    (
        "threshold_on = [0.1, 0.3]",
        "threshold_on = 0.2",
        r"line 3[89]: threshold_on is 0.2; it must be a sequence",
    ),
    ('licence = "MIT"', "licence = 3", r"line 24: licence is 3; it must be text"),
    (
        "variants = 3",
        "variants = 1",
        r"validation is 0.25; 2 scenes that share nothing are too few|test is 0.25",
    ),
    ('split = "train"', 'split = "trian"', r"line 23: split is 'trian'; did you mean 'train'"),
    ('split = "train"', 'trajectories = ["obit"]', r"line 23: trajectories has 'obit'; .*own"),
    ('name = "small"', 'name = "a b"', r"line 2: name is 'a b'; it must consist of letters"),
    ("size = [32, 24]\nrate", "size = [32, 24\nrate", r"is no TOML"),
]


@pytest.mark.parametrize(("good", "bad", "message"), WRONG, ids=[bad[:24].strip() for _, bad, _ in WRONG])
def test_errors_name_the_line_and_the_nearest_key(good: str, bad: str, message: str, tmp_path: Path) -> None:
    assert SPEC.count(good) >= 1
    path = spec_in(tmp_path, SPEC.replace(good, bad, 1))
    with pytest.raises(evis.FormatError, match=message) as error:
        dataset.read_spec(path)
    assert str(path) in str(error.value)


def test_the_good_specification_is_taken(tmp_path: Path) -> None:
    """Canary of the errors: what they are made of is right."""
    spec = dataset.read_spec(spec_in(tmp_path))
    assert len(spec.recordings()) == 8
    assert [len(shard.recordings) for shard in spec.shards()] == [2, 2, 2, 2]


def test_lines_of_keys_are_found() -> None:
    lines = lines_of('a = 1\n[b]\nc.d = 2\n[[e]]\n[[e]]\nf = 3\n[e.g]\n"h i" = 4\n')
    assert lines[("a",)] == 1
    assert lines[("b", "c", "d")] == 3
    assert lines[("e", 1, "f")] == 6
    assert lines[("e", 1, "g", "h i")] == 8
    assert ("e", 0, "f") not in lines


def test_what_the_engine_refuses_names_the_recording(device: evis.Device, tmp_path: Path) -> None:
    text = SPEC.replace("samples = 1", "samples = 0")
    with pytest.raises(evis.ConfigError, match=r"recording spinner/0/own/ideal/0: samples is 0"):
        dataset.make(spec_in(tmp_path, text), tmp_path / "out", workers=1)
    text = SPEC.replace("[randomise]", '[[trajectories]]\nmotion = "orbit"\n\n[randomise]')
    with pytest.raises(evis.ConfigError, match=r"scene 'spinner' with trajectory 'orbit'"):
        dataset.make(spec_in(tmp_path, text), tmp_path / "out2", workers=1)
    with pytest.raises(evis.ConfigError, match="workers is -1"):
        dataset.make(spec_in(tmp_path), tmp_path / "out3", workers=-1)


def test_one_run_at_a_time(made: dataset.Dataset, tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    folder = tmp_path / "out"
    shutil.copytree(made.folder, folder)
    with (folder / ".lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(BlockingIOError, match="another process is making"):
            dataset.make(spec_in(tmp_path), folder, workers=0)
    dataset.make(spec_in(tmp_path), folder, workers=0)


def test_recordings_cross_to_other_processes(made: dataset.Dataset) -> None:
    recording = made[3]
    again = pickle.loads(pickle.dumps(recording))
    assert np.array_equal(again.events.to_numpy(), recording.events.to_numpy())
    assert not np.array_equal(again.events.to_numpy(), made[2].events.to_numpy())  # canary
    assert again.seed == made.info[3].seed
    window = recording.slice_time(5_000, 15_000)
    inside = recording.events.t[(recording.events.t >= 5_000) & (recording.events.t < 15_000)]
    assert np.array_equal(window.t, inside)


def test_windows_for_torch(made: dataset.Dataset) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: make test-torch")
    from torch.utils.data import DataLoader

    from evis.representations import Dense

    train = made.split("train")
    windows = train.torch(time_us=10_000, representation=Dense("voxel_grid", bins=3))
    assert len(windows) == 3 * len(train)
    data, target = windows[4]
    assert data.shape == (3, 24, 32)
    assert (target["recording"], target["start_us"], target["end_us"]) == (1, 10_000, 20_000)
    expected = train[1].events.slice_time(10_000, 20_000)
    assert float(data.sum()) == pytest.approx(int((2 * expected.p.astype(int) - 1).sum()), abs=1e-3)
    loader = DataLoader(windows, batch_size=4, num_workers=2, multiprocessing_context="spawn")
    assert torch.equal(torch.cat([batch for batch, _ in loader]), torch.stack([one for one, _ in windows]))


def test_the_command_makes_checks_and_lists(made: dataset.Dataset, tmp_path: Path) -> None:
    spec_in(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        process = command(*arguments, folder=tmp_path)
        out, err = process.communicate(timeout=120)
        return process.returncode, out, err

    code, out, _ = run("spec.toml", "--dry-run")
    assert code == 0
    wanted = ["train 4 recordings 2 shards", "validation 2 recordings 1 shards", "test 2 recordings 1 shards"]
    assert [" ".join(line.split()) for line in out.splitlines()] == wanted
    code, out, err = run("spec.toml", "-o", "out", "--workers", "2")
    assert code == 0, err
    assert "8 recordings" in out
    assert hashes(dataset.load(tmp_path / "out")) == hashes(made)
    assert run("--check", "out")[0] == 0
    (tmp_path / "out" / "shards" / "test-00000.h5").write_bytes(b"no HDF5")
    assert run("--check", "out")[0] == 2
    assert run("spec.toml")[0] == 2
    assert "takes 'spec.toml' for its address" in run("--ray", "spec.toml", "-o", "x")[2]
    assert run("no.toml", "-o", "x")[0] == 2
    code, out, _ = run("objects2d", "--print")
    assert code == 0
    (tmp_path / "printed.toml").write_text(out, "utf-8")
    assert len(dataset.read_spec(tmp_path / "printed.toml").recordings()) == 1000


# Recipes.


def test_cards_move_smoothly_before_a_background(device: evis.Device) -> None:
    scene = objects2d(5, objects=(6, 6), size=(48, 36), duration=1.0)
    assert sum(name.startswith("card") for name in scene.nodes) == 6
    sim = evis.Simulator(
        scene, labels=["instance", "flow", "hdr"], label_rate_hz=20, rate_hz=500.0, samples=1
    )
    packet = sim.step(400_000)
    assert len(packet.events) > 500
    ids = packet.labels["instance"].data
    assert ids.min() > 0, "the border of the background is seen"
    assert 2 <= len(np.unique(ids)) <= 7
    flow = packet.labels["flow_forward"].data[:-1]
    step = np.abs(np.diff(flow, axis=0))
    same = ids[1:-1] == ids[:-2]
    # Speeds are at most 1.5 heights a second, times what a crest factor of two sines and turning add.
    assert np.abs(flow).max() < 3 * 1.5 * 36 / 20
    assert np.median(step[same]) < 0.5 * np.median(np.abs(flow)), "paths are smooth"
    assert len(np.unique(packet.labels["hdr"].data)) > 500


def test_recipes_are_functions_of_their_seed(device: evis.Device) -> None:
    def events(seed: int) -> Any:
        scene = objects2d(seed, objects=(2, 3), size=(32, 24), duration=0.5)
        return evis.Simulator(scene, rate_hz=500.0, samples=1).step(50_000).events

    assert np.array_equal(events(1), events(1))
    assert not np.array_equal(events(1), events(2))  # canary


def test_pictures_of_a_folder_become_textures(device: evis.Device, tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    rng = np.random.default_rng(0)
    for k in range(10):
        write_png(pictures / f"{k}.png", rng.integers(0, 255, (16, 24, 4 if k % 2 else 3), np.uint8))
    scene = objects2d(1, images=pictures, objects=(3, 3), size=(32, 24), duration=0.5)
    assert len(evis.Simulator(scene, rate_hz=500.0, samples=1).step(50_000).events) > 20
    text = SPEC.replace("objects = [2, 3]", 'objects = [2, 3]\nimages = "pictures"').replace(
        "seeds = 2\n", ""
    )
    made = dataset.make(spec_in(tmp_path, text), tmp_path / "out", workers=0)
    dealt = deal([f"{k}.png" for k in range(10)], {"train": 0.5, "validation": 0.25, "test": 0.25}, 3)
    assert set(dealt.values()) == {"train", "validation", "test"}
    assert len(made) == 4
    with pytest.raises(evis.ConfigError, match="has no picture"):
        objects2d(1, images=tmp_path / "out")


def write_png(path: Path, pixels: Any) -> None:
    import struct
    import zlib

    height, width, channels = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    head = struct.pack(">IIBBBBB", width, height, 8, 6 if channels == 4 else 2, 0, 0, 0)
    parts = [(b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    body = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"objects": (0, 3)}, r"objects is \(0, 3\); it must be \(low, high\), between 1 and 200"),
        ({"speed": (2, 1)}, r"speed is \(2, 1\)"),
        ({"duration": 0}, "duration is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"images": []}, "images is empty"),
    ],
)
def test_recipes_refuse_what_cannot_be(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(evis.ConfigError, match=message):
        objects2d(**settings)
