"""A Raspberry Pi's own camera in the settings; `rpicam` reads its frames."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Mapping
from typing import Annotated, ClassVar, Final

import msgspec
from msgspec import Meta

from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.camera.source_settings import SourceSettings, slow_exposure
from tacshade_edge.finding import Findings, fault, ok
from tacshade_edge.fixes import END_THE_OTHER
from tacshade_edge.reasons import ReasonCode

PROGRAM: Final = "rpicam-vid"
_WIDTH_MULTIPLE_PX: Final = 64
"""rpicam-vid does not report the length of a line,
which equals a width that is a multiple of it.
"""
_LIST_S: Final = 2.5
_CABLE: Final = (
    "is the ribbon cable plugged in at both ends, contacts facing contacts? "
    "rpicam-hello --list-cameras lists it"
)


class Rpicam(SourceSettings, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="rpicam"):
    """A Raspberry Pi's own (CSI) camera, through the program rpicam-vid."""

    is_camera: ClassVar[bool] = True
    names: ClassVar[str] = "camera"
    fixes: ClassVar[Mapping[ReasonCode, str]] = {
        ReasonCode.ABSENT: _CABLE,
        ReasonCode.IN_USE: END_THE_OTHER,
        ReasonCode.NOT_OFFERED: (
            "set source.width_px and height_px to a size that rpicam-hello --list-cameras shows"
        ),
        ReasonCode.LOST: _CABLE,
        ReasonCode.STALLED: _CABLE,
    }

    camera: Annotated[
        int, Meta(ge=0, le=7, description="its number in rpicam-vid --list-cameras")
    ] = 0
    width_px: (
        Annotated[
            int, Meta(ge=64, le=4096, multiple_of=_WIDTH_MULTIPLE_PX, description="image width")
        ]
        | None
    ) = None
    height_px: (
        # YUV 4:2:0 has a row of colours for two rows.
        Annotated[int, Meta(ge=16, le=4096, multiple_of=2, description="image height")] | None
    ) = None
    fps: Annotated[
        int, Meta(ge=1, le=240, description="frames per second to request from the camera")
    ] = 30
    exposure_us: Annotated[int, Meta(ge=1, le=1_000_000, description="locked exposure")] = 10_000
    gain: Annotated[float, Meta(ge=1, le=64, description="locked gain of the image sensor")] = 1.0
    lens_position: (
        Annotated[
            float, Meta(ge=0, le=50, description="locked focus of a lens that moves, dioptres")
        ]
        | None
    ) = None
    sensor_mode: (
        Annotated[
            str,
            Meta(
                pattern=r"^[0-9]{2,5}:[0-9]{2,5}$", description="WIDTH:HEIGHT of the sensor's mode"
            ),
        ]
        | None
    ) = None

    def misfit(self) -> tuple[tuple[str, ...], str] | None:
        return SourceSettings.misfit(self) or slow_exposure(
            "exposure_us", self.exposure_us, 1, self.fps
        )

    def size_misfit(self, expected_px: tuple[int, int]) -> tuple[str, str] | None:
        if self.width_px is None and expected_px[0] % _WIDTH_MULTIPLE_PX:
            return "width_px", (
                f"found null, which takes the calibration's {expected_px[0]} px, "
                f"expected a calibration of a multiple of {_WIDTH_MULTIPLE_PX} px"
            )
        return SourceSettings.size_misfit(self, expected_px)

    def make(self) -> FrameSource:
        from tacshade_edge.camera.rpicam import RpicamSource

        return RpicamSource(**msgspec.structs.asdict(self))

    def inspect(self) -> Findings:
        """Whether the program lists the camera."""
        if not shutil.which(PROGRAM):
            return (
                fault("camera", f"found no program {PROGRAM}", "sudo apt install rpicam-apps-lite"),
            )
        cameras = csi_cameras()
        if name := cameras.get(self.camera):
            return (ok("camera", f"camera {self.camera} of {PROGRAM}: {name}"),)
        found = ", ".join(f"{number} ({name})" for number, name in cameras.items()) or "none"
        fix = f"set source.camera to a listed camera; {_CABLE}" if cameras else _CABLE
        text = f"{PROGRAM} does not list camera {self.camera}; it lists {found}"
        return (fault("camera", text, fix),)


def csi_cameras() -> dict[int, str]:
    """Return number and name of each CSI camera that ``rpicam-vid --list-cameras`` lists;
    none without the program.
    """
    words = (PROGRAM, "--list-cameras")
    try:
        done = subprocess.run(
            words, capture_output=True, text=True, errors="replace", timeout=_LIST_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return {}
    found = re.findall(r"^(\d+) : (.*?)(?: \(/.*\))?$", done.stdout, re.MULTILINE)
    return {int(number): name for number, name in found}
