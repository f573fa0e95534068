"""Array types by element, and a function that makes arrays read-only."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

U8 = npt.NDArray[np.uint8]
U16 = npt.NDArray[np.uint16]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]
F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


def freeze(value: object, *names: str) -> None:
    """Replace the named array attributes by read-only views."""
    for name in names:
        view = getattr(value, name).view()
        view.setflags(write=False)
        object.__setattr__(value, name, view)
