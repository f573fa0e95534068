import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.studies.evaluate.labelled import FoundRow, agreements, document, text


def row(k: int, depth: float, shear: tuple[float, float], tilt: tuple[float, float], refused: str = "") -> FoundRow:
    return FoundRow(f"{k}.png", "fast", refused, True, False, False, depth, 3 * depth, *tilt, *shear)


def some(count: int = 60) -> tuple[list[FoundRow], list[Mapping[str, float]]]:
    """Found depth is half the true one; the robot's axes are turned by 30 degrees and one of them is mirrored."""
    rng = np.random.default_rng(5)
    a = math.radians(30)
    turned = np.array(((math.cos(a), -math.sin(a)), (-math.sin(a), -math.cos(a))))
    rows, known = [], []
    for k in range(count):
        depth, shear, tilt = rng.uniform(1, 5), rng.uniform(-5, 5, 2), rng.uniform(-20, 20, 2)
        rows.append(row(k, 0.5 * depth + 0.2, tuple((0.8 * turned @ shear).tolist()), tuple((turned @ tilt).tolist())))
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


def test_what_is_the_same_in_other_axes_agrees_wholly() -> None:
    rows, known = some()
    for made in agreements(rows, known):
        assert made.rank_correlation == pytest.approx(1.0)
        assert made.error < 1e-9
    assert [made.quantity for made in agreements(rows, known)] == [
        "depth",
        "depth by volume",
        "tilt",
        "shear",
        "shear, by tilt and depth too",
    ]
    assert [made.frames for made in agreements(rows, known)] == [60, 60, 30, 30, 30]


def test_what_has_nothing_to_do_with_it_does_not() -> None:
    rows, known = some(400)
    for made in agreements(rows, known[::-1]):
        assert abs(made.rank_correlation) < 0.2


def test_refused_frames_and_unknown_labels_are_left_out() -> None:
    rows, known = some()
    rows[0] = row(0, 99.0, (9.0, 9.0), (9.0, 9.0), refused="torn")
    known[2] = {}
    assert [made.frames for made in agreements(rows, known)][:2] == [58, 58]
    assert all(made.rank_correlation == pytest.approx(1.0) for made in agreements(rows, known))
    assert agreements(rows, [{}] * len(rows)) == []


def test_the_text_counts_and_the_document_has_no_nan() -> None:
    rows, known = some()
    rows[3] = row(3, math.nan, (math.nan, math.nan), (math.nan, math.nan), refused="dark")
    made = {"fast": agreements(rows, known)}
    assert "|    fast |     60 |       1 |" in text(rows, made)
    frames = document(rows, made)["frames"]
    assert isinstance(frames, list)
    assert frames[3]["shear_x_mm"] is None


def test_a_flange_that_tilts_drags_the_skin_elsewhere() -> None:
    rows, known = some(200)
    tilted = [replace(each, shear_x_mm=each.shear_x_mm + 0.3 * each.tilt_y_deg) for each in rows]
    shear, by_tilt = agreements(tilted, known)[3:]
    assert shear.rank_correlation < 0.9
    assert by_tilt.rank_correlation == pytest.approx(1.0)
    assert by_tilt.error < 1e-9
