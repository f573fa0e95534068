"""Labels are held against what profiles found in their frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tacshade_edge.lab.studies.evaluate.label_doubts import label_doubts
from tacshade_edge.lab.studies.evaluate.labelled import FoundRow
from tacshade_edge.lab.studies.evaluate.touch_scores import TouchAgreement
from tacshade_edge.plausibility.suspicions import Suspicion

DEPTHS_MM = np.random.default_rng(0).uniform(0.5, 3.0, 60)
ROWS = [
    FoundRow(f"{k}.png", "fast", "", True, False, False, float(d), 1.0, 0.0, 0.0, 0.0, 0.0)
    for k, d in enumerate(DEPTHS_MM)
]


def doubted(depths_mm: list[float], rows: list[FoundRow], **touch: float) -> list[Suspicion]:
    """What is said of labelled depths by two profiles of rows, and of touch models."""
    agreements = {
        profile: [TouchAgreement("depth_mm", 60, 0, correlation, 0.1, 0.9)]
        for profile, correlation in touch.items()
    }
    known = [{"depth_mm": depth_mm} for depth_mm in depths_mm]
    return label_doubts({"fast": rows, "accurate": rows}, known, agreements)


def test_what_is_wrong_is_said_once_for_all_profiles() -> None:
    right = DEPTHS_MM.tolist()
    assert doubted(right, ROWS) == []
    for wrong, said in (
        ([depth_mm / 1000 for depth_mm in right], "are they in m?"),
        ([right[-1], *right[:-1]], "does each image have the values of the row before?"),
        (right[::-1], "are the images in the opposite order?"),
        ([right[7 * k % 60] for k in range(60)], "are the rows in another order, or of other "),
        ([right[k] for k in by_text()], "are the images sorted by number, and the values as text"),
    ):
        (found,) = doubted(wrong, ROWS)
        assert said in str(found)


def by_text() -> list[int]:
    return sorted(range(60), key=lambda k: f"{k}.png")


def test_what_a_touch_model_follows_is_not_doubted() -> None:
    wrong = [float(DEPTHS_MM[7 * k % 60]) for k in range(60)]
    assert len(doubted(wrong, ROWS, fast=0.9)) == 1
    assert doubted(wrong, ROWS, fast=0.9, accurate=0.9) == []
    assert len(doubted(wrong, ROWS, fast=0.1, accurate=0.0)) == 1


def test_frames_that_show_nothing_say_nothing_of_labels() -> None:
    wrong = (DEPTHS_MM / 1000).tolist()
    for changes in ({"contact": False}, {"refused": "torn"}):
        assert doubted(wrong, [replace(row, **changes) for row in ROWS]) == []
