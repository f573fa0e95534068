"""``calibrate --fit``: find a sensor's print, simulate a twin, train the networks on it,
keep those that are better.
"""

from __future__ import annotations

import contextlib
import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.lab.fitting.explained import LEAST_TOUCHES, LIKELY, Choice, chosen_prints
from tacshade_edge.lab.fitting.identify import identify
from tacshade_edge.lab.fitting.judge import (
    LENGTH_UNKNOWN,
    WHOLE_WAY,
    NetworkReport,
    error_scales_of,
    judged,
    towards,
)
from tacshade_edge.lab.fitting.prints import Found
from tacshade_edge.lab.fitting.twin import Mechanics, Steps
from tacshade_edge.lab.fitting.twin_work import FULL, NAMES, Effort, Say, Task, worked
from tacshade_edge.lab.fitting.words import advice, found_words, refused
from tacshade_edge.sensor.inference.network import shipped_layout
from tacshade_edge.sensor.profiles import LADDER
from tacshade_edge.types import F32, U8, Calibration, FittedNetwork

CONTRADICTED = 1.2
"""Stated sizes are wrong if they leave more than this many times as much unexplained as those found
without them: pins stated a fifth too long or too short leave 1.4 and 1.6 times as much, exact ones
1.0.
"""


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """The calibration with the networks that were kept, what was found of the sensor, the reports,
    advice, and all networks, with those that were not kept.
    """

    calibration: Calibration
    found: tuple[str, ...]
    networks: tuple[NetworkReport, ...] = ()
    advice: tuple[str, ...] = ()
    trained: Mapping[str, FittedNetwork] = field(default_factory=dict)


def fit(
    calibration: Calibration,
    presses: Sequence[KnownPress],
    say: Say,
    stated: Mapping[str, float] | None = None,
    folder: Path | None = None,
    mechanics: Mechanics | None = None,
    touches: Sequence[U8] = (),
) -> FitResult:
    """Fit every network to a sensor.

    `calibration`: without fitted networks. `presses`: the presses that `calibrate` used; may be
    empty. `stated`: sizes of the print in mm from its drawing, by the keys of ``print`` in
    SENSOR.yaml; they are not fitted. `folder`: keeps finished steps, so that an interrupted fit
    goes on; removed at the end. `mechanics`: the skin's if they are known. `touches`: pictures of
    touches without labels, which choose the print and may veto networks where there are no
    presses. Raises ConfigError (too few of the touches show a touch).
    """
    stated = stated or {}
    say("fit: finding the print in the reference")
    prints = identify(calibration, stated)
    if contradicted := _contradicted(calibration, prints, stated):
        return FitResult(calibration, contradicted)
    pictures = touches or [press.image for press in presses]
    choice = None
    if touches or len(pictures) >= LEAST_TOUCHES:
        say("fit: comparing prints with the touches")
        choice = chosen_prints(calibration, prints, pictures, "pin_length_mm" in stated)
    # What touches leave unexplained says how far off networks are on this sensor.
    if choice and touches and not calibration.error_scales:
        calibration = replace(calibration, error_scales=error_scales_of(choice.lefts))
    if reasons := refused(prints, choice, has_presses=bool(presses)):
        return FitResult(calibration, reasons[:1], advice=reasons[1:])
    prints = list(choice.prints) if choice else _likely(prints)
    mechanics = mechanics or Mechanics()
    with contextlib.ExitStack() as stack:
        folder = folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        steps = Steps(folder, _digest(calibration, prints, mechanics, FULL))
        task = Task(calibration, prints, mechanics, FULL, steps)
        made = _judged(task, worked(task, say), presses, choice if touches else None)
        steps.remove()
    kept = {name: network for name, (network, report) in made.items() if report.kept}
    return FitResult(
        replace(calibration, fitted=kept),
        found_words(prints, stated, choice),
        tuple(report for _, report in made.values()),
        advice(has_presses=bool(presses), touches=bool(pictures)),
        {name: network for name, (network, _) in made.items()},
    )


def _contradicted(
    calibration: Calibration, prints: Sequence[Found], stated: Mapping[str, float]
) -> tuple[str, ...]:
    """Why the stated sizes are wrong, and what the reference shows; empty if they may be right."""
    if not stated or not prints:
        return ()
    # A second search, without what was stated: only then is it known whether the drawing is worse.
    shown = identify(calibration)
    if prints[0].residual <= CONTRADICTED * shown[0].residual:
        return ()
    doubt = f"the stated print leaves {100 * prints[0].residual:.0f} % of the reference unexplained"
    return (
        f"{doubt}: nothing is fitted; compare print in SENSOR.yaml with what the reference shows:",
        *found_words(shown, {}),
    )


def _likely(prints: Sequence[Found]) -> list[Found]:
    """The prints that explain the reference about as well as the best."""
    return [each for each in prints if each.residual <= LIKELY * prints[0].residual]


def _judged(
    task: Task,
    weights: Mapping[str, F32],
    presses: Sequence[KnownPress],
    touches: Choice | None,
) -> dict[str, tuple[FittedNetwork, NetworkReport]]:
    """Judge every network by presses, or else by touches."""
    held_out = task.held_out()
    part = LENGTH_UNKNOWN if task.prints[0].kind.white_tips else WHOLE_WAY
    return {
        name: judged(
            task.calibration, presses, touches, held_out, name, towards(name, weights[name], part)
        )
        for name in NAMES
    }


def _digest(
    calibration: Calibration, prints: Sequence[Found], mechanics: Mechanics, effort: Effort
) -> str:
    """Digest everything that a fit's steps depend on."""
    digest = hashlib.sha256(
        calibration.reference_white.tobytes() + calibration.reference_grey.tobytes()
    )
    found = [(each.kind, each.values.tolist(), each.deviations.tolist()) for each in prints]
    # By repr, which gives every digit of a float: another calibration must not go on from these
    # steps.
    known = (calibration.geometry, calibration.pitch_px, found, mechanics, effort)
    digest.update(repr(known).encode())
    # Weights of another layout do not fit into the networks of this release.
    for name in LADDER:
        digest.update(shipped_layout(name).encode())
    return digest.hexdigest()
