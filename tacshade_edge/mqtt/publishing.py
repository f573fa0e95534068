"""What is published, and when: a frame's results, ``health`` and ``preview``."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from tacshade_edge.mqtt.link import MqttLink
from tacshade_edge.pipeline.ledger import Counts, FrameLedger, FrameOutcome, Timings
from tacshade_edge.pipeline.observer import FrameObserver, FrameResult
from tacshade_edge.reasons import Reason, ReasonCode, code_of, reason_fields
from tacshade_edge.sensor.frame_check.turned import likelier_turn
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.turned_frames import with_turn_of
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.settings import Settings
from tacshade_edge.types import Frame, Need, Reconstruction, Slip
from tacshade_edge.wire import binary, messages
from tacshade_edge.wire.codec import encode_json
from tacshade_edge.wire.sensor_topics import ContactEvent
from tacshade_edge.wire.stamped_jpeg import stamped

_log = logging.getLogger(__name__)

# Without contact; in contact, every frame is published.
CONTACT_PERIOD_NS = 100_000_000
_NEEDS = {
    "height": Need.DEPTH,
    "cloud": Need.DEPTH,
    "contact": Need.DEPTH,
    "shear": Need.SHEAR,
    "sigma": Need.SIGMA,
    "touch": Need.TOUCH,
}
"""What a subscriber to a topic needs of each frame."""


@dataclass(eq=False)
class Publisher(FrameObserver):
    """Publishes what subscribers want of a frame, and settles the frame, if its height is offered
    by the outcome of that. Messages without a listener are left out, except when a contact, or a
    touch of unknown depth, begins or ends, so that no subscriber is left with outdated values. With
    `always_shear` it requests shear even without a listener.
    """

    offer: Callable[[str, bytes, int], None]
    publish_event: Callable[[str, bytes], None]
    settle: Callable[[int, FrameOutcome], None]
    has_listener: Callable[[str], bool] = lambda stream: True
    always_shear: bool = False
    fps: float = 0.0
    _sliding: frozenset[int | None] = frozenset()
    # Contact and touched, of the latest frame, and whether it could be used.
    _state: tuple[bool, bool] = (False, False)
    _valid: bool = True
    _has_touch: bool = False
    _contact_sent_ns: int | None = None

    def need(self) -> Need:
        need = Need.SHEAR if self.always_shear else Need.CONTACT
        for stream, needed in _NEEDS.items():
            if self.has_listener(stream):
                need |= needed
        return need

    def settings_changed(self, settings: Settings) -> None:
        self.always_shear = settings.shear == "always"

    def see(self, seen: FrameResult) -> None:
        if (result := seen.reconstruction) is None:
            self.settle(seen.frame.seq, "unasked")
            return
        changed = (result.contact, result.touched) != self._state
        self._state = result.contact, result.touched
        # What was known no longer is, or is again.
        known_anew, self._valid = result.valid != self._valid, result.valid
        # All are encoded first, and handed over last:
        # the link's thread then does not take turns with this one.
        payloads: list[tuple[str, bytes]] = []
        crc32 = 0 if seen.calibration is None else seen.calibration.crc32
        taken = binary.Taken(
            calibration_crc32=crc32, pose=seen.frame.pose, pose_error_us=seen.frame.pose_error_us
        )
        height_goes = changed or (result.contact and self.has_listener("height"))
        if height_goes:
            payloads.append(("height", binary.encode_height(result, **taken)))
        if result.contact and (changed or self.has_listener("cloud")):
            payloads.append(("cloud", binary.encode_cloud(result, **taken)))
        for stream, encode, grid in (
            ("shear", binary.encode_shear, result.shear_mm),
            ("sigma", binary.encode_sigma, result.sigma_mm),
        ):
            if grid is not None and (result.contact or changed) and self.has_listener(stream):
                payloads.append((stream, encode(result, **taken)))
        touch_ended = (
            result.touch is None
            and not result.contact
            and (changed or known_anew or self._has_touch)
        )
        self._has_touch = result.touch is not None
        if (self._has_touch or touch_ended) and self.has_listener("touch"):
            payloads.append(("touch", messages.encode_touch(result)))
        self._report_slips(result)
        sent_ns = self._contact_sent_ns
        waited = sent_ns is None or result.t_ns - sent_ns >= CONTACT_PERIOD_NS
        due = result.contact or known_anew or waited
        if changed or (due and self.has_listener("contact")):
            self._contact_sent_ns = result.t_ns
            payloads.append(("contact", messages.encode_contact(result, fps=self.fps)))
        # Settled here, since no `height` will settle it by its outcome.
        if not height_goes:
            without: FrameOutcome = "without_contact" if result.valid else "invalid"
            self.settle(result.seq, "unasked" if result.contact else without)
        for stream, payload in payloads:
            self.offer(stream, payload, result.seq)

    def _report_slips(self, result: Reconstruction) -> None:
        """Publish an event for each object that begins to slide, not for each frame in which it
        does.
        """
        sliding = {o.id: o for o in result.objects if o.slip is Slip.FULL}
        for began in sliding.keys() - self._sliding:
            self.publish_event("event/slip", messages.encode_slip(result, sliding[began]))
        self._sliding = frozenset(sliding)


# A shorter gap does not end a contact: single frames may miss a light touch.
BRIDGED_NS = 100_000_000
UPDATE_PERIOD_NS = 1_000_000_000


class ContactEvents(FrameObserver):
    """Publishes ``event/contact``: each contact's begin, its greatest values so far once a second,
    and its end. It requests nothing: values are those of frames that others need, at least one a
    second. A touch of unknown depth continues a contact, and begins one once it has lasted
    `BRIDGED_NS`.
    """

    def __init__(self, publish_event: Callable[[str, bytes], None]) -> None:
        self._publish_event = publish_event
        self._count = self._touched_ns = self._sent_ns = 0
        self._start_ns: int | None = None
        # Since when the depth of a touch is unknown.
        self._unmeasured_ns: int | None = None
        self._greatest: dict[str, Any] = {}

    def see(self, seen: FrameResult) -> None:
        frame, result = seen.frame, seen.reconstruction
        lasts = self._unmeasured_lasts(frame.t_ns, touched=result is not None and result.touched)
        if result is None or result.contact or lasts:
            self._touched_ns = frame.t_ns
            new = self._start_ns is None
            if new:
                self._start_ns = self._unmeasured_ns if lasts else frame.t_ns
                self._count, self._greatest = self._count + 1, {}
            if result is not None and result.contact:
                for name, value in messages.event_values(result).items():
                    self._greatest[name] = max(self._greatest.get(name, value), value)
            if new or frame.t_ns - self._sent_ns >= UPDATE_PERIOD_NS:
                self._send("new" if new else "update", frame)
        elif self._start_ns is not None and frame.t_ns - self._touched_ns >= BRIDGED_NS:
            self._send("end", frame, end_ns=self._touched_ns, ended_by=result)
            self._start_ns = None

    def _unmeasured_lasts(self, t_ns: int, *, touched: bool) -> bool:
        """Whether a touch of unknown depth counts as contact in this frame."""
        if not touched:
            self._unmeasured_ns = None
            return False
        if self._unmeasured_ns is None:
            self._unmeasured_ns = t_ns
        return self._start_ns is not None or t_ns - self._unmeasured_ns >= BRIDGED_NS

    def _send(
        self,
        type_: Literal["new", "update", "end"],
        frame: Frame,
        end_ns: int | None = None,
        ended_by: Reconstruction | None = None,
    ) -> None:
        self._sent_ns = frame.t_ns
        values = {
            **self._greatest,
            "t_ns": frame.t_ns,
            "wall_ns": frame.wall_ns,
            "start_ns": self._start_ns,
            "reason_code": code_of(None if ended_by is None else ended_by.reason),
        }
        event = ContactEvent(type=type_, id=self._count, end_ns=end_ns, **values)
        self._publish_event("event/contact", encode_json(event))


# This many periods without one good frame are a state, not an event.
UNUSABLE_PERIODS = 3


def delivered(counts: Counts) -> int:
    """Number of frames with a good outcome: sent, with nothing to send, or not requested."""
    return counts.published + counts.without_contact + counts.unasked


class HealthReport(FrameObserver):
    """The ``health`` message: how many frames arrived, their outcomes, and how fast,
    as means between two snapshots.

    `unusable` is why every frame of the last `UNUSABLE_PERIODS` periods was invalid, and whether
    the latest would be valid if it was not turned; None if one was good or none came.
    """

    def __init__(self, ledger: FrameLedger, timings: Timings) -> None:
        self._ledger = ledger
        self._timings = timings
        self._started_ns = self._last_ns = time.monotonic_ns()
        self._last = ledger.counts()
        self._unusable_periods = 0
        self._touched_frames = 0
        self._latest: Reconstruction | None = None
        self._seen: FrameResult | None = None
        self._turn_judged: int | None = None  # the calibration's CRC
        self.unusable: Reason | None = None

    def see(self, seen: FrameResult) -> None:
        self._latest = seen.reconstruction or self._latest
        self._seen = seen
        if seen.reconstruction is not None and seen.reconstruction.touched:
            self._touched_frames += 1

    def snapshot(self, source_dropped: int, mqtt: dict[str, int]) -> dict[str, Any]:
        """The message without the observers' reports; ``frames`` are all counted at one instant."""
        now_ns = time.monotonic_ns()
        counts, before = self._ledger.counts(), self._last
        # Two snapshots within one tick of the clock must not divide by zero.
        seconds = max(now_ns - self._last_ns, 1) / 1e9
        self._last, self._last_ns = counts, now_ns
        stages = self._timings.percentiles()
        latest = self._latest
        reason, degraded = (latest.reason, latest.degraded) if latest else (None, None)
        self._judge(before, counts, reason)
        self._warn_of_turn()
        return {
            "wall_ns": time.time_ns(),
            "uptime_s": round((now_ns - self._started_ns) / 1e9, 1),
            "frames": counts.as_dict(),
            "touched_frames": self._touched_frames,
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
        """Note whether frames come but none can be used;
        keep the first reason, so that it is published once.
        """
        # Without a calibration no frame can be valid, whatever the camera shows.
        if reason is not None and reason.code is ReasonCode.NOT_CALIBRATED:
            return
        if delivered(counts) > delivered(before):
            self._unusable_periods, self.unusable = 0, None
        elif counts.invalid > before.invalid:
            self._unusable_periods += 1
        if self._unusable_periods >= UNUSABLE_PERIODS and not self.unusable:
            self.unusable = reason or Reason(ReasonCode.NO_USABLE_FRAME, "no frame is usable")
            self._look_for_turn(self.unusable)

    def _look_for_turn(self, reason: Reason) -> None:
        """Add to why frames are refused how the latest would pass; once for each state."""
        seen = self._seen
        if seen is None or seen.calibration is None or seen.reconstruction is None:
            return
        if seen.reconstruction.reason is not None:
            profile, image = PROFILES[seen.reconstruction.profile], np.asarray(seen.frame.image)
            self.unusable = with_turn_of(reason, image, seen.calibration, profile)

    def _warn_of_turn(self) -> None:
        """Log that frames are used although they show the reference turned; the first frame of each
        calibration is judged.
        """
        seen = self._seen
        if seen is None or seen.calibration is None or seen.reconstruction is None:
            return
        known = seen.calibration
        if seen.reconstruction.reason is not None or known.crc32 == self._turn_judged:
            return
        self._turn_judged = known.crc32
        if turn := likelier_turn(to_grey(np.asarray(seen.frame.image)), known.reference_grey):
            found = "pictures fit the reference only %s: has the camera or a program done that?"
            _log.warning(found, turn)


WIDTH_PX = 320
ASPECT_MAX = 16
"""Greatest ratio of a picture's sides; a JPEG of some longer ones cannot be made."""


class Preview(FrameObserver):
    """The ``preview`` message: a small picture of what the camera sees; no frame twice.

    A picture with sides beyond `ASPECT_MAX` has none; the log says so once for each size.
    """

    def __init__(self, link: MqttLink) -> None:
        self._link = link
        self._refused: tuple[int, int] | None = None
        self._latest: Frame | None = None
        self._published: Frame | None = None

    def see(self, seen: FrameResult) -> None:
        self._latest = seen.frame

    def publish(self) -> None:
        """Publish the newest frame if somebody listens."""
        frame = self._latest
        if (
            frame is None
            or frame is self._published
            or not (self._link.connected and self._link.has_listener("preview"))
        ):
            return
        self._published = frame
        rows, cols = frame.image.shape[:2]
        if max(rows, cols) > ASPECT_MAX * min(rows, cols):
            self._refuse(rows, cols)
            return
        size = (WIDTH_PX, round(WIDTH_PX * rows / cols))
        _, jpeg = cv2.imencode(
            ".jpg", cv2.resize(np.asarray(frame.image), size, interpolation=cv2.INTER_AREA)
        )
        self._link.offer("preview", stamped(jpeg.tobytes(), frame.wall_ns), frame.seq)

    def _refuse(self, rows: int, cols: int) -> None:
        if self._refused != (rows, cols):
            self._refused = rows, cols
            found = "no preview of %dx%d px, expected no side over %d times as long as the other"
            _log.warning(found, cols, rows, ASPECT_MAX)
