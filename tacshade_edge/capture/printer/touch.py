"""The head and the camera together: down step by step, and the height at which it first touches."""

from __future__ import annotations

from collections.abc import Sequence

from tacshade_edge.capture.printer.contact_detector import ContactDetector
from tacshade_edge.capture.printer.head import Head
from tacshade_edge.capture.printer.safety_stop import SafetyStop
from tacshade_edge.capture.printer.steps import CLEAR_MM, NEAR_MM, Expected, descent, search

# Steps in which a touch is looked for, one after the other: where nothing is known of its height, and where it is.
FROM_AFAR_MM, FROM_NEAR_MM = (1.0, 0.25, 0.05), (0.25, 0.05)

# Above what a step found it is free again by so much; and found again within so much more.
_OFF_MM, _AGAIN_MM = 0.15, 0.1
# A touch is seen so much late on average: half of the last step, and what the camera needs to see.
_SEEN_LATE_MM = 0.045
# So much lower than expected a touch is looked for.
_LOWER_MM = 3.0


class Touch:
    """Moves of one head that one camera watches. All raise Stopped, SafetyStop and DeviceError.

    Parameters
    ----------
    head : Head
    detector : ContactDetector
    least_z_mm : float
        Of the printer.
    """

    def __init__(self, head: Head, detector: ContactDetector, least_z_mm: float) -> None:
        self.head = head
        self.detector = detector
        self._least_z_mm = least_z_mm

    def down(self, touch_z_mm: float, to_z_mm: float) -> None:
        """Straight down, and at every step see what must be seen by where it must touch."""
        for step in descent(self.head.z_mm, touch_z_mm, to_z_mm):
            self.head.to(step.z_mm)
            touched = self.detector.look()
            if step.expected is (Expected.FREE if touched else Expected.TOUCHED):
                where = f"{step.z_mm - touch_z_mm:+.2f} mm from the expected touch"
                found = "contact" if touched else "no contact"
                raise SafetyStop(f"the picture shows {found} {where}, expected {step.expected.value}")

    def lift(self) -> None:
        """Up to where it is free."""
        self.head.to(self.head.free_z_mm)

    def free_over(self, touch_z_mm: float) -> None:
        """From now on it is free at some distance over a touch; go there."""
        self.head.free_z_mm = touch_z_mm + CLEAR_MM
        self.lift()

    def from_near(self, x_mm: float, y_mm: float, expected_z_mm: float) -> float:
        """Touch at a place where the height is known roughly: it more exactly. The head stays there."""
        self.head.over(x_mm, y_mm)
        self.detector.learn_free()
        self.down(expected_z_mm, expected_z_mm + NEAR_MM)
        return self._touch(expected_z_mm - _LOWER_MM, FROM_NEAR_MM)

    def from_afar(self) -> float:
        """Touch where nothing is known of the height; the head stays there."""
        self.detector.learn_free()
        return self._touch(self._least_z_mm, FROM_AFAR_MM)

    def _touch(self, least_z_mm: float, steps_mm: Sequence[float]) -> float:
        """Look for a touch in ever smaller steps, each of which must find again what the one before found."""
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
        raise SafetyStop(f"found no touch down to z {self.head.z_mm:.2f} mm, expected one above z {least_z_mm:.2f} mm")
