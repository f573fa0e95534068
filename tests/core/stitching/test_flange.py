from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tacshade_edge.core.stitching.flange import ORDER, FoundFlange, delay_seen, find_flange, unseen
from tacshade_edge.core.stitching.flange_equations import ContactFrame
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, of_pose, shift, turn
from tacshade_edge.types import F64, Pose
from tools.testbed.bumpy_surface import APEX_MM
from tools.testbed.flange_plan import Turns, exact_frames

TRUE = shift(12, -7, 55) @ turn((0.3, -0.2, 1.1))
START = shift(6, 6, -5) @ Rigid(turn((0.1, -0.1, 0.1)).rotation @ TRUE.rotation, TRUE.translation_mm)
DELAY_MS = 45.0
ONE = (((0, 0, 0),) * 5,)
YAWS = (((0, 0, 0), (90, 0, 0), (-90, 0, 0), (45, 0, 0), (-45, 0, 0)),)


def off(found: FoundFlange) -> F64:
    turned, _ = cv2.Rodrigues(found.flange_T_sensor.rotation @ TRUE.rotation.T)
    moved_mm = found.flange_T_sensor.translation_mm - TRUE.translation_mm
    return np.concatenate((moved_mm, np.degrees(turned.ravel()), (found.delay_ms - DELAY_MS,)))


@pytest.mark.slow
def test_the_plan_finds_it_from_ten_millimetres_and_ten_degrees() -> None:
    found = find_flange(exact_frames(TRUE, DELAY_MS), START, APEX_MM)
    error, sigma = off(found), np.sqrt(np.diag(found.covariance))
    assert np.linalg.norm(error[:3]) < 0.3
    assert np.linalg.norm(error[3:6]) < 0.5
    assert abs(error[6]) < 3
    assert (np.abs(error) < 2.5 * sigma).all()
    assert delay_seen(found)
    assert unseen(exact_frames(TRUE, DELAY_MS), START, found) == ""
    assert found.left_mm < 0.1


@pytest.mark.slow
def test_the_same_again_is_the_same() -> None:
    given = exact_frames(TRUE, DELAY_MS)
    a, b = (find_flange(given, START, APEX_MM) for _ in range(2))
    assert a.flange_T_sensor.seven() == b.flange_T_sensor.seven()
    np.testing.assert_array_equal(a.covariance, b.covariance)


@pytest.mark.slow
def test_where_the_base_is_does_not_matter() -> None:
    # The surface hangs on a wall a metre away.
    base = shift(1000, -500, 30) @ turn((0, 1.5, 0.8))

    def there(pose: Pose) -> Pose:
        return Pose(pose.t_ns, *(base @ of_pose(pose)).seven())

    given = exact_frames(TRUE, DELAY_MS)
    hung = [replace(frame, track=tuple(there(pose) for pose in frame.track)) for frame in given]
    found = find_flange(hung, START, APEX_MM)
    assert np.linalg.norm(off(found)[:3]) < 0.3
    assert np.linalg.norm(off(found)[3:6]) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turns", "names", "why"),
    [
        (
            ONE,
            "translation along x, y and z",
            "every press has the same orientation, expected presses that differ by",
        ),
        (YAWS, "translation along z", "no press is tilted, expected tilts of ±15° about two axes"),
    ],
)
def test_a_motion_that_is_missing_is_named(turns: Turns, names: str, why: str) -> None:
    # The sensor's axes are the flange's here, so that the names are those of the plan.
    start = Rigid(np.eye(3), np.array((1.0, 2.0, 50.0)))
    given = exact_frames(start, 0.0, turns, moving=False)
    line = unseen(given, start, find_flange(given, start, APEX_MM))
    assert line.startswith(names)
    assert why in line


@pytest.mark.slow
def test_presses_that_do_not_overlap() -> None:
    given = [
        replace(frame, track=tuple(replace(pose, x_mm=pose.x_mm + 40 * frame.press) for pose in frame.track))
        for frame in exact_frames(TRUE, DELAY_MS)[:30]
    ]
    assert "hardly overlap" in unseen(given, TRUE, find_flange(given, TRUE, APEX_MM))


@pytest.mark.slow
def test_presses_that_stand_still_say_nothing_of_the_delay() -> None:
    given = exact_frames(TRUE, DELAY_MS, moving=False)
    found = find_flange(given, START, APEX_MM)
    assert not delay_seen(found)
    assert np.sqrt(found.covariance[-1, -1]) == pytest.approx(100)
    assert np.linalg.norm(off(found)[:3]) < 0.3
    assert ORDER[-1] == "delay_ms"


def test_presses_of_one_point_in_one_place_show_nothing() -> None:
    point, pose = np.array(((0.0, 0.0, 20.0, 1.0),)), Pose(0, 0, 0, 0, 0, 1, 0, 0)
    given = [ContactFrame(point, k, 0, (pose,)) for k in range(12)]
    found = find_flange(given, shift(0, 0, 0), APEX_MM)
    assert np.isfinite(found.covariance).all()
    assert "translation along x, y and z, rotation about x, y and z cannot be determined" in unseen(
        given, shift(0, 0, 0), found
    )


def test_presses_from_opposite_sides_are_refused() -> None:
    given = exact_frames(TRUE, DELAY_MS)[:40]
    turned = [
        replace(
            frame,
            press=40 + k,
            track=tuple(Pose(0, *(turn((np.pi, 0, 0)) @ of_pose(p)).seven()) for p in frame.track[:1]),
        )
        for k, frame in enumerate(given)
    ]
    with pytest.raises(ConfigError, match="face in opposite directions"):
        find_flange([*given, *turned], START, APEX_MM)
