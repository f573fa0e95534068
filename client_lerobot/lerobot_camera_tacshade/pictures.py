"""From a sensor's messages to pictures of one size, whatever grid the sensor computes on."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from tacshade_client import Contact, DecodeError, HeightMessage, Info, InfoGeometry, Message, ShearMessage

from .colours import F32, U8, to_rgb

F64 = npt.NDArray[np.float64]

TOPICS: Final = ("info", "height", "shear", "contact")
REACH: Final = 1.02
"""Half the picture's side, in radii of the visible circle: as of the daemon's own square of 112 x 112 cells."""


class Pictures:
    """Puts the messages of a frame together: ``contact`` comes last, and a frame without contact has nothing else.

    Parameters
    ----------
    size_px : int
        Of the square picture.

    Attributes
    ----------
    passed_over : int
        Frames in contact of which something had not come, or that the sensor could not use.
    """

    def __init__(self, size_px: int) -> None:
        self._size_px = size_px
        self._geometry: InfoGeometry | None = None
        self._height: HeightMessage | None = None
        self._shear: ShearMessage | None = None
        self.passed_over = 0

    def add(self, message: Message) -> U8 | None:
        """Take a message; the picture (size, size, 3) of the frame that it completes, or None."""
        match message.value:
            case Info(geometry=geometry):
                self._geometry = geometry
            case HeightMessage() as height:
                self._height = height
            case ShearMessage() as shear:
                self._shear = shear
            case Contact() as contact if not message.retained:
                picture = self._picture(contact)
                self.passed_over += picture is None
                return picture
        return None

    def _picture(self, contact: Contact) -> U8 | None:
        geometry, seq = self._geometry, contact.seq & 0xFFFFFFFF
        if geometry is None or contact.reason_code:
            return None
        if not contact.contact:
            return to_rgb(_untouched(geometry, self._size_px), None)
        height, shear = self._height, self._shear
        if height is None or height.seq != seq or height.calibration_crc32 != geometry.calibration_crc32:
            return None
        cells = _cells(height, geometry, self._size_px)
        shear_mm = None
        if shear is not None and shear.seq == seq:
            if shear.shear_mm.shape[:2] != height.height_mm.shape:
                raise DecodeError("shear: found another grid than the height of its frame has")
            shear_mm = shear.shear_mm[cells]
        height_mm = np.where(np.isnan(_untouched(geometry, self._size_px)), np.float32(np.nan), height.height_mm[cells])
        return to_rgb(height_mm, shear_mm)


def _pixels(geometry: InfoGeometry, size_px: int) -> tuple[F64, F64]:
    """Image rows and columns of the picture's cells, (size,) each."""
    along = (np.arange(size_px) + 0.5 - size_px / 2) * (2 * REACH * geometry.radius_px / size_px)
    return np.asarray(geometry.row_c + along, np.float64), np.asarray(geometry.col_c + along, np.float64)


def _untouched(geometry: InfoGeometry, size_px: int) -> F32:
    """0 inside the visible circle, NaN outside: float32 (size, size)."""
    rows, cols = _pixels(geometry, size_px)
    away = np.hypot((rows - geometry.row_c)[:, None], (cols - geometry.col_c)[None, :])
    return np.where(away <= geometry.radius_px, np.float32(0), np.float32(np.nan))


def _cells(
    height: HeightMessage, geometry: InfoGeometry, size_px: int
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """The nearest cell of a height map for each of the picture's, as an index."""
    found = []
    for pixels, first, count in zip(
        _pixels(geometry, size_px), (height.row0, height.col0), height.height_mm.shape, strict=True
    ):
        # An even enlargement falls between two cells: the same one everywhere, whatever the last bit is.
        nearest = np.rint((pixels - first) / height.step_px - 1e-6).astype(np.intp)
        found.append(np.clip(nearest, 0, count - 1))
    return np.ix_(*found)  # type: ignore[return-value]
