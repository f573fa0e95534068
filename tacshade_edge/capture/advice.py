"""Which press would help most next, from those that were taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tacshade_edge.core.calibration.indenters.indenter import Indenter
from tacshade_edge.core.calibration.presses.coverage import advice
from tacshade_edge.core.calibration.presses.press_check import PressCheck
from tacshade_edge.storage.tables.capture_folder import CaptureFolder, TakenPress
from tacshade_edge.storage.tables.presses import BALL
from tacshade_edge.storage.tables.tables import number


@dataclass(frozen=True, slots=True)
class _Taken:
    """A `coverage.Pressed`."""

    place_mm: tuple[float, float]
    depth_mm: float
    radius_mm: float
    indenter: str


class Advice:
    """Remembers the place of each picture that had to be looked at for it.

    Parameters
    ----------
    folder : CaptureFolder
    indenters : mapping of str to Indenter or float
        Of INDENTERS.yaml.
    """

    def __init__(self, folder: CaptureFolder, indenters: Mapping[str, Indenter | float]) -> None:
        self._folder = folder
        self._indenters = indenters
        self._known: dict[TakenPress, _Taken] = {}

    def text(self, taken: Sequence[TakenPress], check: PressCheck) -> str:
        """A line; empty before the first press.

        Raises
        ------
        ConfigError
            The table has something else than numbers, or a picture cannot be read.
        """
        # One that was taken back is forgotten: another picture may get its name.
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
