"""What a calibration finds, as values: a code and its numbers (`sentences` has the words)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum, auto

from tacshade_edge.types import Geometry


class FindingCode(Enum):
    """Everything that a calibration may find."""

    # References.
    FEW_REFERENCES = auto()
    REFERENCES_DIFFER = auto()
    CAMERA_MOVED = auto()
    PRESSED_PATCH = auto()
    PRESSED_CENTRE = auto()
    PRESSED_MARKERS = auto()
    PRESSED_IMAGES = auto()
    REFERENCE_PRESSED = auto()
    NO_RIM = auto()
    MARKERS_OUTSIDE = auto()
    CIRCLE_STATED = auto()
    FINE_PATTERN = auto()
    WHITE_PINS = auto()
    NO_WHITE_PINS = auto()
    # One press.
    PRESS_SIZE = auto()
    PRESS_IMPOSSIBLE = auto()
    PRESS_UNUSABLE = auto()
    PRESS_CHANGED = auto()
    NO_CONTACT = auto()
    OTHER_DEPTH = auto()
    OTHER_PLACE = auto()
    LARGER_BALL = auto()
    SMALLER_BALL = auto()
    LOOKS_LARGER = auto()
    LOOKS_SMALLER = auto()
    OTHER_SKIN = auto()
    # All presses.
    FEW_PRESSES = auto()
    MANY_LEFT_OUT = auto()
    DEPTH_UNIT = auto()
    AXES = auto()
    OTHER_ROWS = auto()
    DIAMETERS = auto()
    HALVED_RADII = auto()
    SKIN_SIZE = auto()
    POLARITY = auto()
    WRONG_KEYS = auto()
    TRAVEL = auto()
    DEPTHS_TOO_GREAT = auto()
    DEPTHS_TOO_SMALL = auto()
    UNKNOWN_KIND = auto()
    UNUSUAL_ERRORS = auto()
    FITTABLE_ERRORS = auto()
    # The verdict and its advice.
    UNCALIBRATED = auto()
    NO_PRESSES = auto()
    CONTACTS_NOT_FOUND = auto()
    LOOK_AT_PRESSES = auto()
    DEPTH_WITHIN = auto()
    MORE_PRESSES = auto()
    CLOSE_TOGETHER = auto()
    EMPTY_SIDES = auto()
    SAME_DEPTHS = auto()
    SHALLOW = auto()
    SAME_INDENTER = auto()
    DISAGREEING = auto()
    REPEAT = auto()


class Axes(StrEnum):
    """Another reading of x and y in PRESSES.csv."""

    SWAPPED = "x and y are swapped"
    X_OPPOSITE = "x has the opposite sign"
    Y_OPPOSITE = "y has the opposite sign"
    BOTH_OPPOSITE = "x and y have the opposite sign"
    SWAPPED_OPPOSITE = "x and y are swapped and have the opposite sign"
    TURNED_LEFT = "the axes are turned by 90 degrees"
    TURNED_RIGHT = "the axes are turned by -90 degrees"
    CM = "x and y are in cm"
    INCHES = "x and y are in inches"
    METRES = "x and y are in m"
    MICROMETRES = "x and y are in µm"
    PIXELS = "x and y are columns and rows in px"
    PIXELS_SWAPPED = "x and y are rows and columns in px"
    PIXELS_FROM_MIDDLE = "x and y are in px from the middle of the visible circle"


class SizeMistake(StrEnum):
    """What may be stated in place of a skin's radius in mm."""

    DIAMETER = "a diameter"
    HALF = "half of the radius"
    CM = "in cm"


@dataclass(frozen=True, slots=True)
class BetterValue:
    """A key of SENSOR.yaml with which the presses fit far better: stated (None: not), expected."""

    key: str
    stated: float | None
    expected: float


@dataclass(frozen=True, slots=True)
class BetterForm:
    """A form of the skin with which the presses fit far better."""

    stated: Geometry
    expected: Geometry


@dataclass(frozen=True, slots=True)
class CalibrationFinding:
    """What was found: a code, the press's name (empty: not of one), whether that press is left out,
    and what the code's sentence says, by names with units.
    """

    code: FindingCode
    values: Mapping[str, object] = field(default_factory=dict)
    press: str = ""
    left_out: bool = False


def finding(
    code: FindingCode, press: str = "", *, left_out: bool = False, **values: object
) -> CalibrationFinding:
    """A finding with the values of its sentence."""
    return CalibrationFinding(code, values, press, left_out)
