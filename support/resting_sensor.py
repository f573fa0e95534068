"""A sensor at rest whose reference is followed, on the test's clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from tacshade_edge.daemon.reference_in_use import REFERENCE_FRAMES, References
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.reasons import Reason
from tacshade_edge.sensor.contact.untouched import PERIOD_S, REST_S, UNTOUCHED_FRAMES, Untouched
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Calibration, Frame, Need

FPS = 10
BATCH_S = UNTOUCHED_FRAMES / FPS


class Resting:
    """`References` and a stream of frames on the test's clock."""

    def __init__(self, calibration: Calibration, path: Path) -> None:
        self.path, self.changes, self.held = path, 0, False
        self.references = References(
            calibration, path, "left", lambda _: self._changed(), self._changed, lambda: self.held
        )
        self._reconstructor = make_reconstructor(calibration, PROFILES["fast"])
        self.s = 0.0

    def show(
        self, image: U8, seconds: float, doubt: Reason | None = None, glance: bool = False
    ) -> None:
        """Show the same result again and again; with `glance`, of a contact only that it is one."""
        need = Need.CONTACT if glance else Need.SHEAR
        result = self._reconstructor.step(Frame(0, 0, 0, image), need=need)
        result = replace(result, degraded=doubt or result.degraded) if result else None
        for _ in range(round(seconds * FPS)):
            self.s += 1 / FPS
            self.references.frames.see(Frame(0, round(self.s * 1e9), 0, image), result)

    def taken(self) -> int | Reason | None:
        """The number of images of a rest, or the doubt."""
        taken = self.references.frames.take()
        return len(taken.images) if isinstance(taken, Untouched) else taken

    def _changed(self) -> None:
        self.changes += 1

    def look(self, image: U8, held: bool = False, doubt: Reason | None = None) -> bool:
        """As long as it takes to the next look, and whether there is something to report."""
        self.show(image, max(REST_S, PERIOD_S) + UNTOUCHED_FRAMES / FPS + 0.2, doubt)
        return self.poll(held)

    def poll(self, held: bool = False) -> bool:
        self.held, before = held, self.changes
        self.references.poll()
        return self.changes > before

    def take(self, image: U8, frames: int = REFERENCE_FRAMES) -> Any:
        """The reply to ``req/reference``, if there is one after so many frames."""
        replies: list[Any] = []
        self.references.handle(replies.append)
        for seq in range(frames):
            frame = Frame(seq, round(self.s * 1e9), 0, image)
            result = self._reconstructor.step(frame, need=self.references.need())
            self.references.see(FrameResult(frame, None, result))
        self.references.poll()
        return replies.pop() if replies else None

    @property
    def health(self) -> dict[str, Any]:
        return self.references.health()
