"""Whether the places of a hand's fingers can be in mm, by the sizes of their sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tacshade_edge.plausibility.suspicions import Suspicion
from tacshade_edge.settings import Document, doubted_finger
from tacshade_edge.types import Calibration


def finger_doubt(
    documents: Sequence[Document], calibrations: Mapping[str, Calibration]
) -> tuple[str, Suspicion] | None:
    """Where the place of a finger is stated that is doubted, judging by the calibrations of some
    sensors, and why; None without doubt.
    """
    # Two pads may lie on each other, as in a gripper that is closed.
    sizes_mm = {
        name: each.geometry.size_mm
        for name, each in calibrations.items()
        if each.geometry.skin == "dome"
    }
    if (doubted := doubted_finger(documents, sizes_mm)) is None:
        return None
    finger, why = doubted
    return finger.where("hand_T_sensor"), why
