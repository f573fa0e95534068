"""The study of recognition, on descriptions whose objects lie far apart."""

from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.lab.simulator.press import Shape
from tacshade_edge.sensor.inference.object_names import load_metric
from tools.studies import recognise
from tools.studies.recognise import Described, answers, text
from tools.testbed.simulator.household import HOUSEHOLD
from tools.training.random_solids import random_solid


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> list[Described]:
    """Two sensors; touches of an object scatter little,
    but those of `stranger` are touches of `b`.
    """
    monkeypatch.setattr(recognise, "SETS", {"some": (("a", "b", "c"), ("stranger", "far"))})
    metric = load_metric()
    random = np.random.default_rng(1)
    places = {name: random.normal(size=len(metric.middle)) for name in ("a", "b", "c", "far")}
    places["stranger"] = places["b"]
    made = []
    for sensor in ("1", "other:2"):
        for name, place in places.items():
            off = place + 0.05 * random.normal(size=(recognise.TOUCHES, len(place)))
            touches = (metric.middle + metric.spread * off).astype(np.float32)
            made.append(Described(sensor, "fast", name, touches, 0.5))
    return made


def test_each_sensor_teaches_and_the_other_is_asked(described: list[Described]) -> None:
    rows = answers(described)
    assert {(row.taught_on, row.sensor) for row in rows} == {("1", "other:2"), ("other:2", "1")}
    assert all(row.nearest == row.object for row in rows if not row.stranger)
    single = [row for row in rows if row.form == "3 taught"]
    assert len(single) == 2 * 5 * recognise.TOUCHES
    together = [row for row in rows if row.form == "3 taught, 3 touches together"]
    assert len(together) == 2 * 5 * recognise.TOUCHES // 3
    assert {row.name for row in rows if row.object == "stranger"} == {"b"}
    assert all(0 < row.probability <= 1 for row in rows if row.name)


def test_the_tables_say_how_often_names_are_right(described: list[Described]) -> None:
    printed = text({"fast": 0.5}, answers(described))
    line = next(line for line in printed.splitlines() if "3 taught |" in line)
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[:7] == ["some", "fast", "3 taught", "100.0", "0.0", "0.0", "100.0"]
    assert float(cells[-1]) < 100  # one of the two strangers is as `b`
    assert "| fast | 0.50 |" in " ".join(printed.split())


def test_solids_stand_on_their_origin() -> None:
    grid = np.linspace(-12, 12, 97)
    x, y = (each.ravel() for each in np.meshgrid(grid, grid))
    shapes: list[Shape] = [*HOUSEHOLD.values(), *map(random_solid, range(24))]
    for shape in shapes:
        below = shape.sdf(np.stack((x, y, np.full(x.size, -0.05)), axis=1))
        inside = shape.sdf(np.stack((x, y, np.full(x.size, 0.4)), axis=1))
        assert below.min() > 0, shape.name
        assert inside.min() < 0, shape.name
