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

from . import emulation as emulation
from . import events as events
from . import files as files
from . import imu as imu
from . import lens as lens
from . import measure as measure
from . import metrics as metrics
from . import motion as motion
from . import packets as packets
from . import representations as representations
from . import rig as rig
from . import sensors as sensors
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
from ._sensor import Sensor
from ._simulator import Device, Simulator, devices
from ._stats import calibrate, compare, statistics
from ._truth import Truth
from ._verify import verify
from ._video import frames, video

__all__ = [
    "ConfigError",
    "Device",
    "DeviceError",
    "EventArray",
    "EventCD",
    "EventCamera",
    "EventEmulator",
    "EvisError",
    "FormatError",
    "Packet",
    "Recording",
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
    "formats",
    "frames",
    "limits",
    "load",
    "open",
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
        "Diffusion": "sensors",
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
        "Exposure": "sensors",
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
        "Noise": "sensors",
        "Pattern": "sensors",
        "Photoreceptor": "sensors",
        "Placement": "motion",
        "Poses": "packets",
        "Readout": "sensors",
        "Recommendation": "measure",
        "RecordedLabels": "files",
        "RecordedView": "files",
        "Refractory": "sensors",
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
