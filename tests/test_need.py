from __future__ import annotations

from itertools import combinations

from tacshade_edge.types import Need


def test_every_bit_of_a_need_has_a_name() -> None:
    """Python 3.11.2 (Debian 12) drops bits without a name from a union: a subscriber to shear and sigma got neither."""
    named = {need.value for need in Need.__members__.values()}
    assert {1 << k for k in range(Need.ALL.value.bit_length())} <= named


def test_a_union_has_all_that_it_is_of() -> None:
    for one, other in combinations((Need.DEPTH, Need.SHEAR, Need.SIGMA, Need.TOUCH), 2):
        assert one in one | other
        assert other in one | other
        assert Need.DEPTH in one | other
    assert Need.SHEAR in Need.TOUCH
    assert Need.SIGMA not in Need.TOUCH
