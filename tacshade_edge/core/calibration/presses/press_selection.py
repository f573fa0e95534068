"""Select the presses for a calibration's fit, with reasons for leaving out the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.observation import PressObservation, observe_press
from tacshade_edge.core.calibration.presses.press_check import PressCheck, PressView, PressViewer, as_seen
from tacshade_edge.core.calibration.presses.press_outliers import outliers
from tacshade_edge.core.calibration.presses.table_check import (
    axes_hint,
    polarity_hint,
    shown_sizes,
    size_mistake,
    table_hints,
    unit_mistake,
)
from tacshade_edge.core.calibration.quality import GRADED_PROFILE
from tacshade_edge.core.calibration.reference.references import PROFILE
from tacshade_edge.core.depth import Network
from tacshade_edge.core.image.preprocess import GreyMapper, Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import Calibration, Geometry

MIN_PRESSES = 8
# If more of the presses disagree, the whole table is wrong.
_MAX_LEFT_OUT = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The presses to fit, their observations, and warnings about all presses."""

    presses: tuple[KnownPress, ...]
    observations: tuple[PressObservation, ...]
    warnings: tuple[str, ...]


def select_presses(unloaded: Calibration, presses: Sequence[KnownPress], network: Network | None = None) -> Selection:
    """Leave out presses without contact, with a moved camera, or that disagree with their stated values; the network of
    `GRADED_PROFILE` shows whether and where something touches, and wrong stated sizes. Raises ConfigError on a gross
    mistake in the whole table or the sensor's description, and on too few presses or too many left out, all of which
    it names.
    """
    if len(presses) < MIN_PRESSES:
        raise ConfigError(f"found {len(presses)} presses, expected at least {MIN_PRESSES} (20 give better results)")
    geometry = unloaded.geometry
    preprocessor = Preprocessor(unloaded, PROFILE)
    viewer = PressViewer(unloaded, PROFILES[GRADED_PROFILE], network) if network else None
    mapper, check = GreyMapper(preprocessor), PressCheck(unloaded)
    views: list[PressView | None] = []
    pressed: list[KnownPress] = []
    left_out: list[str] = []
    warnings: list[str] = []
    for press in presses:
        if impossible := _impossible(unloaded, press):
            left_out.append(f"{press.name}: {impossible}")
            continue
        judged = check.judge(press.image)
        if judged.unusable:
            left_out.append(f"{press.name}: {judged.unusable}")
            continue
        if judged.moved:
            left_out.append(f"{press.name}: {judged.moved} since the references were taken")
            continue
        view = viewer.view(press) if viewer else None
        if not (judged.in_contact or view):
            left_out.append(f"{press.name}: the image shows no contact, expected one {press.depth_mm} mm deep")
        else:
            pressed.append(press)
            views.append(view)
            if judged.changed:
                warnings.append(f"{press.name}: {judged.changed} since the references were taken")
    observations = [observe_press(preprocessor, mapper, press) for press in pressed]
    if len(observations) >= MIN_PRESSES and (hint := _polarity_mistake(unloaded, pressed, observations)):
        raise ConfigError(hint)
    observations = [as_seen(observed, view) for observed, view in zip(observations, views, strict=True)]
    if len(observations) >= MIN_PRESSES and (
        mistakes := _gross_mistakes(geometry, pressed, views if viewer else None, observations)
    ):
        raise ConfigError("; ".join(mistakes))
    disagreeing = {outlier.index: outlier.reason for outlier in outliers(observations, geometry)}
    left_out += disagreeing.values()
    usable = [k for k in range(len(pressed)) if k not in disagreeing]
    if len(left_out) > _MAX_LEFT_OUT * len(presses) or len(usable) < MIN_PRESSES:
        found = f"{len(left_out)} of {len(presses)} presses are unusable; the first one: {left_out[0]}"
        raise ConfigError(found, others=left_out[1:])
    return Selection(
        tuple(pressed[k] for k in usable),
        tuple(observations[k] for k in usable),
        (*warnings, *(f"{reason}; left out" for reason in left_out)),
    )


def _polarity_mistake(
    unloaded: Calibration, presses: Sequence[KnownPress], observations: Sequence[PressObservation]
) -> str:
    """A hint at the other polarity, from where the skin brightens; empty if the stated one fits."""
    other = replace(unloaded, polarity="dark" if unloaded.polarity == "bright" else "bright")
    preprocessor = Preprocessor(other, PROFILE)
    mapper = GreyMapper(preprocessor)
    seen_otherwise = [observe_press(preprocessor, mapper, press) for press in presses]
    return polarity_hint(observations, seen_otherwise, unloaded.polarity)


def _gross_mistakes(
    geometry: Geometry,
    presses: Sequence[KnownPress],
    views: Sequence[PressView | None] | None,
    observations: Sequence[PressObservation],
) -> tuple[str, ...]:
    """Mistakes that all presses share, or in the size of the skin; empty if none."""
    if views is None:
        return table_hints(observations, geometry)
    shown = shown_sizes(presses, views)
    mistakes = unit_mistake(shown.depth), axes_hint(observations, geometry)
    if not any(mistakes):  # with a wrong unit or place, the other sizes mean nothing
        mistakes = (size_mistake(shown, observations, geometry), "")
    return tuple(mistake for mistake in mistakes if mistake)


def _impossible(calibration: Calibration, press: KnownPress) -> str:
    """Why this cannot be a press of the sensor; empty if it can."""
    r = calibration.geometry.skin_radius_mm
    if press.image.shape[:2] != (calibration.image_height_px, calibration.image_width_px):
        expected = f"expected {calibration.image_width_px}x{calibration.image_height_px} px as in the reference"
        return f"found {press.image.shape[1]}x{press.image.shape[0]} px, {expected}"
    if not 0 < press.depth_mm < r or not (press.indenter or press.radius_mm > 0):
        found = f"found a depth of {press.depth_mm} mm and a ball radius of {press.radius_mm} mm"
        return f"{found}, expected a depth above 0 and below {r} mm and a radius above 0"
    return ""
