"""What tests share. A missing device is a failure where EVIS_REQUIRE_GPU=1, and else a skip that says so."""

from __future__ import annotations

import os

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
