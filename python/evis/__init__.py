"""EVIS: moving 3D scenes in, labelled event streams out.

Public time is integer microseconds since the stream's start; x runs right and y down from the top-left
pixel; polarity is ON = 1, OFF = 0.

>>> import evis
>>> sim = evis.Simulator(evis.Scene.builtin("spinner"), size=(64, 48))
>>> for packet in sim.stream(duration=0.02):
...     print(packet.start_us, packet.t.dtype, packet.events.dtype.names)
0 int64 ('x', 'y', 'p', 't')
10000 int64 ('x', 'y', 'p', 't')
"""

import os as _os
import sys as _sys
import tempfile as _tempfile

if _sys.platform == "linux":
    # Mesa's drivers complain on stderr where this is missing, as in containers; nothing of ours is put there.
    _os.environ.setdefault("XDG_RUNTIME_DIR", _tempfile.gettempdir())

from typing import TYPE_CHECKING as _TYPE_CHECKING

from . import emulation, events, files, imu, lens, measure, metrics, motion, packets, representations, rig
from ._builder import SceneBuilder
from ._chart import chart
from ._emulator import EventEmulator
from ._events import EventArray, EventCD
from ._evis import ConfigError, DeviceError, EvisError, FormatError, __version__
from ._files import Recording, Writer, load, save
from ._io import formats, open
from ._limits import limits, set_limits
from ._method import Warp
from ._packets import Packet
from ._scene import EventCamera, Scene, scenes
from ._sensor import Diffusion, Exposure, Noise, Pattern, Photoreceptor, Readout, Refractory, Sensor
from ._simulator import Device, Simulator, devices
from ._stats import calibrate, compare, statistics
from ._truth import Truth
from ._verify import verify
from ._video import frames, video
from .motion import Placement

__all__ = [
    "ConfigError",
    "Device",
    "DeviceError",
    "Diffusion",
    "EventArray",
    "EventCD",
    "EventCamera",
    "EventEmulator",
    "EvisError",
    "Exposure",
    "FormatError",
    "Noise",
    "Packet",
    "Pattern",
    "Photoreceptor",
    "Placement",
    "Readout",
    "Recording",
    "Refractory",
    "Scene",
    "SceneBuilder",
    "Sensor",
    "Simulator",
    "Truth",
    "Warp",
    "Writer",
    "__version__",
    "calibrate",
    "chart",
    "compare",
    "devices",
    "emulation",
    "events",
    "files",
    "formats",
    "frames",
    "imu",
    "lens",
    "limits",
    "load",
    "measure",
    "metrics",
    "motion",
    "open",
    "packets",
    "representations",
    "rig",
    "save",
    "scenes",
    "set_limits",
    "statistics",
    "verify",
    "video",
]

if not _TYPE_CHECKING:
    _MOVED = {
        "CAUSES": "packets",
        "Calibration": "measure",
        "CameraInfo": "packets",
        "Chart": "measure",
        "ChartPoint": "measure",
        "ChartSetting": "measure",
        "Comparison": "measure",
        "Convergence": "measure",
        "EmulatorReport": "emulation",
        "EnvironmentPacket": "packets",
        "ErrorFit": "measure",
        "Estimate": "measure",
        "EventExtTrigger": "files",
        "EventFile": "files",
        "EventFileWriter": "files",
        "EventWindow": "events",
        "Events": "events",
        "EventsIterator": "files",
        "FailureCell": "measure",
        "FailureVerification": "measure",
        "FileFrame": "files",
        "FilePacket": "files",
        "FlickerEstimate": "measure",
        "FormCheck": "measure",
        "Frames": "emulation",
        "ImuDtype": "files",
        "KeyframeReport": "emulation",
        "Labels": "packets",
        "LightError": "measure",
        "LightPixel": "measure",
        "LightVerification": "measure",
        "MotionCheck": "emulation",
        "Poses": "packets",
        "Recommendation": "measure",
        "RecordedLabels": "files",
        "RecordedView": "files",
        "Report": "packets",
        "SceneChart": "measure",
        "SceneVerification": "measure",
        "Statistics": "measure",
        "Stream": "packets",
        "StreamProgress": "packets",
        "Verification": "measure",
        "VideoReport": "emulation",
        "View": "packets",
        "Waveform": "motion",
        "as_event_cd": "events",
        "check_motion": "emulation",
        "load_truth": "measure",
        "static_scene": "measure",
        "verify_failures": "measure",
        "verify_light": "measure",
        "verify_scene": "measure",
    }

    def __getattr__(name: str) -> object:
        """Find names that stood here in 0.1."""
        if name not in _MOVED:
            raise AttributeError(f"module 'evis' has no attribute '{name}'")
        import warnings

        place = f"evis.{_MOVED[name]}"
        warnings.warn(f"evis.{name} is {place}.{name} now", DeprecationWarning, stacklevel=2)
        return getattr(_sys.modules[place], name)
