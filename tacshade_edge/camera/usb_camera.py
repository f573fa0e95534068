"""A Linux video device in the settings; `v4l2` reads its frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Final, Literal

import msgspec
from msgspec import Meta

from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.camera.source_settings import SourceSettings, slow_exposure
from tacshade_edge.fixes import END_THE_OTHER
from tacshade_edge.reasons import ReasonCode

# The unit of V4L2_CID_EXPOSURE_ABSOLUTE.
_EXPOSURE_US: Final = 100
_CABLE: Final = (
    "plug it in again, into another USB port or a powered hub; sudo dmesg shows what the kernel saw"
)


class V4l2(SourceSettings, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="v4l2"):
    """A Linux video device."""

    is_camera: ClassVar[bool] = True
    names: ClassVar[str] = "device"
    fixes: ClassVar[Mapping[ReasonCode, str]] = {
        ReasonCode.ABSENT: (
            "plug it in, or set source.device to one that tacshade-edge doctor lists"
        ),
        ReasonCode.PERMISSION: "sudo usermod -aG video $USER, then log out and in again",
        ReasonCode.IN_USE: END_THE_OTHER,
        ReasonCode.NOT_OFFERED: (
            "set source.fourcc, width_px, height_px and fps to what v4l2-ctl --list-formats-ext "
            "lists"
        ),
        ReasonCode.NO_ANSWER: _CABLE,
        ReasonCode.LOST: _CABLE,
        ReasonCode.STALLED: _CABLE,
    }

    # No number, as OpenCV takes it: a camera has another one after the next start.
    device: Annotated[str, Meta(pattern="^/dev/", description="a path under /dev")] = "/dev/video0"
    width_px: Annotated[int, Meta(ge=16, le=4096, description="image width")] | None = None
    height_px: Annotated[int, Meta(ge=16, le=4096, description="image height")] | None = None
    fps: Annotated[
        int, Meta(ge=1, le=240, description="frames per second to request from the camera")
    ] = 30
    fourcc: Annotated[Literal["MJPG", "YUYV", "NV12", "GREY"], Meta(description="pixel format")] = (
        "MJPG"
    )
    exposure: (
        Annotated[
            int,
            Meta(
                ge=1, le=100_000, description="locked exposure in the driver's unit, 0.1 ms on UVC"
            ),
        ]
        | None
    ) = None

    def misfit(self) -> tuple[tuple[str, ...], str] | None:
        return SourceSettings.misfit(self) or slow_exposure(
            "exposure", self.exposure, _EXPOSURE_US, self.fps
        )

    def make(self) -> FrameSource:
        # Imported only now: the rest of the program does not need OpenCV's video.
        from tacshade_edge.camera.v4l2 import V4l2Source

        return V4l2Source(**msgspec.structs.asdict(self))

    def check(self) -> None:
        """A camera that is absent may appear later; a path to something else never becomes one."""
        from tacshade_edge.camera.v4l2_node import check_kind

        check_kind(self.device)
