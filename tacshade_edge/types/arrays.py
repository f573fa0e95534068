"""Array types by element, and records whose arrays are read-only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

import numpy as np
import numpy.typing as npt

U8 = npt.NDArray[np.uint8]
U16 = npt.NDArray[np.uint16]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]
F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


Record = TypeVar("Record")


@dataclass_transform(frozen_default=True, eq_default=False)
def frozen(cls: type[Record]) -> type[Record]:
    """Make a frozen dataclass with slots, equal only to itself, whose arrays are read-only views."""
    names = tuple(cls.__annotations__)

    def __post_init__(self: Record) -> None:
        freeze(self, *(name for name in names if isinstance(getattr(self, name), np.ndarray)))

    cls.__post_init__ = __post_init__  # type: ignore[attr-defined]
    return dataclass(frozen=True, slots=True, eq=False)(cls)


def freeze(value: object, *names: str) -> None:
    """Replace the named array attributes by read-only views."""
    for name in names:
        view = getattr(value, name).view()
        view.setflags(write=False)
        object.__setattr__(value, name, view)
