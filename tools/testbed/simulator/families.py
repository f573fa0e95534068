"""More families of simulated sensors, never trained on;
importing this module registers their names for studies.

The other model has a square lattice, mushroom pins, another skin and other mechanics of drag.
"""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tacshade_edge.cli.shared import study
from tacshade_edge.lab.simulator.drag import TURNING, drag_skin, two_scale_skin
from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.render import CAP, FRUSTUM, Print, Renderer, print_at, reach_mm
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model
from tacshade_edge.lab.simulator.skin import Skin, left_over, press_skin
from tacshade_edge.lab.simulator.truth import SimulatedFrame, skin_under
from tacshade_edge.lab.studies.evaluate.work import FAMILIES, PressedSensor, SensorName
from tacshade_edge.types import F32, U8


def lattice_print(model: SensorModel, angle_deg: float, ratio: float = 1.0) -> Print:
    """Place pins on a lattice with any angle and ratio of sides,
    and a marker in the middle of each cell.
    """
    n = 2 * math.ceil(reach_mm(model) / model.pitch_mm) + 2
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    a, b = math.radians(model.lattice_rotation_deg), math.radians(angle_deg)
    sides = np.array(((1.0, 0.0), (ratio * math.cos(b), ratio * math.sin(b)))) / math.sqrt(ratio)
    cell = (
        model.pitch_mm * sides @ np.array(((math.cos(a), math.sin(a)), (-math.sin(a), math.cos(a))))
    )
    corners = np.stack((i.ravel(), j.ravel()), axis=1)
    return print_at(model, corners @ cell, (corners + 0.5) @ cell)


class OtherSensor:
    """A `SimulatedSensor` of the other model, or of the usual model with the other's lattice,
    pins or skin.
    """

    def __init__(
        self, model: SensorModel, square: bool = True, capped: bool = True, two_scales: bool = True
    ) -> None:
        self.model = model
        self._differences = (square, capped, two_scales)
        marks = lattice_print(model, 90.0) if square else None
        self._renderer = Renderer(model, marks, CAP if capped else FRUSTUM)
        self._drawn: tuple[Skin, F32] | None = None

    def noiseless(self) -> OtherSensor:
        """Make the same sensor with a noiseless camera."""
        return OtherSensor(
            replace(self.model, read_noise_grey=0.0, shot_noise_grey=0.0), *self._differences
        )

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture."""
        skin = self.skin(presses)
        return SimulatedFrame(self.picture(skin, noise_seed), tuple(presses), skin, self.model)

    def released(
        self, presses: Sequence[Press], part: float, noise_seed: int = 0
    ) -> SimulatedFrame:
        """Take a picture after a release, while the skin still keeps part of its deformation."""
        skin = left_over(self.skin(presses), part)
        return SimulatedFrame(self.picture(skin, noise_seed), (), skin, self.model)

    def picture(self, skin: Skin, noise_seed: int = 0) -> U8:
        """Take a picture of a skin: uint8 (H, W, 3) BGR."""
        if self._drawn is None or self._drawn[0] is not skin:
            self._drawn = skin, self._renderer.draw(skin)
        return self._renderer.expose(self._drawn[1], noise_seed)

    def skin(self, presses: Sequence[Press] = ()) -> Skin:
        """Compute the skin under the presses."""
        model, presses = self.model, tuple(presses)

        def shape(leaning_mm: F32 | None) -> Skin:
            if self._differences[2]:
                return two_scale_skin(model, presses, leaning_mm)
            return press_skin(model.skin_radius_mm, model.skin_decay_mm, presses, leaning_mm)

        return drag_skin(shape, model, presses, TURNING if self._differences[2] else None)


def other_model(seed: int) -> SensorModel:
    """Draw a sensor with caps so wide that contact makes the image brighter."""
    rng = np.random.default_rng((seed, 13))
    return replace(
        random_model(seed),
        pin_tip_radius_pitches=float(rng.uniform(0.36, 0.40)),
        pin_base_radius_pitches=float(rng.uniform(0.18, 0.24)),
        marker_radius_pitches=float(rng.uniform(0.40, 0.50)),
    )


def released(
    sensor: PressedSensor, presses: Sequence[Press], part: float, noise_seed: int = 0
) -> SimulatedFrame:
    """Take a picture after a release, while the skin still keeps part of its deformation."""
    if isinstance(sensor, OtherSensor):
        return sensor.released(presses, part, noise_seed)
    skin, renderer = (
        left_over(skin_under(sensor.model, tuple(presses)), part),
        _renderer(sensor.model),
    )
    return SimulatedFrame(renderer.expose(renderer.draw(skin), noise_seed), (), skin, sensor.model)


@functools.lru_cache(maxsize=2)
def _renderer(model: SensorModel) -> Renderer:
    return Renderer(model)


FINAL_SEED = 9000
"""Sensors from this seed on are for final figures;
nobody evaluates them while working on the measured code.
"""


def _usual(seed: int | None) -> SensorModel:
    return SensorModel() if seed is None else random_model(seed)


def other(seed: int | None) -> OtherSensor:
    """Make a sensor of the other family, on which no network was trained."""
    return OtherSensor(other_model(seed or 0))


# Each of these families has one of the other family's differences.


def square(seed: int | None) -> OtherSensor:
    """Make a usual sensor with a square lattice."""
    return OtherSensor(_usual(seed), capped=False, two_scales=False)


def capped(seed: int | None) -> OtherSensor:
    """Make a sensor with the usual skin and lattice, and the other family's mushroom pins."""
    return OtherSensor(other_model(seed or 0), square=False, two_scales=False)


def two_scales(seed: int | None) -> OtherSensor:
    """Make a sensor with the usual print on the other family's skin."""
    return OtherSensor(_usual(seed), square=False, capped=False)


FAMILIES.update({"other": other, "square": square, "capped": capped, "two-scales": two_scales})
FINAL_SENSORS = tuple(
    SensorName(family, FINAL_SEED + k) for family in ("tacshade", "other") for k in (21, 22, 23)
)


def sensor_name(text: str) -> SensorName:
    """Read ``[FAMILY:]SEED`` or ``default``. Raises ValueError."""
    return SensorName.parse(text)


def working_sensors(text: str) -> tuple[SensorName, ...]:
    """Read ``[FAMILY:]SEED,...``, for argparse; refuse sensors that are kept for final figures."""
    names = study.sensors(text)
    kept = [name for name in names if name.seed is not None and name.seed >= FINAL_SEED]
    if kept:
        raise argparse.ArgumentTypeError(
            f"{kept[0]}: seeds from {FINAL_SEED} on are kept for --final"
        )
    return names
