"""Is an image a press that `calibrate` can use? Told while the indenter is still there."""

from __future__ import annotations

from tacshade_edge.core.calibration.references import PROFILE
from tacshade_edge.core.contact.gate import ContactGate
from tacshade_edge.core.frame_check import registration
from tacshade_edge.core.frame_check.validity import invalid_reason, sensor_check
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.types import U8, Calibration


class PressCheck:
    """Judges images of one sensor.

    Parameters
    ----------
    unloaded : Calibration
        From the references alone.
    """

    def __init__(self, unloaded: Calibration) -> None:
        self._preprocessor = Preprocessor(unloaded, PROFILE)
        self._gate = ContactGate(self._preprocessor)
        self._check = sensor_check(unloaded)
        self._disc = unloaded.geometry.disc
        self._reference = registration.look(unloaded.reference_grey, self._disc, unloaded.pitch_px)

    def in_contact(self, image: U8) -> bool:
        """Whether anything touches the skin in an image (H, W) or (H, W, 3) that can be used."""
        return self._gate.opens(self._preprocessor.preprocess(self._preprocessor.grey(image)))

    def refusal(self, image: U8) -> str:
        """Why `calibrate` would leave the press out; empty when it is one."""
        grey = self._preprocessor.grey(image)
        if reason := invalid_reason(grey, self._check):
            return f"the picture cannot be used: {reason}"
        drift = registration.drift(self._reference, grey)
        if registration.shifted_too_far(drift, self._disc):
            shift = registration.shift_reason(drift, self._disc)
            return f"{shift} since the references: fix the camera and take the references again"
        return "" if self.in_contact(image) else "nothing touches the skin in the picture"

    def warning(self, image: U8) -> str:
        """What changed since the references, of a press that is one; empty when nothing did."""
        drift = registration.drift(self._reference, self._preprocessor.grey(image))
        change = registration.shift_reason(drift, self._disc) or registration.light_drift_reason(drift)
        return f"{change} since the references" if change else ""
