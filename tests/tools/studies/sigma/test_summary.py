from __future__ import annotations

import numpy as np
import pytest

from tools.studies.sigma.summary import figures, text
from tools.studies.sigma.work import Found, SigmaRow


def found(error_mm: list[float], sigma_mm: list[float], **other: object) -> Found:
    errors, sigmas = np.array(error_mm, np.float32), np.array(sigma_mm, np.float32)
    fields: dict = {"profile": "fast", "sensor": "5", "object": "cube", "depth_mm": 1.0, "drag_mm": 0.0}
    row = SigmaRow(
        **(fields | other),
        cells=len(errors),
        error_mm=float(errors.mean()),
        sigma_mm=float(sigmas.mean()),
        covered=int(np.count_nonzero(errors <= 1.645 * sigmas)),
    )
    return Found(row, errors, sigmas)


def test_figures_are_of_all_cells_of_all_frames() -> None:
    one = found([0.1] * 9 + [0.9], [0.1] * 9 + [0.2])
    other = found([0.3] * 10, [0.1] * 9 + [0.5])
    made = figures([one, other])
    assert (made.frames, made.cells) == (2, 20)
    assert made.error_mm == pytest.approx((0.9 + 0.9 + 3.0) / 20)
    assert made.covered == 10 / 20
    assert made.told == pytest.approx((0.9 + 0.3) / 4.8)
    assert made.most == pytest.approx((0.9 + 0.3) / 4.8)


def test_a_table_for_each_family_and_for_both_by_depth_and_drag() -> None:
    frames = [
        found([0.1] * 10, [0.1] * 10, sensor=sensor, depth_mm=depth_mm, drag_mm=drag_mm)
        for sensor in ("5", "other:31")
        for depth_mm in (4.5, 1.0)
        for drag_mm in (0.0, 2.0)
    ]
    printed = text(frames)
    assert [line for line in printed.splitlines() if "amil" in line] == [
        "Family tacshade",
        "Family other",
        "Both families",
    ]
    what = [line.split("|")[1].strip() for line in printed.splitlines() if "| fast" in line]
    assert what == ["1 mm deep", "4.5 mm deep", "0 mm of drag", "2 mm of drag", "all"] * 3
    assert "Both" not in text(frames[:4])
