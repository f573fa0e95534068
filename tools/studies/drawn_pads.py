"""Random surfaces for a robot to press all over: with the touchpad, they are the test cases of stitching."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacshade_edge.rigid import Rigid
from tacshade_edge.simulator.objects import Shape
from tacshade_edge.simulator.pad import Arc, Bar, Bulge, Dot, Pad, Surface, touchpad
from tacshade_edge.types import F64

SIDE_MM = 36.0
_MARGIN_MM = 2.0


@dataclass(frozen=True, slots=True)
class Relief:
    """A smooth square: a sum of waves.

    Attributes
    ----------
    width_mm, length_mm : float
        Extent from (0, 0).
    waves : tuple of (float, float, float, float)
        Each wave's amplitude in mm, wave numbers along x and y in rad per mm, and phase in rad.
    """

    width_mm: float
    length_mm: float
    waves: tuple[tuple[float, float, float, float], ...]

    @property
    def top_mm(self) -> float:
        """The z of the highest point in mm."""
        axis = np.linspace(0, 1, 73)
        return float(self.height_mm(*np.meshgrid(axis * self.width_mm, axis * self.length_mm)).max())

    def height_mm(self, x: F64, y: F64) -> F64:
        """The surface's z in mm at points of the plane."""
        return np.asarray(sum(a * np.sin(kx * x + ky * y + phase) for a, kx, ky, phase in self.waves))

    def under(self, base_T_sensor: Rigid, skin_radius_mm: float) -> Shape:
        """The shape that a sensor at a pose meets, like `Pad.under`."""
        apex = np.array((0.0, 0.0, skin_radius_mm))
        # A height over the surface is at most this many times the distance to it.
        steepest = math.hypot(1, sum(abs(a) * math.hypot(kx, ky) for a, kx, ky, _ in self.waves))

        def sdf(points: F64) -> F64:
            at = base_T_sensor.apply(points + apex)
            return ((at[:, 2] - self.height_mm(at[:, 0], at[:, 1])) / steepest).astype(points.dtype)

        return Shape("relief", sdf)


def shapes(seed: int) -> Pad:
    """Bars, arcs, rings and dots at random places, many of them meeting."""
    rng = np.random.default_rng((seed, 11))
    return Pad(SIDE_MM, SIDE_MM, tuple(_bulge(rng) for _ in range(12)))


def sparse(seed: int) -> Pad:
    """A plate with two bulges: most presses feel nothing but the plate."""
    rng = np.random.default_rng((seed, 12))
    return Pad(SIDE_MM, SIDE_MM, tuple(_bulge(rng) for _ in range(2)))


def relief(seed: int) -> Relief:
    """Waves of 12 to 40 mm, together about 2 mm high."""
    rng = np.random.default_rng((seed, 13))
    waves = []
    for _ in range(4):
        number, angle = 2 * math.pi / rng.uniform(12, 40), rng.uniform(0, math.pi)
        amplitude, phase = rng.uniform(0.2, 0.5), rng.uniform(0, 2 * math.pi)
        waves.append((float(amplitude), number * math.cos(angle), number * math.sin(angle), float(phase)))
    return Relief(SIDE_MM, SIDE_MM, tuple(waves))


KINDS: dict[str, Callable[[int], Surface]] = {
    "touchpad": lambda _seed: touchpad(),
    "shapes": shapes,
    "sparse": sparse,
    "relief": relief,
}
"""Kind to the surface of a seed."""


def _bulge(rng: np.random.Generator) -> Bulge:
    x, y = rng.uniform(_MARGIN_MM, SIDE_MM - _MARGIN_MM, 2).tolist()
    width, size, angle = float(rng.uniform(2, 4)), float(rng.uniform(3, 7)), float(rng.uniform(0, 2 * math.pi))
    kind = int(rng.integers(4))
    if kind == 0:
        return Dot(x, y, size / 2)
    if kind == 1:
        return Arc(x, y, size, width)
    if kind == 2:
        return Arc(x, y, size, width, math.degrees(angle), math.degrees(angle) + float(rng.uniform(90, 270)))
    return Bar(x, y, x + 2 * size * math.cos(angle), y + 2 * size * math.sin(angle), width)
