"""Every setting with its type, range, default and meaning;
``config/default.yaml`` shows them to people.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta

from tacshade_edge.camera.sources import Source, V4l2
from tacshade_edge.section import PATH, RESTART, Section, marked
from tacshade_edge.sensor.profiles import AUTO, DEFAULT, NETWORK, PROFILES, Outline
from tacshade_edge.wire.broker_address import HOST

Placed = Annotated[
    list[float], Meta(min_length=7, max_length=7, description="x_mm, y_mm, z_mm, qw, qx, qy, qz")
]

# People copy quaternions with four digits; a wrong one is off by far more.
_UNIT_TOLERANCE: Final = 1e-3
# Far beyond any robot's reach.
_PLACE_MAX_MM: Final = 1e6


def wrong_with(seven: Sequence[float]) -> str | None:
    """The mistake in seven numbers that their type cannot find, ``found …, expected …``;
    None if there is none.
    """
    away_mm = max(abs(value) for value in seven[:3])
    if away_mm > _PLACE_MAX_MM:
        return f"found a place {away_mm:g} mm away, expected one within {_PLACE_MAX_MM:g}"
    norm = math.sqrt(sum(q * q for q in seven[3:]))
    if abs(norm - 1) > _UNIT_TOLERANCE:
        return f"found a quaternion of length {norm:.4g}, expected length 1"
    return None


SENSORS = "sensors"
"""The key of a file with several sensors (`settings.load`)."""
OWN = ("sensor_id", "calibration", "source", "hand_T_sensor")
"""Keys that sensors cannot share."""
HAND, FINGER = "hand_id", "hand_T_sensor"
"""The keys of a hand and of each of its sensors; not allowed in a file with one sensor."""
_PROFILES = [*PROFILES, AUTO]
_ID = "^[A-Za-z0-9_-]{1,64}$"
# The topics of hands begin with tacshade/hand.
_SENSOR_ID = "^(?!hand$)[A-Za-z0-9_-]{1,64}$"


class Mqtt(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The broker."""

    host: Annotated[
        # Refused here, a URL gets a line; the resolver would say that the host is unknown.
        str, Meta(pattern=HOST, description="host name or address, without port, brackets or URL")
    ] = "localhost"
    port: Annotated[int, Meta(ge=1, le=65535, description="TCP port of the broker")] = 1883
    username: Annotated[str, Meta(min_length=1, description="user name")] | None = None
    password_file: (
        Annotated[
            str, Meta(min_length=1, description="file whose first line is the password", extra=PATH)
        ]
        | None
    ) = None
    ca_file: (
        Annotated[
            str,
            Meta(min_length=1, description="PEM file of the broker's CA; turns TLS on", extra=PATH),
        ]
        | None
    ) = None
    home_assistant: Annotated[bool, Meta(description="announce this sensor to Home Assistant")] = (
        False
    )


class Recorder(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Recordings requested by ``req/record``."""

    folder: Annotated[
        str,
        Meta(min_length=1, description="a folder for recordings, each in a subfolder", extra=PATH),
    ] = "/var/lib/tacshade-edge/recordings"
    pre_roll_s: Annotated[
        float, Meta(ge=0, le=60, description="a recording begins this long before its request")
    ] = 0.0


class Stitching(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Stitching sessions, if frames have poses."""

    folder: Annotated[
        str,
        Meta(min_length=1, description="a folder for sessions, each in a subfolder", extra=PATH),
    ] = "/var/lib/tacshade-edge/sessions"


class Serial(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The robot's serial line."""

    device: Annotated[
        str,
        Meta(
            # pyserial's URLs reach a robot behind a serial server, or a simulated one.
            pattern="^(/dev/|[a-z0-9]+://)",
            description="a serial port's path under /dev, or a pyserial URL",
        ),
    ]
    baud: Annotated[
        int, Meta(ge=1200, le=4_000_000, description="bits per second; USB devices ignore it")
    ] = 115200
    dtr: Annotated[
        bool,
        Meta(
            description="false: keep the lines DTR and RTS low, with which opening the port resets "
            "some boards"
        ),
    ] = True


class Settings(Section, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Everything that a user can set."""

    sensor_id: Annotated[
        str,
        Meta(
            pattern=_SENSOR_ID,
            description="letters, digits, - and _, not `hand`; part of every topic",
            extra=RESTART,
        ),
    ] = "tacshade"
    calibration: Annotated[
        str, Meta(min_length=1, description="file that `tacshade-edge calibrate` wrote", extra=PATH)
    ] = "/var/lib/tacshade-edge/calibration.npz"
    profile: Annotated[
        # Their names are known only at run time, which a Literal cannot express.
        str, Meta(pattern=f"^({'|'.join(_PROFILES)})$", extra_json_schema={"enum": _PROFILES})
    ] = DEFAULT
    latency_budget_ms: (
        Annotated[
            float,
            Meta(gt=0, le=60_000, description="from a frame's time stamp to its result, for auto"),
        ]
        | None
    ) = None
    outline: Annotated[
        Outline, Meta(description="what separates the contact from the other skin")
    ] = NETWORK
    shear: Annotated[
        Literal["asked", "always"],
        Meta(description="when to compute the skin's shear, twist and slip"),
    ] = "asked"
    source: Annotated[Source, Meta(description="where frames come from", extra=RESTART)] = V4l2()
    mqtt: Annotated[Mqtt, Meta(description="the broker", extra=RESTART)] = Mqtt()
    recorder: Annotated[Recorder, Meta(description="recordings")] = Recorder()
    serial: Annotated[Serial, Meta(description="the robot's serial line", extra=RESTART)] | None = (
        None
    )
    stitching: Annotated[Stitching, Meta(description="stitching sessions", extra=RESTART)] = (
        Stitching()
    )
    hand_id: (
        Annotated[
            str,
            Meta(
                pattern=_ID,
                description="letters, digits, - and _; part of the hand's topics",
                extra=RESTART,
            ),
        ]
        | None
    ) = None
    hand_T_sensor: Placed | None = None

    def misfit(self) -> tuple[tuple[str, ...], str] | None:
        """Only `AUTO` has a budget, and it must have one."""
        budget_ms = self.latency_budget_ms
        if (self.profile == AUTO) == (budget_ms is not None):
            return None
        given = "nothing" if budget_ms is None else f"{budget_ms:g}"
        expected = (
            "a number of milliseconds" if budget_ms is None else f"it with profile {AUTO} only"
        )
        text = f"found {given} with profile {self.profile}, expected {expected}"
        return ("latency_budget_ms",), text


RESTART_KEYS: Final = marked(Settings, RESTART)
"""What is made once: the source, the link and its topics, the robot's line."""


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a settings file."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "tacshade-edge settings",
        **msgspec.json.schema(Settings),
        # The types cannot say that `auto` needs a budget and that only `auto` may have one.
        "if": {"properties": {"profile": {"enum": [AUTO]}}, "required": ["profile"]},
        "then": {
            "properties": {"latency_budget_ms": {"type": "number"}},
            "required": ["latency_budget_ms"],
        },
        "else": {"properties": {"latency_budget_ms": {"type": "null"}}},
    }


def file_schema() -> dict[str, Any]:
    """JSON Schema of a settings file with one sensor, or with several."""
    one = json_schema()
    definitions, head = one.pop("$defs"), {key: one.pop(key) for key in ("$schema", "title")}
    whole = definitions["Settings"]["properties"]
    common = {key: schema for key, schema in whole.items() if key not in OWN}
    own = {key: schema for key, schema in whole.items() if key not in ("sensor_id", HAND)}
    sensor = {
        "type": "object",
        "properties": own,
        "required": ["calibration", "source"],
        "additionalProperties": False,
    }
    sensors = {
        "type": "object",
        "propertyNames": {"pattern": whole["sensor_id"]["pattern"]},
        "additionalProperties": sensor,
        "minProperties": 1,
    }
    several = {
        "type": "object",
        "properties": {**common, SENSORS: sensors},
        "additionalProperties": False,
        # Every sensor of a hand has its place in it; without a hand none has one.
        "if": {"properties": {HAND: {"type": "string"}}, "required": [HAND]},
        "then": _each({"properties": {FINGER: {"type": "array"}}, "required": [FINGER]}),
        "else": _each({"properties": {FINGER: {"type": "null"}}}),
    }
    return {
        **head,
        "if": {"properties": {SENSORS: {}}, "required": [SENSORS]},
        "then": several,
        "else": {**one, "properties": {HAND: {"type": "null"}, FINGER: {"type": "null"}}},
        "$defs": definitions,
    }


def _each(sensor: dict[str, Any]) -> dict[str, Any]:
    return {"properties": {SENSORS: {"additionalProperties": sensor}}}


def digest(settings: Settings) -> str:
    """The first 12 hex digits of the settings' SHA-256,
    which distinguish configurations in ``info``.
    """
    # Equal settings have the same digest, in whatever order a file has them.
    return hashlib.sha256(msgspec.json.encode(settings, order="deterministic")).hexdigest()[:12]
