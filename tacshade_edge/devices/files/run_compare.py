"""Two runs of `replay`, frame by frame: the first difference in words."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tacshade_edge.devices.files.run_files import CLOUDS, HEIGHTS, SHEARS, payloads, read_summary
from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol import wire

Message = wire.HeightMessage | wire.CloudMessage | wire.ShearMessage


def first_difference(folder: Path, against: Path) -> str:
    """Which frame, which field, how much; empty when the runs are the same bytes.

    Raises
    ------
    ConfigError
        One of the folders has no whole run.
    DecodeError
        One of the runs is damaged.
    """
    runs = folder, against
    records, others = (read_summary(run) for run in runs)
    names = [HEIGHTS, CLOUDS]
    if all((run / SHEARS).exists() and (run / SHEARS).stat().st_size for run in runs):
        names.append(SHEARS)
    streams = [(name, payloads(folder, name), payloads(against, name)) for name in names]
    for index, (record, other) in enumerate(zip(records, others, strict=False)):
        where = f"frame {index} ({record.get('image')})"
        if said := _record_difference(record, other):
            return f"{where}: {said}"
        for name, mine, theirs in streams:
            one, two = next(mine, None), next(theirs, None)
            for run, payload in zip(runs, (one, two), strict=True):
                if payload is None:
                    raise DecodeError(f"{run / name}: found {index} payloads, expected {len(read_summary(run))}")
            if one is not None and two is not None and one != two:
                return f"{where}: {name}: {_payload_difference(wire.decode(one), wire.decode(two))}"
    if len(records) != len(others):
        return f"frames: {len(records)}, against {len(others)}"
    return ""


def _record_difference(record: dict[str, Any], other: dict[str, Any]) -> str:
    for field in dict.fromkeys([*record, *other]):
        mine, theirs = record.get(field), other.get(field)
        if mine != theirs:
            if field == "objects" and isinstance(mine, list) and isinstance(theirs, list):
                return _object_difference(mine, theirs)
            return f"{field}: {mine}, against {theirs}{_by(mine, theirs)}"
    return ""


def _object_difference(objects: list[Any], others: list[Any]) -> str:
    if len(objects) != len(others):
        return f"objects: {len(objects)}, against {len(others)}"
    index = next(i for i, (mine, theirs) in enumerate(zip(objects, others, strict=True)) if mine != theirs)
    return f"objects[{index}].{_record_difference(objects[index], others[index])}"


def _by(mine: object, theirs: object) -> str:
    numbers = isinstance(mine, int | float) and isinstance(theirs, int | float)
    if numbers and not isinstance(mine, bool) and not isinstance(theirs, bool):
        return f" (by {mine - theirs:+.6g})"  # type: ignore[operator]
    return ""


def _payload_difference(mine: Message, theirs: Message) -> str:
    if type(mine) is not type(theirs):
        return f"{type(mine).__name__}, against {type(theirs).__name__}"
    for field in fields(mine):
        one, two = getattr(mine, field.name), getattr(theirs, field.name)
        if isinstance(one, np.ndarray):
            if said := _array_difference(one, two):
                return f"{field.name}: {said}"
        elif one != two:
            return f"{field.name}: {one}, against {two}{_by(one, two)}"
    return "the bytes differ where no field is"


def _array_difference(one: npt.NDArray[Any], two: npt.NDArray[Any]) -> str:
    if one.shape != two.shape:
        return f"shape {one.shape}, against {two.shape}"
    different = ~((one == two) | (np.isnan(one) & np.isnan(two)))
    if not different.any():
        return ""
    apart = np.where(different, np.nan_to_num(np.abs(one.astype(float) - two.astype(float)), nan=np.inf), 0.0)
    at = np.unravel_index(int(np.argmax(apart)), one.shape)
    place = ", ".join(str(int(i)) for i in at)
    return f"{np.count_nonzero(different)} of {one.size} values differ, most at ({place}): {one[at]}, against {two[at]}"
