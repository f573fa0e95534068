"""Poses of presses on wavy and flat surfaces, by sensors from 5 to 60 mm: honest, and in other
units, signs and orders.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from support.pressed_tables import PressedTable, pressed_table
from tacshade_edge.plausibility.pose_tables import Reading
from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode
from tacshade_edge.plausibility.units import LENGTHS, UnitName
from tacshade_edge.rigid import from_seven, shift
from tacshade_edge.stitching.press_agreement import suspected_poses
from tacshade_edge.types import F64


def suspected(table: PressedTable, *, flange_known: bool = True) -> Suspicion | None:
    return suspected_poses(
        table.presses,
        table.base_T_flange,
        table.flange_T_sensor,
        table.size_mm,
        flange_known=flange_known,
    )


def sizes(seed: int, count: int) -> list[float]:
    """Skin radii, evenly from tiny pads to large domes."""
    draw = np.random.default_rng(seed)
    return np.exp(draw.uniform(np.log(5), np.log(60), count)).tolist()


def honest(k: int, size_mm: float) -> PressedTable:
    """Flat and wavy surfaces, exact and trembling robots, few and many presses."""
    relief, noise = (0.0, 0.02, 0.05, 0.1)[k % 4], (0.0, 0.2, 0.5)[k % 3] * size_mm / 20
    return pressed_table(k, size_mm=size_mm, relief=relief, noise=noise, presses=(36, 9, 64)[k % 3])


@pytest.mark.slow
def test_no_honest_table_of_two_hundred_is_suspected() -> None:
    found = {
        k: str(one)
        for k, size_mm in enumerate(sizes(1, 200))
        if (one := suspected(honest(k, size_mm))) is not None
    }
    assert found == {}


@pytest.mark.slow
def test_no_honest_table_is_suspected_while_the_flange_is_looked_for() -> None:
    for k, size_mm in enumerate(sizes(2, 60)):
        table = honest(k, size_mm)
        off = shift(8, -5, 6) @ table.flange_T_sensor
        assert suspected(replace(table, flange_T_sensor=off), flange_known=False) is None, k


def test_a_sparse_scan_is_not_suspected() -> None:
    for k, size_mm in enumerate(sizes(3, 12)):
        table = pressed_table(k, size_mm=size_mm, relief=0.05)
        # Only every third of each third row, which nothing overlaps.
        kept = [6 * i + j for i in (0, 3) for j in (0, 3)]
        one = replace(
            table,
            presses=[table.presses[n] for n in kept],
            base_T_flange=[table.base_T_flange[n] for n in kept],
        )
        assert suspected(one) is None


def scaled(factor: float) -> Callable[[F64], F64]:
    return lambda seven: np.hstack((seven[:, :3] * factor, seven[:, 3:]))


def signed(*signs: float) -> Callable[[F64], F64]:
    return lambda seven: np.hstack((seven[:, :3] * signs, seven[:, 3:]))


WRONG: dict[UnitName | Reading, Callable[[F64], F64]] = {
    **{unit: scaled(1 / size) for unit, size in LENGTHS.items()},
    Reading.QUATERNION_LAST: lambda s: np.hstack((s[:, :3], np.roll(s[:, 3:], -1, axis=1))),
    Reading.TURNED_BACK: lambda s: s * (1, 1, 1, 1, -1, -1, -1),
    Reading.INVERSE: lambda s: np.array([from_seven(one).inverse().seven() for one in s]),
    Reading.X_OPPOSITE: signed(-1, 1, 1),
    Reading.Y_OPPOSITE: signed(1, -1, 1),
    Reading.Z_OPPOSITE: signed(1, 1, -1),
    Reading.ALL_OPPOSITE: signed(-1, -1, -1),
    Reading.SWAPPED: lambda s: s[:, [1, 0, 2, 3, 4, 5, 6]],
    Reading.ROW_BEFORE: lambda s: np.vstack((s[:1], s[:-1])),
    Reading.ROW_AFTER: lambda s: np.vstack((s[1:], s[-1:])),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_every_wrong_reading_of_a_wavy_surface_is_named(name: UnitName | Reading) -> None:
    named = 0
    tables = sizes(4, 16)
    for k, size_mm in enumerate(tables):
        table = pressed_table(1000 + k, size_mm=size_mm, noise=(k % 2) * 0.1 * size_mm / 20)
        seven = WRONG[name](np.array([pose.seven() for pose in table.base_T_flange]))
        found = suspected(replace(table, base_T_flange=[from_seven(one) for one in seven]))
        if found is None:
            continue
        assert found.values.get("unit", found.values.get("reading")) == name
        assert "\n" not in str(found)
        assert str(found).endswith("?")
        named += 1
    # What no other reading explains well is left alone.
    assert named >= 0.85 * len(tables)


def test_one_pose_for_all_is_refused_if_the_presses_differ() -> None:
    table = pressed_table(5, size_mm=20.0)
    same = [table.base_T_flange[0]] * len(table.presses)
    found = suspected(replace(table, base_T_flange=same))
    assert found is not None
    assert (found.code, found.impossible) == (SuspicionCode.ONE_POSE, True)
    # A press that was repeated.
    repeated = replace(table, base_T_flange=same, presses=[table.presses[0]] * len(same))
    found = suspected(repeated)
    assert found is not None
    assert (found.code, found.impossible) == (SuspicionCode.ONE_POSE, False)


def test_metres_on_a_flat_surface_may_be_right_and_cannot_find_a_flange() -> None:
    table = pressed_table(6, size_mm=20.0, relief=0.0)
    seven = scaled(1e-3)(np.array([pose.seven() for pose in table.base_T_flange]))
    flat = replace(table, base_T_flange=[from_seven(one) for one in seven])
    for flange_known in (True, False):
        found = suspected(flat, flange_known=flange_known)
        assert found is not None
        assert str(found).endswith("are they in m?")


def test_few_presses_show_nothing() -> None:
    table = pressed_table(7, size_mm=20.0)
    few = replace(table, presses=table.presses[:3], base_T_flange=table.base_T_flange[:3])
    assert suspected(few) is None
    assert suspected(replace(table, presses=[], base_T_flange=[])) is None
