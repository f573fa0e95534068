from collections.abc import Iterator

import numpy as np
import pytest
from support.half_family import HALF_SENSOR, half_family
from support.toy_network import saying

from tacshade_edge.core.depth.network_maps import HEIGHT_SCALE, fold, unfold
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.studies.evaluate.score import Row
from tacshade_edge.studies.evaluate.summary import figures
from tacshade_edge.studies.parallel import ThisProcess
from tacshade_edge.studies.tables import csv_text
from tools.studies.ablation.perfected import PerfectedNetwork, true_answer
from tools.studies.ablation.work import VARIANTS, AblationRow, Plan, ablate, object_rows, text
from tools.testbed.calibrated_sensor import HALF

PLAN = Plan((HALF_SENSOR,), objects=("ball", "cube"), references=3, presses=10, depths_mm=(3.0,))


@pytest.fixture(scope="module")
def found() -> Iterator[tuple[tuple[str, Row], ...]]:
    with half_family():
        yield ablate(PLAN, ThisProcess(), lambda what, done, total: None)


@pytest.mark.slow
def test_what_is_true_leaves_no_error(found: tuple[tuple[str, Row], ...]) -> None:
    some = {what: figures(row for which, row in found if which == what) for what in VARIANTS}
    assert all(each.presses == 6 and each.missed == 0 for each in some.values())
    # True points are a pixel apart, 0.15 mm and more on the slope: the nearest to a cell's is half of that off.
    assert some["true gradient and outline"].me_mm < 0.04
    assert some["true gradient and outline"].iou > 0.9
    for what in ("true gradient", "true greatest depth"):
        assert some[what].depth_error_pct < 2 < some["as it is"].depth_error_pct
    assert some["true outline"].iou > some["as it is"].iou
    assert some["frames without noise"].me_mm != some["as it is"].me_mm


@pytest.mark.slow
def test_it_is_told_by_object_and_by_family(found: tuple[tuple[str, Row], ...]) -> None:
    rows = object_rows(found)
    assert [(r.object, r.what) for r in rows[:2]] == [("ball", "as it is"), ("cube", "as it is")]
    assert len(csv_text(AblationRow, rows).splitlines()) == 1 + 2 * len(VARIANTS)
    words = text(found)
    assert words.startswith("Family half")
    assert all(f"| {what} " in words for what in VARIANTS)


def test_the_true_answer_is_the_truth_at_the_cells() -> None:
    frame = SimulatedSensor(HALF).frame((Press(ball(6.0), 1.0, 2.0, 3.0),))
    height, contact = true_answer(frame, HALF.geometry, disc_map.CELLS)
    true = frame.truth()
    grid = disc_map.map_grid(HALF.geometry.disc)
    rows, cols = (
        np.rint(first + grid.step_px * np.arange(disc_map.CELLS)).astype(int) for first in (grid.row0, grid.col0)
    )
    unit_mm = HALF.skin_radius_mm * np.sin(np.radians(HALF.visible_half_angle_deg)) / HEIGHT_SCALE
    nearest = np.nan_to_num(true.height_mm[np.ix_(rows, cols)])
    assert float(height.max()) * unit_mm == pytest.approx(true.depth_max_mm, abs=0.05)
    assert np.abs(height * unit_mm - nearest).mean() < 0.05
    assert np.mean(contact != true.contact[np.ix_(rows, cols)]) < 0.01


def test_the_truth_stands_in_the_place_of_the_answer() -> None:
    rng = np.random.default_rng(0)
    shape = (disc_map.CELLS, disc_map.CELLS)
    found, logit = rng.random((2, *shape), dtype=np.float32) - np.float32(0.2)
    network = saying(fold(np.stack((found, logit)), 4))
    height, contact = rng.random(shape, dtype=np.float32), rng.random(shape) < 0.5

    def answer(**perfect: bool) -> tuple[np.ndarray, np.ndarray]:
        made = PerfectedNetwork(network, **perfect)
        made.show(height, contact)
        nothing = np.zeros((1, 1, 1), np.float32)
        first, second = unfold(made.as_network().run(nothing, nothing).depth_and_contact, 4)
        return first, second

    np.testing.assert_array_equal(answer(), (found, logit))
    np.testing.assert_array_equal(answer(height=True), (height, logit))
    np.testing.assert_array_equal(answer(contact=True)[1] > 0, contact)
    scaled = answer(top=True)[0]
    assert scaled[logit > 0].max() == pytest.approx(height.max())
    assert np.allclose(scaled / found, height.max() / found[logit > 0].max())
