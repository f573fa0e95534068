"""The sensors, scenes and rows of an evaluation; figures over rows, their tables and documents."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest

from support.half_family import HALF_SENSOR, half_family
from support.published_sensor import unmeasured
from tacshade_edge.calibration.calibrate import CalibrationResult
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.parallel import ThisProcess
from tacshade_edge.lab.simulator.press import PAPER_OBJECTS
from tacshade_edge.lab.simulator.sensor_model import random_model
from tacshade_edge.lab.studies.evaluate.accuracy import document, figures, null_figures, table
from tacshade_edge.lab.studies.evaluate.labelled import (
    COUNTS,
    FoundRow,
    agreements,
    found_row,
    text,
)
from tacshade_edge.lab.studies.evaluate.score import Row
from tacshade_edge.lab.studies.evaluate.work import (
    DEPTHS_MM,
    RINGS,
    SensorName,
    calibrated,
    evaluate,
    places,
    scenes,
)
from tacshade_edge.lab.studies.markdown import csv_text


@pytest.mark.parametrize("text", ["default", "5", "0", "8999"])
def test_a_name_is_written_as_it_is_read(text: str) -> None:
    assert str(SensorName.parse(text)) == text
    assert SensorName.parse(f"tacshade:{text}") == SensorName.parse(text)


@pytest.mark.parametrize(
    "text", ["", "x", "-1", "1.5", "teapot:3", "tacshade:", ":5", "٣", "99999999999"]
)
def test_what_is_no_sensor_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        SensorName.parse(text)


@pytest.mark.slow  # likewise
def test_a_sensor_that_cannot_be_calibrated_is_named() -> None:
    with pytest.raises(ConfigError, match=r"sensor 5: found 2 presses, expected at least 8"):
        calibrated(SensorName.parse("5"), references=1, presses=2)


def test_every_place_and_depth_once_and_the_same_again() -> None:
    model = random_model(5)
    made = scenes(model, 5, "cube")
    grid = [((s.press.x_mm, s.press.y_mm, s.press.rotation_deg), s.press.depth_mm) for s in made]
    assert grid == list(itertools.product(places(model, 5), DEPTHS_MM))
    assert len(grid) == len(set(grid)) == 9
    assert len({s.noise_seed for s in made}) == 9
    assert {s.press.scale for s in made} == {model.skin_radius_mm / 20}
    for (low, high), (x, y, _) in zip(RINGS, places(model, 5), strict=True):
        assert low - 1e-3 <= np.hypot(x, y) / model.skin_radius_mm <= high + 1e-3
    assert places(model, 6) != places(model, 5)


def quiet(what: str, done: int, total: int) -> None:
    assert 0 <= done <= total


@pytest.fixture(scope="module", autouse=True)
def family() -> Iterator[None]:
    with half_family():
        yield


@pytest.fixture(scope="module")
def found() -> tuple[list[Row], list[CalibrationResult]]:
    given = {"references": 3, "presses": 8, "null_frames": 5}
    return evaluate(
        (HALF_SENSOR,), ("fast",), ("ball", "ring"), ThisProcess(), quiet, depths_mm=(2.0,), **given
    )


@pytest.mark.slow
def test_a_row_for_every_press_and_frame_without_contact(
    found: tuple[list[Row], list[CalibrationResult]],
) -> None:
    rows, calibrations = found
    assert [r.object for r in rows] == ["ball"] * 3 + ["ring"] * 3 + ["none"] * 5
    assert {(r.sensor, r.profile) for r in rows} == {("half:default", "fast")}
    assert all(
        r.valid and r.contact and r.iou > 0.3 and r.me_mm < 2 for r in rows if r.object == "ball"
    )
    assert not any(r.contact for r in rows if r.object == "none")
    assert [r.image for r in rows[-5:-3]] == ["", "light x0.8"]
    fit = calibrations[0].calibration.fit
    assert fit is not None
    assert fit.presses == 8


ROW = Row(
    profile="fast",
    sensor="default",
    object="ball",
    image="",
    depth_mm=3.0,
    x_mm=0.0,
    y_mm=0.0,
    rotation_deg=0.0,
    valid=True,
    contact=True,
    saturated=False,
    true_depth_mm=3.0,
    found_depth_mm=2.7,
    depth_error_pct=-10.0,
    me_mm=0.2,
    sd_pct=92.0,
    sd_sum_pct=84.0,
    backward_mm=0.3,
    iou=0.8,
    points=100,
    true_points=120,
    objects=1,
    repaired_px=0,
    degraded="",
    touched=False,
)


def test_a_missed_contact_counts_as_a_skin_left_alone() -> None:
    missed = replace(
        ROW,
        me_mm=math.nan,
        backward_mm=math.nan,
        sd_pct=0.0,
        iou=0.0,
        contact=False,
        true_depth_mm=3.0,
    )
    found = figures([replace(ROW, me_mm=0.2, backward_mm=0.4, sd_pct=90.0), missed])
    assert found.missed == 1
    assert (found.me_mm, found.backward_mm, found.sd_pct) == pytest.approx((1.6, 1.7, 45))


def test_a_touch_of_unknown_depth_is_counted_on_its_own_and_measured_like_a_missed_one() -> None:
    missed = replace(
        ROW,
        me_mm=math.nan,
        backward_mm=math.nan,
        sd_pct=0.0,
        contact=False,
        found_depth_mm=0.0,
        depth_error_pct=-100.0,
    )
    unknown = replace(missed, touched=True, found_depth_mm=math.nan, depth_error_pct=math.nan)
    made, lost = figures([ROW, ROW, unknown]), figures([ROW, ROW, missed])
    assert (made.found, made.touched, made.missed) == (2, 1, 0)
    assert (lost.found, lost.touched, lost.missed) == (2, 0, 1)
    for name in ("presses", "me_mm", "backward_mm", "sd_pct", "depth_error_pct"):
        assert getattr(made, name) == getattr(lost, name)
    null = replace(NULL, touched=True, found_depth_mm=math.nan)
    free = null_figures([null, NULL, replace(NULL, contact=True, found_depth_mm=0.4), null])
    assert (free.phantoms, free.touched, free.deepest_mm) == (1, 2, 0.4)
    lines = [re.split(r"\s*\|\s*", line)[1:-1] for line in table([ROW, unknown, null]).splitlines()]
    assert [line[-3:] for line in lines if line[:2] == ["ball", "fast"]] == [["1", "1", "0"]]
    assert lines[-1] == ["fast", "1", "0", "1", "0.00", "0"]


def test_frames_without_contact() -> None:
    null = replace(ROW, object="none", true_points=0, contact=False, found_depth_mm=0.0)
    rows = [ROW, null, replace(null, contact=True, found_depth_mm=0.4), replace(null, valid=False)]
    found = null_figures(rows)
    assert (found.frames, found.phantoms, found.deepest_mm, found.refused) == (3, 1, 0.4, 1)
    assert figures(rows).presses == 1


NULL = replace(
    ROW,
    object="none",
    contact=False,
    true_points=0,
    me_mm=math.nan,
    sd_pct=math.nan,
    iou=math.nan,
    found_depth_mm=0.0,
)
ROWS = [
    *(
        replace(ROW, object=name, me_mm=0.1 * (k + 1))
        for k, name in enumerate((*PAPER_OBJECTS, "ring"))
    ),
    NULL,
]


def test_the_document_is_json_that_any_program_reads() -> None:
    nowhere = replace(ROW, object="ring", iou=math.nan)
    made = document([ROWS[0], nowhere, NULL], {"presses": 40})
    text = json.dumps(made, allow_nan=False)
    read = json.loads(text)
    fast = read["profiles"]["fast"]
    assert fast["objects"]["ring"]["iou"] is None
    assert (fast["objects"]["cube"]["me_mm"], fast["all"]["presses"]) == (0.1, 2)
    assert fast["without_contact"]["frames"] == 1
    assert read["settings"] == {"presses": 40}
    assert {"python", "numpy", "tacshade-edge"} <= set(read["versions"])
    assert read["table_i"]["ball"] == {"me_mm": 0.1039, "sd_pct": 96.02}


def row(
    k: int, depth: float, shear: tuple[float, float], tilt: tuple[float, float], refused: str = ""
) -> FoundRow:
    return FoundRow(
        f"{k}.png", "fast", refused, True, False, False, depth, 3 * depth, *tilt, *shear
    )


def some(count: int = 60) -> tuple[list[FoundRow], list[Mapping[str, float]]]:
    """Found depth is half the true one; the robot's axes are turned by 30 degrees and one
    of them is mirrored.
    """
    rng = np.random.default_rng(5)
    a = math.radians(30)
    turned = np.array(((math.cos(a), -math.sin(a)), (-math.sin(a), -math.cos(a))))
    rows, known = [], []
    for k in range(count):
        depth, shear, tilt = rng.uniform(1, 5), rng.uniform(-5, 5, 2), rng.uniform(-20, 20, 2)
        rows.append(
            row(
                k,
                0.5 * depth + 0.2,
                tuple((0.8 * turned @ shear).tolist()),
                tuple((turned @ tilt).tolist()),
            )
        )
        known.append(
            {
                "depth_mm": depth,
                "shear_x_mm": shear[0],
                "shear_y_mm": shear[1],
                "tilt_x_deg": tilt[0],
                "tilt_y_deg": tilt[1],
            }
        )
    return rows, known


@pytest.mark.slow
def test_what_is_the_same_in_other_axes_agrees_wholly() -> None:
    rows, known = some()
    for made in agreements(rows, known):
        assert made.rank_correlation == pytest.approx(1.0)
        assert made.error < 1e-9
    assert [made.quantity for made in agreements(rows, known)] == ["depth", "tilt", "shear"]
    assert [made.frames for made in agreements(rows, known)] == [60, 30, 30]


def test_refused_frames_and_unknown_labels_are_left_out() -> None:
    rows, known = some()
    rows[0] = row(0, 99.0, (9.0, 9.0), (9.0, 9.0), refused="torn")
    known[2] = {}
    assert agreements(rows, known)[0].frames == 58
    assert all(made.rank_correlation == pytest.approx(1.0) for made in agreements(rows, known))
    assert agreements(rows, [{}] * len(rows)) == []


@dataclass(frozen=True)
class Line:
    name: str
    found: bool
    depth_mm: float


def test_csv_has_a_column_for_each_field_and_nothing_for_nan() -> None:
    rows = [Line("a, b", True, 1.23456789), Line("", False, math.nan)]
    assert csv_text(Line, rows) == 'name,found,depth_mm\n"a, b",1,1.23457\n,0,\n'
    assert csv_text(Line, []) == "name,found,depth_mm\n"


def test_a_touch_of_unknown_depth_is_not_lost_but_has_no_depth() -> None:
    rows, known = some()
    found = found_row("5.png", unmeasured(5))
    assert (found.contact, found.touched, math.isnan(found.depth_mm)) == (False, True, True)
    rows[5] = found
    assert agreements(rows, known)[0].frames == len(rows) - 1
    assert [count(rows) for name, count in COUNTS.items() if "without" in name] == ["0"]
    assert COUNTS["touched, depth unknown"](rows) == "1"
    assert "touched, depth unknown" in text(rows, {})
