"""The planned presses for a printer, checked before anything moves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.core.calibration.machine import first_touch_mm
from tacshade_edge.errors import ConfigError
from tacshade_edge.settings.sensor_file import PrinterFile
from tacshade_edge.storage.tables.capture_folder import Stated
from tacshade_edge.storage.tables.presses import BALL

BESIDE_START_MM = 5.0
"""Greatest distance of the skin's axis from the stated start."""

# Beyond a third of the skin's radius, depths are unreliable and the press strains the skin.
_DEEPEST_RADII = 1 / 3


@dataclass(frozen=True, slots=True)
class PlannedPress:
    """A press that the plan asks for. `stated`: the press as the plan states it. `indenter`: a float is a ball's radius
    in mm. `x_mm`, `y_mm`, `depth_mm`: place and depth, defined as in PRESSES.csv.
    """

    stated: Stated
    indenter: Indenter | float
    x_mm: float
    y_mm: float
    depth_mm: float

    @property
    def name(self) -> str:
        """Name of the indenter to mount."""
        indenter, radius_mm, *_ = self.stated.columns
        return f"{indenter} of {radius_mm} mm" if radius_mm else indenter

    def taken_as(self, yaw_deg: float) -> Stated:
        """Return the row of PRESSES.csv for this press; a ball has no yaw."""
        if not isinstance(self.indenter, Indenter):
            return self.stated
        return Stated((*self.stated.columns, f"{yaw_deg:.2f}", "", "", "", ""))

    def is_taken_as(self, taken: Stated) -> bool:
        """Whether `taken` is this press, at any yaw."""
        return taken.columns[: len(self.stated.columns)] == self.stated.columns


def planned_presses(
    plan: Sequence[Stated], indenters: Mapping[str, Indenter | float], sensor: Sensor, limits: PrinterFile
) -> tuple[PlannedPress, ...]:
    """Check a plan and return its presses. Raises ConfigError (a press has no place, lies outside the camera's view or
    the printer's limits, has no travel or too much, or states yaw, tilt or shear; or no press is with a ball).
    """
    presses = tuple(_planned(stated, indenters) for stated in plan)
    for press in presses:
        _check(press, sensor, limits)
    if not any(isinstance(press.indenter, float) for press in presses):
        raise ConfigError("--plan: found no ball press, expected at least one, because ball presses locate the sensor")
    return presses


def check_reach(reach_mm: float, what: str, limits: PrinterFile) -> None:
    """Raise ConfigError unless the head can move `reach_mm` from the skin's axis on every side."""
    for axis, start, (least, most) in zip("xy", limits.start_mm, (limits.x_mm, limits.y_mm), strict=False):
        room_mm = min(start - least, most - start) - BESIDE_START_MM
        if reach_mm > room_mm:
            expected = f"expected at most {room_mm:.1f} mm, the limit set by {axis}_mm and start_mm in PRINTER.yaml"
            raise ConfigError(f"{what}: found a reach of {reach_mm:.1f} mm from the skin's axis, {expected}")


def _planned(stated: Stated, indenters: Mapping[str, Indenter | float]) -> PlannedPress:
    name, radius_mm, depth_mm, x_mm, y_mm, *more = stated.columns
    if any(more):
        raise ConfigError(
            f"--plan: {stated}: found yaw, tilt or shear, expected none of them; the printer presses straight down"
        )
    if not x_mm:
        raise ConfigError(f"--plan: {stated}: found no x_mm and y_mm, expected both")
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
            f"{what}: found a place {beside_mm:.1f} mm from the skin's axis, "
            f"expected at most {visible_mm:.1f} mm, the radius of the visible skin"
        )
    check_reach(beside_mm, what, limits)
    travel_mm = press.depth_mm - first_touch_mm(press.indenter, r, press.x_mm, press.y_mm)
    if not 0 < travel_mm <= _DEEPEST_RADII * r:
        expected = f"expected more than 0 mm and at most {_DEEPEST_RADII * r:.1f} mm"
        raise ConfigError(f"{what}: found {travel_mm:.1f} mm of travel from first touch, {expected}")
