"""Files of events: reading and writing them piece by piece."""

from ._files import RecordedLabels, RecordedState, RecordedView, Recording, Writer
from ._io import EventExtTrigger, EventFile, EventFileWriter, EventsIterator, FileFrame, FilePacket, ImuDtype

__all__ = [
    "EventExtTrigger",
    "EventFile",
    "EventFileWriter",
    "EventsIterator",
    "FileFrame",
    "FilePacket",
    "ImuDtype",
    "RecordedLabels",
    "RecordedState",
    "RecordedView",
    "Recording",
    "Writer",
]
