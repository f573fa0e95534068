"""Whether the robot's places, as the frames have them, can be in mm."""

from __future__ import annotations

import logging
from collections.abc import Callable

from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.plausibility.stream_places import StreamPlaces
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.verbs import places_text

_log = logging.getLogger(__name__)


class PlacedFrames:
    """Judges the places of frames, and tells the robot of a doubt once; the main thread reads
    `reason`.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.reason: Reason | None = None
        self._tell = tell
        self._size_mm = 0.0
        self._places: StreamPlaces | None = None

    def see(self, seen: FrameResult) -> None:
        """Take a frame in the reconstruct thread."""
        pose, result, calibration = seen.frame.pose, seen.reconstruction, seen.calibration
        # A touch of unknown depth is neither a press nor its end.
        if pose is None or result is None or calibration is None or result.touched:
            return
        if not result.valid:
            return
        size_mm = calibration.geometry.size_mm
        if self._places is None or size_mm != self._size_mm:
            self._size_mm, self._places = size_mm, StreamPlaces(size_mm)
        depth_mm = result.depth_max_mm if result.contact else None
        place, facing = (pose.x_mm, pose.y_mm, pose.z_mm), (pose.qw, pose.qx, pose.qy, pose.qz)
        self._places.take(place, result.t_ns, depth_mm, facing)
        found = self._places.found
        if found is None:
            self.reason = None
        elif self.reason is None:
            _log.warning("the robot's places: %s", found)
            self._tell(places_text(found))
            self.reason = Reason(ReasonCode.POSE_UNIT, str(found))
