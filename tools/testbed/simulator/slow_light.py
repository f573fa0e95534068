"""Slowly changing light: a camera and LEDs that warm up, and LEDs that age."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tacshade_edge.simulator import camera_faults, nuisance
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.types import U8


@dataclass(frozen=True, slots=True)
class SlowLight:
    """The light of a sensor over time.

    `warm_up_s` is Newton's time constant of warming, and `l70_h` the hours after which an LED gives 70 % of its light,
    which decays exponentially, as in IES TM-21. At time 0, the sensor has been on for `on_for_s`, and the LEDs have
    burned for `burnt_h` in total.
    """

    warm_up_s: float = 600.0
    l70_h: float = 30_000.0
    on_for_s: float = 0.0
    burnt_h: float = 0.0

    def warm_part(self, t_s: float) -> float:
        """Compute how warm the sensor is, 0 to 1."""
        return 1 - math.exp(-max(self.on_for_s + t_s, 0.0) / self.warm_up_s)

    def aged_part(self, t_s: float) -> float:
        """Compute the share of their original light that the LEDs still give."""
        return float(0.7 ** ((self.burnt_h + t_s / 3600) / self.l70_h))

    def on(self, image: U8, model: SensorModel, t_s: float) -> U8:
        """Change an image, uint8 (H, W, 3), from the original light to the light at a time."""
        warm = camera_faults.warm(image, model.row_c, model.col_c, self.warm_part(t_s))
        return nuisance.gain(warm, self.aged_part(t_s))
