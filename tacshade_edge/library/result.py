"""The result of one frame, and a stream of results."""

from __future__ import annotations

import base64
import html
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from tacshade_edge.files.drawing import height_png
from tacshade_edge.quoting import counted
from tacshade_edge.reasons import code_of, text_of
from tacshade_edge.sensor.geometry.disc import Grid, disc_rays, skin_points
from tacshade_edge.types import (
    F32,
    U16,
    Bool,
    Geometry,
    Pose,
    Reconstruction,
    TouchedObject,
    freeze,
)


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """The reconstruction of one image or frame; arrays are read-only, lengths in mm.

    Attributes
    ----------
    seq : int
        The frame's number in its source; 0 for a single image.
    t_ns, wall_ns : int
        Capture time in ns: CLOCK_MONOTONIC of the machine with the camera, or the recording's
        clock; and Unix time. 0 if unknown.
    profile : str
    valid : bool
        Whether the frame was usable; if not, every height is 0 and `depth_max_mm` NaN.
    reason, reason_code : str
        Why the frame is invalid, for people and for programs (docs/reference/mqtt/reasons.md);
        empty when valid.
    degraded, degraded_code : str
        Why the result is less trustworthy; empty when all is well.
    in_contact : bool
        Whether anything touches the skin.
    saturated : bool
        Whether the grey left the range that the calibration covers;
        if so, the depth is a lower bound.
    height_mm : float32 (rows, cols)
        h, how far the skin is pressed in; NaN outside the visible disc,
        exactly 0 inside it without contact.
    contact : bool (rows, cols)
        Cells where the skin touches an object.
    untrusted : bool (rows, cols) or None
        Cells that do not show the sensor's skin; None if not reported.
    shear_mm : float32 (rows, cols, 2) or None
        How far the skin is dragged along x and y; None if not reported.
    sigma_mm : float32 (rows, cols) or None
        Standard deviation of `height_mm` where `contact` is true, NaN elsewhere;
        None if not reported.
    row0, col0, step_px : float
        Cell (i, j) is image pixel (row0 + i·step_px, col0 + j·step_px).
    points_mm : float32 (N, 3)
        Points of the skin in contact: x, y, z in the sensor frame.
    labels : uint16 (N,)
        The label of each point's object, from 1.
    objects : tuple of TouchedObject
        The objects in the order of their labels, largest first.
    volume_mm3 : float
        Volume displaced under the contacts; NaN if the frame is invalid or `touched`.
    touch, touch_sigma : mapping of str to float or None
        The touch as a few numbers, each in the unit of its name, and the standard deviation of
        each; a value is None if the model does not know it. Both mappings are None without contact
        or if not reported.
    touch_reason, touch_reason_code : str
        Why some or all of the values are unknown; empty when all are known.
    pose : Pose or None
        ``base_T_flange`` at `t_ns`; None if no robot reports it.
    geometry : Geometry
        Skin, camera and visible circle.
    touched : bool
        Whether something touches, but its depth is unknown: `in_contact` is then false, every
        height 0, `depth_max_mm` NaN, and `degraded` states why.
    """

    seq: int
    t_ns: int
    wall_ns: int
    profile: str
    valid: bool
    reason: str
    reason_code: str
    degraded: str
    degraded_code: str
    in_contact: bool
    saturated: bool
    height_mm: F32
    contact: Bool
    untrusted: Bool | None
    shear_mm: F32 | None
    sigma_mm: F32 | None
    row0: float
    col0: float
    step_px: float
    points_mm: F32
    labels: U16
    objects: tuple[TouchedObject, ...]
    volume_mm3: float
    touch: Mapping[str, float | None] | None
    touch_sigma: Mapping[str, float | None] | None
    touch_reason: str
    touch_reason_code: str
    pose: Pose | None
    geometry: Geometry
    touched: bool = False

    def __post_init__(self) -> None:
        # The other arrays are read-only already.
        if self.untrusted is not None:
            freeze(self, "untrusted")

    @property
    def depth_max_mm(self) -> float:
        """Greatest h of the touched objects in mm; 0 without contact,
        NaN if the frame is invalid or `touched`.
        """
        if self.touched or not self.valid:
            return math.nan
        return max((o.depth_max_mm for o in self.objects), default=0.0)

    def __repr__(self) -> str:
        """The result in a line, for people."""
        what = self.reason or ("touched, depth unknown" if self.touched else "no contact")
        if self.objects:
            what = f"{counted(len(self.objects), 'object')}, deepest {self.depth_max_mm:.2f} mm"
        return f"<Result {self.seq} of {self.profile}: {what}>"

    def _repr_html_(self) -> str:
        """The line and, if there is one, the height map: what a notebook shows."""
        line = html.escape(repr(self))
        # A listener has no map before the first contact.
        if not self.height_mm.size:
            return line
        # In the page itself: a notebook is one file.
        data = base64.b64encode(height_png(self.height_mm)).decode()
        return f'{line}<br><img alt="h in mm, with its scale" src="data:image/png;base64,{data}">'

    def skin_mm(self) -> F32:
        """Place each cell's skin point in the sensor frame.

        Returns
        -------
        float32 (rows, cols, 3)
            x, y, z in mm; NaN outside the visible disc.
        """
        rows, cols = self.height_mm.shape
        grid = Grid(rows, cols, self.row0, self.col0, self.step_px)
        return skin_points(self.height_mm, disc_rays(grid, self.geometry), self.geometry)


def result_of(
    made: Reconstruction, geometry: Geometry, pose: Pose | None, untrusted: Bool | None
) -> Result:
    """Convert a reconstruction to the library's result."""
    height, cloud, touch = made.height, made.cloud, made.touch
    touch_reason = None if touch is None else touch.reason
    return Result(
        seq=made.seq,
        t_ns=made.t_ns,
        wall_ns=made.wall_ns,
        profile=made.profile,
        valid=made.valid,
        reason=text_of(made.reason),
        reason_code=code_of(made.reason),
        degraded=text_of(made.degraded),
        degraded_code=code_of(made.degraded),
        in_contact=made.contact,
        saturated=made.saturated,
        height_mm=height.height_mm,
        contact=height.contact,
        untrusted=untrusted,
        shear_mm=made.shear_mm,
        sigma_mm=made.sigma_mm,
        row0=height.row0,
        col0=height.col0,
        step_px=height.step_px,
        points_mm=cloud.points_mm,
        labels=cloud.labels,
        objects=made.objects,
        volume_mm3=made.volume_mm3 if made.valid and not made.touched else math.nan,
        touch=None if touch is None else touch.values,
        touch_sigma=None if touch is None else touch.sigma,
        touch_reason=text_of(touch_reason),
        touch_reason_code=code_of(touch_reason),
        pose=pose,
        geometry=geometry,
        touched=made.touched,
    )


class Results(ABC, Iterator[Result]):
    """An iterator of results, each computed in the caller's thread when it is requested.

    After an exception, the next call of ``next`` continues.
    Close the iterator with ``with`` or `close`, or exhaust it.

    Attributes
    ----------
    passed_over : int
        Number of frames without a result: a newer one replaced them, or they were lost or damaged
        in transit.
    refused : int
        Number of messages that no daemon publishes, from `listen`; the log shows the first, and one
        every 10 s.
    """

    @property
    @abstractmethod
    def passed_over(self) -> int:
        """Number of frames without a result: a newer one replaced them,
        or they were lost or damaged in transit.
        """

    @property
    def refused(self) -> int:
        """Number of messages that no daemon publishes, from `listen`."""
        return 0

    # Of the class: `close` must work even if a subclass's constructor has failed.
    _closed = False

    def __next__(self) -> Result:
        """Return the next result.

        Raises
        ------
        DeviceError
            The camera or the broker was lost, or nothing came; the next call tries again.
        ConfigError
            Another thread is using the sensor.
        """
        if self._closed or (result := self._next()) is None:
            # At the end too, so that a camera is free as soon as its last frame is read.
            self.close()
            raise StopIteration
        return result

    def close(self) -> None:
        """Release the camera, recording or connection; safe to call twice."""
        if not self._closed:
            self._closed = True
            self._release()

    @abstractmethod
    def _next(self) -> Result | None:
        """The next result; None at the end."""

    @abstractmethod
    def _release(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
