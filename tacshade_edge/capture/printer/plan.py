"""The presses of a plan that a printer can take, checked before anything moves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tacshade_edge.core.calibration.indenters.indenter import Indenter
from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.core.calibration.observation.touches import first_touch_mm
from tacshade_edge.errors import ConfigError
from tacshade_edge.settings.printer_file import PrinterFile
from tacshade_edge.storage.tables.capture_folder import Stated
from tacshade_edge.storage.tables.presses import BALL

BESIDE_START_MM = 5.0
"""So far the skin's axis may be from the stated start."""

# Beyond a third of the skin's radius depths are unreliable, and the skin is strained.
_DEEPEST_RADII = 1 / 3


@dataclass(frozen=True, slots=True)
class PlannedPress:
    """A press.

    Attributes
    ----------
    stated : Stated
        As the plan has it.
    indenter : Indenter or float
        A float is a ball's radius in mm.
    x_mm, y_mm, depth_mm : float
        As PRESSES.csv has them.
    """

    stated: Stated
    indenter: Indenter | float
    x_mm: float
    y_mm: float
    depth_mm: float

    @property
    def name(self) -> str:
        """Of the indenter, to be mounted."""
        indenter, radius_mm, *_ = self.stated.columns
        return f"{indenter} of {radius_mm} mm" if radius_mm else indenter

    def taken_as(self, yaw_deg: float) -> Stated:
        """What PRESSES.csv says of it: a ball has no yaw."""
        if not isinstance(self.indenter, Indenter):
            return self.stated
        return Stated((*self.stated.columns, f"{yaw_deg:.2f}", "", "", "", ""))

    def is_taken_as(self, taken: Stated) -> bool:
        """Whether this one was taken so, whatever the yaw was."""
        return taken.columns[: len(self.stated.columns)] == self.stated.columns


def planned_presses(
    plan: Sequence[Stated], indenters: Mapping[str, Indenter | float], sensor: Sensor, limits: PrinterFile
) -> tuple[PlannedPress, ...]:
    """Check a plan.

    Raises
    ------
    ConfigError
        A press without a place, outside what the camera sees, too deep, outside the printer's limits, of an indenter
        that would have to be turned or tilted; no ball.
    """
    presses = tuple(_planned(stated, indenters) for stated in plan)
    for press in presses:
        _check(press, sensor, limits)
    if not any(isinstance(press.indenter, float) for press in presses):
        raise ConfigError("--plan: found no press with a ball, expected at least one: ball presses locate the sensor")
    return presses


def check_reach(reach_mm: float, what: str, limits: PrinterFile) -> None:
    """Raises ConfigError where the head cannot be so far beside the skin's axis, on every side."""
    for axis, start, (least, most) in zip("xy", limits.start_mm, (limits.x_mm, limits.y_mm), strict=False):
        room_mm = min(start - least, most - start) - BESIDE_START_MM
        if reach_mm > room_mm:
            expected = f"expected at most {room_mm:.1f} mm, given {axis}_mm and start_mm in PRINTER.yaml"
            raise ConfigError(f"{what}: found a reach of {reach_mm:.1f} mm from the skin's axis, {expected}")


def _planned(stated: Stated, indenters: Mapping[str, Indenter | float]) -> PlannedPress:
    name, radius_mm, depth_mm, x_mm, y_mm, *more = stated.columns
    if any(more):
        raise ConfigError(
            f"--plan: {stated}: found yaw, tilt or shear, expected none: the head only moves straight down"
        )
    if not x_mm:
        raise ConfigError(f"--plan: {stated}: found no x_mm and y_mm, expected a place to press")
    indenter = float(radius_mm) if name == BALL else indenters[name]
    columns = Stated((name, radius_mm, depth_mm, x_mm, y_mm))
    return PlannedPress(columns, indenter, float(x_mm), float(y_mm), float(depth_mm))


def _check(press: PlannedPress, sensor: Sensor, limits: PrinterFile) -> None:
    r, what = sensor.skin_radius_mm, f"--plan: {press.stated}"
    beside_mm, visible_mm = (
        math.hypot(press.x_mm, press.y_mm),
        r * math.sin(math.radians(sensor.visible_half_angle_deg)),
    )
    if beside_mm > visible_mm:
        raise ConfigError(
            f"{what}: found a place {beside_mm:.1f} mm from the axis, expected at most {visible_mm:.1f} mm (in view)"
        )
    check_reach(beside_mm, what, limits)
    travel_mm = press.depth_mm - first_touch_mm(press.indenter, r, press.x_mm, press.y_mm)
    if not 0 < travel_mm <= _DEEPEST_RADII * r:
        expected = f"expected more than 0 and at most {_DEEPEST_RADII * r:.1f} mm"
        raise ConfigError(f"{what}: found {travel_mm:.1f} mm of travel from first touch, {expected}")
