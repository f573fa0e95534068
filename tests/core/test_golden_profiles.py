"""Every object once, by every profile, against tests/golden/profiles.json (support/golden_profiles.py)."""

from __future__ import annotations

import json

import pytest
from support.golden_profiles import GOLDEN, figures

TOLERANCE = 0.03
"""For another machine's rounding, in mm or grey levels; twice what one without AVX-512 took from the golden replay."""
CELLS, CELLS_RATIO = 4, 0.03


@pytest.mark.slow
def test_every_profile_finds_what_it_found() -> None:
    golden = json.loads(GOLDEN.read_text())
    found = figures()
    assert len(found) == len(golden)
    for mine, theirs in zip(found, golden, strict=True):
        cells = mine.pop("cells", 0), theirs.pop("cells", 0)
        assert cells[0] == pytest.approx(cells[1], abs=CELLS, rel=CELLS_RATIO), theirs
        lengths = {name for name, value in theirs.items() if isinstance(value, float)}
        assert mine == {
            name: pytest.approx(value, abs=TOLERANCE) if name in lengths else value
            for name, value in theirs.items()
        }
