"""INDENTERS.yaml: the shapes that PRESSES.csv names, for ``tacshade-edge calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from tacshade_edge.errors import ConfigError
from tacshade_edge.settings import strict_yaml
from tacshade_edge.settings.load import as_struct

_Length = Annotated[float, Meta(gt=0, le=500)]

REQUIRED: dict[str, tuple[str, ...]] = {
    "ball": ("radius_mm",),
    "cylinder": ("radius_mm",),
    "box": ("length_mm", "width_mm"),
    "bar": ("radius_mm", "length_mm"),
    "cone": ("angle_deg",),
    "mesh": ("file",),
}
"""The required keys of each shape."""


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

    Raises
    ------
    ConfigError
        ``FILE:LINE: NAME.key: found …, expected …``.
    """
    value, found, mistakes = strict_yaml.read(path)
    strict_yaml.refuse(mistakes)
    if not isinstance(value, dict):
        raise ConfigError(f"{path}:{found[()].line}: found {found[()].text}, expected indenter names")
    schema = msgspec.json.schema(IndenterEntry)
    root: dict[str, Any] = {**schema["$defs"]["IndenterEntry"], "$defs": schema["$defs"]}
    entries = {}
    for name in value:
        where = f"{path}:{found[name,].line}"
        if name == "ball":
            raise ConfigError(f"{where}: ball: found an entry, expected none, because this name is built in")
        entry = as_struct(path, value, found, IndenterEntry, root, at=(name,))
        for key in REQUIRED[entry.shape]:
            if getattr(entry, key) is None:
                raise ConfigError(f"{where}: {name}.{key}: found nothing, expected a value for shape {entry.shape}")
        entries[name] = where, entry
    return entries
