"""Event arrays and their parts."""

from ._events import EventArray, EventCD, Events, EventWindow, as_event_cd

__all__ = [
    "EventArray",
    "EventCD",
    "EventWindow",
    "Events",
    "as_event_cd",
]
