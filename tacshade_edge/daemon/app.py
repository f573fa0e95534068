"""The daemon: the only module that wires source, reconstructor and broker together,
and the main thread's loop.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Literal

import cv2
import msgspec

from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import reference_file
from tacshade_edge.camera import sources
from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.daemon.active_profile import ActiveProfile, Step
from tacshade_edge.daemon.live_recorder import LiveRecorder
from tacshade_edge.daemon.named_files import check_files
from tacshade_edge.daemon.ongoing_recording import SOURCE_ENDED
from tacshade_edge.daemon.reference_in_use import References
from tacshade_edge.daemon.systemd import Service, notify, notify_reloading, notify_stopping
from tacshade_edge.daemon.taught_objects import ObjectEvents, TaughtObjects
from tacshade_edge.errors import ConfigError
from tacshade_edge.fixes import with_fix
from tacshade_edge.free_memory import return_free_memory, share_free_memory
from tacshade_edge.mqtt import links
from tacshade_edge.mqtt.outgoing import PayloadOutcome
from tacshade_edge.mqtt.publishing import (
    ContactEvents,
    HealthReport,
    HomeAssistant,
    Preview,
    Publisher,
)
from tacshade_edge.pipeline.ledger import FrameLedger, Timings
from tacshade_edge.pipeline.observer import (
    FRAMES_SENT_S,
    LINK_STOPPED_S,
    THREADS_STOPPED_S,
    FrameObserver,
    Reply,
    SourceState,
)
from tacshade_edge.pipeline.pipeline import Crash, Pipeline, crashes_to
from tacshade_edge.quoting import counted, shown
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.rigid import from_seven
from tacshade_edge.robot.ports import make_serial_port
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import AUTO, LADDER, PROFILES, profile_with
from tacshade_edge.settings import Document, digest, load
from tacshade_edge.types import Calibration
from tacshade_edge.version import installed_version
from tacshade_edge.wire import codec, messages, requests
from tacshade_edge.wire.requests import Request
from tacshade_edge.wire.results import ProfileChosen, RequestResult

if TYPE_CHECKING:
    from tacshade_edge.daemon.hand_process import FingerLine
    from tacshade_edge.robot.robot import Robot, SharedLine
    from tacshade_edge.stitching.session_worker import Sessions


_log = logging.getLogger(__name__)

HEALTH_PERIOD_S = 1.0
PREVIEW_PERIOD_S = 0.25
STALL_S = 3.0
EVENTS_MAX = 16


Event = Literal["stop", "reload", "recorded"] | Crash | SourceState | tuple[Request, Reply] | Step


class App:
    """One sensor's daemon; until `reload` finds a calibration,
    only the camera's picture is published.

    `hand_line` and `robot_line` lead to other processes of the daemon:
    to its hand, and to those that share a robot.
    """

    def __init__(
        self,
        document: Document,
        source: FrameSource,
        calibration: Calibration | Reason,
        hand_line: FingerLine | None = None,
        robot_line: SharedLine | None = None,
    ) -> None:
        settings = document.settings
        self._document = document
        # SimpleQueue: the one queue that a signal handler may put into.
        self._events: SimpleQueue[Event] = SimpleQueue()
        self._source = source
        self.ledger = FrameLedger()
        self.link = links.make_link(
            document, on_request=self._on_mqtt_request, on_outcome=self._on_outcome
        )
        sinks = (
            self.link.offer,
            self.link.publish_event,
            self.ledger.settle,
            self.link.has_listener,
        )
        self._publisher = Publisher(*sinks, always_shear=settings.shear == "always")
        self._home_assistant = HomeAssistant(
            self.link, settings.sensor_id, wanted=settings.mqtt.home_assistant
        )
        robot = self._make_robot(robot_line)
        self._recorder = LiveRecorder(
            partial(self.link.set_retained, "status/recorder"),
            partial(self._events.put, "recorded"),
            robot.with_interpolated_pose if robot else lambda frame: frame,
            settings.recorder.pre_roll_s,
        )
        self._references = References(
            calibration,
            reference_file.path_beside(settings.calibration),
            settings.sensor_id,
            self._use,
            self._publish_info,
            lambda: self._recorder.now() is not None,
            running=lambda: self._active.reconstructor,
        )
        known = self._references.calibration
        name = settings.profile if settings.profile in PROFILES else LADDER[-1]
        profile = profile_with(name, settings.outline)
        first = known if isinstance(known, Reason) else make_reconstructor(known, profile)
        self._active = ActiveProfile(
            first, settings.profile, settings.latency_budget_ms, settings.outline, self._events.put
        )
        self._sessions = self._make_sessions(robot)
        timings = Timings()
        self._health = HealthReport(self.ledger, timings)
        self._preview = Preview(self.link)
        # In the order in which they see a frame: sessions before publishing, since a subscriber
        # that sees a contact may begin one.
        parts: list[FrameObserver | None] = [
            self._sessions,
            self._publisher,
            ContactEvents(self.link.publish_event),
            ObjectEvents(
                self.link.publish_event, self.link.has_listener, robot.tell if robot else None
            ),
        ]
        parts += [
            self._health,
            self._preview,
            self._references,
            self._make_reporter(hand_line),
            robot,
        ]
        parts += [self._active, self._recorder]
        self._observers: tuple[FrameObserver, ...] = tuple(
            part for part in parts if part is not None
        )
        self._pipeline = Pipeline(
            source,
            lambda: self._active.reconstructor,
            self._observers,
            self.ledger,
            timings,
            self._events.put,
            robot.with_pose if robot else None,
        )
        self._service = Service(self._pipeline.grab, self._pipeline.reconstruct)
        self._camera = SourceState("away", Reason(ReasonCode.STARTING, "starting"))
        self._published_camera: SourceState | None = None
        self._published_limit: Reason | None = None
        self._latest_health: dict[str, Any] = {}
        self._refused_ns: int | None = None  # st_mtime_ns of a calibration's file
        self._taught = TaughtObjects(settings.calibration)

    def _make_robot(self, line: SharedLine | None) -> Robot | None:
        follows = line is not None and line.hears is not None
        port = None if follows else make_serial_port(self._document.settings.serial)
        if not port and not follows:
            return None
        from tacshade_edge.robot.robot import Robot  # imports pyserial

        publish = partial(self.link.set_retained, "status/serial")
        return Robot(port, self._on_request, self._status, publish, self._missing, line)

    def _make_sessions(self, robot: Robot | None) -> Sessions | None:
        settings = self._document.settings
        if not sources.frames_have_poses(settings):
            return None
        from tacshade_edge.stitching.session_worker import Sessions

        return Sessions(
            Path(settings.stitching.folder), settings.sensor_id, self.link.set_retained, robot
        )

    def _make_reporter(self, line: FingerLine | None) -> FrameObserver | None:
        if line is None or not (hand_T_sensor := self._document.settings.hand_T_sensor):
            return None
        from tacshade_edge.daemon.hand_process import FingerReporter

        return FingerReporter(line, from_seven(hand_T_sensor))

    def stop(self) -> None:
        """Make `run` end; any thread and a signal handler may call it."""
        self._events.put("stop")

    def reload(self) -> None:
        """Make `run` read the settings and the calibration again; callable like `stop`."""
        self._events.put("reload")

    def run(self) -> None:
        """Work until `stop` or the end of a finite source.

        Raises ConfigError, or what ended a thread.
        """
        # OpenCV's other threads spin between a frame's small images:
        # they take a third of its CPU time and save none.
        cv2.setNumThreads(1)
        share_free_memory()
        return_free_memory()
        with crashes_to(self._events.put):
            self._changed()
            self._publish_state()
            self.link.start()
            for observer in self._observers:
                observer.start()
            self._pipeline.start()
            notify("READY=1")
            self._loop()
            self._shut_down()

    def _loop(self) -> None:
        next_health_s = next_preview_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            if now_s >= next_health_s:
                next_health_s = now_s + HEALTH_PERIOD_S
                self._publish_health()
                self._look_for_calibration()
                if (known := self._taught.changed()) is not None:
                    self._references.know(known)
                self._service.tick(
                    self._published_camera or self._camera, self._latest_health["delivered_fps"]
                )
            if now_s >= next_preview_s:
                next_preview_s = now_s + PREVIEW_PERIOD_S
                self._preview.publish()
            self._publish_state()
            for observer in self._observers:
                observer.poll()
            try:
                event = self._events.get(
                    timeout=max(0.0, min(next_health_s, next_preview_s) - time.monotonic())
                )
            except Empty:
                continue
            if event == "stop":
                return
            if isinstance(event, Crash):
                event.error.add_note(f"in thread {event.thread}")
                raise event.error
            if isinstance(event, tuple):
                self._handle(*event)
            elif event == "reload":
                self._reload()
            elif isinstance(event, Step):
                if self._active.step(event):
                    self._changed()
            elif isinstance(event, SourceState):
                self._camera = event
                if event.state == "ended":
                    _log.info("the frame source has no more frames")
                    self._recorder.end(SOURCE_ENDED)
                    return

    def _reload(self) -> None:
        """Apply what the settings file says now; if it is bad, change nothing."""
        notify_reloading()
        try:
            document, calibration, waiting = reload(
                self._document, calibrated=self._missing() is None
            )
        except ConfigError as error:
            note: Reason | None = Reason(
                error.code, f"rejected the reload and kept the running settings: {error}"
            )
            _log.warning("%s", note)
            if self._missing():
                self._active.use(Reason(ReasonCode.NOT_CALIBRATED, f"not calibrated: {error}"))
                self._publish_info()
        else:
            self._document, settings = document, document.settings
            self._references.reload(calibration, reference_file.path_beside(settings.calibration))
            self._active.reload(
                settings.profile,
                settings.latency_budget_ms,
                settings.outline,
                self._references.calibration,
            )
            for observer in self._observers:
                observer.settings_changed(settings)
            self._recorder.event("reload", waiting=list(waiting))
            self._changed()
            text = f"restart the daemon to use the new {' and '.join(waiting)}"
            note = Reason(ReasonCode.RESTART, text) if waiting else None
            _log.info("reloaded%s", f"; {note}" if note else "")
        self._service.reloaded(note)

    def _missing(self) -> Reason | None:
        reconstructor = self._active.reconstructor
        return reconstructor if isinstance(reconstructor, Reason) else None

    def _look_for_calibration(self) -> None:
        """If there is no calibration, use one that has appeared;
        an unusable one is reported once.
        """
        if self._missing() is None:
            return
        try:
            written_ns = os.stat(self._document.settings.calibration).st_mtime_ns
        except OSError:
            return
        if written_ns != self._refused_ns:
            self._refused_ns = written_ns
            self._reload()

    def _shut_down(self) -> None:
        """Finish what is in progress, account for the rest, publish the end and disconnect."""
        began_s = time.monotonic()

        def left_s(due_s: float) -> float:
            return max(0.0, began_s + due_s - time.monotonic())

        notify_stopping()
        stops = [(THREADS_STOPPED_S, self._pipeline.stop), (FRAMES_SENT_S, self._give_up_frames)]
        stops += [(observer.stop_s, observer.stop) for observer in self._observers]
        for due_s, stop in sorted(stops, key=itemgetter(0)):
            stop(left_s(due_s))
        self._publish_health()
        self._publish_state(
            replace(self._camera, state="ended", reason=Reason(ReasonCode.STOPPED, "stopped"))
        )
        self.link.stop(left_s(LINK_STOPPED_S))
        _log.info("stopped: %s", self.ledger.counts().as_dict())

    def _give_up_frames(self, timeout_s: float) -> None:
        given_up = self.ledger.close(timeout_s)
        if given_up:
            _log.warning("stopped without sending %s still in progress", counted(given_up, "frame"))

    # Other threads call these: they count or enqueue and do nothing else.

    def _on_mqtt_request(self, request: Request) -> None:
        self._on_request(request, partial(self._reply, request))

    def _on_request(self, request: Request, reply: Reply) -> None:
        if self._events.qsize() >= EVENTS_MAX:
            reply(
                Reason(
                    ReasonCode.BUSY, f"busy: {EVENTS_MAX} requests are already waiting; try again"
                )
            )
        else:
            self._events.put((request, reply))

    def _reply(self, request: Request, outcome: RequestResult | Mapping[str, Any] | Reason) -> None:
        if isinstance(outcome, Reason):
            _log.info("rejected req/%s: %s", request.verb, outcome)
        self.link.reply(request, requests.encode_reply(request, outcome))

    def _on_outcome(self, stream: str, seq: int, outcome: PayloadOutcome) -> None:
        if stream == "height":
            self.ledger.settle(seq, "failed" if outcome == "refused" else outcome)

    # Requests, and changes of the reconstructor.

    def _handle(self, request: Request, reply: Reply) -> None:
        """Carry out a request; it gets exactly one reply, perhaps later."""
        running = self._active.reconstructor
        if request.verb == "status":
            reply(self._status())
        elif request.verb == "replay":  # only `replay --play` accepts it
            reply(Reason(ReasonCode.UNAVAILABLE, "this daemon is not playing a recording"))
        elif isinstance(running, Reason):
            reply(running)
        elif request.verb == "record":
            self._recorder.handle(
                request, reply, self._document.settings, running, self._camera_now()
            )
        elif request.verb == "profile":
            reply(self._choose_profile(request.profile))
        elif request.verb == "reference":
            self._references.handle(reply)
        elif self._sessions is not None:
            self._sessions.handle(request, reply)
        else:
            text = (
                "found no source of poses, expected `serial` in the settings or a recording with "
                "poses"
            )
            reply(Reason(ReasonCode.UNAVAILABLE, text))

    def _choose_profile(self, name: str) -> ProfileChosen | Reason:
        if name not in self._active.choices:
            expected = f"one of {', '.join(self._active.choices)}"
            if name == AUTO:
                expected += "; the settings give no latency budget"
            return Reason(
                ReasonCode.UNKNOWN_PROFILE, f"profile: found {shown(name, 60)}, expected {expected}"
            )
        self._active.choose(name)
        self._changed()
        _log.info("using profile %s", name)
        return ProfileChosen(self._active.name)

    def _use(self, calibration: Calibration) -> None:
        self._active.use(calibration)
        return_free_memory()
        self._changed()

    def _changed(self) -> None:
        """Record and publish that the reconstructor was replaced."""
        reconstructor = self._active.reconstructor
        if not isinstance(reconstructor, Reason):
            self._recorder.reconstructs_with(
                reconstructor.profile.name, reconstructor.calibration.crc32
            )
        self._publish_info()

    # Publishing.

    def _camera_now(self) -> SourceState:
        """The source's state, including what only the clock and the reconstruction show:
        a stall, unusable frames.
        """
        silent_s = (time.monotonic_ns() - self._pipeline.grab.last_frame_ns) / 1e9
        if self._camera.state == "streaming" and silent_s > STALL_S:
            stalled = Reason(ReasonCode.STALLED, f"no frame for more than {STALL_S:.0f} s")
            return SourceState("away", stalled, self._camera.details)
        unusable = self._missing() or self._health.unusable
        if self._camera.state == "streaming" and unusable:
            return SourceState("unusable", unusable, self._camera.details)
        return self._camera

    def _publish_state(self, state: SourceState | None = None) -> None:
        camera, limit = state or self._camera_now(), self.link.limited
        if camera == self._published_camera and limit == self._published_limit:
            return
        if camera != self._published_camera:
            self._published_camera = camera
            for observer in self._observers:
                observer.source_changed(camera)
            reason = camera.reason
            if (
                reason is None
                or reason.code is ReasonCode.STARTING
                or camera.state not in ("away", "unusable")
            ):
                _log.info("source %s%s", camera.state, f": {reason}" if reason else "")
            else:
                fix = sources.how_to_fix(self._document.settings.source, reason.code)
                _log.warning("source %s: %s", camera.state, with_fix(reason, fix))
            self.link.set_retained(
                "status/camera", messages.encode_status(camera.state, camera.reason, camera.details)
            )
        if limit != self._published_limit:
            self._published_limit = limit
            self.link.set_retained(
                "status/broker", messages.encode_status("limited" if limit else "connected", limit)
            )
        if camera.state != "ended":
            sound = camera.state == "streaming" and limit is None
            self.link.set_retained("state", b"online" if sound else b"degraded")

    def _publish_info(self) -> None:
        reconstructor = self._active.reconstructor
        info = messages.encode_info(
            version=installed_version(),
            config_digest=digest(self._document.settings),
            profile=self._active.name,
            calibration=reconstructor
            if isinstance(reconstructor, Reason)
            else reconstructor.calibration,
            profiles=self._active.choices,
            choice=self._active.choice,
            reference=self._references.info(),
            hand_id=self._document.settings.hand_id,
            hand_T_sensor=self._document.settings.hand_T_sensor,
        )
        self.link.set_retained("info", info)
        self._home_assistant.announce(self._active.choices)

    def _status(self) -> dict[str, Any]:
        """The latest ``health`` and the state, for ``req/status``."""
        camera = self._camera_now()
        return {
            "source": camera.state,
            **reason_fields(camera.reason),
            "health": self._latest_health,
        }

    def _publish_health(self) -> None:
        self._latest_health = {
            **self._health.snapshot(self._source.dropped, self.link.counters()),
            **{
                observer.health_key: observer.health()
                for observer in self._observers
                if observer.health_key
            },
        }
        self._active.log_late()
        self._publisher.fps = self._latest_health["delivered_fps"]
        self.link.set_retained("health", codec.encode_json(self._latest_health), qos=0)


# The source, the link and its topics, and the robot's line are made once.
RESTART_KEYS = ("sensor_id", "source", "mqtt", "serial", "stitching", "hand_id")


def reload(
    running: Document, *, calibrated: bool
) -> tuple[Document, Calibration | Reason, tuple[str, ...]]:
    """Read the settings and the calibration again; there must be one if there was (`calibrated`).

    The result has the running settings for every key in `RESTART_KEYS`, and names those that
    changed. Raises ConfigError.
    """
    new = load(running.path, running.settings.sensor_id if running.several else None)
    check_files(new)
    kept = {key: getattr(running.settings, key) for key in RESTART_KEYS}
    waiting = tuple(key for key, value in kept.items() if getattr(new.settings, key) != value)
    document = replace(new, settings=msgspec.structs.replace(new.settings, **kept))
    find = loading.load_calibration if calibrated else loading.find_calibration
    return document, find(document), waiting
