"""How firmly an object is held: a margin before it slips, from what shear and depth show of its loads.

On skin that gives way like springs side by side (Winkler's foundation), the load across a contact goes with its depth
and the load along it with its shear: by Coulomb's law it slides at some ratio of the two, friction times the springs'
stiffnesses. This limit differs from skin to skin and from object to object. It is learned where the contact slides, and
taken as `LIMIT` before. What was borne without a slide shows that it is higher: a load that was borne for a while, or
that went back, as what slides keeps its ratio.

That the sticking part of a contact shrinks before all of it slides (Cattaneo 1938; Mindlin 1949) does not help: the
strain of the shear that networks find is the same part of it from a half that sticks to nothing.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from tacshade_edge.types import Slip

ALARM = 0.25
"""A contact of so little margin is about to slip."""
LIMIT = 0.65
"""Mean shear over greatest depth at which a contact slides, before it is known: of simulated skins a low one."""
LEAST_LIMIT, LEAST_DEPTH_MM = 0.1, 0.2
"""What is learned and divided by is at least this: less is noise."""
FILTER_NS = 80_000_000
"""Time constant of the ratio's low pass."""
SLIDE_NS = 60_000_000
"""A slide counts from so long on: what is shaken seems to slide for a frame or two."""

WENT_BACK = 0.85
"""A ratio that falls below this part of its peak without a slide: the peak was borne."""
BORNE_NS, BEYOND = 2_000_000_000, 1.5
"""A ratio without a slide since so long was borne, too; before any slide the limit is taken to be so much beyond it."""


@dataclass(slots=True)
class Grip:
    """The hold on one object, followed frame by frame.

    Attributes
    ----------
    limit : float
        The ratio at which it slides: once it slid, the greatest of the last slide or of what it bore since.
    """

    limit: float = LIMIT
    _ratio: float = 0.0
    _t_ns: int | None = None
    _since_ns: int | None = None
    """When the slide began."""
    _slides: bool = False
    _beyond: float = BEYOND
    _peak: float = 0.0
    """Greatest ratio since one went back."""
    _lately: deque[tuple[int, float]] = field(default_factory=deque)
    """Times and ratios of the last `BORNE_NS`."""

    def step(self, t_ns: int, shear_mm: tuple[float, float], depth_mm: float, slip: Slip) -> float:
        """Take a frame.

        Parameters
        ----------
        t_ns : int
            A time not after the last one begins another stream.
        shear_mm : (float, float)
            Mean over the contact.
        depth_mm : float
            Greatest h.
        slip : Slip

        Returns
        -------
        float
            1 firm to 0: the whole contact slides, or would.
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
