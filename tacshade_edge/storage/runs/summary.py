"""The record of one reconstruction in ``summary.json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tacshade_edge.protocol.messages import touch_fields
from tacshade_edge.reasons import reason_fields
from tacshade_edge.types import Reconstruction


def summary(result: Reconstruction) -> dict[str, Any]:
    """A reconstruction's values except the arrays, with lengths rounded to 0.1 µm."""
    return {
        "profile": result.profile,
        "valid": result.valid,
        **reason_fields(result.reason),
        "contact": result.contact,
        "saturated": result.saturated,
        **reason_fields(result.degraded, "degraded"),
        "depth_max_mm": round(result.depth_max_mm, 4),
        "volume_mm3": round(result.volume_mm3, 4),
        "repaired_px": result.repaired_px,
        "shear_mm": _rounded(result.shear_of_contact_mm),
        **touch_fields(result.touch),
        **reason_fields(None if result.touch is None else result.touch.reason, "touch_reason"),
        "objects": [
            {
                "label": o.label,
                "centroid_mm": [round(v, 4) for v in o.centroid_mm],
                "extent_mm": [round(v, 4) for v in o.extent_mm],
                "depth_max_mm": round(o.depth_max_mm, 4),
                "area_mm2": round(o.area_mm2, 4),
                "normal": _rounded(o.normal),
                "shear_mm": _rounded(o.shear_mm),
                "twist_deg": None if o.twist_deg is None else round(o.twist_deg, 3),
                "id": o.id,
                "slip": o.slip,
                "slip_mm_s": None if o.slip_mm_s is None else round(o.slip_mm_s, 3),
            }
            for o in result.objects
        ],
    }


def _rounded(values: Sequence[float] | None) -> list[float] | None:
    return None if values is None else [round(v, 4) for v in values]
