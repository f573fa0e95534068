"""Lowers the head step by step while the camera watches, and finds the height of the first touch."""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.capture.printer.contact_detector import ContactDetector
from tacshade_edge.capture.printer.head import Head
from tacshade_edge.capture.printer.safety_stop import SafetyStop
from tacshade_edge.capture.printer.steps import CLEAR_MM, NEAR_MM, Expected, descent, search

# Step sizes of the successive searches for a touch of unknown height, and of roughly known height.
FROM_AFAR_MM, FROM_NEAR_MM = (1.0, 0.25, 0.05), (0.25, 0.05)

# How far above a touch and its step the head is free again, and how far below the touch it is sought again.
_OFF_MM, _AGAIN_MM = 0.15, 0.1
# How much too low a touch is found on average: half of the last step, plus the depth that the camera needs.
_SEEN_LATE_MM = 0.045
# How far below the expected touch the search goes.
_LOWER_MM = 3.0


class Touch:
    """Moves of one head watched by one camera. All raise Stopped, SafetyStop and DeviceError.

    Parameters
    ----------
    head : Head
    detector : ContactDetector
    least_z_mm : float
        The printer's lowest allowed z.
    """

    def __init__(self, head: Head, detector: ContactDetector, least_z_mm: float) -> None:
        self.head = head
        self.detector = detector
        self._least_z_mm = least_z_mm

    def down(self, touch_z_mm: float, to_z_mm: float) -> None:
        """Move straight down and check after each step that the camera sees contact only where it must."""
        for step in descent(self.head.z_mm, touch_z_mm, to_z_mm):
            self.head.to(step.z_mm)
            touched = self.detector.look()
            if step.expected is (Expected.FREE if touched else Expected.TOUCHED):
                where = f"{step.z_mm - touch_z_mm:+.2f} mm from the expected first touch"
                found = "contact" if touched else "no contact"
                raise SafetyStop(f"found {found} in the picture {where}, expected {step.expected.value}")

    def lift(self) -> None:
        """Move up to the free height."""
        self.head.to(self.head.free_z_mm)

    def free_over(self, touch_z_mm: float) -> None:
        """Set the free height to `CLEAR_MM` above a touch and move there."""
        self.head.free_z_mm = touch_z_mm + CLEAR_MM
        self.lift()

    def from_near(self, x_mm: float, y_mm: float, expected_z_mm: float) -> float:
        """Touch at a place of roughly known height and return its exact z in mm. The head stays there."""
        self.head.over(x_mm, y_mm)
        self.detector.learn_free()
        self.down(expected_z_mm, expected_z_mm + NEAR_MM)
        return self._touch(expected_z_mm - _LOWER_MM, FROM_NEAR_MM)

    def from_afar(self) -> float:
        """Touch where the height is unknown and return its z in mm. The head stays there."""
        self.detector.learn_free()
        return self._touch(self._least_z_mm, FROM_AFAR_MM)

    def _touch(self, least_z_mm: float, steps_mm: Sequence[float]) -> float:
        """Search for a touch in ever smaller steps, each of which must find again the touch of the step before."""
        for step_mm in steps_mm:
            self._search(max(least_z_mm, self._least_z_mm), step_mm)
            if step_mm == steps_mm[-1]:
                break
            least_z_mm = self.head.z_mm - _AGAIN_MM
            self.head.to(self.head.z_mm + step_mm + _OFF_MM)
            if self.detector.look():
                raise SafetyStop("the picture still shows contact after the head rose")
        return self.head.z_mm + _SEEN_LATE_MM

    def _search(self, least_z_mm: float, step_mm: float) -> None:
        for z_mm in search(self.head.z_mm, least_z_mm, step_mm):
            self.head.to(z_mm)
            if self.detector.look():
                return
        raise SafetyStop(
            f"found no contact down to z {self.head.z_mm:.2f} mm, expected contact above z {least_z_mm:.2f} mm"
        )
