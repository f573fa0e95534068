"""How often right depths are taken for travel from first touch: a part of the study."""

from __future__ import annotations

import pytest

from tools.studies import travel


@pytest.mark.slow
def test_right_depths_are_not_taken_for_travel() -> None:
    """The study has what is rarer: of 20,000 such tables, one."""
    wrongly, rightly = travel.rates(0, 150)
    assert wrongly == 0
    assert rightly > 120
