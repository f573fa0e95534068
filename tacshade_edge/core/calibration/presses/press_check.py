"""Check that `calibrate` can use the image of a press, while the indenter is still there."""

from __future__ import annotations

from dataclasses import dataclass

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.observation.press_observation import observe_press
from tacshade_edge.core.calibration.presses.press_question import question
from tacshade_edge.core.calibration.presses.press_view import PressViewer
from tacshade_edge.core.calibration.quality import GRADED_PROFILE
from tacshade_edge.core.calibration.reference.references import PROFILE
from tacshade_edge.core.contact.gate import ContactGate
from tacshade_edge.core.depth import Network
from tacshade_edge.core.frame_check import registration
from tacshade_edge.core.frame_check.validity import invalid_reason, sensor_check
from tacshade_edge.core.image.grey_maps import GreyMapper
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.reasons import Reason
from tacshade_edge.types import U8, Calibration


@dataclass(frozen=True, slots=True)
class Judgement:
    """The judgement on an image of a press; an unusable one leaves the other fields without meaning. `moved` says that
    the camera moved too far since the references, `changed` what changed less; both empty if nothing did.
    """

    unusable: Reason | None
    moved: str = ""
    changed: str = ""
    in_contact: bool = False


class PressCheck:
    """Judges images of one sensor from its calibration without presses; a network of `GRADED_PROFILE` lets it compare a
    press with its stated values.
    """

    def __init__(self, unloaded: Calibration, network: Network | None = None) -> None:
        self.geometry = unloaded.geometry
        self._preprocessor = Preprocessor(unloaded, PROFILE)
        self._mapper = GreyMapper(self._preprocessor)
        self._gate = ContactGate(self._preprocessor)
        self._check = sensor_check(unloaded)
        self._viewer = PressViewer(unloaded, PROFILES[GRADED_PROFILE], network) if network else None
        self._disc = unloaded.geometry.disc
        self._reference = registration.look(unloaded.reference_grey, self._disc, unloaded.pitch_px)

    def located_mm(self, image: U8, depth_mm: float) -> tuple[float, float]:
        """The place (x, y) of a pressed ball in mm, as `calibrate` finds it."""
        press = KnownPress("", image, 1.0, depth_mm, None, None)
        return observe_press(self._preprocessor, self._mapper, press).place_mm

    def question(self, press: KnownPress) -> str:
        """A question about the value that differs from the image, as in `press_question`; empty without a network."""
        view = self._viewer.view(press) if self._viewer else None
        return question(view, press, self.geometry) if view else ""

    def judge(self, image: U8) -> Judgement:
        """Judge an image (H, W) or (H, W, 3)."""
        grey = self._preprocessor.grey(image)
        if reason := invalid_reason(grey, self._check):
            return Judgement(reason)
        drift = registration.drift(self._reference, grey)
        shift = registration.shift_reason(drift, self._disc)
        if shift and registration.shifted_too_far(drift, self._disc):
            return Judgement(None, moved=str(shift))
        changed = str(shift or registration.light_drift_reason(drift) or "")
        in_contact = self._gate.opens(self._preprocessor.preprocess(grey))
        if not in_contact and self._viewer:
            in_contact = self._viewer.touches(grey)
        return Judgement(None, changed=changed, in_contact=in_contact)
