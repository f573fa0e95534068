"""The literal wire vectors, and reconstructions to encode."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacshade_edge.types import F32, HeightMap, ObjectCloud, Reconstruction, TouchedObject

VECTORS = json.loads((Path(__file__).parent / "vectors" / "wire.json").read_text())


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """`sound`, `damaged`, `own` (no later version's), `mapped` (of `map/cloud`):
    one test per vector of wire.json.
    """
    for name, wanted in (
        ("sound", lambda v: "expect" in v),
        ("damaged", lambda v: "error" in v),
        ("own", lambda v: "expect" in v and "later" not in v),
        ("mapped", lambda v: v["name"] == "map cloud"),
    ):
        if name in metafunc.fixturenames:
            chosen = [v for v in VECTORS if wanted(v)]
            metafunc.parametrize(name, chosen, ids=[v["name"] for v in chosen])


@pytest.fixture
def make_result() -> Callable[..., Reconstruction]:
    """A reconstruction with the given height map and cloud; everything else by keyword."""

    def make(
        height_mm: F32 | None = None, points_mm: F32 | None = None, **other: Any
    ) -> Reconstruction:
        height = np.zeros((2, 2), np.float32) if height_mm is None else height_mm
        points = np.zeros((0, 3), np.float32) if points_mm is None else points_mm
        fields: dict[str, Any] = {
            "seq": 5,
            "t_ns": 1_000,
            "wall_ns": 2_000,
            "profile": "fast",
            "valid": True,
            "reason": None,
            "contact": True,
            "saturated": False,
            "degraded": None,
            "height": HeightMap(height, np.zeros(height.shape, np.bool_), 1.5, 2.5, 4.0),
            "cloud": ObjectCloud(points, np.ones(len(points), np.uint16)),
        }
        return Reconstruction(**(fields | other))

    return make


@pytest.fixture
def two_objects() -> tuple[TouchedObject, ...]:
    return (
        TouchedObject(1, (1.25, -2.5, 19.0), (3.0, 3.0, 1.0), 1.75, 8.5),
        TouchedObject(2, (9.0, 9.0, 15.0), (1.0, 1.0, 0.5), 0.5, 1.5),
    )
