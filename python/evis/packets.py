"""What a simulator yields: packets, their views, labels, poses and reports."""

from ._bodies import Bodies, Instance
from ._packets import CAUSES, CameraInfo, DenseWindows, EnvironmentPacket, Labels, Packet, Poses, Report, View
from ._simulator import Stream, StreamProgress

__all__ = [
    "CAUSES",
    "Bodies",
    "CameraInfo",
    "DenseWindows",
    "EnvironmentPacket",
    "Instance",
    "Labels",
    "Packet",
    "Poses",
    "Report",
    "Stream",
    "StreamProgress",
    "View",
]
