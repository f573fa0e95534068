import numpy as np
import pytest
from support.calibrated_sensor import HALF, simulated

from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tools.studies.limits.disturbances import BEYOND, CHANGES, RELEASED, UNDISTURBED, without_contact
from tools.testbed.simulator.variants import released

CLEAN = simulated(HALF).frame((), 9).image


@pytest.mark.parametrize("what", [*CHANGES, RELEASED, *BEYOND])
def test_a_seed_draws_one_image_that_differs_from_the_clean_one(what: str) -> None:
    one, same = (without_contact(simulated(HALF), what, 3, 9) for _ in range(2))
    np.testing.assert_array_equal(one, same)
    assert np.array_equal(one, CLEAN) == (what == UNDISTURBED)
    if what != UNDISTURBED:
        assert any(not np.array_equal(one, without_contact(simulated(HALF), what, seed, 9)) for seed in range(4, 9))


def test_after_a_release_the_skin_is_left_a_shallow_dent_and_no_contact() -> None:
    left = released(simulated(HALF), (Press(ball(), 0, 0, 3.0),), 0.05, 1)
    assert left.skin.height_mm.max() == pytest.approx(0.15, abs=0.001)
    assert left.presses == ()
    assert not left.skin.obstacle_mm.any()
