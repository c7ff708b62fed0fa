"""Forked processes end with an error instead of waiting for ever; settings cross to others by pickles."""

from __future__ import annotations

import multiprocessing
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import evis


def run(script: str, folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


FORK = """
import os, sys, time
import numpy as np
import evis

def child(work):
    \"\"\"Run work in a forked process; return what it says, or that it had to be killed.\"\"\"
    ends = os.pipe()
    process = os.fork()
    if process == 0:
        try:
            said = work()
        except BaseException as error:
            said = f"{type(error).__name__}: {error}"
        os.write(ends[1], str(said).encode())
        os._exit(0)
    os.close(ends[1])
    until = time.monotonic() + 20
    while os.waitpid(process, os.WNOHANG) == (0, 0):
        if time.monotonic() > until:
            os.kill(process, 9)
            return "hangs"
        time.sleep(0.01)
    return os.read(ends[0], 10000).decode()

def push():
    emulator = evis.EventEmulator(256, 192, sensor="v2e-noisy", threads=2)
    emulator.push(np.ones((192, 256), np.float32), 0)
    return len(emulator.push(np.full((192, 256), 3, np.float32), 1000))
"""


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="this system does not fork")
def test_a_process_that_was_forked_before_the_first_call_works(tmp_path: Path):
    assert int(run(FORK + "print(child(push))", tmp_path)) > 0


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="this system does not fork")
def test_a_process_that_was_forked_after_a_call_says_what_to_do(tmp_path: Path):
    evis.save(tmp_path / "a.h5", evis.EventArray(np.zeros(3, evis.EventCD), width=4, height=4))
    script = """
count = push()
mine = evis.EventEmulator(256, 192, threads=2)
mine.push(np.ones((192, 256), np.float32), 0)
recording = evis.load("a.h5")
begin = time.monotonic()
print(child(push))
print(child(lambda: mine.push(np.ones((192, 256), np.float32), 9)))
print(child(lambda: evis.Scene.builtin("spinner")))
print("took", time.monotonic() - begin < 3)
def drop():
    global mine
    del mine
    return "dropped"
print(child(drop))
# What uses no threads goes on.
print(child(lambda: len(recording.events)))
print(len(mine.push(np.full((192, 256), 3, np.float32), 9)) > 0)
"""
    lines = run(FORK + script, tmp_path).splitlines()
    assert all(line.startswith("EvisError: ") and "spawn or forkserver" in line for line in lines[:3]), lines
    assert lines[3:] == ["took True", "dropped", "3", "True"], lines


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="this system does not fork")
@pytest.mark.usefixtures("device")
def test_what_a_forked_process_inherits_is_left_alone(tmp_path: Path):
    script = """
scene = evis.Scene.builtin("spinner")
sim = evis.Simulator(scene, size=(32, 24), rate_hz=500, samples=1)
stream = evis.Simulator(scene, size=(32, 24), rate_hz=500, samples=1).stream(duration=5)
next(stream)
writer = evis.Writer("out.h5", sim)
writer.write(sim.step(10000))
def drop():
    global sim, stream, writer
    del sim, stream, writer
    import gc
    gc.collect()
    return "dropped"
print(child(drop))
writer.write(sim.step(20000))
writer.close()
stream.close()
print(evis.load("out.h5").complete)
"""
    assert run(FORK + script, tmp_path).split() == ["dropped", "True"]


def events_of(simulator: evis.Simulator) -> bytes:
    return simulator.step(20_000).events.tobytes()


@pytest.mark.usefixtures("device")
def test_settings_cross_to_another_process():
    scene = evis.Scene.builtin("spinner", seed=3).at_speed(2.0)
    sim = evis.Simulator(scene, sensor=evis.Sensor(threshold_on=0.3), size=(32, 24), rate_hz=500, seed=5)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        other = pool.apply(events_of, (sim,))
    assert other == events_of(sim)
    assert len(other) > 0
    again = pickle.loads(pickle.dumps(sim))
    assert again.seed == 5
    assert again.sensor == sim.sensor
    assert events_of(evis.Simulator(scene, size=(32, 24), rate_hz=500, seed=5)) != other, "canary"


def test_scenes_and_recordings_pickle_by_their_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    text = """
        materials = [{ name = "grey" }]
        primitives = [{ name = "box", shape = "box", size = [1, 1, 1], material = "grey" }]
    """
    (tmp_path / "a.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    camera = evis.EventCamera(name="left", width=64, height=48)
    scenes = [
        evis.Scene.builtin("desk", seed=7),
        evis.Scene.load("a.toml"),
        evis.Scene.from_toml(text),
        evis.Scene.builtin("desk").with_cameras([camera]).at_speed(0.5),
    ]
    events = evis.EventArray(np.zeros(3, evis.EventCD), width=4, height=4)
    paths = [evis.save(f"a{ending}", events)[0] for ending in (".h5", ".npz", ".npy")]
    recordings = [evis.load(path) for path in paths]
    pickles = pickle.dumps((scenes, recordings, evis.Sensor.preset("v2e-noisy")))
    monkeypatch.chdir("/")
    again, loaded, sensor = pickle.loads(pickles)
    for one, other in zip(scenes, again, strict=True):
        assert (one.name, one.nodes, one.cameras, one.duration) == (
            other.name,
            other.nodes,
            other.cameras,
            other.duration,
        )
    assert all(recording.events == events for recording in loaded[:2])
    assert len(loaded[2].events) == 3
    assert sensor == evis.Sensor.preset("v2e-noisy")
