"""INDENTERS.yaml and its meshes: the shapes that PRESSES.csv names;
and a folder of printable indenters.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import yaml
from msgspec import Meta

from tacshade_edge.calibration import indenters as shapes
from tacshade_edge.calibration.files.press_table import HEADER
from tacshade_edge.calibration.indenters import Indenter
from tacshade_edge.calibration.printable_indenters import planned_presses, printables
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.atomic_files import disk_errors, write_whole
from tacshade_edge.files.meshes import read_stl, stl_bytes
from tacshade_edge.regular_files import named_file
from tacshade_edge.settings import strict_yaml
from tacshade_edge.settings.conversion import convert

_Length = Annotated[float, Meta(gt=0, le=500)]

REQUIRED: dict[str, tuple[str, ...]] = {
    "ball": ("radius_mm",),
    "cylinder": ("radius_mm",),
    "box": ("length_mm", "width_mm"),
    "bar": ("radius_mm", "length_mm"),
    "cone": ("angle_deg",),
    "mesh": ("file",),
}
"""The required keys of each shape, in the order of the arguments of its function in
`calibration.indenters`.
"""


class IndenterEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of one indenter."""

    shape: Literal["ball", "cylinder", "box", "bar", "cone", "mesh"]
    radius_mm: _Length | None = None
    length_mm: _Length | None = None
    width_mm: _Length | None = None
    angle_deg: Annotated[float, Meta(gt=0, le=175, description="the full angle")] | None = None
    file: Annotated[str, Meta(min_length=1, description="an STL file")] | None = None


def read_indenters_file(path: Path) -> dict[str, tuple[str, IndenterEntry]]:
    """Read INDENTERS.yaml: name to (``FILE:LINE``, entry).

    Raises ConfigError, ``FILE:LINE: NAME.key: found …``.
    """
    file = strict_yaml.read(path)
    found = file.found
    if not isinstance(file.value, dict):
        raise ConfigError(
            f"{path}:{found[()].line}: found {found[()].text}, expected indenter names"
        )
    entries = {}
    for name in file.value:
        where = f"{path}:{found[name,].line}"
        if name == "ball":
            raise ConfigError(
                f"{where}: ball: found an entry, expected none, because this name is built in"
            )
        entry = convert(file, IndenterEntry, at=(name,))
        for key in REQUIRED[entry.shape]:
            if getattr(entry, key) is None:
                raise ConfigError(
                    f"{where}: {name}.{key}: found nothing, expected a value for shape "
                    f"{entry.shape}"
                )
        entries[name] = where, entry
    return entries


# Limits of a mesh's longest side in mm; a mesh outside them is in metres or inches, or a mistake.
_LEAST_MM, _MOST_MM = 0.5, 500.0


def read_indenters(path: Path) -> dict[str, Indenter | float]:
    """Read the file and its meshes: name to indenter, or to a ball's radius in mm.

    Raises ConfigError.
    """
    return {
        name: _indenter(path, name, *entry) for name, entry in read_indenters_file(path).items()
    }


def write_printables(folder: Path) -> list[Path]:
    """Write an STL file for each of `printables`, their INDENTERS.yaml, and a plan of presses,
    PLAN.csv.

    Raises ConfigError if one of the tables exists, as it may be a person's own, and DeviceError.
    """
    table, plan = folder / "INDENTERS.yaml", folder / "PLAN.csv"
    for path in (table, plan):
        if path.exists():
            raise ConfigError(
                f"{path}: already exists; this command does not replace existing files"
            )
    written = []
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for each in printables():
            # The meshes first, so that the tables never name a file that is absent.
            written.append(folder / f"{each.name}.stl")
            write_whole(written[-1], stl_bytes(each.triangles_mm))
        entries = {each.name: dict(each.entry) for each in printables()}
        write_whole(
            table, yaml.safe_dump(entries, sort_keys=False, default_flow_style=None).encode()
        )
        rows = (f",{p.name},,{p.depth_mm},{p.x_mm},{p.y_mm}\n" for p in planned_presses())
        write_whole(plan, "".join((",".join(HEADER) + "\n", *rows)).encode())
    return [*written, table, plan]


def _indenter(path: Path, name: str, where: str, entry: IndenterEntry) -> Indenter | float:
    values = [getattr(entry, key) for key in REQUIRED[entry.shape]]
    if entry.shape == "ball":
        return float(values[0])
    if entry.shape == "mesh":
        return _mesh(named_file(path.parent, values[0]), name, where)
    make: Callable[..., Indenter] = getattr(shapes, entry.shape)
    return make(name, *values)


def _mesh(path: Path, name: str, where: str) -> Indenter:
    try:
        triangles_mm = read_stl(path)
    except DecodeError as error:
        raise ConfigError(f"{where}: {name}.file: {error}") from None
    size_mm = float((triangles_mm.max(axis=(0, 1)) - triangles_mm.min(axis=(0, 1))).max())
    if not _LEAST_MM <= size_mm <= _MOST_MM:
        expected = (
            f"expected {_LEAST_MM} to {_MOST_MM:g} mm, "
            "because tacshade-edge reads lengths in STL files as mm"
        )
        raise ConfigError(
            f"{where}: {name}.file: {path}: found a largest dimension of {size_mm:.3g} mm, "
            f"{expected}"
        )
    return shapes.mesh(name, triangles_mm)
