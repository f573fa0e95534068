from __future__ import annotations

import pytest

from tacshade_edge.studies.evaluate.sensors import SensorName
from tacshade_edge.studies.parallel import ThisProcess
from tools.studies.margin.work import Group, HeldRow, LoadRow, Plan, study


@pytest.mark.slow
def test_loads_and_a_hold() -> None:
    group = Group("some", ((SensorName("other", 1), None),), ("ball",))
    rows = study(Plan("fast", (group,), held_s=1.0), ThisProcess(), lambda what, done, of: None)
    (held,) = [row for row in rows if isinstance(row, HeldRow)]
    assert held.least_stuck > 0.5
    loads = [row for row in rows if isinstance(row, LoadRow)]
    assert "pulled" in [row.load for row in loads]
    for row in loads:
        assert 0.5 <= row.reach_s <= 2.0
        assert 0.8 < row.onset_s < 5.0
