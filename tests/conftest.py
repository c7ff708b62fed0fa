"""What tests share. A missing device is a failure where EVIS_REQUIRE_GPU=1, and else a skip that says so."""

from __future__ import annotations

import importlib.util
import os
import sys
import types
from collections.abc import Callable
from pathlib import Path

import pytest

import evis


@pytest.fixture(scope="session")
def device() -> evis.Device:
    """The device that tests run on."""
    found = evis.devices()
    if not found:
        if os.environ.get("EVIS_REQUIRE_GPU") == "1":
            pytest.fail("EVIS_REQUIRE_GPU=1 and there is no device: install mesa-vulkan-drivers, libvulkan1")
        pytest.skip("no device: install mesa-vulkan-drivers, libvulkan1; EVIS_REQUIRE_GPU=1 makes this fail")
    return found[0]


@pytest.fixture
def spinner(device: evis.Device) -> evis.Scene:
    """A built-in scene with one camera and much motion."""
    return evis.Scene.builtin("spinner")


@pytest.fixture(scope="session")
def tool() -> Callable[[str], types.ModuleType]:
    """Load a program of tools/ as a module, by its name."""

    def load(name: str) -> types.ModuleType:
        path = Path(__file__).parent.parent / "tools" / f"{name}.py"
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture
def network_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[type], Callable[[str], Path]]:
    """Let a class stand in for onnxruntime's session; give what makes files whose content is their name."""

    def of(session: type) -> Callable[[str], Path]:
        stand_in = types.ModuleType("onnxruntime")
        stand_in.SessionOptions = types.SimpleNamespace  # type: ignore[attr-defined]
        stand_in.InferenceSession = session  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "onnxruntime", stand_in)

        def made(name: str) -> Path:
            path = tmp_path / f"{name}.onnx"
            path.write_text(name)
            return path

        return made

    return of
