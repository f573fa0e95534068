"""The table of all topics: how each payload is decoded.

The types are in `sensor_topics` and `wire_format`, each with its topic, `hand_topics` and
`health_topics`. Daemons fill them in, and subscribers decode them; anything that no daemon
publishes is rejected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeVar, get_args

from ..errors import DecodeError
from ..quoting import quoted
from .codec import decode_json, decode_object
from .hand_topics import HandObjects
from .health_topics import HandHealth, Health
from .sensor_topics import (
    NEWEST_WINS,
    OF_JSON,
    Contact,
    ContactEvent,
    Info,
    ObjectEvent,
    SlipEvent,
    Status,
    StitchedMap,
    TouchNumbers,
)
from .wire_format import GRIDS, CloudMessage, decode

State = Literal["online", "degraded", "stopped", "offline"]
STATES: Final[tuple[State, ...]] = get_args(State)
ALIVE: Final = ("online", "degraded")
T = TypeVar("T")

_JSON: Final = "application/json"
# What every JPEG image begins with; whoever shows the image decodes the rest.
_JPEG: Final = b"\xff\xd8"
# Many times a picture of 320 px: only a stranger's is larger.
PREVIEW_BYTES_MAX: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class Topic:
    """How to decode a topic's payload, and its MQTT 5 content type.

    `newest_wins` states whether only the newest of its messages is of use,
    so that a reader need not keep more.
    """

    decode: Callable[[str, bytes], Any]
    content_type: str = _JSON
    newest_wins: bool = False


def _json(kind: type, *, newest_wins: bool = False) -> Topic:
    return Topic(lambda part, payload: decode_json(part, payload, kind), newest_wins=newest_wins)


def _binary(kind: type, name: str) -> Topic:
    def read(part: str, payload: bytes) -> Any:
        message = decode(payload)
        if not isinstance(message, kind):
            raise DecodeError(
                f"{part}: found a {type(message).__name__}, expected a {kind.__name__}"
            )
        return message

    return Topic(read, f"application/vnd.tacshade.{name}", newest_wins=True)


def decode_status(topic: str, payload: bytes) -> Status:
    """Decode a ``status/<part>``. Raises DecodeError."""
    # An empty payload clears a retained value.
    return decode_json(topic, payload or b"{}", Status)


def decode_state(payload: bytes) -> State:
    """Decode a ``state``. Raises DecodeError."""
    # Plain text, not JSON: the broker sends a will as it is, and people read it with any tool.
    for state in STATES:
        if payload == state.encode():
            return state
    # Cut before it is quoted: the payload may be large.
    found = quoted(payload[:60].decode(errors="replace"))
    raise DecodeError(f"state: found {found}, expected one of {', '.join(STATES)}")


def decode_preview(_part: str, payload: bytes) -> bytes:
    """Check a ``preview``, which is a JPEG image. Raises DecodeError."""
    if len(payload) > PREVIEW_BYTES_MAX or not payload.startswith(_JPEG):
        raise DecodeError(
            f"preview: found a payload of {len(payload)} bytes, "
            f"expected a JPEG image of at most {PREVIEW_BYTES_MAX} bytes"
        )
    return payload


_OF_BOTH: Final = {
    "state": Topic(lambda _part, payload: decode_state(payload), "text/plain"),
    "instance": Topic(decode_object),
}
OF_SENSORS: Final[dict[str, Topic]] = {
    **_OF_BOTH,
    **{name: _binary(kind, name) for name, kind, _ in GRIDS.values()},
    "cloud": _binary(CloudMessage, "cloud"),
    "map/cloud": _binary(CloudMessage, "cloud"),
    **{name: _json(kind, newest_wins=name in NEWEST_WINS) for name, kind in OF_JSON.items()},
    "health": _json(Health, newest_wins=True),
    "preview": Topic(decode_preview, "image/jpeg", newest_wins=True),
    "status/": Topic(decode_status),
    "res/": Topic(decode_object),
}
"""The topics below ``tacshade/SENSOR/``; one that ends in a slash stands for all below it."""
OF_HANDS: Final[dict[str, Topic]] = {
    **_OF_BOTH,
    "objects": _json(HandObjects, newest_wins=True),
    "health": _json(HandHealth, newest_wins=True),
}
"""The topics below ``tacshade/hand/HAND/``."""


def _decoder(what: str, kind: type[T]) -> Callable[[bytes], T]:
    def read(payload: bytes) -> T:
        return decode_json(what, payload, kind)

    # Names of their own, since the client's wheel offers them one by one.
    read.__doc__ = f"Decode the payload of ``{what}`` as `{kind.__name__}`. Raises DecodeError."
    return read


decode_info = _decoder("info", Info)
decode_contact = _decoder("contact", Contact)
decode_touch = _decoder("touch", TouchNumbers)
decode_slip = _decoder("event/slip", SlipEvent)
decode_contact_event = _decoder("event/contact", ContactEvent)
decode_object_event = _decoder("event/object", ObjectEvent)
decode_health = _decoder("health", Health)
decode_map = _decoder("map", StitchedMap)
decode_hand = _decoder("objects", HandObjects)
decode_hand_health = _decoder("health", HandHealth)
