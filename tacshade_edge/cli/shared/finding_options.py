"""The options that help with what a calibration finds, in its sentences."""

from __future__ import annotations

from tacshade_edge.calibration.findings import FindingCode
from tacshade_edge.calibration.sentences import Wording

WITH_OPTIONS = Wording(
    {
        FindingCode.REFERENCE_PRESSED: ", or pass --allow-loaded-reference",
        FindingCode.MARKERS_OUTSIDE: "; `--plot` draws both",
        FindingCode.TRAVEL: "pass --depth-from-touch, or ",
        FindingCode.FITTABLE_ERRORS: "; --fit may help",
        FindingCode.UNCALIBRATED: "--",
        FindingCode.NO_PRESSES: " and pass --presses PRESSES.csv",
    }
)
"""How `calibrate` speaks."""
