"""What a sensor publishes as JSON: the type of each topic, with its bounds, and `OF_JSON`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

from msgspec import Meta

from ..rigid import from_seven
from ..types.geometry import Disc, Geometry, Skin
from .bounds import Code, Count, Key, Number, Rate, SevenNumbers, SlipCode, Volume

_Numbers = Annotated[dict[Key, Number | None], Meta(max_length=64)]
_Sigmas = Annotated[dict[Key, Annotated[float, Meta(ge=0, le=1e6)] | None], Meta(max_length=64)]
_Place = Annotated[float, Meta(ge=-1e7, le=1e7)]
_Px = Annotated[float, Meta(ge=-1e5, le=1e5)]
_SizePx = Annotated[int, Meta(ge=1, le=65535)]


@dataclass(frozen=True, slots=True, kw_only=True)
class InfoGeometry:
    """The geometry that converts pixels to mm.

    A pad has neither `skin_radius_mm` nor `visible_half_angle_deg`.
    """

    # A default, because daemons before pads do not send it.
    skin: Skin = "dome"
    skin_radius_mm: Annotated[float, Meta(ge=0.1, le=1e4)] | None
    camera_distance_mm: Annotated[float, Meta(ge=-1e4, le=1e5)] | None
    visible_half_angle_deg: Annotated[float, Meta(ge=1e-3, le=90)] | None
    visible_radius_mm: Annotated[float, Meta(ge=1e-3, le=1e4)] | None = None
    f_px: float | None = None
    mm_per_px: float | None = None
    row_c: _Px
    col_c: _Px
    radius_px: Annotated[float, Meta(ge=1, le=1e5)]
    image_height_px: _SizePx
    image_width_px: _SizePx
    flange_T_sensor: SevenNumbers
    calibration_crc32: Annotated[int, Meta(ge=0, le=2**32 - 1)]

    def __post_init__(self) -> None:
        # Raises ValueError for a quaternion that is no rotation; decoding reports it in one line.
        from_seven(self.flange_T_sensor)
        d, geometry = self.camera_distance_mm, self.geometry
        if d is not None and not geometry.f_px > 0:
            raise ValueError(f"found a camera distance of {d} mm, expected one behind the skin")

    @property
    def geometry(self) -> Geometry:
        """Skin, camera and disc."""
        disc, d = Disc(self.row_c, self.col_c, self.radius_px), self.camera_distance_mm
        if self.skin == "pad":
            if self.visible_radius_mm is None:
                raise ValueError("found no visible_radius_mm, expected that of a pad")
            return Geometry(math.inf, d, 0.0, disc, self.visible_radius_mm)
        if self.skin_radius_mm is None or self.visible_half_angle_deg is None:
            raise ValueError("found no skin_radius_mm or visible_half_angle_deg, expected a dome's")
        return Geometry(self.skin_radius_mm, d, self.visible_half_angle_deg, disc)


@dataclass(frozen=True, slots=True, kw_only=True)
class Info:
    """``info``: what a subscriber needs to place every pixel of ``height`` in mm.

    `geometry` is None without a calibration; `reason` and its code then give the reason. `profiles`
    are the names that ``req/profile`` accepts, and `choice` is the chosen one of them. `reference`
    is where the reference started and how far it may follow from there; None if it does not follow.
    `fitted` are the profiles whose networks were fitted to this sensor. `hand_id` names the hand
    that the sensor is a finger of, and `hand_T_sensor` (x, y, z in mm, quaternion w, x, y, z) is
    the sensor's pose in it; both are None without a hand.
    """

    version: str = ""
    wire_version: Count = 1
    config_digest: str = ""
    profile: str
    profiles: tuple[str, ...] = ()
    choice: str = ""
    reference: dict[str, Any] | None = None
    geometry: InfoGeometry | None
    fitted: tuple[str, ...] = ()
    hand_id: str | None = None
    hand_T_sensor: SevenNumbers | None = None
    reason: str = ""
    reason_code: Code = ""

    def __post_init__(self) -> None:
        if self.hand_T_sensor is not None:
            from_seven(self.hand_T_sensor)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """``contact``: flat numbers, None if nothing touches or it is not computed, and codes,
    empty if all is well.

    `contact` is 0 or 1, `objects` the number of objects, `area_mm2` their total area; `x_mm` and
    `y_mm` are the centroid of the largest object. `touched` is 1 if something touches but its depth
    is unknown: `contact` is then 0, and depth, area and volume are None. In an unusable frame, with
    a `reason_code`, `contact` and all of these are None. Shear, twist and slip (0 stick, 1
    partial, 2 full) each come from the object with the largest value. `fps` is the delivery rate in
    1/s. `t_ns` and `wall_ns` are the capture time, on the daemon's monotonic clock
    and in Unix time.
    """

    t_ns: Count
    seq: Count
    contact: Annotated[int, Meta(ge=0, le=1)] | None
    depth_max_mm: Number | None = None
    area_mm2: Rate | None = None
    volume_mm3: Volume | None = None
    objects: Count | None = 0
    x_mm: Number | None = None
    y_mm: Number | None = None
    shear_x_mm: Number | None = None
    shear_y_mm: Number | None = None
    twist_deg: Number | None = None
    slip: SlipCode | None = None
    slip_mm_s: Number | None = None
    fps: Rate | None = None
    reason_code: Code = ""
    degraded_code: Code = ""
    wall_ns: Count = 0
    # Last and with a default, because older daemons do not send it.
    touched: Annotated[int, Meta(ge=0, le=1)] | None = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchNumbers:
    """``touch``: each quantity and its standard deviation, in the unit of its name,
    and why some or all are unknown.

    Both mappings have the same names, and are None without contact.
    """

    t_ns: Count
    seq: Count
    wall_ns: Count = 0
    touch: _Numbers | None
    touch_sigma: _Sigmas | None
    reason: str = ""
    reason_code: Code = ""

    def __post_init__(self) -> None:
        # A value without a standard deviation would be trusted without bounds.
        if (self.touch or {}).keys() != (self.touch_sigma or {}).keys():
            raise ValueError("found other names in touch_sigma than in touch")


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipEvent:
    """``event/slip``: the object `id` began to slide at x, y in the sensor frame,
    this fast over the skin.
    """

    t_ns: Count
    seq: Count
    id: Count | None = None
    x_mm: Number
    y_mm: Number
    slip_mm_s: Number | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectEvent:
    """``event/object``: the object `label` of the frame is the taught object `name`,
    this probably.
    """

    name: Key
    probability: Annotated[float, Meta(ge=0, le=1)]
    label: Count
    t_ns: Count
    seq: Count
    wall_ns: Count = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactEvent:
    """``event/contact``: contact `id` has begun (``new``), goes on (``update``,
    once a second) or has ended.

    The values are the greatest since `start_ns`: of depth, volume, length of the mean shear, slip
    and number of objects. They are None while none is known. `reason_code` says why the frames that
    ended the contact could not be used; it is empty if they showed that nothing touches.
    """

    type: Literal["new", "update", "end"]
    id: Count
    t_ns: Count
    wall_ns: Count = 0
    start_ns: Count
    end_ns: Count | None = None
    depth_max_mm: Number | None = None
    volume_mm3: Volume | None = None
    shear_mm: Rate | None = None
    slip: SlipCode | None = None
    objects: Count | None = None
    # With a default, because older daemons do not send it.
    reason_code: Code = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class StitchedMap:
    """``map/revision`` and ``map/final``: extent along x and y of the base frame, range of heights,
    and points.

    `revision` counts the presses and the end; `used` is the number of presses in the map, `points`
    that of points in ``map/cloud``, `spacing_mm` apart. An empty map has no heights. `folder` holds
    the final map's files on the daemon's machine; it is empty before the end.
    """

    name: str
    revision: Count
    presses: Count
    used: Count
    x0_mm: _Place
    y0_mm: _Place
    width_mm: _Place
    length_mm: _Place
    z_min_mm: _Place | None
    z_max_mm: _Place | None
    area_mm2: Rate
    points: Count
    spacing_mm: _Place
    folder: str = ""


@dataclass(frozen=True, slots=True)
class Status:
    """``status/<part>``, without the part's own details; an empty payload gives empty fields."""

    state: str = ""
    reason: str | None = ""
    reason_code: Code | None = ""


OF_JSON: Final[dict[str, type]] = {
    "contact": Contact,
    "touch": TouchNumbers,
    "event/slip": SlipEvent,
    "event/contact": ContactEvent,
    "event/object": ObjectEvent,
    "info": Info,
    "map/revision": StitchedMap,
    "map/final": StitchedMap,
}
"""The topics of these types."""
NEWEST_WINS: Final = frozenset({"contact", "touch", "map/revision"})
"""Those of whose messages only the newest is of use."""
