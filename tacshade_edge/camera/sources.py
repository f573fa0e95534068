"""The frame source and the robot's port that the settings name,
and the checks that do not open them.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from tacshade_edge import fixes
from tacshade_edge.camera import v4l2_node
from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.errors import ConfigError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.recording.frame_table import table_in
from tacshade_edge.settings import (
    Document,
    Files,
    Rpicam,
    Settings,
    Simulated,
    Source,
    V4l2,
)

if TYPE_CHECKING:
    pass


DEFAULT_SIZE_PX = (320, 240)
"""Width and height where neither the settings nor a calibration state them: the smallest size that
costs no accuracy (docs/results/image-size.md)."""


def sized(source: Source, size_px: tuple[int, int] | None = None) -> Source:
    """The source, with a width and a height if it is a camera whose settings state none.

    `size_px` is the width and height of the calibration's images.
    """
    if not isinstance(source, V4l2 | Rpicam) or source.width_px is not None:
        return source
    width_px, height_px = size_px or DEFAULT_SIZE_PX
    return msgspec.structs.replace(source, width_px=width_px, height_px=height_px)


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


def make_source(source: Source, size_px: tuple[int, int] | None = None) -> FrameSource:
    """Make the frame source that the settings name, without opening it; `size_px` as in `sized`.

    A camera needs no simulator's modules.
    """
    source = sized(source, size_px)
    match source:
        case V4l2():
            # Imported only now: the rest of the program needs neither OpenCV's video nor the
            # laboratory.
            from tacshade_edge.camera.v4l2 import V4l2Source

            return V4l2Source(**msgspec.structs.asdict(source))
        case Rpicam():
            from tacshade_edge.camera.rpicam import RpicamSource

            return RpicamSource(**msgspec.structs.asdict(source))
        case Files(path=path, fps=fps, loop=loop):
            from tacshade_edge.camera.file_source import FilesSource

            return FilesSource(path=Path(path), fps=fps, loop=loop)
        case Simulated(fps=fps, pressed=pressed):
            from tacshade_edge.lab.pressed_file import PressedFile
            from tacshade_edge.lab.simulated_source import SimulatedSource

            return SimulatedSource(fps=fps, script=PressedFile(Path(pressed)) if pressed else None)


def frames_have_poses(settings: Settings) -> bool:
    """Whether frames may have poses: from a robot, or from a table in the source's folder."""
    source = settings.source
    return settings.serial is not None or (
        isinstance(source, Files) and table_in(Path(source.path)) is not None
    )


def how_to_fix(source: Source, code: ReasonCode) -> str | None:
    """What a person can do about a source's state;
    None if that is unknown or the reason itself says it.
    """
    of_cameras = {V4l2: fixes.OF_USB_CAMERAS, Rpicam: fixes.OF_CSI_CAMERAS}.get(type(source), {})
    return of_cameras.get(code) or fixes.OF_FRAMES.get(code)


def check_source(document: Document) -> None:
    """Check the path of the source. Raises ConfigError."""
    source = document.settings.source
    if isinstance(source, Files):
        first_size(document, source)
    # A camera that is absent may appear later; a path to something else never becomes one.
    elif isinstance(source, V4l2):
        try:
            v4l2_node.check_kind(source.device)
        except ConfigError as error:
            raise ConfigError(f"{document.where('source', 'device')}: {error}") from None


def first_size(document: Document, source: Files) -> tuple[int, int] | None:
    """Width and height of the first image, px; None if there is no image yet.

    Raises ConfigError.
    """
    from tacshade_edge.camera.file_source import first_size_px

    try:
        return first_size_px(Path(source.path))
    except ConfigError as error:
        raise ConfigError(f"{document.where('source', 'path')}: {error}") from None
