"""The paper's α from presses: "the ratio between the ground-truth contact depth
and the maximum estimated depth".

Eqs. 10 and 11 scale every contact to a greatest height of 1, so a constant α gives every press the
same depth. The greatest g_d hardly grows with depth either; its RMS over the disc does, in
proportion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.sensor.depth.hybrid_sfs import change_grey
from tacshade_edge.sensor.image.preprocess import GreyMapper, Preprocessor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import Calibration

_GREY_MAX = 255.0


def with_paper_scale(calibration: Calibration, presses: Sequence[KnownPress]) -> Calibration:
    """The calibration with α for the mean depth of at least one press,
    and the change to which that belongs.
    """
    preprocessor = Preprocessor(calibration, PROFILES["paper"])
    mapper = GreyMapper(preprocessor)
    depths_mm = np.array([press.depth_mm for press in presses])
    changes = np.array(
        [
            change_grey(mapper.maps(preprocessor.preprocess(preprocessor.grey(press.image))))
            for press in presses
        ]
    )
    mean_mm = float(depths_mm.mean())
    # The median, so that a press with a false depth does not move the scale of all.
    grey = mean_mm * float(np.median(changes / depths_mm))
    # α multiplies the h of eq. 11, of which the greatest is 1, and gives px.
    alpha = mean_mm / calibration.geometry.mm_per_px
    return replace(calibration, alpha=alpha, alpha_grey=min(grey, _GREY_MAX))
