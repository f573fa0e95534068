"""A stranger whose mechanics this package solves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.lab.simulator.press import PAPER_OBJECTS
from tacshade_edge.lab.simulator.skin import chart_to_direction
from tacshade_edge.lab.studies.evaluate.work import PRESS_NOISE, REFERENCE_NOISE, SCENE_NOISE
from tacshade_edge.types import U8
from tools.studies.command import DEPTH_NOISE_MM, PLACE_NOISE_MM
from tools.studies.strangers.paths import BALL_MM, Dome, States, paths, states_file
from tools.studies.strangers.picture import Painter
from tools.studies.strangers.sensor import BALLS, REFERENCES, TOUCH_NOISE, TOUCHES, Seen
from tools.studies.strangers.surface import RestMm, Surface, View, seen, truth

COUNTS = {"judged": 2 * len(PAPER_OBJECTS), "touch": TOUCHES, "ball": BALLS}
"""Numbers of paths of each kind."""


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """A sensor whose states lie in a folder (`tools.studies.strangers.solve`)."""

    stated: StatedSensor
    dome: Dome
    rest: RestMm
    painter: Painter
    seed: int
    states: Path
    range_name: str
    number: int

    def references(self, count: int = REFERENCES) -> list[U8]:
        """Take pictures of the untouched skin."""
        drawn = self.painter.drawn(*self._views(untouched(self.rest)))
        return [self.painter.exposed(drawn, REFERENCE_NOISE + k) for k in range(count)]

    def touches(self, count: int = TOUCHES) -> list[U8]:
        """Take pictures of objects that touch it, mixed. Raises FileNotFoundError (not solved)."""
        return [
            self.painter.painted(*self._views(self._surface("touch", k, 0)), TOUCH_NOISE + k)
            for k in range(count)
        ]

    def balls(self, count: int = BALLS) -> Sequence[KnownPress]:
        """Press balls, with errors in the stated places and depths.

        Raises FileNotFoundError (not solved).
        """
        rng, made = np.random.default_rng((self.seed, 45)), []
        for k, path in enumerate(paths(self.dome, "ball", self.seed, count)):
            surface, press = self._surface("ball", k, 0), path.stops[0]
            image = self.painter.painted(*self._views(surface), PRESS_NOISE + k)
            x_mm, y_mm = (at + rng.normal(0, PLACE_NOISE_MM) for at in (press.x_mm, press.y_mm))
            depth_mm = path.depths_mm[0] + rng.normal(0, DEPTH_NOISE_MM)
            radius_mm = BALL_MM * press.scale
            made.append(KnownPress(f"press {k}", image, radius_mm, depth_mm, x_mm, y_mm))
        return made

    def judged(self) -> Iterator[Seen]:
        """Press and drag Table I's objects. Raises FileNotFoundError (not solved)."""
        inside = self.painter.inside > 0.5
        radius_mm = self.dome.radius_mm
        for k, path in enumerate(paths(self.dome, "judged", self.seed, COUNTS["judged"])):
            for stop, press in enumerate(path.stops):
                surface = self._surface("judged", k, stop)
                surface, view = self._views(surface)
                image = self.painter.painted(surface, view, SCENE_NOISE + 2 * k + stop)
                measured = truth(view, inside, press, radius_mm, self.rest)
                yield Seen(path.object_name, press.is_dragged, image, measured)

    def _surface(self, kind: str, k: int, stop: int) -> Surface:
        kept = States.read(states_file(self.states, self.range_name, self.number, kind, k))
        return Surface(kept.rest_mm, kept.stops_mm[stop], self.rest)

    def _views(self, surface: Surface) -> tuple[Surface, View]:
        half_angle_deg = self.stated.visible_half_angle_deg
        return surface, seen(surface, self.painter.camera, half_angle_deg, self.dome.radius_mm)


def untouched(rest: RestMm) -> Surface:
    """A skin that nothing touches."""
    x, y = np.meshgrid((-2.0, 0.0, 2.0), (-2.0, 0.0, 2.0))
    direction = chart_to_direction(x.ravel(), y.ravel(), 1.0)
    points = direction * rest(direction)[:, None]
    return Surface(points, points, rest)
