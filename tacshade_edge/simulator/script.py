"""The scripted hand: presses in turn, as a function of the frame index."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press


@dataclass(frozen=True, slots=True)
class Script:
    """Each press in turn: approach, hold, release, and a pause without contact; then from the first again.

    Attributes
    ----------
    presses : tuple of Press
        At their greatest depth.
    approach, hold, release, pause : int
        Frames of each phase.
    """

    presses: tuple[Press, ...]
    approach: int = 10
    hold: int = 20
    release: int = 10
    pause: int = 20

    def __post_init__(self) -> None:
        """Refuse an empty script."""
        if not self.presses or min(self.approach, self.hold, self.release, self.pause) < 1:
            raise ValueError("a script needs a press, and a frame or more in every phase")

    @property
    def period(self) -> int:
        """Frames until the script begins again."""
        return len(self.presses) * self._turn

    @property
    def _turn(self) -> int:
        return self.pause + self.approach + self.hold + self.release

    def at(self, index: int) -> tuple[Press, ...]:
        """The presses of a frame: none or one. A turn begins with its pause, so frame 0 is without contact."""
        turn, frame = divmod(index % self.period, self._turn)
        press = self.presses[turn]
        frame -= self.pause
        if frame < 0:
            return ()
        if frame < self.approach:
            part = (frame + 1) / (self.approach + 1)
        elif frame < self.approach + self.hold:
            part = 1.0
        else:
            part = 1 - (frame - self.approach - self.hold + 1) / (self.release + 1)
        return (replace(press, depth_mm=press.depth_mm * part),)


def demonstration(depth_mm: float = 3.0, objects: Sequence[str] = ()) -> Script:
    """The hand of the demo: the named objects (all of them by default), each a little elsewhere and turned."""
    places = ((0.0, 0.0), (3.0, -2.0), (-4.0, 1.0), (1.0, 4.0), (-2.0, -3.0))
    names = tuple(objects) or tuple(OBJECTS)
    presses = tuple(
        Press(OBJECTS[name](), *places[k % len(places)], depth_mm, 25.0 * k % 360) for k, name in enumerate(names)
    )
    return Script(presses)
