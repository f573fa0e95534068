"""What a ``summary.json`` says of one reconstruction."""

from __future__ import annotations

from typing import Any

from tacshade_edge.reasons import reason_fields
from tacshade_edge.types import Reconstruction


def summary(result: Reconstruction) -> dict[str, Any]:
    """Everything but the arrays, lengths rounded to 0.1 µm."""
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
        "objects": [
            {
                "label": o.label,
                "centroid_mm": [round(v, 4) for v in o.centroid_mm],
                "extent_mm": [round(v, 4) for v in o.extent_mm],
                "depth_max_mm": round(o.depth_max_mm, 4),
                "area_mm2": round(o.area_mm2, 4),
            }
            for o in result.objects
        ],
    }
