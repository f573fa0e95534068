"""What a fit says of a sensor in words: what was found, why nothing is fitted,
what a person can do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tacshade_edge.lab.fitting.explained import Choice
from tacshade_edge.lab.fitting.identify import MERGED
from tacshade_edge.lab.fitting.prints import PARAMETERS, Found

UNEXPLAINED_ALONE = 0.45
"""Greatest part of the reference's pattern (RMS) that a print may leave unexplained without touches
or presses, which would show whether the networks of a wrong print are worse.
"""
MOST_LEFT, MOST_LEFT_ALONE = 0.9, 0.5
"""Greatest part of the touches' changes that the best print may leave unexplained: with presses,
which judge the networks by labels, and without. No print that leaves more moves like those pins. On
skins of the family `layered` (its working range), fits to prints that leave a third have 0.67 to
1.0 times the error of the shipped networks (one of twelve 1.16 times), at nearly a half 0.8 to 1.45
times.
"""
MORE_TOUCHES = (
    "record twenty touches of anything (`capture` does) and repeat with --touches: "
    "they choose the print and judge the fit"
)
PRESS_BALLS = "press twenty balls at stated places: they judge the fit by labels"


def refused(
    prints: Sequence[Found], choice: Choice | None, *, has_presses: bool
) -> tuple[str, ...]:
    """Why nothing is fitted, and then what a person can do about it; empty without a reason."""
    if choice is not None:
        if choice.left <= (MOST_LEFT if has_presses else MOST_LEFT_ALONE):
            return ()
        left = (
            f"the best print leaves {100 * choice.left:.0f} % of the touches' changes unexplained"
        )
        return (
            f"{left}: nothing is fitted",
            (
                "compare skin_radius_mm, camera_distance_mm and the visible circle with the "
                "sensor's drawing" + ("" if has_presses else f"; or {PRESS_BALLS}")
            ),
        )
    if not prints:
        return (
            (
                "no known kind of print looks like the reference (no pins were found): "
                "nothing is fitted"
            ),
            MORE_TOUCHES,
        )
    if prints[0].residual > UNEXPLAINED_ALONE:
        doubt = f"{100 * prints[0].residual:.0f} % of the reference unexplained"
        return (
            (
                f"the likeliest print leaves {doubt}: "
                "nothing is fitted without touches that judge the fit"
            ),
            MORE_TOUCHES,
        )
    return ()


def found_words(
    prints: Sequence[Found], stated: Mapping[str, float], choice: Choice | None = None
) -> tuple[str, ...]:
    """What was found, in words that a person can check against the drawing."""
    best = prints[0]
    pitch_mm = best.base.pitch_mm
    named = zip(
        ("pins", "tips", "bases", "markers"), ("long", *["in radius"] * 3), PARAMETERS, strict=True
    )
    sizes = []
    for k, (what, how, parameter) in enumerate(named):
        if best.kind.white_tips and what == "markers":
            continue
        key = parameter.replace("_pitches", "_mm")
        if key in stated:
            sizes.append(f"{what} {stated[key]:g} mm {how} as stated")
            continue
        # A size that nothing shows would look like a finding.
        if what == "markers" and best.values[k] == MERGED:
            sizes.append("markers that merge")
            continue
        each = pitch_mm * np.array([found.values[k] for found in prints])
        # Ranges, not single values: a person compares them with a drawing, and prints alike differ.
        spread = pitch_mm * math.sqrt(best.cloud()[k, k])
        sizes.append(
            f"{what} {max(each.min() - spread, 0):.2f} to {each.max() + spread:.2f} mm {how}"
        )
    unexplained = f"{100 * best.residual:.0f} % of the pattern unexplained"
    lines = [
        (
            f"found a print of {best.kind.name}, pitch {pitch_mm:.2f} mm: {', '.join(sizes)} "
            f"({unexplained})"
        )
        if not best.kind.patches
        else f"took the tips from the sensor's own picture: pitch {pitch_mm:.2f} mm, {sizes[0]}"
    ]
    if choice is not None:
        left = f"{100 * choice.left:.0f} % of the touches' changes"
        lines.append(f"it leaves {left} unexplained")
    return tuple(lines)


def advice(*, has_presses: bool, touches: bool) -> tuple[str, ...]:
    """What would judge the fit that nothing has judged yet."""
    return (*(() if has_presses else (PRESS_BALLS,)), *(() if touches else (MORE_TOUCHES,)))
