"""Frames to events: the emulator, keyframes, films, and what they report."""

from ._emulator import EmulatorReport, EventEmulator, KeyframeReport, MotionCheck, check_motion
from ._video import Frames, VideoReport

__all__ = [
    "EmulatorReport",
    "EventEmulator",
    "Frames",
    "KeyframeReport",
    "MotionCheck",
    "VideoReport",
    "check_motion",
]
