"""What seems wrong with numbers, as values, and the sentence for each, in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Final


class SuspicionCode(Enum):
    """Everything that numbers may be suspected of."""

    # Times.
    STEPS_TOO_SHORT = auto()
    TIME_ROUNDED = auto()
    TIME_FRACTION = auto()
    TABLE_EDITED = auto()
    CLOCK_RATE = auto()
    CLOCK_COUNTS_DOWN = auto()
    CLOCK_STANDS = auto()
    # Poses.
    ONE_POSE = auto()
    POSES_CLOSE = auto()
    POSES_APART = auto()
    POSES_UNIT = auto()
    POSES_READING = auto()
    POSES_SCATTERED = auto()
    PLACES_SMALL = auto()
    PLACES_SHORT = auto()
    PLACES_FAST = auto()
    FINGERS_CLOSE = auto()
    FINGERS_APART = auto()
    # Labels.
    LABEL_UNIT = auto()
    LABEL_SIGN = auto()
    LABELS_SWAPPED = auto()
    LABELS_SHIFTED = auto()
    LABEL_CONSTANT = auto()
    LABEL_UNSHOWN = auto()
    # Presses and the sensor that they are of.
    ROWS_OF_OTHERS = auto()
    CIRCLE_STATED = auto()


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A code, what its sentence says by names with units, and whether the numbers cannot be as they
    stand (else they might).
    """

    code: SuspicionCode
    values: Mapping[str, object] = field(default_factory=dict)
    impossible: bool = False

    def __str__(self) -> str:
        values = {
            name: f" in {value}?" if name == "unit" else value
            for name, value in self.values.items()
            if value is not None
        }
        values.setdefault("unit", " in another unit?")
        return SUSPICION_SENTENCES[self.code].format(**values)


def suspicion(code: SuspicionCode, *, impossible: bool = False, **values: object) -> Suspicion:
    """A suspicion with the values of its sentence."""
    return Suspicion(code, values, impossible)


SUSPICION_SENTENCES: Final[Mapping[SuspicionCode, str]] = {
    SuspicionCode.STEPS_TOO_SHORT: (
        "t_ns: found frames {step_ns:g} ns apart, expected at least {least_ns} ns: "
        "are the times{unit}"
    ),
    SuspicionCode.TIME_ROUNDED: (
        "t_ns: found {found}, expected a whole number of nanoseconds: has a spreadsheet rounded it?"
    ),
    SuspicionCode.TIME_FRACTION: (
        "t_ns: found {found}, expected a whole number of nanoseconds: are the times in s?"
    ),
    SuspicionCode.TABLE_EDITED: (
        "no line has its checksum: was the table edited? without its column crc32 it is read as "
        "it stands"
    ),
    SuspicionCode.CLOCK_RATE: (
        "found the robot's times to pass {rate:.3g} times as fast as time, expected ns: "
        "are they{unit}"
    ),
    SuspicionCode.CLOCK_COUNTS_DOWN: (
        "found the robot's times to go backwards, expected ns that increase"
    ),
    SuspicionCode.CLOCK_STANDS: (
        "found the robot's time to stand still while it sends, expected ns that increase"
    ),
    SuspicionCode.ONE_POSE: (
        "x_mm to qz: found one pose for all {rows} presses, which differ by {rms_mm:.2f} mm, "
        "expected the pose of each"
    ),
    SuspicionCode.POSES_CLOSE: (
        "x_mm, y_mm, z_mm span {spread_mm:.2g} mm: found presses at one place, expected them to "
        "stand apart, with a sensor of {size_mm:.2g} mm: are they{unit}"
    ),
    SuspicionCode.POSES_APART: (
        "x_mm, y_mm, z_mm: found presses {apart_mm:.3g} mm from the nearest others, expected "
        "neighbours that overlap, with a sensor of {size_mm:.2g} mm: are they{unit}"
    ),
    SuspicionCode.POSES_UNIT: (
        "x_mm, y_mm, z_mm span {spread_mm:.2g} mm: found presses that disagree by "
        "{stated_mm:.2f} mm where they overlap, expected {rms_mm:.2f} mm as with another unit: "
        "are they{unit}"
    ),
    SuspicionCode.POSES_READING: (
        "x_mm to qz: found presses that disagree by {stated_mm:.2f} mm where they overlap, "
        "expected {rms_mm:.2f} mm as if read otherwise: {reading}"
    ),
    SuspicionCode.POSES_SCATTERED: (
        "x_mm to qz: found presses that nowhere overlap, expected them to agree within "
        "{rms_mm:.2f} mm as if read otherwise: {reading}"
    ),
    SuspicionCode.PLACES_SMALL: (
        "found presses {factor:.2g} times as deep as the robot moved, and all its places within "
        "{span_mm:.2g} mm, expected x, y, z in mm: are they{unit}"
    ),
    SuspicionCode.PLACES_SHORT: (
        "found presses {factor:.2g} times as deep as the robot moved in them, expected x, y, z in "
        "mm: are they{unit}"
    ),
    SuspicionCode.PLACES_FAST: (
        "found the robot to move at {speed_m_s:.2g} m/s and more, expected x, y, z in mm: "
        "are they{unit}"
    ),
    SuspicionCode.FINGERS_CLOSE: (
        "found {apart_mm:.2g} mm from {other}, expected sensors that do not overlap, with x, y, z "
        "in mm: are they{unit}"
    ),
    SuspicionCode.FINGERS_APART: (
        "found {apart_mm:.3g} mm from {other}, expected the sensors of one hand, with x, y, z "
        "in mm: are they{unit}"
    ),
    SuspicionCode.LABEL_UNIT: (
        "{name} spans {span:.2g}: found labels that the frames show {factor:.3g} times as large, "
        "expected {expected}: are they{unit}"
    ),
    SuspicionCode.LABEL_SIGN: (
        "{name}: found labels that fall as what the frames show rises, expected both to rise: has "
        "it the opposite sign?"
    ),
    SuspicionCode.LABELS_SWAPPED: (
        "{name}, {other}: found each to go with what the frames show of the other, expected its "
        "own: are they swapped?"
    ),
    SuspicionCode.LABELS_SHIFTED: (
        "found labels that go with no frame but that of another row, expected each image's own: "
        "{order}"
    ),
    SuspicionCode.LABEL_CONSTANT: (
        "{name}: found {value:g} in all {rows} rows that have it, expected values that differ"
    ),
    SuspicionCode.LABEL_UNSHOWN: (
        "{name}: found labels that do not go with the depths in the frames (correlation "
        "{correlation:.2f} in {rows} frames), expected each image's own: are the rows in another "
        "order, or of other images?"
    ),
    SuspicionCode.ROWS_OF_OTHERS: (
        "found places and depths that fit no image but that of another row, expected each image's "
        "own: {order}"
    ),
    SuspicionCode.CIRCLE_STATED: (
        "visible_circle: found row {row_px:g}, column {col_px:g}, radius {radius_px:g}, expected "
        "row_px: {expected_row_px:.0f}, col_px: {expected_col_px:.0f}, "
        "radius_px: {expected_radius_px:.0f} as the image shows: {reading}"
    ),
}
"""The sentence of each; `{unit}` and `{reading}` end with a question mark."""
