"""Calls of the engine: exceptions, the GIL, Ctrl-C."""

from __future__ import annotations

import pickle
import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest

import evis
from evis import _evis


def test_exceptions_also_are_the_usual_ones():
    assert issubclass(evis.ConfigError, evis.EvisError)
    assert issubclass(evis.ConfigError, ValueError)
    assert issubclass(evis.FormatError, evis.EvisError)
    assert issubclass(evis.FormatError, ValueError)
    assert issubclass(evis.DeviceError, evis.EvisError)
    assert issubclass(evis.DeviceError, RuntimeError)
    assert not issubclass(evis.EvisError, ValueError), "canary"
    error = pickle.loads(pickle.dumps(evis.ConfigError("rate is -1")))
    assert type(error) is evis.ConfigError


@pytest.mark.parametrize(
    ("kind", "exception", "message"),
    [
        ("config", evis.ConfigError, "rate is -1; it must be above 0"),
        ("scene invalid", evis.FormatError, "bad.glb: wrong magic"),
        ("scene unknown", evis.ConfigError, "no camera named 'x'; there is left"),
        ("device", evis.DeviceError, "no driver"),
        ("panic", evis.EvisError, "internal error: probe"),
        ("call after a panic", evis.EvisError, "this object is unusable since an internal error"),
    ],
)
def test_rust_errors_become_exceptions(kind: str, exception: type[Exception], message: str):
    with pytest.raises(exception) as caught:
        _evis._probe(kind)
    assert type(caught.value) is exception
    assert message in str(caught.value)


def test_file_errors_become_os_errors():
    with pytest.raises(FileNotFoundError) as caught:
        _evis._probe("scene io")
    assert caught.value.filename == "missing.glb"
    with pytest.raises(FileNotFoundError):
        evis.Scene.load("/nowhere/at all.glb")


def test_python_runs_while_the_engine_works():
    progress = 0
    stop = threading.Event()

    def count() -> None:
        nonlocal progress
        while not stop.is_set():
            progress += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    before = progress
    _evis._probe("wait")
    during = progress - before
    stop.set()
    thread.join()
    # 300 ms without the GIL leave room for hundreds of steps; with the GIL held there would be one at most.
    assert during > 10


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_interrupts_a_call():
    script = """
        from evis import _evis
        print("ready", flush=True)
        try:
            while True:
                _evis._probe("wait")
        except KeyboardInterrupt:
            print("stopped", flush=True)
    """
    assert "stopped" in interrupted(script)


#: A shell lets its background jobs ignore Ctrl-C, and children inherit that.
HEED_CTRL_C = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"


def interrupted(script: str, *, limit_s: float = 5.0) -> str:
    """Run ``script`` until it says ready, interrupt it, and return what it wrote."""
    process = subprocess.Popen(
        [sys.executable, "-c", HEED_CTRL_C + textwrap.dedent(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    head = ""
    for line in process.stdout:
        head += line
        if "ready" in line:
            break
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    try:
        rest, _ = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return head + rest
