"""What the settings say of a source: what all kinds have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import msgspec

from tacshade_edge import fixes
from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.finding import Findings
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.section import Section

DEFAULT_SIZE_PX = (320, 240)
"""Width and height where neither the settings nor a calibration state them: the smallest size that
costs no accuracy (docs/results/image-size.md)."""


class SourceSettings(
    Section, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"
):
    """The settings of one kind of source, which its own file says, with what the program must know
    of that kind. One with the fields `width_px` and `height_px` may leave the size to the
    calibration.
    """

    is_camera: ClassVar[bool] = False
    """Whether it shows what happens now, on a device that no two sensors share."""
    names: ClassVar[str] = "kind"
    """The field that names the device or the file."""
    fixes: ClassVar[Mapping[ReasonCode, str]] = {}
    """What a person can do about the reasons that only this kind has."""

    def make(self) -> FrameSource:
        """The source, not opened, for `sources.make_source`: a size is stated by now."""
        raise NotImplementedError

    def check(self) -> None:
        """Look at what `names` names without opening it. Raises ConfigError."""

    def inspect(self) -> Findings:
        """What `doctor` reports before it opens the source; after a fault, it does not open it."""
        return ()

    def has_poses(self) -> bool:
        """Whether its frames may have poses of their own."""
        return False

    def misfit(self) -> tuple[tuple[str, ...], str] | None:
        """A width without a height, or a height without a width."""
        missing = [each for each in ("width_px", "height_px") if getattr(self, each, 0) is None]
        if len(missing) != 1:
            return None
        return (), f"found no {missing[0]}, expected both width_px and height_px, or neither"

    def size_misfit(self, expected_px: tuple[int, int]) -> tuple[str, str] | None:
        """Why its images cannot have this width and height: the field, and ``found …, expected …``.

        Raises ConfigError, as `check` does.
        """
        width_px, height_px = (getattr(self, each, None) for each in ("width_px", "height_px"))
        if width_px is None or height_px is None:
            return None
        return other_size("width_px", (width_px, height_px), expected_px)

    def sized(self, size_px: tuple[int, int] | None = None) -> Self:
        """The same, with the width and height `size_px` of the calibration's images, or the
        default, if the settings can state a size but do not.
        """
        if getattr(self, "width_px", 0) is not None:
            return self
        width_px, height_px = size_px or DEFAULT_SIZE_PX
        return msgspec.structs.replace(self, width_px=width_px, height_px=height_px)

    def how_to_fix(self, code: ReasonCode) -> str | None:
        """What a person can do about the source's state;
        None if that is unknown or the reason itself says it.
        """
        return self.fixes.get(code) or fixes.OF_FRAMES.get(code)


def other_size(
    name: str, found_px: tuple[int, int], expected_px: tuple[int, int]
) -> tuple[str, str] | None:
    """What `SourceSettings.size_misfit` says of two widths and heights; None if they are equal."""
    if found_px == expected_px:
        return None
    found, expected = (f"{width}x{height} px" for width, height in (found_px, expected_px))
    return name, f"found {found}, expected {expected}, the size of the calibration's images"


def slow_exposure(
    name: str, exposure: int | None, unit_us: int, fps: float
) -> tuple[tuple[str, ...], str] | None:
    """An exposure that does not fit into the frame period,
    which slows the camera down without notice.
    """
    most = (1_000_000 - 1) // (fps * unit_us)
    if exposure is None or exposure <= most:
        return None
    period = f"a frame takes {1e6 / fps:.0f} µs at {fps} frames/s"
    return (name,), f"found {exposure}, expected at most {most}, because {period}"
