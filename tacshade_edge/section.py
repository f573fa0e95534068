"""A section of the settings: a frozen struct whose fields carry marks, and which knows the rules
between its fields.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, get_args, get_type_hints

import msgspec
from msgspec import Meta

PATH: Final = {"is_path": True}
"""Mark (`Meta.extra`) of a file or a folder: a relative one starts at the settings file's."""
RESTART: Final = {"needs_restart": True}
"""Mark of a setting of which a reload keeps the running value."""


class Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The settings below one key, or the whole of them."""

    def misfit(self) -> tuple[tuple[str, ...], str] | None:
        """The first rule between the fields that these values break, which no type can state: the
        key below this section, and ``found …, expected …``; None if they break none.
        """
        return None


def marked(kind: type[Section], mark: dict[str, bool]) -> tuple[str, ...]:
    """The names of the fields that have this mark."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple(
        name
        for name, hint in hints.items()
        if any(mark.items() <= (meta.extra or {}).items() for meta in _metas(hint))
    )


def _metas(hint: Any) -> Iterator[Meta]:
    if isinstance(hint, Meta):
        yield hint
    for part in get_args(hint):
        yield from _metas(part)
