from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tacshade_edge.core.calibration.observation.press_observation import PressObservation
from tacshade_edge.core.calibration.presses.coverage import advice, missing_coverage, widest_gap
from tacshade_edge.simulator.calibration_set import ball_presses
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))
VISIBLE_MM = 20 * math.sin(math.radians(50))
PRESSES = [
    PressObservation(f"press {k}", 5.0, 5.0, 20.0, p.x_mm, p.y_mm, radius_mm, p.depth_mm, p.x_mm, p.y_mm)
    for k, (p, radius_mm) in enumerate(ball_presses(SensorModel(), 24))
]


def missing(presses: list[PressObservation]) -> str:
    return "\n".join(missing_coverage(presses, GEOMETRY))


def test_presses_spread_over_everything_miss_nothing() -> None:
    assert missing(PRESSES) == ""
    assert missing([replace(o, x_mm=None, y_mm=None) for o in PRESSES]) == ""


def test_few_presses() -> None:
    assert "12 presses: 20 to 40" in missing(PRESSES[::2])


def test_places_close_together_or_on_one_side() -> None:
    together = [replace(o, x_mm=(o.x_mm or 0) / 5, y_mm=(o.y_mm or 0) / 5) for o in PRESSES]
    assert (
        f"close together, around x 0, y 0 mm: depth elsewhere is a guess; add presses up to {0.66 * VISIBLE_MM:.0f}"
        in (missing(together))
    )
    assert "no press lies at x < 0: " in missing([replace(o, x_mm=abs(o.x_mm or 0)) for o in PRESSES])
    assert "no press lies at y > 0: " in missing([replace(o, y_mm=-abs(o.y_mm or 0)) for o in PRESSES])


def test_depths_alike_or_none_deep() -> None:
    alike = [replace(o, depth_mm=1 + k / 46) for k, o in enumerate(PRESSES)]
    assert "all presses are 1.0 to 1.5 mm deep: other depths are a guess; add some from 0.5 to 4.0 mm" in missing(alike)
    assert "no press is deeper than 1.9 mm" in missing([replace(o, depth_mm=o.depth_mm / 2) for o in PRESSES])


@pytest.mark.parametrize(
    ("radii", "wanted"),
    [((6.0, 6.0), "all balls have a radius of 6 mm"), ((5.0, 6.0), "all balls have radii of 5 to 6")],
)
def test_ball_radii_alike(radii: tuple[float, float], wanted: str) -> None:
    assert wanted in missing([replace(o, radius_mm=radii[k % 2]) for k, o in enumerate(PRESSES)])


def test_following_the_advice_covers_everything() -> None:
    presses = [replace(PRESSES[0], x_mm=1.0, y_mm=0.0, depth_mm=2.0, radius_mm=6.0)]
    assert "; all balls have a radius of 6 mm: " in advice(presses, GEOMETRY)
    while missing_coverage(presses, GEOMETRY):
        assert len(presses) < 30
        x_mm, y_mm, depth_mm = widest_gap(presses, GEOMETRY)
        assert f"the next press helps most around x {x_mm:.0f}, y {y_mm:.0f} mm, {depth_mm:.1f} mm deep" in advice(
            presses, GEOMETRY
        )
        assert math.hypot(x_mm, y_mm) <= 0.67 * VISIBLE_MM
        assert 0.5 <= depth_mm <= 4.0
        radius_mm = (3.0, 6.0, 9.0)[len(presses) % 3]
        presses.append(replace(presses[0], x_mm=x_mm, y_mm=y_mm, depth_mm=depth_mm, radius_mm=radius_mm))
    assert advice(presses, GEOMETRY).startswith("16 presses cover everything; one more helps most around x ")
