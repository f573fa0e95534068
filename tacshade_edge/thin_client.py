"""Receives and decodes the MQTT messages of TacShade sensors as NumPy arrays.

The names listed here and the module `rigid` are public.
"""

from .errors import ConfigError, DecodeError, DeviceError, TacshadeError
from .mqtt.listener import Listener, listen
from .rigid import Rigid, from_seven
from .types.geometry import Geometry, Pose
from .wire.codec import decode_object
from .wire.hand_topics import Finger, HandObject, HandObjects, Motion, Unobservable
from .wire.health_topics import HandHealth, Health
from .wire.received import Message, decode_message, skin_mm
from .wire.sensor_topics import (
    Contact,
    ContactEvent,
    Info,
    InfoGeometry,
    ObjectEvent,
    SlipEvent,
    Status,
    StitchedMap,
    TouchNumbers,
)
from .wire.topics import (
    decode_contact,
    decode_contact_event,
    decode_hand,
    decode_hand_health,
    decode_health,
    decode_info,
    decode_map,
    decode_object_event,
    decode_slip,
    decode_state,
    decode_status,
    decode_touch,
)
from .wire.wire_format import CloudMessage, HeightMessage, ShearMessage, SigmaMessage, decode

__all__ = [
    "CloudMessage",
    "ConfigError",
    "Contact",
    "ContactEvent",
    "DecodeError",
    "DeviceError",
    "Finger",
    "Geometry",
    "HandHealth",
    "HandObject",
    "HandObjects",
    "Health",
    "HeightMessage",
    "Info",
    "InfoGeometry",
    "Listener",
    "Message",
    "Motion",
    "ObjectEvent",
    "Pose",
    "Rigid",
    "ShearMessage",
    "SigmaMessage",
    "SlipEvent",
    "Status",
    "StitchedMap",
    "TacshadeError",
    "TouchNumbers",
    "Unobservable",
    "decode",
    "decode_contact",
    "decode_contact_event",
    "decode_hand",
    "decode_hand_health",
    "decode_health",
    "decode_info",
    "decode_map",
    "decode_message",
    "decode_object",
    "decode_object_event",
    "decode_slip",
    "decode_state",
    "decode_status",
    "decode_touch",
    "from_seven",
    "listen",
    "skin_mm",
]
