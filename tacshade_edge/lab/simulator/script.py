"""Scripted presses: the demo's hand, as a function of the frame index,
and the ball presses that calibrate a sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel

# Drawing a new position takes as long as several frames, a held one costs nothing.
_DRAG_STEPS = 3
# Any number of turns by it leaves no gaps (the sunflower of Vogel, 1979).
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True, slots=True)
class Drag:
    """The motion of an object along the skin while it is held: `Press.drag_x_mm` and so on."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    twist_deg: float = 0.0


@dataclass(frozen=True, slots=True)
class Script:
    """A sequence of presses at their greatest depth, before the drag: each is a pause without
    contact, approach, hold and release, of as many frames; repeats after the last. One drag per
    press, cyclically, is made in few steps over the middle half of the hold and kept through the
    release, which then has equally few steps.
    """

    presses: tuple[Press, ...]
    approach: int = 10
    hold: int = 20
    release: int = 10
    pause: int = 20
    drags: tuple[Drag, ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError for an empty script."""
        if not self.presses or min(self.approach, self.hold, self.release, self.pause) < 1:
            raise ValueError("a script needs a press, and a frame or more in every phase")

    @property
    def period(self) -> int:
        """Number of frames until the script repeats."""
        return len(self.presses) * self._turn

    @property
    def _turn(self) -> int:
        return self.pause + self.approach + self.hold + self.release

    def at(self, index: int) -> tuple[Press, ...]:
        """The presses of a frame: none or one.

        A turn begins with its pause, so frame 0 is without contact.
        """
        turn, frame = divmod(index % self.period, self._turn)
        press = self.presses[turn]
        drag = self.drags[turn % len(self.drags)] if self.drags else Drag()
        frame -= self.pause
        # The pause comes first, so that frame 0 is without contact.
        if frame < 0:
            return ()
        if frame < self.approach:
            return (_part_way(press, (frame + 1) / (self.approach + 1)),)
        frame -= self.approach
        if frame < self.hold:
            step = math.floor((frame / self.hold - 0.25) * 2 * _DRAG_STEPS) + 1
            return (_moved(press, drag, min(max(step / _DRAG_STEPS, 0.0), 1.0)),)
        frame -= self.hold
        steps = self.release if drag == Drag() else min(_DRAG_STEPS, self.release)
        part = 1 - (frame * steps // self.release + 1) / (steps + 1)
        return (_part_way(_moved(press, drag, 1.0), part),)


def _part_way(press: Press, part: float) -> Press:
    return replace(press, depth_mm=press.depth_mm * part)


def _moved(press: Press, drag: Drag, part: float) -> Press:
    x_mm, y_mm, turn_deg = part * drag.x_mm, part * drag.y_mm, part * drag.twist_deg
    return replace(
        press,
        x_mm=press.x_mm + x_mm,
        y_mm=press.y_mm + y_mm,
        rotation_deg=press.rotation_deg + turn_deg,
        drag_x_mm=x_mm,
        drag_y_mm=y_mm,
        twist_deg=turn_deg,
    )


def demonstration() -> Script:
    """The script of the demo: all objects, each shifted and turned a little. Of every five, one
    is dragged, one so far that it slips fully, and one is dragged and twisted.
    """
    places = ((0.0, 0.0), (3.0, -2.0), (-4.0, 1.0), (1.0, 4.0), (-2.0, -3.0))
    drags = (Drag(), Drag(-2.5, 0.5), Drag(), Drag(-5.0, -4.0), Drag(2.0, 1.0, 10.0))
    presses = tuple(
        Press(make(), *places[k % len(places)], 3.0, 25.0 * k % 360)
        for k, make in enumerate(OBJECTS.values())
    )
    return Script(presses, drags=drags)


def ball_presses(model: SensorModel, count: int, seed: int = 0) -> list[tuple[Press, float]]:
    """Draw ball presses and the radius of each ball in mm: places on a sunflower over the inner two
    thirds of the visible disc; radii (3 to 9 mm) and depths (0.5 to 4 mm) stratified, then
    shuffled, so that any subset covers their ranges. All lengths are for a skin of 20 mm and scale
    with its radius.
    """
    rng = np.random.default_rng((seed, 4))
    scale = model.skin_radius_mm / 20
    reach = 0.66 * model.skin_radius_mm * math.sin(math.radians(model.visible_half_angle_deg))

    def stratified(low: float, high: float) -> list[float]:
        # One from each of as many equal parts, so that few presses cover the range too.
        cells = (rng.permutation(count) + rng.uniform(0, 1, count)) / max(count, 1)
        return [round(float(low + (high - low) * c) * scale, 3) for c in cells]

    presses = []
    for k, (radius, depth) in enumerate(
        zip(stratified(3.0, 9.0), stratified(0.5, 4.0), strict=True)
    ):
        # The root spreads them evenly over the area, not over the radius.
        rho, angle = reach * math.sqrt((k + 0.5) / count), k * _GOLDEN_ANGLE
        x, y = round(rho * math.cos(angle), 3), round(rho * math.sin(angle), 3)
        presses.append((Press(ball(radius), x, y, depth), radius))
    return presses
