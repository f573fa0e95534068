"""Every object once, by every profile, against tests/golden/profiles
(support/golden_profiles.py).
"""

from __future__ import annotations

import json
from itertools import chain

import pytest

from support.golden_profiles import GOLDEN, figures

TOLERANCE = 0.03
"""For another machine's rounding, in mm or grey levels;
twice what one without AVX-512 took from the golden replay.
"""
CELLS, CELLS_RATIO = 4, 0.03


@pytest.mark.slow
def test_every_profile_finds_what_it_found() -> None:
    found = figures()
    assert {path.stem for path in GOLDEN.glob("*.json")} == set(found)
    golden = {name: json.loads((GOLDEN / f"{name}.json").read_text()) for name in found}
    pairs = (zip(found[name], golden[name], strict=True) for name in found)
    for mine, theirs in chain.from_iterable(pairs):
        cells = mine.pop("cells", 0), theirs.pop("cells", 0)
        assert cells[0] == pytest.approx(cells[1], abs=CELLS, rel=CELLS_RATIO), theirs
        lengths = {name for name, value in theirs.items() if isinstance(value, float)}
        assert mine == {
            name: pytest.approx(value, abs=TOLERANCE) if name in lengths else value
            for name, value in theirs.items()
        }
