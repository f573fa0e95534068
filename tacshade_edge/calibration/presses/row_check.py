"""Whether each row of a table of presses is that of its image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.observation import PressObservation
from tacshade_edge.plausibility.row_order import disagreement, judge_rows
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.types import F64, Geometry

# Far apart: places by so many mm on the nominal skin, depths by this factor.
_PLACE_MM: Final = 4.0
_DEPTH_FACTOR: Final = 1.6


def order_hint(
    presses: Sequence[KnownPress],
    observations: Sequence[PressObservation],
    geometry: Geometry,
    axes: tuple[float, float, float, float] | None,
) -> CalibrationFinding | None:
    """That the rows of all presses go with other rows' images, judging by some of them, as observed
    by name; None if they go with their own, or do with other axes.
    """
    far_mm = _PLACE_MM * skin_scale(geometry)
    observed = {one.name: one for one in observations}
    seen = np.full((len(presses), 3), np.nan)
    stated = np.full_like(seen, np.nan)
    for k, press in enumerate(presses):
        # A depth of 0 or less is another mistake.
        depth = np.log(press.depth_mm) if press.depth_mm > 0 else np.nan
        stated[k] = _number(press.x_mm), _number(press.y_mm), depth
        if one := observed.get(press.name):
            seen[k] = one.located_x_mm, one.located_y_mm, np.log(one.seen_depth_mm)
    # A network is off by one factor for all.
    seen[:, 2] += _middle(stated[:, 2] - seen[:, 2])
    unit = np.array([far_mm, far_mm, np.log(_DEPTH_FACTOR)])
    explained = 1.0
    if axes is not None:
        a, b, c, d = axes
        turned = stated.copy()
        turned[:, :2] = stated[:, :2] @ np.array([[a, c], [b, d]])
        explained = disagreement(turned / unit, seen / unit)
    found = judge_rows(stated / unit, seen / unit, explained)
    if found is None:
        return None
    image, row = (presses[int(str(found.values[key]))].name for key in ("image", "row"))
    return finding(FindingCode.OTHER_ROWS, suspicion=found, image=image, row=row)


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _middle(values: F64) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
