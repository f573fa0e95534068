"""SENSOR.yaml: a person's description of a sensor, for ``tacshade-edge calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.settings import strict_yaml
from tacshade_edge.settings.load import convert, expectation, schema_of
from tacshade_edge.settings.model import Placed, wrong_with
from tacshade_edge.types import IDENTITY_POSE, Disc


class VisibleCircle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of `SensorFile.visible_circle`."""

    row_px: Annotated[float, Meta(ge=-10000, le=20000, description="row of its centre")]
    col_px: Annotated[float, Meta(ge=-10000, le=20000, description="column of its centre")]
    radius_px: Annotated[float, Meta(ge=8, le=20000)]


_Size = Annotated[float, Meta(gt=0, le=20)]


class PrintSizes(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of `SensorFile.print`, from the sensor's drawing; each overrules what ``calibrate --fit`` finds."""

    pitch_mm: _Size | None = None
    pin_length_mm: _Size | None = None
    pin_tip_radius_mm: _Size | None = None
    pin_base_radius_mm: _Size | None = None
    marker_radius_mm: _Size | None = None


class SensorFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of SENSOR.yaml."""

    skin_radius_mm: Annotated[
        float, Meta(ge=1, le=200, description="radius of the undeformed skin")
    ]
    visible_half_angle_deg: Annotated[
        float, Meta(ge=5, le=85, description="of the visible circle, at the centre")
    ]
    polarity: (
        Annotated[
            Literal["bright", "dark"],
            Meta(description="bright when contact raises the white ratio"),
        ]
        | None
    ) = None
    camera_distance_mm: (
        Annotated[float, Meta(gt=0, le=1000, description="lens behind the skin's centre")] | None
    ) = None
    alpha: Annotated[
        float, Meta(gt=0, le=10000, description="the paper's depth scale, without presses")
    ] = 15.0
    binarisation: Literal["adaptive", "global", "otsu"] | None = None
    flange_T_sensor: Placed = msgspec.field(default_factory=lambda: list(IDENTITY_POSE))
    visible_circle: VisibleCircle | None = None
    print: PrintSizes | None = None


def check_value(key: str, text: str) -> float | str:
    """Check and return the value that a person typed for a key of SENSOR.yaml. Raises ConfigError."""
    kinds = {field.name: field.type for field in msgspec.structs.fields(SensorFile)}
    try:
        value: float | str = msgspec.convert(text, kinds[key], strict=False)
        if value == value:  # not NaN
            return value
    except msgspec.ValidationError:
        pass
    expected = expectation(schema_of(SensorFile)["properties"][key])
    raise ConfigError(f"{key}: found {text or 'nothing'}, expected {expected}")


def read_sensor(path: Path) -> Sensor:
    """Read SENSOR.yaml. Raises ConfigError."""
    file = strict_yaml.read(path)
    given = convert(file, SensorFile)
    if problem := wrong_with(given.flange_T_sensor):
        raise file.error(("flange_T_sensor",), problem)
    circle = given.visible_circle
    disc = None if circle is None else Disc(circle.row_px, circle.col_px, circle.radius_px)
    sizes = {} if given.print is None else msgspec.structs.asdict(given.print)
    others = {
        "flange_T_sensor": tuple(given.flange_T_sensor),
        "visible_circle": disc,
        "print_mm": {name: size for name, size in sizes.items() if size is not None},
    }
    plain = {
        name: value for name, value in msgspec.structs.asdict(given).items() if name != "print"
    }
    return Sensor(**plain | others)
