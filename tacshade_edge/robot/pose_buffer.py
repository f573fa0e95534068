"""The robot's latest poses, and its pose between two of them."""

from __future__ import annotations

import bisect
import math
from collections import deque
from dataclasses import dataclass

from tacshade_edge.types import Pose

_SMALL_RAD = 1e-4
"""The sines of smaller angles equal them within 1e-9."""
GAP_MAX_NS = 250_000_000  # poses farther apart do not show the motion in between
EXTRAPOLATION_MAX_NS = 20_000_000  # at 1 m/s² a straight line is then wrong by 0.2 mm
# Longer than a frame can wait for its reconstruction, its session or its recording.
HISTORY_NS = 5_000_000_000
# More than this time holds at 1 kHz, the highest rate of a line at 460800 baud.
POSES_MAX = 8192


@dataclass(frozen=True, slots=True)
class InterpolatedPose:
    """A pose, and the time by which it is later than the newest known one."""

    pose: Pose
    extrapolated_ns: int


def interpolate(a: Pose, b: Pose, t_ns: int) -> Pose:
    """The pose at `t_ns` in a uniform motion and rotation by slerp (Shoemake 1985), the shorter
    way, from `a` to `b` (at another time), extrapolated beyond. Two equal poses give that pose to
    the last bit: a robot at rest is at one place.
    """
    fraction = (t_ns - a.t_ns) / (b.t_ns - a.t_ns)
    q, r = (a.qw, a.qx, a.qy, a.qz), (b.qw, b.qx, b.qy, b.qz)
    dot = sum(u * v for u, v in zip(q, r, strict=True))
    # q and -q are the same rotation; from the other one, the way is the shorter.
    if dot < 0:
        dot, r = -dot, (-r[0], -r[1], -r[2], -r[3])
    angle = math.acos(min(dot, 1.0))
    if q == r:
        weights = 1.0, 0.0
    elif angle < _SMALL_RAD:
        weights = 1 - fraction, fraction
    else:
        weights = (
            math.sin((1 - fraction) * angle) / math.sin(angle),
            math.sin(fraction * angle) / math.sin(angle),
        )
    rotated = [weights[0] * u + weights[1] * v for u, v in zip(q, r, strict=True)]
    norm = math.hypot(*rotated)
    qw, qx, qy, qz = (value / norm for value in rotated)
    x, y, z = (
        u + fraction * (v - u) for u, v in ((a.x_mm, b.x_mm), (a.y_mm, b.y_mm), (a.z_mm, b.z_mm))
    )
    return Pose(t_ns, x, y, z, qw, qx, qy, qz)


class PoseBuffer:
    """The latest poses in order of time, all of one clock, for one thread; `late` counts those
    dropped because they were not later.
    """

    def __init__(self) -> None:
        self.late = 0
        self._poses: deque[Pose] = deque(maxlen=POSES_MAX)

    def add(self, pose: Pose) -> None:
        """Keep a pose."""
        poses = self._poses
        if poses and pose.t_ns <= poses[-1].t_ns:
            self.late += 1
            return
        poses.append(pose)
        while pose.t_ns - poses[0].t_ns > HISTORY_NS:
            poses.popleft()

    def clear(self) -> None:
        """Drop all poses, because the next ones are of another clock."""
        self._poses.clear()

    def at(self, t_ns: int) -> InterpolatedPose | None:
        """The pose between two poses at most `GAP_MAX_NS` apart,
        or at most `EXTRAPOLATION_MAX_NS` after the newest.
        """
        poses = self._poses
        if len(poses) <= 1 or t_ns < poses[0].t_ns:
            return None
        after = bisect.bisect_left(poses, t_ns, key=lambda pose: pose.t_ns)
        extrapolated_ns = max(0, t_ns - poses[-1].t_ns)
        after = min(max(after, 1), len(poses) - 1)
        a, b = poses[after - 1], poses[after]
        if extrapolated_ns > EXTRAPOLATION_MAX_NS or (
            b.t_ns - a.t_ns > GAP_MAX_NS and t_ns not in (a.t_ns, b.t_ns)
        ):
            return None
        return InterpolatedPose(interpolate(a, b, t_ns), extrapolated_ns)
