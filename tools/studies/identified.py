"""How well the identified TacShade gives Table I:
on other prints and places, and what the networks give there.

.venv/bin/python -m tools.studies.identified

The paper's method takes each press's own α and the reading that the search found
(tools/studies/identify_tacshade.py).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

from tacshade_edge.lab.simulator.press import PAPER_OBJECTS
from tacshade_edge.lab.simulator.tacshade import DEPTH_MM, OBJECT_SCALE, TACSHADE
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.lab.studies.evaluate.accuracy import PAPER_ROW
from tacshade_edge.lab.studies.evaluate.score import KnownTruth, Label, score
from tacshade_edge.lab.studies.evaluate.work import (
    PRESSES,
    REFERENCES,
    calibrated_sensor,
    one_thread,
    reconstructor,
)
from tacshade_edge.types import Frame
from tools.studies.command import NETWORKS
from tools.studies.identify_tacshade import TRUE_ME_MM, me_table
from tools.studies.paper_readings import (
    PressedObject,
    Reading,
    calibrated,
    pressed_object,
    scores,
)

READING = Reading(tv_weight=0.3, saturates=True)
"""The reading with which the sensor gives Table I."""
PRINTS = 3
MIDDLE_MM = (0.0, 0.0)
ELSEWHERE_MM = ((3.0, 1.0), (-2.0, -4.0))
Line = tuple[str, tuple[float, ...]]


def by_the_paper() -> Iterator[Line]:
    """The paper's MEs on the sensor, without eq. 11, with the usual reading,
    on other prints and off the middle.
    """
    own = TACSHADE.print_seed
    yield _by_the_paper("the identified TacShade", own)
    yield _by_the_paper("without eq. 11", own, eq_11=False)
    yield _by_the_paper("as the profile `paper` reads it", own, Reading())
    for seed in range(PRINTS):
        yield _by_the_paper(f"print {seed}", seed)
    for place_mm in ELSEWHERE_MM:
        x, y = place_mm
        yield _by_the_paper(f"pressed at {x:g}, {y:g} mm", own, place_mm=place_mm)


def _by_the_paper(
    what: str,
    print_seed: int,
    reading: Reading = READING,
    *,
    place_mm: tuple[float, float] = MIDDLE_MM,
    eq_11: bool = True,
) -> Line:
    sensor = SimulatedSensor(replace(TACSHADE, print_seed=print_seed))
    ((_, found),) = scores(
        calibrated(sensor), tacshade_presses(sensor, place_mm), [reading], eq_11=eq_11
    )
    return what, tuple(each.me_mm for each in found)


def tacshade_presses(
    sensor: SimulatedSensor, place_mm: tuple[float, float] = MIDDLE_MM
) -> list[PressedObject]:
    """Press Table I's objects into the identified sensor, or one with another print."""
    scale = OBJECT_SCALE * 20 / sensor.model.skin_radius_mm
    return [pressed_object(sensor, name, DEPTH_MM, place_mm, scale) for name in PAPER_OBJECTS]


def by_networks() -> Iterator[Line]:
    """The MEs of the shipped networks, calibrated as a user does."""
    sensor = SimulatedSensor(TACSHADE)
    calibration = calibrated_sensor(sensor, 0, REFERENCES, PRESSES).calibration
    pressed = tacshade_presses(sensor)
    for name in ("paper", *NETWORKS):
        made = reconstructor(calibration, name)
        rows = [
            score(
                Label("tacshade", each.name),
                KnownTruth.of(each.truth),
                made.step(Frame(0, 0, 0, each.image)),
            )
            for each in pressed
        ]
        yield f"{name}, as shipped", tuple(row.me_mm for row in rows)


def main() -> int:
    """Print the table."""
    with one_thread():
        print(me_table([(PAPER_ROW, TRUE_ME_MM), *by_the_paper(), *by_networks()]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
