"""Estimate how firmly an object is held: its margin before it slips, from the loads that shear and depth show.

On skin that behaves like independent springs (Winkler's foundation), the normal load of a contact follows its depth and
the tangential load its shear: by Coulomb's law it slides at some ratio of the two, friction times the ratio of the
springs' stiffnesses. This limit differs between skins and objects. The contact shows it when it slides; before that,
`LIMIT` is assumed. A load borne without a slide shows that the limit is higher, if it was borne for a while or went
back, because a sliding contact keeps its ratio.

The shrinking of the sticking part before the whole contact slides (Cattaneo 1938; Mindlin 1949) does not help: the
networks' shear has the same relative strain whether half of the contact sticks or nothing does.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from tacshade_edge.types import Slip

ALARM = 0.25
"""Margin below which a contact is about to slip."""
LIMIT = 0.65
"""Assumed ratio of mean shear to greatest depth at which a contact slides: a low one among simulated skins."""
LEAST_LIMIT, LEAST_DEPTH_MM = 0.1, 0.2
"""Least learned limit and least depth to divide by; less is noise."""
FILTER_NS = 80_000_000
"""Time constant of the ratio's low pass."""
SLIDE_NS = 60_000_000
"""Least duration of a slide: a shaken object seems to slide for a frame or two."""

WENT_BACK = 0.85
"""If the ratio falls below this part of its peak without a slide, the peak was borne."""
BORNE_NS, BEYOND = 2_000_000_000, 1.5
"""A ratio held this long without a slide was borne too; before any slide, the limit is assumed this factor above it."""


@dataclass(slots=True)
class Grip:
    """The hold on one object, updated frame by frame; `limit` is the ratio at which it slides: after a slide, the
    greatest of that slide or borne since.
    """

    limit: float = LIMIT
    _ratio: float = 0.0
    _t_ns: int | None = None
    _since_ns: int | None = None
    """Time at which the slide began."""
    _slides: bool = False
    _beyond: float = BEYOND
    _peak: float = 0.0
    """Greatest ratio since the last one that went back."""
    _lately: deque[tuple[int, float]] = field(default_factory=deque)
    """Times and ratios of the last `BORNE_NS`."""

    def step(self, t_ns: int, shear_mm: tuple[float, float], depth_mm: float, slip: Slip) -> float:
        """Update the hold with a frame (its time, mean shear, greatest h and slip), and return the margin from 1 (firm)
        to 0 (the whole contact slides, or would). A frame not after the last begins another stream.
        """
        ratio = math.hypot(*shear_mm) / max(depth_mm, LEAST_DEPTH_MM)
        if self._t_ns is None or t_ns <= self._t_ns:
            self._ratio, self._since_ns = ratio, None
            self._lately.clear()
        else:
            self._ratio += (ratio - self._ratio) * -math.expm1((self._t_ns - t_ns) / FILTER_NS)
        self._t_ns = t_ns
        if slip is not Slip.FULL:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = t_ns
        slid, self._slides = self._slides, self._since_ns is not None and t_ns - self._since_ns >= SLIDE_NS
        if self._slides:
            self.limit = max(self._ratio, self.limit if slid else LEAST_LIMIT)
            self._beyond = 1.0
            self._lately.clear()
            self._peak = 0.0
            return 0.0
        self._lately.append((t_ns, self._ratio))
        self._peak = max(self._peak, self._ratio)
        if self._ratio < WENT_BACK * self._peak:
            self.limit = max(self.limit, self._beyond * self._peak)
            self._peak = self._ratio
        while t_ns - self._lately[0][0] >= BORNE_NS:
            self.limit = max(self.limit, self._beyond * self._lately.popleft()[1])
        return max(0.0, 1 - self._ratio / self.limit)
