"""The third family (../third_family) as strangers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.lab.simulator.render import Renderer
from tacshade_edge.lab.simulator.skin import undeformed
from tacshade_edge.lab.studies.evaluate.score import KnownTruth
from tacshade_edge.lab.studies.evaluate.work import REFERENCE_NOISE, SCENE_NOISE
from tacshade_edge.types import F64, U8
from tools.studies.strangers.sensor import BALLS, REFERENCES, TOUCH_NOISE, TOUCHES, Seen
from tools.studies.third_family.domes import (
    FIRST_SEED,
    Kept,
    Way,
    deformed,
    drawn,
    kept_file,
    renderer,
    seen_truth,
)
from tools.studies.third_family.judging import DRAGGED, dragged_ways, known_balls

WAYS, PRESSES = 3, 12
"""Numbers of solved paths, which are dragged and give two pictures each, and presses:
touches take them in turn.
"""


@dataclass(frozen=True, slots=True)
class Third:
    """A sensor whose states `tools.studies.third_family.solve` wrote into a folder."""

    range_name: str
    number: int
    states: Path

    @property
    def stated(self) -> StatedSensor:
        """What its user writes into SENSOR.yaml."""
        model, _ = drawn(self.range_name, self.number)
        return StatedSensor(
            model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, "bright"
        )

    def references(self, count: int = REFERENCES) -> list[U8]:
        """Take pictures of the untouched skin."""
        draws = self._renderer()
        untouched = draws.draw(undeformed(self.stated.skin_radius_mm))
        return [draws.expose(untouched, REFERENCE_NOISE + k) for k in range(count)]

    def touches(self, count: int = TOUCHES) -> list[U8]:
        """Take pictures of the first objects that touch it.

        Raises FileNotFoundError (not solved).
        """
        states = []
        for k in range(WAYS):
            kept = self._kept("", k)
            states += [(kept.rest_mm, kept.pressed_mm), (kept.rest_mm, kept.dragged_mm)]
        for k in range(PRESSES):
            kept = self._kept("press", k)
            states.append((kept.rest_mm, kept.pressed_mm))
        draws = self._renderer()
        return [
            self._picture(draws, *states[k % len(states)], noise_seed=TOUCH_NOISE + k)
            for k in range(count)
        ]

    def balls(self, count: int = BALLS) -> Sequence[KnownPress]:
        """Press balls. Raises FileNotFoundError (not solved)."""
        return known_balls(self.range_name, self.number, count, self.states)

    def judged(self) -> Iterator[Seen]:
        """Press and drag Table I's objects. Raises FileNotFoundError (not solved)."""
        _, dome = drawn(self.range_name, self.number)
        draws = self._renderer()
        for k, way in enumerate(dragged_ways(dome, FIRST_SEED[self.range_name] + self.number)):
            kept = self._kept(DRAGGED, k)
            for dragged in (False, True):
                yield self._seen(draws, way, kept, dragged, SCENE_NOISE + 2 * k + dragged)

    def _renderer(self) -> Renderer:
        model, _ = drawn(self.range_name, self.number)
        return renderer(model, FIRST_SEED[self.range_name] + self.number)

    def _kept(self, what: str, number: int) -> Kept:
        return Kept.read(kept_file(self.states, self.range_name, self.number, what, number))

    def _picture(self, draws: Renderer, rest_mm: F64, at_mm: F64, noise_seed: int) -> U8:
        skin = deformed(self.stated.skin_radius_mm, rest_mm, at_mm)
        return draws.expose(draws.draw(skin), noise_seed)

    def _seen(self, draws: Renderer, way: Way, kept: Kept, dragged: bool, noise_seed: int) -> Seen:
        radius_mm = self.stated.skin_radius_mm
        skin = deformed(radius_mm, kept.rest_mm, kept.dragged_mm if dragged else kept.pressed_mm)
        press = way.press if dragged else way.pressed(radius_mm)
        found = seen_truth(skin, (press,), drawn(self.range_name, self.number)[0])
        truth = replace(KnownTruth.of(found), height_mm=found.height_mm)
        return Seen(way.object_name, dragged, draws.expose(draws.draw(skin), noise_seed), truth)
