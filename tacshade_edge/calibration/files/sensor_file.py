"""SENSOR.yaml: a person's description of a sensor, for ``tacshade-edge calibrate``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.settings import strict_yaml
from tacshade_edge.settings.conversion import convert, expectation, schema_of
from tacshade_edge.settings.model import Placed, wrong_with
from tacshade_edge.types import IDENTITY_POSE, Disc, Skin

MAX_HALF_ANGLE_DEG = 85.0


class VisibleCircle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of `_SensorFile.visible_circle`."""

    row_px: Annotated[float, Meta(ge=-10000, le=20000, description="row of its centre")]
    col_px: Annotated[float, Meta(ge=-10000, le=20000, description="column of its centre")]
    radius_px: Annotated[float, Meta(ge=8, le=20000)]


_Size = Annotated[float, Meta(gt=0, le=20)]


class PrintSizes(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of `_SensorFile.print`, from the sensor's drawing;
    each overrules what ``calibrate --fit`` finds.
    """

    pitch_mm: _Size | None = None
    pin_length_mm: _Size | None = None
    pin_tip_radius_mm: _Size | None = None
    pin_base_radius_mm: _Size | None = None
    marker_radius_mm: _Size | None = None


_Radius = Annotated[
    float, Meta(ge=1, le=200, description="radius of the visible circle on the skin, mm")
]


class _SensorFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of SENSOR.yaml for either form of skin."""

    skin: Annotated[Skin, Meta(description="a hemisphere or a flat skin")] = "dome"
    polarity: (
        Annotated[
            Literal["bright", "dark"],
            Meta(description="bright when contact raises the white ratio"),
        ]
        | None
    ) = None
    alpha: Annotated[
        float, Meta(gt=0, le=10000, description="the paper's depth scale, without presses")
    ] = 15.0
    binarisation: Literal["adaptive", "global", "otsu"] | None = None
    flange_T_sensor: Placed = msgspec.field(default_factory=lambda: list(IDENTITY_POSE))
    visible_circle: VisibleCircle | None = None
    print: PrintSizes | None = None


class DomeFile(_SensorFile, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of SENSOR.yaml for a dome, which states the half angle or the radius
    of its visible circle.
    """

    skin_radius_mm: Annotated[
        float, Meta(ge=1, le=10000, description="radius of the undeformed skin")
    ]
    visible_half_angle_deg: (
        Annotated[
            float,
            Meta(ge=5, le=MAX_HALF_ANGLE_DEG, description="of the visible circle, at the centre"),
        ]
        | None
    ) = None
    visible_radius_mm: _Radius | None = None
    camera_distance_mm: (
        Annotated[float, Meta(ge=-10000, le=1000, description="lens behind the skin's centre")]
        | None
    ) = None


class PadFile(_SensorFile, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of SENSOR.yaml for a pad."""

    visible_radius_mm: _Radius
    camera_distance_mm: (
        Annotated[float, Meta(gt=0, le=1000, description="lens behind the skin's plane")] | None
    ) = None


KINDS: Mapping[Skin, type[DomeFile | PadFile]] = {"dome": DomeFile, "pad": PadFile}


def check_value(key: str, text: str, skin: Skin = "dome") -> float | str:
    """Check and return the value that a person typed for a key of SENSOR.yaml.

    Raises ConfigError.
    """
    kind = KINDS[skin]
    kinds = {field.name: field.type for field in msgspec.structs.fields(kind)}
    try:
        value: float | str = msgspec.convert(text, kinds[key], strict=False)
        if value == value:  # not NaN
            return value
    except msgspec.ValidationError:
        pass
    expected = expectation(schema_of(kind)["properties"][key])
    raise ConfigError(f"{key}: found {text or 'nothing'}, expected {expected}")


def read_sensor(path: Path) -> StatedSensor:
    """Read SENSOR.yaml. Raises ConfigError."""
    file = strict_yaml.read(path)
    is_pad = isinstance(file.value, dict) and file.value.get("skin") == "pad"
    # Each form has keys of its own, so a mistake names those of the form that was meant.
    given = convert(file, KINDS["pad" if is_pad else "dome"])
    if problem := wrong_with(given.flange_T_sensor):
        raise file.error(("flange_T_sensor",), problem)
    circle = given.visible_circle
    disc = None if circle is None else Disc(circle.row_px, circle.col_px, circle.radius_px)
    sizes = {} if given.print is None else msgspec.structs.asdict(given.print)
    return StatedSensor(
        **_form(file, given),
        polarity=given.polarity,
        alpha=given.alpha,
        binarisation=given.binarisation,
        flange_T_sensor=tuple(given.flange_T_sensor),
        visible_circle=disc,
        print_mm={name: size for name, size in sizes.items() if size is not None},
    )


def _form(file: strict_yaml.YamlFile, given: DomeFile | PadFile) -> dict[str, Any]:
    """Skin and camera as fields of `StatedSensor`.

    Raises ConfigError if a dome cannot be seen so.
    """
    distance_mm = given.camera_distance_mm
    if isinstance(given, PadFile):
        flat = {"skin_radius_mm": math.inf, "visible_half_angle_deg": 0.0}
        return flat | {"pad_radius_mm": given.visible_radius_mm, "camera_distance_mm": distance_mm}
    r, angle_deg = given.skin_radius_mm, given.visible_half_angle_deg
    if (angle_deg is None) == (given.visible_radius_mm is None):
        found = "neither it nor" if angle_deg is None else "it and also"
        problem = f"found {found} visible_radius_mm, expected one of both"
        raise file.error(("visible_half_angle_deg",), problem)
    if angle_deg is None:
        assert given.visible_radius_mm is not None
        most_mm = r * math.sin(math.radians(MAX_HALF_ANGLE_DEG))
        if given.visible_radius_mm > most_mm:
            problem = f"found {given.visible_radius_mm:g}, expected at most {most_mm:g}"
            raise file.error(("visible_radius_mm",), f"{problem} on a skin of this radius")
        angle_deg = math.degrees(math.asin(given.visible_radius_mm / r))
    least_mm = -r * math.cos(math.radians(angle_deg))
    if distance_mm is not None and not distance_mm > least_mm:
        problem = f"found {distance_mm:g}, expected a lens behind the visible circle"
        raise file.error(("camera_distance_mm",), f"{problem}, above {least_mm:.1f}")
    form = {"skin_radius_mm": r, "visible_half_angle_deg": angle_deg}
    return form | {"camera_distance_mm": distance_mm}
