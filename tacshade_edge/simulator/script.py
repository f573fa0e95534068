"""The scripted hand: presses in turn, as a function of the frame index."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press

_DRAG_STEPS = 3  # drawing a new position takes as long as several frames, a held one costs nothing


@dataclass(frozen=True, slots=True)
class Drag:
    """The motion of an object along the skin while it is held: `Press.drag_x_mm` and so on."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    twist_deg: float = 0.0


@dataclass(frozen=True, slots=True)
class Script:
    """A sequence of presses at their greatest depth, before the drag: each is a pause without contact, approach, hold
    and release, of as many frames; repeats after the last. One drag per press, cyclically, is made in few steps over
    the middle half of the hold and kept through the release, which then has equally few steps.
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
        """The presses of a frame: none or one. A turn begins with its pause, so frame 0 is without contact."""
        turn, frame = divmod(index % self.period, self._turn)
        press = self.presses[turn]
        drag = self.drags[turn % len(self.drags)] if self.drags else Drag()
        frame -= self.pause
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


def demonstration(depth_mm: float = 3.0, objects: Sequence[str] = ()) -> Script:
    """The script of the demo: the named objects (by default all), each shifted and turned a little. Of every five, one
    is dragged, one so far that it slips fully, and one is dragged and twisted.
    """
    places = ((0.0, 0.0), (3.0, -2.0), (-4.0, 1.0), (1.0, 4.0), (-2.0, -3.0))
    drags = (Drag(), Drag(-2.5, 0.5), Drag(), Drag(-5.0, -4.0), Drag(2.0, 1.0, 10.0))
    names = tuple(objects) or tuple(OBJECTS)
    presses = tuple(
        Press(OBJECTS[name](), *places[k % len(places)], depth_mm, 25.0 * k % 360) for k, name in enumerate(names)
    )
    return Script(presses, drags=drags)
