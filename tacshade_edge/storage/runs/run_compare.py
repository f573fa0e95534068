"""Compares two runs of `replay` frame by frame: the first difference in words, and figures over all frames."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol import wire
from tacshade_edge.storage.runs.run_files import CLOUDS, HEIGHTS, SHEARS, payloads, read_summary

Message = wire.HeightMessage | wire.CloudMessage | wire.ShearMessage | wire.SigmaMessage


def first_difference(folder: Path, against: Path) -> str:
    """The frame, field and size of the first difference, as a line; empty if the runs are the same bytes.

    Raises ConfigError if a folder has no complete run, and DecodeError if a run is damaged.
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


def figures(folder: Path, against: Path) -> list[str]:
    """Differences in contact, depth and height over the common frames: mean, worst and its place, one line each.

    Raises like `first_difference`.
    """
    records, others = (read_summary(run) for run in (folder, against))
    places = [f"frame {k} ({record.get('image')})" for k, record in enumerate(records[: len(others)])]
    pairs = list(zip(records, others, strict=False))
    if not pairs:
        return []
    changed = [k for k, (one, two) in enumerate(pairs) if one.get("contact") != two.get("contact")]
    first = f", first {places[changed[0]]}" if changed else ""
    lines = [f"contact: differs in {len(changed)} of {len(pairs)} frames{first}"]
    depths_mm = np.array([[one.get("depth_max_mm", 0.0), two.get("depth_max_mm", 0.0)] for one, two in pairs], float)
    apart_mm = np.abs(depths_mm[:, 0] - depths_mm[:, 1])
    worst = int(np.argmax(apart_mm))
    lines.append(f"depth_max_mm: mean {apart_mm.mean():.4f}, worst {apart_mm[worst]:.4f} mm apart in {places[worst]}")
    return [*lines, _height_figures(folder, against, places)]


def _height_figures(folder: Path, against: Path, places: list[str]) -> str:
    """The line on the differences between the height maps' cells."""
    total_mm, cells, worst_mm, where = 0.0, 0, -1.0, ""
    for place, *pair in zip(places, payloads(folder, HEIGHTS), payloads(against, HEIGHTS), strict=False):
        one, two = (wire.decode(payload) for payload in pair)
        if not isinstance(one, wire.HeightMessage) or not isinstance(two, wire.HeightMessage):
            raise DecodeError(
                f"{folder / HEIGHTS} or {against / HEIGHTS}: found payloads of another kind, expected height maps"
            )
        grids = [(m.row0, m.col0, m.step_px, *m.height_mm.shape) for m in (one, two)]
        if grids[0] != grids[1]:
            return f"height_mm: on other cells in {place}, so not compared cell by cell"
        apart_mm = np.abs(one.height_mm - two.height_mm)
        total_mm += float(np.nansum(apart_mm, dtype=np.float64))
        cells += int(np.count_nonzero(np.isfinite(apart_mm)))
        if np.nanmax(apart_mm, initial=-1.0) > worst_mm:
            worst_mm = float(np.nanmax(apart_mm))
            row, col = np.unravel_index(int(np.nanargmax(apart_mm)), apart_mm.shape)
            at_px = f"image row {one.row0 + row * one.step_px:.0f}, col {one.col0 + col * one.step_px:.0f}"
            where = f" in {place} at {at_px}"
    return f"height_mm: mean {total_mm / max(cells, 1):.4f}, worst {max(worst_mm, 0.0):.4f} mm apart{where}"


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
