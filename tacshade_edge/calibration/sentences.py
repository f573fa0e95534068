"""The sentence for each finding, in one place.

What checks images and tables decides by codes; only what speaks to a person makes sentences. A
command names its files and options in them by a `Wording` of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tacshade_edge.calibration.findings import (
    BetterForm,
    BetterValue,
    CalibrationFinding,
    FindingCode,
)
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import Disc, Geometry


@dataclass(frozen=True, slots=True)
class Wording:
    """How a command speaks: what it appends to a sentence on an option that helps, by code; and
    what it calls SENSOR.yaml and PRESSES.csv.
    """

    options: Mapping[FindingCode, str] = field(default_factory=dict)
    sensor_file: str = "SENSOR.yaml"
    press_table: str = "PRESSES.csv"


PLAIN = Wording()
"""No command's: without options, files by their generic names."""


class FindingError(ConfigError):
    """Findings with which there is no calibration. The text is in `PLAIN` words."""

    def __init__(
        self, *findings: CalibrationFinding, others: Sequence[CalibrationFinding] = ()
    ) -> None:
        super().__init__(_sentences(findings, PLAIN), others=[sentence(one) for one in others])
        self.findings = findings

    def __reduce__(self) -> tuple[Any, ...]:
        # An exception is made again from its text by default: one from another process has to be
        # made from its findings.
        return type(self), self.findings, self.__dict__

    def worded(self, wording: Wording) -> ConfigError:
        """The same in a command's words."""
        return ConfigError(_sentences(self.findings, wording), others=self.others)


def sentence(found: CalibrationFinding, wording: Wording = PLAIN) -> str:
    """What a finding says to a person, in one line."""
    words = {
        name: _WORDS[name](value) if name in _WORDS else value
        for name, value in found.values.items()
    }
    said = SENTENCES[found.code].format(
        option=wording.options.get(found.code, ""),
        sensor_file=wording.sensor_file,
        press_table=wording.press_table,
        **words,
    )
    lead = f"{found.press}: " if found.press else ""
    return f"{lead}{said}{'; left out' if found.left_out else ''}"


def _sentences(findings: Sequence[CalibrationFinding], wording: Wording) -> str:
    return "; ".join(sentence(one, wording) for one in findings)


def circle_to_state(disc: Disc) -> str:
    """The advice to state a circle, with the line of SENSOR.yaml."""
    circle = (
        f"{{row_px: {disc.row_c:.0f}, col_px: {disc.col_c:.0f}, radius_px: {disc.radius_px:.0f}}}"
    )
    return (
        f"; measure it in the image and state it in SENSOR.yaml, such as `visible_circle: {circle}`"
    )


def _better(found: Sequence[BetterValue | BetterForm]) -> str:
    return "; or ".join(
        f"{_skins(one) if isinstance(one, BetterForm) else _value(one)} by the presses"
        for one in found
    )


def _value(found: BetterValue) -> str:
    stated = "none" if found.stated is None else f"{found.stated:.4g}"
    return f"{found.key}: found {stated}, expected about {found.expected:.0f}"


def _skins(found: BetterForm) -> str:
    return f"skin: found {_skin(found.stated)}, expected {_skin(found.expected)}"


def _skin(geometry: Geometry) -> str:
    """A skin as keys of SENSOR.yaml with values."""
    d = geometry.camera_distance_mm
    lens = "no camera_distance_mm" if d is None else f"camera_distance_mm {d:.0f}"
    if geometry.skin == "pad":
        return f"a pad (visible_radius_mm {geometry.visible_radius_mm:.0f}, {lens})"
    r, half = geometry.skin_radius_mm, geometry.visible_half_angle_deg
    return f"a dome (skin_radius_mm {r:.0f}, visible_half_angle_deg {half:.0f}, {lens})"


def _pressed_images(names: Sequence[str]) -> str:
    others = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{others}"


def _pressed_by(indenter: str | float) -> str:
    """An indenter's name, or the radius of a ball."""
    return indenter if isinstance(indenter, str) else f"a ball of {indenter:g} mm"


def _used(indenter: str | tuple[float, float]) -> str:
    """An indenter's name, or the least and greatest radius of balls."""
    if isinstance(indenter, str):
        return indenter
    low, high = indenter
    return f"balls of radius {low:g}{f' to {high:g}' if high > low else ''} mm"


def _worst(presses: Sequence[tuple[str, float]]) -> str:
    return ", ".join(f"{name} ({error_mm:.1f} mm off)" for name, error_mm in presses)


_NAMED = 3
"""A sentence names at most this many images."""
_WORDS: Mapping[str, Callable[[Any], str]] = {
    "better": _better,
    "circle": circle_to_state,
    "first": sentence,
    "load": sentence,
    "images": _pressed_images,
    "of": _pressed_by,
    "sides": " or ".join,
    "used": _used,
    "worst": _worst,
}
"""How values that are more than a number or a name are said, by their names."""
SENTENCES: Mapping[FindingCode, str] = {
    FindingCode.FEW_REFERENCES: (
        "references: found {found}, expected {expected} to measure noise; "
        "assuming {noise_grey} grey levels"
    ),
    FindingCode.REFERENCES_DIFFER: "reference {name}: {change} compared with reference {against}",
    FindingCode.CAMERA_MOVED: (
        "reference {name}: {change} since reference {against}; "
        "fasten the camera and take all references again"
    ),
    FindingCode.PRESSED_PATCH: (
        "the skin seems pressed in the reference: {area_mm2:.0f} mm² differ from the skin around "
        "the centre"
    ),
    FindingCode.PRESSED_CENTRE: (
        "the skin's centre seems pressed in the reference: "
        "its profile bends by {bend_grey:.0f} grey levels"
    ),
    FindingCode.PRESSED_MARKERS: (
        "the skin seems pressed in the reference: "
        "the markers around row {row_px:.0f}, column {col_px:.0f} stand {percent:.0f} % too far "
        "apart"
    ),
    FindingCode.PRESSED_IMAGES: (
        "the skin seems pressed in reference {images}, compared with the mean of all references"
    ),
    FindingCode.REFERENCE_PRESSED: "{load}; take the references again without contact{option}",
    FindingCode.NO_RIM: (
        "visible circle: found the circle around the outermost markers, not a rim that ends "
        "them{circle}"
    ),
    FindingCode.MARKERS_OUTSIDE: (
        "{sensor_file}: visible_circle: found {percent:.0f} % or more of the markers outside it, "
        "expected nearly all inside{option}"
    ),
    FindingCode.CIRCLE_STATED: "{sensor_file}: {suspicion}",
    FindingCode.FINE_PATTERN: (
        "markers: found a pitch of {found_px:.1f} px, expected at least {expected_px:g}: heights "
        "may be off up to twice as much; take larger images (source.width_px)"
    ),
    FindingCode.WHITE_PINS: (
        "polarity: found {found}, expected {expected}: "
        "the reference shows white pins on black, as of a TacTip"
    ),
    FindingCode.NO_WHITE_PINS: (
        "polarity: found {found}, expected {expected}: the reference shows no white pins on black"
    ),
    FindingCode.PRESS_SIZE: "found {found} px, expected {expected} px as in the reference",
    FindingCode.PRESS_IMPOSSIBLE: (
        "found a depth of {depth_mm} mm and a ball radius of {radius_mm} mm, "
        "expected a depth above 0 and below {most_mm:g} mm and a radius above 0"
    ),
    FindingCode.PRESS_UNUSABLE: "{reason}",
    FindingCode.PRESS_CHANGED: "{change} since the references were taken",
    FindingCode.NO_CONTACT: "the image shows no contact, expected one {depth_mm} mm deep",
    FindingCode.OTHER_DEPTH: (
        "found a depth of {found_mm:.2f} mm, "
        "expected {expected_mm:.2f} mm by the other presses with {of}"
    ),
    FindingCode.OTHER_PLACE: (
        "found x {found_x_mm:.1f}, y {found_y_mm:.1f} mm, "
        "expected x {expected_x_mm:.1f}, y {expected_y_mm:.1f} mm, as the image shows"
    ),
    FindingCode.LARGER_BALL: (
        "found a ball of {found_mm:g} mm, expected about {expected_mm:.1f} mm, as the image shows"
    ),
    FindingCode.SMALLER_BALL: (
        "found a ball of {found_mm:g} mm, expected about {expected_mm:.1f} mm, as the image "
        "shows: is {found_mm:g} mm its diameter?"
    ),
    FindingCode.LOOKS_LARGER: (
        "this looks like a ball of about {seen_mm:.0f} mm: is its radius {stated_mm:g} mm?"
    ),
    FindingCode.LOOKS_SMALLER: (
        "this looks like a ball of about {seen_mm:.0f} mm: is {stated_mm:g} mm its diameter?"
    ),
    FindingCode.OTHER_SKIN: "{percent:.0f} % of it does not show this sensor's skin",
    FindingCode.FEW_PRESSES: (
        "found {found} presses, expected at least {expected} (20 give better results)"
    ),
    FindingCode.MANY_LEFT_OUT: (
        "{unusable} of {presses} presses are unusable; the first one: {first}"
    ),
    FindingCode.DEPTH_UNIT: (
        "{press_table}: depth_mm: the images show presses about {factor:.0f} times as deep as "
        "stated: are the depths in {unit}? expected mm"
    ),
    FindingCode.AXES: (
        "{press_table}: x_mm, y_mm: the places fit within {expected_mm:.1f} mm, "
        "not {found_mm:.1f} mm, if {axes}"
    ),
    FindingCode.OTHER_ROWS: (
        "{press_table}: {suspicion} the picture of {image} shows the values of {row}"
    ),
    FindingCode.DIAMETERS: (
        "{press_table}: radius_mm: the images show balls of about {factor:.1f} times the stated "
        "radii: are they diameters? expected radii in mm"
    ),
    FindingCode.HALVED_RADII: (
        "{press_table}: radius_mm: the images show balls of about {factor:.1f} times the stated "
        "radii: are they halved? expected radii in mm"
    ),
    FindingCode.SKIN_SIZE: (
        "{sensor_file}: {key}: found {found_mm:g}, but with it the images show presses about "
        "{factor:.1f} times as large as {press_table}: is it {mistake}? "
        "expected about {expected_mm:.0f}"
    ),
    FindingCode.POLARITY: (
        "{sensor_file}: polarity: found {found}, expected {expected}: "
        "the places fit within {expected_mm:.1f} mm with it, not {found_mm:.1f} mm"
    ),
    FindingCode.WRONG_KEYS: "{sensor_file}: {better}",
    FindingCode.TRAVEL: (
        "{press_table}: depth_mm: found travel from first touch, judging by the images: "
        "{option}state the undeformed skin's z at (x, y) minus the z "
        "of the indenter's lowest point (docs/reference/calibration-files.md)"
    ),
    FindingCode.DEPTHS_TOO_GREAT: (
        "the depths fit better if all are {by_mm:.1f} mm less: check where depth is zero"
    ),
    FindingCode.DEPTHS_TOO_SMALL: (
        "the depths fit better if all are {by_mm:.1f} mm more: check where depth is zero"
    ),
    FindingCode.UNKNOWN_KIND: (
        "unlike the sensors that the networks know: "
        "they do not explain {percent:.0f} % of the median press"
    ),
    FindingCode.UNUSUAL_ERRORS: (
        "heights are off {factor:.1f} times as much as on sensors that the networks know, "
        "and their intervals are that much wider"
    ),
    FindingCode.FITTABLE_ERRORS: (
        "heights are off {factor:.1f} times as much as on sensors that the networks know, "
        "and their intervals are that much wider{option}"
    ),
    FindingCode.UNCALIBRATED: (
        "uncalibrated: depth assumes an average sensor of this kind; "
        "only {option}presses can measure its error on this one"
    ),
    FindingCode.NO_PRESSES: "take 20 to 40 presses{option} (docs/how-to/calibration.md)",
    FindingCode.CONTACTS_NOT_FOUND: (
        "poor: the learned profiles find the contact at the indenter in too few presses for a fit"
    ),
    FindingCode.LOOK_AT_PRESSES: (
        "look at the presses' images, places and depths, and at SENSOR.yaml"
    ),
    FindingCode.DEPTH_WITHIN: (
        "{grade}: depth is within {mean_mm:.2f} mm of the stated depth on average, "
        "{worst_mm:.2f} mm at worst, on held-out presses (profile {profile})"
    ),
    FindingCode.MORE_PRESSES: (
        "{found} presses: 20 to 40 make the depth and its error more certain"
    ),
    FindingCode.CLOSE_TOGETHER: (
        "the presses lie close together, around x {x_mm}, y {y_mm} mm: "
        "add some up to {reach_mm:.0f} mm from the middle"
    ),
    FindingCode.EMPTY_SIDES: (
        "no press lies at {sides}: add some up to {reach_mm:.0f} mm from the middle"
    ),
    FindingCode.SAME_DEPTHS: (
        "all presses are {low_mm:.1f} to {high_mm:.1f} mm deep: "
        "add some from {shallow_mm:.1f} to {deep_mm:.1f} mm"
    ),
    FindingCode.SHALLOW: (
        "no press is deeper than {deepest_mm:.1f} mm: add some down to {deep_mm:.1f} mm"
    ),
    FindingCode.SAME_INDENTER: (
        "all presses use {used}: other sizes and shapes are less certain; "
        "add balls of {low_mm:.0f} to {high_mm:.0f} mm"
    ),
    FindingCode.DISAGREEING: (
        "the presses agree with each other only within {mean_mm:.2f} mm: "
        "measure their depths and places more exactly"
    ),
    FindingCode.REPEAT: "repeat these presses, or more like them: {worst}",
}
"""The sentence of each finding; `{option}` is what a command's `Wording` says there."""
