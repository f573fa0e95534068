"""PRINTER.yaml: a person's description of the machine that presses, for ``tacshade-edge capture --printer``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from tacshade_edge.errors import ConfigError
from tacshade_edge.settings.load import read_struct

_Place = Annotated[float, Meta(ge=-2000, le=2000)]
_Range = Annotated[list[_Place], Meta(min_length=2, max_length=2, description="two numbers, the least and the most")]

FEED_MOST_MM_S = 100


class PrinterFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The keys of PRINTER.yaml: positions of the print head in the printer's own coordinates, z upwards."""

    x_mm: _Range
    y_mm: _Range
    z_mm: _Range
    start_mm: Annotated[list[_Place], Meta(min_length=3, max_length=3, description="x, y, z over the skin's middle")]
    feed_mm_s: Annotated[float, Meta(ge=1, le=FEED_MOST_MM_S, description="of moves above the skin")]
    baud: Annotated[int, Meta(ge=1200, le=4000000, description="of the port")] = 115200


def read_printer(path: Path) -> PrinterFile:
    """Read PRINTER.yaml. Raises ConfigError."""
    given, found = read_struct(path, PrinterFile)
    limits = {"x_mm": given.x_mm, "y_mm": given.y_mm, "z_mm": given.z_mm}
    for (key, (least, most)), start in zip(limits.items(), given.start_mm, strict=True):
        if not least < most:
            line = found[key,].line
            raise ConfigError(
                f"{path}:{line}: {key}: found {least:g} to {most:g}, expected the minimum before the maximum"
            )
        if not least <= start <= most:
            line = found["start_mm",].line
            problem = f"found {key[0]} {start:g}, expected a value within {key} ({least:g} to {most:g})"
            raise ConfigError(f"{path}:{line}: start_mm: {problem}")
    return given
