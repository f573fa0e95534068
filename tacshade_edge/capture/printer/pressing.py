"""The whole sequence: home, mount, locate the sensor, then touch, dry run and presses for each indenter.

Any doubt ends the run. The head lifts the indenter only if its position is certain; otherwise M112 stops the printer.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

import numpy as np

from tacshade_edge.capture.live import Live, Terminal
from tacshade_edge.capture.printer.head import Head, KeypressStop
from tacshade_edge.capture.printer.line import PrinterLine, SafetyStop, Stopped
from tacshade_edge.capture.printer.plan import BESIDE_START_MM, PlannedPress, check_reach
from tacshade_edge.capture.printer.touch import NEAR_MM, ContactDetector, Touch
from tacshade_edge.capture.session import Session
from tacshade_edge.core.calibration.inputs import KnownPress, Sensor
from tacshade_edge.core.calibration.machine import Stand, first_touch_mm, skin_centre, stand, yaw_of
from tacshade_edge.core.calibration.observation import pictured_places
from tacshade_edge.core.calibration.presses.press_check import PressCheck
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.protocol import gcode
from tacshade_edge.settings.sensor_file import PrinterFile
from tacshade_edge.types import F64, Calibration

# Rings of touches around the start and then the axis (radii in skin radii); at the axis the ball presses further.
_AROUND_START, _AROUND_START_RADII = 3, 0.2
_AROUND_AXIS, _AROUND_AXIS_RADII, _TURNED_RAD, _PRESSED_MM = 6, 0.4, 0.35, 1.0
_VISIBLE_PART = 0.6


class Pressing:
    """One run of ``capture --printer``. `session`: holds the references and the table of presses. `line`: connected."""

    def __init__(
        self,
        session: Session,
        live: Live,
        terminal: Terminal,
        line: PrinterLine,
        limits: PrinterFile,
        sensor: Sensor,
        presses: Sequence[PlannedPress],
    ) -> None:
        check_reach(reach_mm(sensor), "finding the sensor", limits)
        self._session = session
        self._live = live
        self._terminal = terminal
        self._line = line
        self._limits = limits
        self._sensor = sensor
        self._keypress = KeypressStop(terminal)
        self._head = Head(line, limits, self._keypress)
        self._left = _without_taken(presses, session)
        self._ball, self._ball_mm = next((p.name, p.indenter) for p in presses if isinstance(p.indenter, float))

    def run(self) -> None:
        """Take the remaining presses of the plan. Raises DeviceError (the run stopped: states why, and what was done
        with the head. The folder keeps what was taken before), InputEnded.
        """
        try:
            with _ended_by_signals():
                self._run_until_doubt()
        except KeyboardInterrupt:
            if self._head.was_moved and not self._head.is_free:
                self._terminal.say(self._line.emergency_stop())
            raise

    def _run_until_doubt(self) -> None:
        try:
            self._run()
        except (Stopped, DeviceError, ConfigError) as error:
            raise DeviceError(f"stopped: {error}; {self._leave()}") from None

    def _run(self) -> None:
        if not self._left:
            self._terminal.say("all planned presses are taken")
            return
        self._home()
        self._live.ask(
            f"Mount the sensor under the head, skin up, and {self._ball} in the head, which stays up "
            "until you press Enter. While it moves, any key stops and lifts it; Ctrl-C stops it at once (M112)."
        )
        unloaded = self._session.unloaded()
        self._check = PressCheck(unloaded)
        self._touch = Touch(self._head, ContactDetector(self._live, self._check, self._keypress), self._limits.z_mm[0])
        with self._terminal.keys():
            self._stand = self._found_stand(unloaded)
        mounted, lower_mm = self._ball, 0.0
        for name in dict.fromkeys(press.name for press in self._left):
            presses = [press for press in self._left if press.name == name]
            if name != mounted:
                with self._terminal.keys():
                    self._head.to_start()
                match self._live.ask(
                    f"Mount {name}, its x along the printer's x; press Enter to continue, or type skip or done:"
                ):
                    case "skip":
                        continue
                    case "done":
                        break
                with self._terminal.keys():
                    lower_mm = self._lower_mm(presses[0])
                mounted = name
            with self._terminal.keys():
                self._dry_run(presses, lower_mm)
                for press in presses:
                    self._press(press, lower_mm)
        with self._terminal.keys():
            self._head.to_start()

    def _home(self) -> None:
        self._terminal.say(f"printer: {self._line.firmware}")
        if gcode.stay_awake(self._line.firmware) is None:
            self._terminal.say("How this firmware keeps idle motors on is not known: set that on the printer itself.")
        text, answers = "Take the sensor off the bed and the indenter off the head, then type home (G28).", ["home"]
        if not self._line.has_restarted:
            text += " If you homed the printer before and it has been on since, type homed instead:"
            answers.append("homed")
        while (answer := self._live.ask(text)) not in answers:
            pass
        with self._terminal.keys():
            self._head.prepare(home=answer == "home")
            self._head.to_start()

    def _found_stand(self, unloaded: Calibration) -> Stand:
        self._terminal.say("looking for the skin ...")
        x, y, _ = self._limits.start_mm
        found, rms_mm = locate_sensor(self._touch, (x, y), self._ball_mm, self._sensor, unloaded)
        tip_x, tip_y, tip_z = found.head_mm(0.0, 0.0, 0.0)
        place = f"its axis at x {tip_x:.2f}, y {tip_y:.2f}, its tip at z {tip_z:.2f} mm"
        self._terminal.say(
            f"found the sensor: {place}, turned by {found.yaw_deg:.1f} degrees; the touches fit within {rms_mm:.3f} mm"
        )
        return found

    def _lower_mm(self, press: PlannedPress) -> float:
        """Return how much higher the head must be with this indenter, in mm, from a touch at the axis."""
        self._head.free_z_mm = self._limits.start_mm[2]
        first_mm = first_touch_mm(press.indenter, self._sensor.skin_radius_mm, 0.0, 0.0)
        x, y, z = self._stand.head_mm(0.0, 0.0, first_mm)
        self._head.over(x, y)
        touch_z = self._touch.from_afar()
        self._touch.free_over(touch_z)
        self._terminal.say(f"{press.name}: touches the tip at z {touch_z:.2f} mm")
        return touch_z - z

    def _dry_run(self, presses: Sequence[PlannedPress], lower_mm: float) -> None:
        self._terminal.say(f"dry run: visiting {len(presses)} places {NEAR_MM:g} mm above the skin ...")
        self._touch.detector.learn_free()
        for press in presses:
            touch_z, _ = self._over(press, lower_mm)
            self._touch.down(touch_z, touch_z + NEAR_MM)
            self._touch.lift()

    def _press(self, press: PlannedPress, lower_mm: float) -> None:
        touch_z, to_z = self._over(press, lower_mm)
        self._touch.detector.learn_free()
        self._touch.down(touch_z, to_z)
        image = self._touch.detector.still_image()
        self._touch.lift()
        if reason := self._session.keep(image, press.taken_as(self._stand.indenter_yaw_deg), self._check):
            raise SafetyStop(f"{press.stated}: {reason}")
        self._left.remove(press)

    def _over(self, press: PlannedPress, lower_mm: float) -> tuple[float, float]:
        """Move above a place; return z at first touch and at full depth. Raises SafetyStop if the circle changed."""
        if self._session.circle_changed:
            raise SafetyStop("the visible circle changed after the printer located the sensor; start again")
        x, y, yaw_deg = press.x_mm, press.y_mm, self._stand.indenter_yaw_deg
        first_mm = first_touch_mm(press.indenter, self._sensor.skin_radius_mm, x, y, yaw_deg)
        place_x, place_y, touch_z = self._stand.head_mm(x, y, first_mm)
        self._head.over(place_x, place_y)
        return touch_z + lower_mm, touch_z + lower_mm - (press.depth_mm - first_mm)

    def _leave(self) -> str:
        """Lift the indenter if that is certainly safe, otherwise stop the printer; return what was done, in words."""
        if not self._head.was_moved:
            return "the head has not moved"
        if self._head.is_free:
            return "the head stands still above the skin"
        if self._head.is_certain:
            try:
                with self._terminal.keys():
                    self._head.to(self._head.free_z_mm)
            except (Stopped, DeviceError) as error:
                return f"lifting the indenter failed too ({error}); {self._line.emergency_stop()}"
            return "the head lifted the indenter off"
        return self._line.emergency_stop()


def _without_taken(presses: Sequence[PlannedPress], session: Session) -> list[PlannedPress]:
    taken = [one.stated for one in session.taken]
    left = []
    for press in presses:
        if (same := next((one for one in taken if press.is_taken_as(one)), None)) is not None:
            taken.remove(same)
        else:
            left.append(press)
    return left


def reach_mm(sensor: Sensor) -> float:
    """Distance of the outer touches from the axis, mm."""
    visible = math.sin(math.radians(sensor.visible_half_angle_deg))
    return sensor.skin_radius_mm * min(_AROUND_AXIS_RADII, _VISIBLE_PART * visible)


def locate_sensor(
    touch: Touch, start_mm: tuple[float, float], ball_mm: float, sensor: Sensor, unloaded: Calibration
) -> tuple[Stand, float]:
    """Find where the sensor stands; a ball is mounted in the head.

    `touch`: its head is free, above the start. `ball_mm`: the ball's radius. `unloaded`: from the references. Returns
    `rms_mm`: distance of the touches from the fitted skin, root mean square. Raises ConfigError (the touches or
    pictures do not fit this sensor), Stopped, SafetyStop, DeviceError.
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


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Let a closed terminal (SIGHUP) and SIGTERM stop the printer as a keypress does."""

    def end(number: int, _frame: FrameType | None) -> NoReturn:
        raise Stopped(f"the program received {signal.Signals(number).name}")

    before = {number: signal.signal(number, end) for number in (signal.SIGTERM, signal.SIGHUP)}
    # A shell's background jobs start with SIGINT ignored, but Ctrl-C must stop the head.
    before[signal.SIGINT] = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
