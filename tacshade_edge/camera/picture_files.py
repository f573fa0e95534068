"""Images or a video in the settings, instead of a camera; `file_source` reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

from msgspec import Meta

from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.camera.source_settings import SourceSettings, other_size
from tacshade_edge.section import PATH


class Files(SourceSettings, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="files"):
    """Images or a video file in place of a camera."""

    names: ClassVar[str] = "path"

    path: Annotated[
        # An empty path would be the folder of the settings file.
        str,
        Meta(min_length=1, description="a folder of images, an image or a video file", extra=PATH),
    ]
    fps: (
        Annotated[
            float,
            Meta(
                ge=1, le=240, description="frames per second, instead of the file's own times or 30"
            ),
        ]
        | None
    ) = None
    loop: Annotated[bool, Meta(description="begin again after the last image")] = False

    def make(self) -> FrameSource:
        from tacshade_edge.camera.file_source import FilesSource

        return FilesSource(path=Path(self.path), fps=self.fps, loop=self.loop)

    def check(self) -> None:
        self._first_size_px()

    def has_poses(self) -> bool:
        """Whether a table of poses is in the folder."""
        from tacshade_edge.recording.frame_table import table_in

        return table_in(Path(self.path)) is not None

    def size_misfit(self, expected_px: tuple[int, int]) -> tuple[str, str] | None:
        found_px = self._first_size_px()
        return None if found_px is None else other_size("path", found_px, expected_px)

    def _first_size_px(self) -> tuple[int, int] | None:
        from tacshade_edge.camera.file_source import first_size_px

        return first_size_px(Path(self.path))
