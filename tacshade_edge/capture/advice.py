"""Advice, from the presses already taken, on which press would help most next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.core.calibration.presses.press_check import PressCheck
from tacshade_edge.core.calibration.quality import advice
from tacshade_edge.storage.tables.capture_folder import CaptureFolder, TakenPress
from tacshade_edge.storage.tables.presses import BALL
from tacshade_edge.storage.tables.tables import number


@dataclass(frozen=True, slots=True)
class _Taken:
    """A press as `coverage.Pressed` requires it."""

    place_mm: tuple[float, float]
    depth_mm: float
    radius_mm: float
    indenter: str


class Advice:
    """Advice on the next press; it caches each press's place, which may have to be found in the picture. `indenters`:
    from INDENTERS.yaml.
    """

    def __init__(self, folder: CaptureFolder, indenters: Mapping[str, Indenter | float]) -> None:
        self._folder = folder
        self._indenters = indenters
        self._known: dict[TakenPress, _Taken] = {}

    def text(self, taken: Sequence[TakenPress], check: PressCheck) -> str:
        """Return one line of advice; empty before the first press. Raises ConfigError (the table has something other
        than a number, or a picture cannot be read).
        """
        # Forget a press that was undone: another picture may get its name.
        self._known = {press: self._known.get(press) or self._look_at(press, check) for press in taken}
        return advice(list(self._known.values()), check.geometry) if taken else ""

    def _look_at(self, press: TakenPress, check: PressCheck) -> _Taken:
        indenter, radius_text, depth_text, x_text, y_text, *_ = press.stated.columns
        depth_mm = number(press.image, "depth_mm", depth_text)
        if x_text:
            place_mm = number(press.image, "x_mm", x_text), number(press.image, "y_mm", y_text)
        else:
            place_mm = check.located_mm(self._folder.picture(press), depth_mm)
        known = self._indenters.get(indenter)
        if indenter == BALL:
            return _Taken(place_mm, depth_mm, number(press.image, "radius_mm", radius_text), "")
        if isinstance(known, float):
            return _Taken(place_mm, depth_mm, known, "")
        return _Taken(place_mm, depth_mm, 0.0, indenter)
