"""The ``health`` message: how many frames arrived, their outcomes, and how fast."""

from __future__ import annotations

import time
from typing import Any

from tacshade_edge.daemon.pipeline.ledger import Counts, FrameLedger, Timings
from tacshade_edge.daemon.pipeline.observer import FrameObserver, FrameResult
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.types import Reconstruction

# This many periods without one good frame are a state, not an event.
UNUSABLE_PERIODS = 3


def delivered(counts: Counts) -> int:
    """Number of frames with a good outcome: sent, with nothing to send, or not requested."""
    return counts.published + counts.without_contact + counts.unasked


class Health(FrameObserver):
    """Makes the message; its rates are means between two calls of `snapshot`.

    Attributes
    ----------
    unusable : Reason or None
        Why every frame of the last `UNUSABLE_PERIODS` periods was invalid; None if one was good or none came.
    """

    def __init__(self, ledger: FrameLedger, timings: Timings) -> None:
        self._ledger = ledger
        self._timings = timings
        self._started_ns = self._last_ns = time.monotonic_ns()
        self._last = ledger.counts()
        self._unusable_periods = 0
        self._latest: Reconstruction | None = None
        self.unusable: Reason | None = None

    def see(self, seen: FrameResult) -> None:
        """Keep the newest reconstruction."""
        self._latest = seen.reconstruction or self._latest

    def snapshot(self, source_dropped: int, mqtt: dict[str, int]) -> dict[str, Any]:
        """The message as a dict, without the observers' reports.

        ``frames`` holds captured = published + superseded + without_contact + unasked + invalid + failed + pending,
        all at one instant. ``source_dropped`` frames never reached this process and are not among them.
        """
        now_ns = time.monotonic_ns()
        counts, before = self._ledger.counts(), self._last
        seconds = max(now_ns - self._last_ns, 1) / 1e9
        self._last, self._last_ns = counts, now_ns
        stages = self._timings.percentiles()
        latest = self._latest
        reason, degraded = (latest.reason, latest.degraded) if latest else (None, None)
        self._judge(before, counts, reason)
        return {
            "wall_ns": time.time_ns(),
            "uptime_s": round((now_ns - self._started_ns) / 1e9, 1),
            "frames": counts.as_dict(),
            "source_dropped": source_dropped,
            "capture_fps": round((counts.captured - before.captured) / seconds, 2),
            "delivered_fps": round((delivered(counts) - delivered(before)) / seconds, 2),
            "published_fps": round((counts.published - before.published) / seconds, 2),
            "latency_ms": stages.pop("latency", None),
            "stages_ms": stages,
            **reason_fields(reason, "invalid_reason"),
            **reason_fields(degraded, "degraded_reason"),
            "mqtt": mqtt,
        }

    def _judge(self, before: Counts, counts: Counts, reason: Reason | None) -> None:
        """Note whether frames come but none can be used; keep the first reason, so that it is published once.

        A missing calibration is no frame's fault: the daemon reports it.
        """
        if reason is not None and reason.code is ReasonCode.NOT_CALIBRATED:
            return
        if delivered(counts) > delivered(before):
            self._unusable_periods, self.unusable = 0, None
        elif counts.invalid > before.invalid:
            self._unusable_periods += 1
        if self._unusable_periods >= UNUSABLE_PERIODS and not self.unusable:
            self.unusable = reason or Reason(ReasonCode.NO_USABLE_FRAME, "no frame is usable")
