"""A simulated sensor: presses in, frames with ground truth out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tacshade_edge.simulator.drag import drag_skin
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.render import Renderer
from tacshade_edge.simulator.skin import Skin, press_skin
from tacshade_edge.simulator.truth import Truth, measure, shear_mm, skin_points
from tacshade_edge.types import F32, F64, U8


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFrame:
    """An image (BGR) with its presses, skin and model."""

    image: U8
    presses: tuple[Press, ...]
    skin: Skin
    model: SensorModel

    def truth(self) -> Truth:
        """Measure the ground truth (under half a second at 640x480)."""
        shape = (self.model.image_height_px, self.model.image_width_px)
        return measure(self.skin, self.presses, self.model.geometry, shape)

    def shear_mm(self, row: F64, col: F64) -> F64:
        """Shear (N, 2), x and y in mm, of the material that the rays of pixels inside the disc meet."""
        return shear_mm(self.skin, skin_points(self.skin, self.model.geometry, row, col), self.model.friction)


class SimulatedSensor:
    """A simulated sensor. The same presses and the same noise seed give the same frame, bit for bit."""

    def __init__(self, model: SensorModel | None = None) -> None:
        self.model = model or SensorModel()
        self._renderer = Renderer(self.model)
        self._last: tuple[tuple[Press, ...], Skin] | None = None  # a held press costs only its noise
        self._drawn: tuple[Skin, F32] | None = None

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture under presses; several at once act as their union. Raises ValueError if one is not over the
        skin, or reaches the middle of the sensor.
        """
        key = tuple(presses)
        if self._last is None or self._last[0] != key:
            self._last = key, self.skin(key)
        skin = self._last[1]
        return SimulatedFrame(self.picture(skin, noise_seed), key, skin, self.model)

    def skin(self, presses: Sequence[Press] = ()) -> Skin:
        """Shape the skin without taking a picture. Raises ValueError as `frame` does."""
        return skin_under(self.model, presses)

    def picture(self, skin: Skin, noise_seed: int = 0) -> U8:
        """Take a picture of a skin: uint8 (H, W, 3) BGR."""
        if self._drawn is None or self._drawn[0] is not skin:
            self._drawn = skin, self._renderer.draw(skin)
        return self._renderer.expose(self._drawn[1], noise_seed)


def skin_under(model: SensorModel, presses: Sequence[Press], rest: Skin | None = None) -> Skin:
    """Shape a sensor's skin under presses; `rest` is the unloaded skin after creep. Raises ValueError as
    `SimulatedSensor.frame`.
    """
    rest_mm = None if rest is None else rest.pressed_mm

    def shape(leaning_mm: F32 | None) -> Skin:
        return press_skin(model.skin_radius_mm, model.skin_decay_mm, presses, leaning_mm, rest_mm)

    return drag_skin(shape, model, presses, rest=rest)
