"""A camera that shows one grey: what `test_places` adds as a new kind of source."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta

from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.camera.source_settings import SourceSettings, slow_exposure
from tacshade_edge.errors import ConfigError
from tacshade_edge.finding import Findings, fault, ok
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.types import Frame


class Still(SourceSettings, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="still"):
    """A device that holds a grey level."""

    is_camera: ClassVar[bool] = True
    names: ClassVar[str] = "device"
    fixes: ClassVar[Mapping[ReasonCode, str]] = {ReasonCode.ABSENT: "write a grey level into it"}

    device: Annotated[str, Meta(min_length=1, description="the device")]
    width_px: Annotated[int, Meta(ge=16, le=4096, description="image width")] | None = None
    height_px: Annotated[int, Meta(ge=16, le=4096, description="image height")] | None = None
    fps: Annotated[int, Meta(ge=1, le=240, description="frames per second")] = 30
    exposure_us: Annotated[int, Meta(ge=1, le=1_000_000, description="locked exposure")] = 1000

    def misfit(self) -> tuple[tuple[str, ...], str] | None:
        return SourceSettings.misfit(self) or slow_exposure(
            "exposure_us", self.exposure_us, 1, self.fps
        )

    def make(self) -> FrameSource:
        return StillSource(self)

    def check(self) -> None:
        if Path(self.device).is_dir():
            raise ConfigError(f"{self.device}: found a folder, expected a device")

    def inspect(self) -> Findings:
        if Path(self.device).exists():
            return (ok("camera", self.device),)
        return (fault("camera", f"{self.device}: no such device", self.fixes[ReasonCode.ABSENT]),)


class StillSource:
    """Its frames."""

    dropped = 0

    def __init__(self, settings: Still) -> None:
        assert settings.width_px is not None
        assert settings.height_px is not None
        self._path = Path(settings.device)
        self._shape = settings.height_px, settings.width_px
        self._seq = -1

    def open(self) -> None:
        """Nothing is held open."""

    def read(self) -> Frame | None:
        self._seq += 1
        image = np.full(self._shape, int(self._path.read_text()), np.uint8)
        return Frame(self._seq, time.monotonic_ns(), time.time_ns(), image)

    def skip(self) -> bool:
        self._seq += 1
        return True

    def close(self) -> None:
        """Nothing is held open."""

    def describe(self) -> dict[str, str | int | float]:
        return {"device": str(self._path)}
