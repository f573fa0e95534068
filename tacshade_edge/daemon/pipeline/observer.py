"""What sees frames: one value that holds all that is known of a frame, and one base class for whoever sees it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from tacshade_edge.protocol.requests import Request
from tacshade_edge.protocol.results import RequestResult
from tacshade_edge.reasons import Reason
from tacshade_edge.settings import Settings
from tacshade_edge.types import Calibration, Frame, Need, Reconstruction

# After the beginning of a stop, whatever hangs: what is done early leaves its time to the next.
SERIAL_STOPPED_S, THREADS_STOPPED_S, FRAMES_SENT_S = 0.1, 0.9, 1.1
RECORDED_S, STITCHED_S, LINK_STOPPED_S = 1.3, 1.4, 1.9


@dataclass(frozen=True, slots=True)
class SourceState:
    """How the frame source is; `reason` is None when all is well."""

    state: Literal["streaming", "away", "unusable", "ended"]
    reason: Reason | None = None
    details: dict[str, str | int | float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """A frame and what came of it.

    Attributes
    ----------
    frame : Frame
        With its pose, where it is known.
    calibration : Calibration or None
        Of the sensor that gave the frame; None: there is none yet, and every reconstruction is invalid.
    reconstruction : Reconstruction or None
        None: a contact whose depth nobody needed.
    step_ms : float
        How long the reconstruction took; 0 where nobody measured it.
    """

    frame: Frame
    calibration: Calibration | None
    reconstruction: Reconstruction | None
    step_ms: float = 0.0


class FrameObserver:
    """A part of the daemon that sees frames; it overrides what it does, and nothing else happens.

    The thread `grab` calls `tap`, and `need` too while nobody needs a frame; `reconstruct` calls `need` and `see`. None
    of them may wait. The main thread calls the others; `answer` comes from any thread.

    Attributes
    ----------
    health_key : str
        Where ``health`` has what `health` returns; empty: nowhere.
    stop_s : float
        How long after the beginning of a stop `stop` is to have returned. The earliest is called first.
    """

    health_key: ClassVar[str] = ""
    stop_s: ClassVar[float] = THREADS_STOPPED_S

    def start(self) -> None:
        """Begin: the threads of the pipeline run."""

    @property
    def tap(self) -> Callable[[Frame], None] | None:
        """What takes each frame that the source gives, whatever becomes of it; None while nothing does."""
        return None

    def need(self) -> Need:
        """How much of the next frame is to be reconstructed."""
        return Need.CONTACT

    def see(self, seen: FrameResult) -> None:
        """See a frame that was reconstructed."""

    def poll(self) -> None:
        """Do what is due; several times a second."""

    def health(self) -> Mapping[str, Any] | None:
        """Report for ``health``, once a second."""
        return None

    def settings_changed(self, settings: Settings) -> None:
        """Follow settings that were read again."""

    def source_changed(self, source: SourceState) -> None:
        """Learn of a new state of the source, which is being published."""

    def answer(self, request: Request, outcome: RequestResult | Mapping[str, Any] | Reason) -> bool:
        """Take the outcome of a request that this part made; False: another made it."""
        return False

    def stop(self, timeout_s: float) -> None:
        """End, within this time."""
