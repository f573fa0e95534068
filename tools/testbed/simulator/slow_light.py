"""Light that changes slowly: a camera and LEDs that warm up, and LEDs that age."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.types import U8
from tools.testbed.simulator import camera_faults


@dataclass(frozen=True, slots=True)
class SlowLight:
    """The light of a sensor over time.

    Attributes
    ----------
    warm_up_s : float
        Time constant of a body that takes up a steady heat and gives it off by its excess of temperature (Newton's
        law of cooling): it is warm to 1 - exp(-t / warm_up_s).
    l70_h : float
        Hours after which an LED gives 70 % of its light; it decays exponentially, as IES TM-21 extrapolates it.
    on_for_s, burnt_h : float
        At time 0: since when it has been switched on, and how long the LEDs have burnt in all.
    """

    warm_up_s: float = 600.0
    l70_h: float = 30_000.0
    on_for_s: float = 0.0
    burnt_h: float = 0.0

    def warm_part(self, t_s: float) -> float:
        """How warm it is, 0 to 1."""
        return 1 - math.exp(-max(self.on_for_s + t_s, 0.0) / self.warm_up_s)

    def aged_part(self, t_s: float) -> float:
        """Which part of their first light the LEDs give."""
        return float(0.7 ** ((self.burnt_h + t_s / 3600) / self.l70_h))

    def on(self, image: U8, model: SensorModel, t_s: float) -> U8:
        """An image, uint8 (H, W, 3), that was drawn in the first light, as it is at a time."""
        warm = camera_faults.warm(image, model.row_c, model.col_c, self.warm_part(t_s))
        return nuisance.gain(warm, self.aged_part(t_s))
