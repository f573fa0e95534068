"""Four judges of a frame, each with one question:
the picture, its light, the camera's place, the skin.
"""

from __future__ import annotations

from collections.abc import Iterable

from tacshade_edge.reasons import Reason
from tacshade_edge.sensor.frame_check.camera_drift import CameraJudge
from tacshade_edge.sensor.frame_check.foreign_skin import PlainSkinJudge
from tacshade_edge.sensor.frame_check.picture import LightJudge, Measured, PictureJudge, size_reason
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.sensor.image.white import eighth
from tacshade_edge.types import U8, Calibration, Disc

__all__ = ["Judges", "Measured", "PictureJudge", "first_reason", "plain_judges", "size_reason"]


class Judges:
    """The judges of one sensor's images that need no network, in the order in which they are asked.

    `pitch_px`: for the plain tests of the skin; None if a network judges it. `camera_px`: width of
    a pixel here in the camera's, in which reasons are given. `unloaded`: nothing touches the skin
    in the images.
    """

    def __init__(
        self,
        reference_grey: U8,
        disc: Disc,
        pitch_px: float | None,
        camera_px: int = 1,
        *,
        unloaded: bool = False,
    ) -> None:
        mask = disc_mask(reference_grey.shape[0], reference_grey.shape[1], disc)
        self._shape = reference_grey.shape
        self.picture = PictureJudge(reference_grey, mask)
        self.light = LightJudge(reference_grey, mask)
        self.camera = CameraJudge(reference_grey, disc, camera_px)
        self.skin = pitch_px and PlainSkinJudge(
            reference_grey, mask, disc, pitch_px, camera_px, unloaded=unloaded
        )

    def measured(self, grey: U8) -> tuple[Measured, ...]:
        """What they measure of an image, uint8 (H, W) of the reference's size;
        nothing after the first that refuses.
        """
        made = self.picture.measured(grey)
        if first_reason(made) is None:
            eighths = eighth(grey)
            made += self.light.measured(grey, eighths) + self.camera.measured(eighths)
            if self.skin and first_reason(made) is None:
                made += self.skin.measured(grey)
        return made

    def passes(self, grey: U8) -> bool:
        """Whether an image, uint8 (H, W) of the reference's size, clearly passes; False for one
        that only `measured` can tell.
        """
        if self.skin or not self.picture.passes(grey):
            return False
        eighths = eighth(grey)
        return self.light.passes(grey, eighths) and self.camera.passes(eighths)

    def reason(self, grey: U8) -> Reason | None:
        """Why an image, uint8 (H, W), cannot be used; None if it can."""
        return size_reason(grey, self._shape) or first_reason(self.measured(grey))


def plain_judges(calibration: Calibration, *, unloaded: bool = False) -> Judges:
    """Those of a sensor's images where no network runs."""
    return Judges(
        calibration.reference_grey,
        calibration.geometry.disc,
        calibration.pitch_px,
        unloaded=unloaded,
    )


def first_reason(measured: Iterable[Measured]) -> Reason | None:
    """The reason of the first judge that refuses; None if none does."""
    return next((each.reason for each in measured if each.refuses), None)
