"""Turns a sensor's messages into pictures of one size, whatever the sensor's grid."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from tacshade_client import Contact, HeightMessage, Info, InfoGeometry, Message, ShearMessage

from .colours import F32, U8, to_rgb

F64 = npt.NDArray[np.float64]

TOPICS: Final = ("info", "height", "shear", "contact")
TACTILE: Final = (
    "contact",
    "x_mm",
    "y_mm",
    "depth_max_mm",
    "volume_mm3",
    "shear_x_mm",
    "shear_y_mm",
    "slip",
)
"""The numbers of ``observation.tactile``, named as in the topic ``contact``;
the volume is a measure of load.

While something touches whose depth is unknown, ``contact`` is 1 too,
and the picture is that of an untouched skin. What is unknown of a touch is NaN; without one, all
are 0.
"""
REACH: Final = 1.02
"""Half the picture's side in radii of the visible circle,
as in the daemon's own square of 112 x 112 cells.
"""


class Pictures:
    """Combines the messages of each frame: ``contact`` comes last,
    and is the only one in a frame without contact.

    `passed_over` counts frames with a missing or mismatched message, or that the sensor could not
    use. `height_mm` is the height map (size, size) of the latest picture, NaN outside the circle,
    and `tactile` its `TACTILE`.
    """

    height_mm: F32
    tactile: F32

    def __init__(self, size_px: int) -> None:
        self._size_px = size_px
        self._geometry: InfoGeometry | None = None
        self._height: HeightMessage | None = None
        self._shear: ShearMessage | None = None
        self.passed_over = 0

    def add(self, message: Message) -> U8 | None:
        """Add a message; return the picture (size, size, 3) of the frame that it completes,
        or None.
        """
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
                if picture is not None:
                    self.tactile = _tactile(contact)
                return picture
        return None

    def _picture(self, contact: Contact) -> U8 | None:
        geometry, seq = self._geometry, contact.seq & 0xFFFFFFFF
        if geometry is None or contact.reason_code:
            return None
        if not contact.contact:
            self.height_mm = _untouched(geometry, self._size_px)
            return to_rgb(self.height_mm, None)
        height, shear = self._height, self._shear
        if (
            height is None
            or height.seq != seq
            or height.calibration_crc32 != geometry.calibration_crc32
        ):
            return None
        cells = _cells(height, geometry, self._size_px)
        shear_mm = None
        if shear is not None and shear.seq == seq:
            if shear.shear_mm.shape[:2] != height.height_mm.shape:
                return None
            shear_mm = shear.shear_mm[cells]
        outside = np.isnan(_untouched(geometry, self._size_px))
        self.height_mm = np.where(outside, np.float32(np.nan), height.height_mm[cells])
        return to_rgb(self.height_mm, shear_mm)


def _tactile(contact: Contact) -> F32:
    """The `TACTILE` of a frame that could be used."""
    touches = bool(contact.contact or contact.touched)
    # 0 would be a value: of a free skin it is the right one, of a touched one it is not.
    missing = np.nan if touches else 0.0
    values = {name: getattr(contact, name) for name in TACTILE} | {"contact": float(touches)}
    return np.array([missing if v is None else v for v in values.values()], np.float32)


def tactile_feature() -> dict[str, Any]:
    """The feature of a LeRobot data set that holds `TACTILE`, for a key such as
    ``observation.tactile.left_index``.
    """
    return {"dtype": "float32", "shape": (len(TACTILE),), "names": list(TACTILE)}


def _pixels(geometry: InfoGeometry, size_px: int) -> tuple[F64, F64]:
    """The image rows and columns of the picture's cells in px, (size,) each."""
    along = (np.arange(size_px) + 0.5 - size_px / 2) * (2 * REACH * geometry.radius_px / size_px)
    return np.asarray(geometry.row_c + along, np.float64), np.asarray(
        geometry.col_c + along, np.float64
    )


def _untouched(geometry: InfoGeometry, size_px: int) -> F32:
    """A height map of the untouched skin, float32 (size, size):
    0 inside the visible circle, NaN outside.
    """
    rows, cols = _pixels(geometry, size_px)
    away = np.hypot((rows - geometry.row_c)[:, None], (cols - geometry.col_c)[None, :])
    return np.where(away <= geometry.radius_px, np.float32(0), np.float32(np.nan))


def _cells(
    height: HeightMessage, geometry: InfoGeometry, size_px: int
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """An index of the height map's nearest cell for each of the picture's cells."""
    found = []
    for pixels, first, count in zip(
        _pixels(geometry, size_px), (height.row0, height.col0), height.height_mm.shape, strict=True
    ):
        # With an even enlargement a pixel falls between two cells;
        # choose the same one regardless of rounding.
        nearest = np.rint((pixels - first) / height.step_px - 1e-6).astype(np.intp)
        found.append(np.clip(nearest, 0, count - 1))
    return np.ix_(*found)  # type: ignore[return-value]
