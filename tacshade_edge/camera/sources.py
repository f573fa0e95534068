"""The kinds of source that the settings may name, each a file of its own."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, get_args

from tacshade_edge.camera.csi_camera import Rpicam
from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.camera.picture_files import Files
from tacshade_edge.camera.simulated_frames import Simulated
from tacshade_edge.camera.source_settings import DEFAULT_SIZE_PX, SourceSettings
from tacshade_edge.camera.usb_camera import V4l2

__all__ = ["Files", "Rpicam", "Simulated", "Source", "V4l2"]

Source = V4l2 | Rpicam | Files | Simulated
KINDS: Final[tuple[type[SourceSettings], ...]] = get_args(Source)


def make_source(source: Source, size_px: tuple[int, int] | None = None) -> FrameSource:
    """Make the frame source that the settings name, without opening it;
    `size_px` as in `SourceSettings.sized`.
    """
    return source.sized(size_px).make()


def best_size(offered: Iterable[tuple[int, int]]) -> tuple[int, int]:
    """The width and height to take of those that a camera offers: the least that holds the default.

    Of two, that with the default's sides goes first, because cameras crop pictures to other ones.
    The default if the camera offers none that holds it.
    """
    cols, rows = DEFAULT_SIZE_PX
    # A larger size than needed costs time for every frame, a smaller one accuracy.
    large = [size for size in offered if size[0] >= cols and size[1] >= rows]

    def cost(size_px: tuple[int, int]) -> tuple[bool, int]:
        width_px, height_px = size_px
        return width_px * rows != height_px * cols, width_px * height_px

    return min(large, key=cost, default=DEFAULT_SIZE_PX)
