"""EVIS: moving 3D scenes in, labelled event streams out.

>>> import evis
>>> sim = evis.Simulator(evis.Scene.builtin("spinner"), size=(64, 48))
>>> for packet in sim.stream(duration=0.02):
...     print(packet.t.dtype, packet.events.dtype.names)
int64 ('x', 'y', 'p', 't')
int64 ('x', 'y', 'p', 't')
"""

from ._evis import ConfigError, DeviceError, EvisError, FormatError, __version__
from ._events import EventArray, EventCD, Events, as_event_cd
from ._packets import CameraInfo, EnvironmentPacket, Labels, Packet, Poses, Report, View
