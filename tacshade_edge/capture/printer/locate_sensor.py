"""Locates the sensor under the printer from a ball's touches and pictures of the pressed skin."""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.capture.printer.plan import BESIDE_START_MM
from tacshade_edge.capture.printer.safety_stop import SafetyStop
from tacshade_edge.capture.printer.touch import Touch
from tacshade_edge.core.calibration.inputs import KnownPress, Sensor
from tacshade_edge.core.calibration.observation.press_observation import pictured_places
from tacshade_edge.core.calibration.observation.touches import Stand, first_touch_mm, skin_centre, stand, yaw_of
from tacshade_edge.types import F64, Calibration

# Rings of touches around the start and then the axis (radii in skin radii); at the axis the ball presses further.
_AROUND_START, _AROUND_START_RADII = 3, 0.2
_AROUND_AXIS, _AROUND_AXIS_RADII, _TURNED_RAD, _PRESSED_MM = 6, 0.4, 0.35, 1.0
_VISIBLE_PART = 0.6


def reach_mm(sensor: Sensor) -> float:
    """Distance of the outer touches from the axis, mm."""
    visible = math.sin(math.radians(sensor.visible_half_angle_deg))
    return sensor.skin_radius_mm * min(_AROUND_AXIS_RADII, _VISIBLE_PART * visible)


def locate_sensor(
    touch: Touch, start_mm: tuple[float, float], ball_mm: float, sensor: Sensor, unloaded: Calibration
) -> tuple[Stand, float]:
    """Find where the sensor stands; a ball is mounted in the head.

    Parameters
    ----------
    touch : Touch
        Its head is free, above the start.
    start_mm : (x, y)
    ball_mm : float
        The ball's radius.
    sensor : Sensor
    unloaded : Calibration
        From the references.

    Returns
    -------
    stand : Stand
    rms_mm : float
        Distance of the touches from the fitted skin, root mean square.

    Raises
    ------
    ConfigError
        The touches or pictures do not fit this sensor.
    Stopped, SafetyStop, DeviceError
    """
    r, start = sensor.skin_radius_mm, np.array(start_mm)
    touch.detector.learn_rest()
    touches = [(*start_mm, touch.from_afar())]
    touch.free_over(touches[0][2])
    for x, y in (start + _ring(_AROUND_START, _AROUND_START_RADII * r, 0.0)).tolist():
        touches.append((x, y, touch.from_near(x, y, touches[0][2])))
        touch.lift()
    centre, _ = skin_centre(np.array(touches), r, ball_mm)
    if (beside_mm := math.dist(centre[:2], start)) > BESIDE_START_MM:
        found = f"found the skin's axis {beside_mm:.1f} mm from start_mm, at x {centre[0]:.1f}, y {centre[1]:.1f} mm"
        raise SafetyStop(f"{found}, expected at most {BESIDE_START_MM:g} mm; move the sensor or correct start_mm")
    touch.free_over(centre[2] + r)
    around, pressed = _ring(_AROUND_AXIS, reach_mm(sensor), _TURNED_RAD), []
    for beside_x, beside_y in around.tolist():
        x, y, first_mm = centre[0] + beside_x, centre[1] + beside_y, first_touch_mm(ball_mm, r, beside_x, beside_y)
        z = touch.from_near(x, y, centre[2] + math.sqrt(r * r - beside_x**2 - beside_y**2) - first_mm)
        touches.append((x, y, z))
        touch.down(z, z - _PRESSED_MM)
        image = touch.detector.still_image()
        touch.lift()
        pressed.append(KnownPress("", image, ball_mm, first_mm + _PRESSED_MM, None, None))
    centre, rms_mm = skin_centre(np.array(touches), r, ball_mm)
    put = np.array(touches)[-_AROUND_AXIS:, :2] - centre[:2]
    found_stand = stand(centre, yaw_of(put, pictured_places(unloaded, pressed)), r)
    touch.free_over(centre[2] + r)
    return found_stand, rms_mm


def _ring(count: int, radius_mm: float, turned_rad: float) -> F64:
    angle = turned_rad + 2 * math.pi * np.arange(count) / count
    return radius_mm * np.column_stack((np.cos(angle), np.sin(angle)))
