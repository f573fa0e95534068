"""Whether frames that are refused would pass, mirrored or turned."""

from __future__ import annotations

import numpy as np

from tacshade_edge.reasons import Reason
from tacshade_edge.sensor.frame_check import first_reason, plain_judges
from tacshade_edge.sensor.frame_check.turned import with_turn
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.network import load_network
from tacshade_edge.sensor.profiles import Profile
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration


def with_turn_of(reason: Reason, image: U8, calibration: Calibration, profile: Profile) -> Reason:
    """The reason why a frame's image is refused, with how it would pass, if it would.

    For any thread: by judges and, for what only it refuses, a network of its own, so that it takes
    as long as a hundred frames.
    """
    judges, grey = plain_judges(calibration), to_grey(np.asarray(image))
    size = calibration.image_height_px, calibration.image_width_px
    if judges.reason(grey) is not None:
        return with_turn(reason, grey, size, lambda turned: judges.reason(turned) is None)
    if profile.network is None:
        return reason
    network = load_network(profile.network, calibration.fitted.get(profile.name))
    own = Reconstructor(calibration, profile, network)

    def passes(turned: U8) -> bool:
        return first_reason(own.measured(turned)) is None

    # It may be another frame than those that are refused.
    return reason if passes(grey) else with_turn(reason, grey, size, passes)
