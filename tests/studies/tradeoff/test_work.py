"""The study on a sensor of half the resolution."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.half_family import HALF_SENSOR, half_family

from tacshade_edge.studies.evaluate.own_images import read_images
from tacshade_edge.studies.evaluate.scenes import DEPTHS_MM
from tacshade_edge.studies.parallel import ThisProcess
from tacshade_edge.studies.tradeoff import cases
from tacshade_edge.studies.tradeoff.accuracy import score_settings
from tacshade_edge.studies.tradeoff.cases import SensorCases
from tacshade_edge.studies.tradeoff.grid import grid
from tacshade_edge.studies.tradeoff.work import weigh_and_time

pytestmark = pytest.mark.slow  # it calibrates, renders and starts interpreters


def quiet(what: str, done: int, total: int) -> None:
    assert 0 <= done <= total


@pytest.fixture(scope="module")
def sensor() -> Iterator[SensorCases]:
    with half_family():
        (found,) = cases.simulated((HALF_SENSOR,), ("ball", "cube"), ThisProcess(), quiet)
        yield found


def test_each_object_has_a_place_of_its_own_and_every_depth(sensor: SensorCases) -> None:
    touched = [case for case in sensor.cases if case.touched]
    assert [(c.label.object, c.label.depth_mm) for c in touched] == [
        (name, depth) for name in ("ball", "cube") for depth in DEPTHS_MM
    ]
    assert len({(c.label.x_mm, c.label.y_mm) for c in touched}) == 2
    assert len(sensor.cases) - len(touched) == cases.NULL_FRAMES


def test_all_of_it(sensor: SensorCases) -> None:
    settings = grid(("fast",))
    rows = score_settings(settings, (sensor,), ThisProcess(), quiet)
    points, busy = weigh_and_time(settings, (sensor,), rows, quiet)
    assert [p.setting for p in points] == list(settings)
    assert busy > 0.9
    for point in points:
        assert (point.presses, point.untouched, point.phantoms) == (6, cases.NULL_FRAMES, 0)
        assert 0.02 < point.me_mm.low <= point.me_mm.value <= point.me_mm.high < 1
        assert point.iou.value > 0.5
        assert 0 < point.idle_p50_ms < point.p50_ms.value <= point.p99_ms.value
        assert point.peak_mib > 0
    assert any(p.front for p in points)


def test_the_same_images_give_the_same_rows_and_those_of_a_user_too(sensor: SensorCases, tmp_path: Path) -> None:
    """Written to files as a user has them, read again."""
    settings = grid(("fast",))[:1]
    ((first,),), ((again,),) = (score_settings(settings, (sensor,), ThisProcess(), quiet) for _ in range(2))
    assert first == again
    for k, case in enumerate(sensor.cases[:3]):
        cv2.imwrite(str(tmp_path / f"{k}.png"), case.image)
        truth = case.truth
        np.savez(
            tmp_path / f"{k}.npz", points_mm=truth.points_mm, contact=truth.contact, depth_max_mm=truth.depth_max_mm
        )
    images = sorted(tmp_path.glob("*.png"))
    own = tuple(read_images(sensor.calibration, "mine", images, quiet, lambda text: pytest.fail(text)))
    ((read,),) = score_settings(settings, (SensorCases(sensor.calibration, own),), ThisProcess(), quiet)
    assert [(r.me_mm, r.iou) for r in read] == [(r.me_mm, r.iou) for r in first[:3]]
