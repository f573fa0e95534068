"""The simulated sensor in the settings; the laboratory draws its frames."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta

from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.camera.source_settings import SourceSettings
from tacshade_edge.section import PATH


class Simulated(
    SourceSettings, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="simulated"
):
    """The simulated sensor, pressed repeatedly or according to a file."""

    fps: Annotated[float, Meta(ge=1, le=240, description="frames per second")] = 30.0
    pressed: (
        Annotated[
            str,
            Meta(min_length=1, description="a CSV file that says what presses it now", extra=PATH),
        ]
        | None
    ) = None

    def make(self) -> FrameSource:
        # Only now: a camera needs no simulator's modules.
        from tacshade_edge.lab.pressed_file import PressedFile
        from tacshade_edge.lab.simulated_source import SimulatedSource

        script = PressedFile(Path(self.pressed)) if self.pressed else None
        return SimulatedSource(fps=self.fps, script=script)
