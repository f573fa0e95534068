"""How firmly an object is held: a margin before it slips, from what shear and depth show of its loads.

On skin that gives way like springs side by side (Winkler's foundation), the load across a contact goes with its depth
and the load along it with its shear: by Coulomb's law it slides at some ratio of the two, friction times the springs'
stiffnesses. This limit differs from skin to skin and from object to object. It is learned where the contact slides, and
taken as `LIMIT` before.

Before all of a contact slides its outer part does (Cattaneo 1938; Mindlin 1949). The shear then falls behind the
imprint's motion, whatever the friction is, which counts beside the ratio.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from tacshade_edge.types import Slip

ALARM = 0.25
"""A contact of so little margin is about to slip."""
LIMIT = 0.7
"""Mean shear over greatest depth at which a contact slides, before it is known: of simulated skins a low one."""
LEAST_LIMIT, LEAST_DEPTH_MM = 0.1, 0.2
"""What is learned and divided by is at least this: less is noise."""
LAG_WEIGHT = 0.5
"""By so much more the ratio counts where the shear no longer follows the motion at all."""
FILTER_NS = 60_000_000
"""Time constant of the ratio's low pass."""
SPAN_NS, LEAST_FRAMES = 350_000_000, 6
"""Over which shear and motion are compared."""
LEAST_SHEAR_MM, LEAST_MOTION_MM = 0.3, 0.25
"""Below it they are not: noise would say as much."""


@dataclass(slots=True)
class Grip:
    """The hold on one object, followed frame by frame.

    Attributes
    ----------
    limit : float
        The ratio at which it slides; of the last slide its greatest, once there was one.
    """

    limit: float = LIMIT
    _ratio: float = 0.0
    _slides: bool = False
    _seen: deque[tuple[int, float, float, float, float]] = field(default_factory=deque)

    def step(
        self, t_ns: int, shear_mm: tuple[float, float], depth_mm: float, place_mm: tuple[float, float], slip: Slip
    ) -> float:
        """Take a frame.

        Parameters
        ----------
        t_ns : int
            A time not after the last one begins another stream.
        shear_mm : (float, float)
            Mean over the contact.
        depth_mm : float
            Greatest h.
        place_mm : (float, float)
            Of the imprint.
        slip : Slip

        Returns
        -------
        float
            1 firm to 0: the whole contact slides, or would.
        """
        ratio = math.hypot(*shear_mm) / max(depth_mm, LEAST_DEPTH_MM)
        if self._seen and t_ns > self._seen[-1][0]:
            self._ratio += (ratio - self._ratio) * -math.expm1((self._seen[-1][0] - t_ns) / FILTER_NS)
        else:
            self._seen.clear()
            self._ratio = ratio
        self._seen.append((t_ns, *shear_mm, *place_mm))
        while t_ns - self._seen[0][0] > SPAN_NS:
            self._seen.popleft()
        slid, self._slides = self._slides, slip is Slip.FULL
        if self._slides:
            self.limit = max(self._ratio, self.limit if slid else LEAST_LIMIT)
            return 0.0
        return max(0.0, 1 - self._ratio / self.limit * (1 + LAG_WEIGHT * self._lag()))

    def _lag(self) -> float:
        """Part of the imprint's motion that its shear did not follow, 0 to 1, along the shear; 0 before it is known."""
        seen = list(self._seen)
        x, y = seen[-1][1:3]
        size = math.hypot(x, y)
        if len(seen) < LEAST_FRAMES or size < LEAST_SHEAR_MM:
            return 0.0
        some = len(seen) // 3  # means of the first and of the last third: less noise than of single frames
        sheared, moved = (
            sum((b[k] - a[k]) * x + (b[k + 1] - a[k + 1]) * y for a, b in zip(seen[:some], seen[-some:], strict=True))
            / (size * some)
            for k in (1, 3)
        )
        return min(max(1 - sheared / moved, 0.0), 1.0) if moved >= LEAST_MOTION_MM else 0.0
