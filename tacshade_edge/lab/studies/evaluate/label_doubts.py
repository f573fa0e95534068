"""What is wrong with labels, judging by what profiles found in their frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tacshade_edge.files.images import by_number
from tacshade_edge.lab.studies.evaluate.labelled import COLUMNS, FoundRow
from tacshade_edge.lab.studies.evaluate.touch_scores import TouchAgreement
from tacshade_edge.plausibility.label_columns import judge_labels
from tacshade_edge.plausibility.row_order import name_orders
from tacshade_edge.plausibility.suspicions import Suspicion
from tacshade_edge.types import QUANTITIES

_FOLLOWED = 0.3
"""Rank correlation from which a touch model answers what the labels say."""


def label_doubts(
    rows: Mapping[str, Sequence[FoundRow]],
    known: Sequence[Mapping[str, float]],
    touch: Mapping[str, Sequence[TouchAgreement]],
) -> list[Suspicion]:
    """What is wrong with the labels of frames by what each profile found in them, the same once.

    `touch`: how well the touch models of profiles follow the labels.
    """
    labels = {
        name: np.array([one.get(name, np.nan) for one in known], np.float64) for name in QUANTITIES
    }
    doubts = [
        doubt
        for profile, some in rows.items()
        for doubt in judge_labels(
            labels,
            {name: np.array([_found(row, name) for row in some]) for name in COLUMNS},
            learnt=[
                one.quantity for one in touch.get(profile, ()) if one.rank_correlation > _FOLLOWED
            ],
            orders=name_orders([row.image for row in some], lambda name: by_number(Path(name))),
        )
    ]
    first = {(doubt.code, doubt.values.get("name")): doubt for doubt in reversed(doubts)}
    return list(reversed(first.values()))


def _found(row: FoundRow, name: str) -> float:
    """A quantity of a frame; NaN without contact, and of one that was refused."""
    value: float = getattr(row, name)
    return value if row.contact and not row.refused else np.nan
