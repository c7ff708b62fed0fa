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

from . import imu, lens, metrics, motion, representations, rig
from ._builder import SceneBuilder
from ._chart import Chart, ChartPoint, ChartSetting, Recommendation, SceneChart, chart
from ._emulator import EmulatorReport, EventEmulator, KeyframeReport, MotionCheck, check_motion
from ._events import EventArray, EventCD, Events, EventWindow, as_event_cd
from ._evis import ConfigError, DeviceError, EvisError, FormatError, __version__
from ._files import RecordedLabels, RecordedView, Recording, Writer, load, save
from ._io import (
    EventExtTrigger,
    EventFile,
    EventFileWriter,
    EventsIterator,
    FileFrame,
    FilePacket,
    ImuDtype,
    formats,
    open,
)
from ._limits import limits, set_limits
from ._method import Warp
from ._packets import CAUSES, CameraInfo, EnvironmentPacket, Labels, Packet, Poses, Report, View
from ._scene import EventCamera, Scene, scenes
from ._sensor import Diffusion, Exposure, Noise, Pattern, Photoreceptor, Readout, Refractory, Sensor
from ._simulator import Device, Simulator, Stream, devices
from ._stats import (
    Calibration,
    Comparison,
    Estimate,
    FlickerEstimate,
    Statistics,
    calibrate,
    compare,
    static_scene,
    statistics,
)
from ._truth import Truth, load_truth
from ._verify import (
    Convergence,
    ErrorFit,
    FailureCell,
    FailureVerification,
    FormCheck,
    LightError,
    LightPixel,
    LightVerification,
    SceneVerification,
    Verification,
    verify,
    verify_failures,
    verify_light,
    verify_scene,
)
from ._video import Frames, VideoReport, frames, video
from .motion import Placement, Waveform

__all__ = [
    "CAUSES",
    "Calibration",
    "CameraInfo",
    "Chart",
    "ChartPoint",
    "ChartSetting",
    "Comparison",
    "ConfigError",
    "Convergence",
    "Device",
    "DeviceError",
    "Diffusion",
    "EmulatorReport",
    "EnvironmentPacket",
    "ErrorFit",
    "Estimate",
    "EventArray",
    "EventCD",
    "EventCamera",
    "EventEmulator",
    "EventExtTrigger",
    "EventFile",
    "EventFileWriter",
    "EventWindow",
    "Events",
    "EventsIterator",
    "EvisError",
    "Exposure",
    "FailureCell",
    "FailureVerification",
    "FileFrame",
    "FilePacket",
    "FlickerEstimate",
    "FormCheck",
    "FormatError",
    "Frames",
    "ImuDtype",
    "KeyframeReport",
    "Labels",
    "LightError",
    "LightPixel",
    "LightVerification",
    "MotionCheck",
    "Noise",
    "Packet",
    "Pattern",
    "Photoreceptor",
    "Placement",
    "Poses",
    "Readout",
    "Recommendation",
    "RecordedLabels",
    "RecordedView",
    "Recording",
    "Refractory",
    "Report",
    "Scene",
    "SceneBuilder",
    "SceneChart",
    "SceneVerification",
    "Sensor",
    "Simulator",
    "Statistics",
    "Stream",
    "Truth",
    "Verification",
    "VideoReport",
    "View",
    "Warp",
    "Waveform",
    "Writer",
    "__version__",
    "as_event_cd",
    "calibrate",
    "chart",
    "check_motion",
    "compare",
    "devices",
    "formats",
    "frames",
    "imu",
    "lens",
    "limits",
    "load",
    "load_truth",
    "metrics",
    "motion",
    "open",
    "representations",
    "rig",
    "save",
    "scenes",
    "set_limits",
    "static_scene",
    "statistics",
    "verify",
    "verify_failures",
    "verify_light",
    "verify_scene",
    "video",
]
