"""A simulated sensor that has worn: dimmer light, faded markers, bent pins, or less gel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.render import Renderer
from tacshade_edge.lab.simulator.sensor_model import RIM_HALF_ANGLE_DEG, SensorModel
from tacshade_edge.lab.simulator.skin import Skin, node_directions, press_skin, undeformed
from tacshade_edge.lab.simulator.truth import SimulatedFrame
from tacshade_edge.types import F32, F64, U8


@dataclass(frozen=True, slots=True)
class Wear:
    """What has worn, and how far; the fields that are 0 have not.

    `dimmed` and `dimmed_side` are the parts of its light that the whole picture has lost, and that
    the edge of one side has (the opposite one none); `faded` the part of the markers' white beyond
    the skin's. `bent_mm` is how far the tips of pins within `bent_radius_mm` of one place stand
    aside, `leaked_mm` how far the tip of the skin has sunk. `seed` chooses side and place.
    """

    dimmed: float = 0.0
    dimmed_side: float = 0.0
    faded: float = 0.0
    bent_mm: float = 0.0
    bent_radius_mm: float = 4.0
    leaked_mm: float = 0.0
    seed: int = 0


class WornSensor:
    """A sensor of the simulator's own family after wear."""

    def __init__(self, model: SensorModel, wear: Wear) -> None:
        self.model = model
        white = model.marker_reflectance
        faded = replace(
            model, marker_reflectance=white - wear.faded * (white - model.skin_reflectance)
        )
        self._renderer = _BentPins(faded, wear)
        self._light = _light(model, wear)
        self._sunk_mm = _sunk_mm(model, wear.leaked_mm) if wear.leaked_mm else None
        self.rest = self.skin()
        self._drawn: tuple[Skin, F32] | None = None

    def skin(self, presses: Sequence[Press] = ()) -> Skin:
        """Shape the skin; what has leaked gives way before an object touches."""
        radius_mm, size_mm = self.model.form_mm
        return press_skin(
            radius_mm, self.model.skin_decay_mm, presses, self._sunk_mm, size_mm=size_mm
        )

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture under presses; their truth is h from the new sensor's skin."""
        skin = self.skin(presses) if presses else self.rest
        return SimulatedFrame(self.picture(skin, noise_seed), tuple(presses), skin, self.model)

    def picture(self, skin: Skin, noise_seed: int = 0) -> U8:
        """Take a picture of a skin: uint8 (H, W, 3) BGR."""
        return self._renderer.expose(self.drawn(skin), noise_seed)

    def drawn(self, skin: Skin) -> F32:
        """The noiseless picture of a skin, float32 (H, W); the last one is kept."""
        if self._drawn is None or self._drawn[0] is not skin:
            self._drawn = skin, self._renderer.draw(skin) * self._light
        return self._drawn[1]

    def exposed(self, drawn: F32, noise_seed: int) -> U8:
        """A noiseless picture as the camera gives it, uint8 (H, W)."""
        return self._renderer.level(drawn, noise_seed)


class _BentPins(Renderer):
    """Draws pins around one place with their tips aside."""

    def __init__(self, model: SensorModel, wear: Wear) -> None:
        super().__init__(model)
        rng = np.random.default_rng((wear.seed, 31))
        reach_mm = 0.6 * model.geometry.visible_radius_mm
        far_mm, angle, aside = rng.uniform(0, reach_mm), *rng.uniform(0, 2 * math.pi, 2)
        place = far_mm * np.array((math.cos(angle), math.sin(angle)))
        near = np.linalg.norm(self.print.pin_chart_mm - place, axis=1) <= wear.bent_radius_mm
        self._aside_mm: F64 = (wear.bent_mm * near)[:, None] * (
            math.cos(aside),
            math.sin(aside),
            0.0,
        )

    def _pins_on(self, skin: Skin, smooth: Skin):  # type: ignore[no-untyped-def]
        pins = super()._pins_on(skin, smooth)
        return replace(pins, lead_mm=pins.lead_mm + self._aside_mm)


def _light(model: SensorModel, wear: Wear) -> F32:
    """The part of the light that is left, float32 (H, W)."""
    rows, cols = np.ogrid[: model.image_height_px, : model.image_width_px]
    angle = float(np.random.default_rng((wear.seed, 32)).uniform(0, 2 * math.pi))
    along = (rows - model.row_c) * math.sin(angle) + (cols - model.col_c) * math.cos(angle)
    side = wear.dimmed_side * np.clip((1 + along / model.disc_radius_px) / 2, 0, 1)
    return np.asarray((1 - wear.dimmed) * (1 - side), np.float32)


def _sunk_mm(model: SensorModel, leaked_mm: float) -> F32:
    """By how much each node of the skin has sunk: most at the tip, not at all at the housing."""
    radius_mm, size_mm = model.form_mm
    directions = node_directions(radius_mm, size_mm)
    if math.isinf(radius_mm):
        rim_mm = 2 * size_mm * math.tan(math.radians(RIM_HALF_ANGLE_DEG / 2))
        up = 1 - np.sum(directions[..., :2] ** 2, axis=-1) / rim_mm**2
    else:
        low = math.cos(math.radians(RIM_HALF_ANGLE_DEG))
        up = (directions[..., 2] - low) / (1 - low)
    made = np.asarray(leaked_mm * np.clip(up, 0, 1), np.float32)
    if made.shape != undeformed(radius_mm, size_mm).height_mm.shape:
        raise ValueError("the nodes of the skin are others than those of its directions")
    return made
