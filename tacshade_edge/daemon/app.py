"""The daemon: the only module that wires source, reconstructor and broker together,
and the main thread's loop.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from operator import itemgetter
from queue import Empty
from typing import TYPE_CHECKING, Any

import cv2

from tacshade_edge.calibration.files import reference_file
from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.daemon import parts
from tacshade_edge.daemon.active_profile import Step
from tacshade_edge.daemon.events import Event, Events
from tacshade_edge.daemon.ongoing_recording import SOURCE_ENDED
from tacshade_edge.daemon.reference_in_use import References
from tacshade_edge.daemon.reloading import CalibrationWatch, reload
from tacshade_edge.daemon.request_handling import RequestHandler
from tacshade_edge.daemon.sensor_state import SensorState, encoded_info
from tacshade_edge.daemon.systemd import Service, notify, notify_reloading, notify_stopping
from tacshade_edge.daemon.taught_objects import ObjectEvents, TaughtObjects
from tacshade_edge.errors import ConfigError
from tacshade_edge.free_memory import return_free_memory, share_free_memory
from tacshade_edge.mqtt import links
from tacshade_edge.mqtt.home_assistant import HomeAssistant
from tacshade_edge.mqtt.outgoing import PayloadOutcome
from tacshade_edge.mqtt.publishing import ContactEvents, HealthReport, Preview
from tacshade_edge.pipeline.ledger import FrameLedger, Timings
from tacshade_edge.pipeline.observer import (
    FRAMES_SENT_S,
    LINK_STOPPED_S,
    THREADS_STOPPED_S,
    FrameObserver,
    SourceState,
)
from tacshade_edge.pipeline.pipeline import Crash, Pipeline, crashes_to
from tacshade_edge.quoting import counted
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.settings import Document
from tacshade_edge.types import Calibration
from tacshade_edge.wire import codec, requests
from tacshade_edge.wire.requests import Request
from tacshade_edge.wire.results import RequestResult

if TYPE_CHECKING:
    from tacshade_edge.daemon.hand_process import FingerLine
    from tacshade_edge.robot.robot import SharedLine
    from tacshade_edge.sensor.reconstruct import Reconstructor

_log = logging.getLogger(__name__)

HEALTH_PERIOD_S = 1.0
PREVIEW_PERIOD_S = 0.25
CONNECT_S = 1.0
"""The first frame waits so long for the broker at most: three times what an unknown name takes."""


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
        self._events = Events()
        self._source = source
        self.ledger = FrameLedger()
        self.link = links.make_link(
            document, on_request=self._on_mqtt_request, on_outcome=self._on_outcome
        )
        self._home_assistant = HomeAssistant(
            self.link, settings.sensor_id, wanted=settings.mqtt.home_assistant
        )
        self._running: Callable[[], Reconstructor | Reason] = lambda: self.active.reconstructor
        self._robot = parts.make_robot(
            settings, self._events.request, self._status, self.link, self._running, robot_line
        )
        self._recorder = parts.make_recorder(
            settings, self.link, self._robot, partial(self._events.put, "recorded")
        )
        self._references = self._make_references(calibration)
        self.active = parts.make_active(settings, self._references.calibration, self._events.put)
        # After the robot, to which they connect themselves.
        self._sessions = parts.make_sessions(settings, self.link, self._robot)
        self._publisher = parts.make_publisher(settings, self.link, self.ledger)
        timings = Timings()
        self._health = HealthReport(self.ledger, timings)
        self._preview = Preview(self.link)
        self._observers = self._in_order(parts.make_reporter(settings, hand_line))
        self._pipeline = Pipeline(
            source,
            self._running,
            self._observers,
            self.ledger,
            timings,
            self._events.put,
            self._robot.with_pose if self._robot else None,
        )
        self._service = Service(self._pipeline.grab, self._pipeline.reconstruct)
        self._state = self._make_state()
        self._requests = self._make_requests()
        self._latest_health: dict[str, Any] = {}
        self._calibration_watch = CalibrationWatch()
        self._taught = TaughtObjects(settings.calibration)

    # The parts, each from those before it in `__init__`.

    def _make_references(self, calibration: Calibration | Reason) -> References:
        settings = self._document.settings
        return References(
            calibration,
            reference_file.path_beside(settings.calibration),
            settings.sensor_id,
            self._use,
            self._publish_info,
            lambda: self._recorder.now() is not None,
            running=self._running,
        )

    def _in_order(self, reporter: FrameObserver | None) -> tuple[FrameObserver, ...]:
        """All that see a frame, in this order: sessions before publishing, since a subscriber that
        sees a contact may begin one.
        """
        publish, robot = self.link.publish_event, self._robot
        names = ObjectEvents(publish, self.link.has_listener, robot.tell if robot else None)
        observers: tuple[FrameObserver | None, ...] = (
            self._sessions,
            self._publisher,
            ContactEvents(publish),
            names,
            self._health,
            self._preview,
            self._references,
            reporter,
            robot,
            self.active,
            self._recorder,
        )
        return tuple(each for each in observers if each is not None)

    def _make_state(self) -> SensorState:
        return SensorState(
            self.link,
            self._document.settings.source,
            lambda: self._pipeline.grab.last_frame_ns,
            lambda: self._missing() or self._health.unusable,
            self._source_changed,
        )

    def _make_requests(self) -> RequestHandler:
        return RequestHandler(
            self.active,
            self._recorder,
            self._references,
            self._sessions,
            settings=lambda: self._document.settings,
            source=self._state.now,
            status=self._status,
            changed=self._changed,
        )

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
            # Before the link starts: what is retained waits for the connection, so that a client
            # never sees the state of an earlier run as this one's.
            self._changed()
            self._state.publish()
            self.link.start()
            for observer in self._observers:
                observer.start()
            # Maps of frames that came before the first connection would only replace each other.
            self.link.wait_until_settled(CONNECT_S)
            # Last: what consumes frames is there before what makes them.
            self._pipeline.start()
            notify("READY=1")
            self._loop()
            self._shut_down()

    def _loop(self) -> None:
        # One loop for all that is not urgent. Events wake it; between them, it sleeps until the
        # next message is due.
        next_health_s = next_preview_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            if now_s >= next_health_s:
                next_health_s = now_s + HEALTH_PERIOD_S
                self._every_second()
            if now_s >= next_preview_s:
                next_preview_s = now_s + PREVIEW_PERIOD_S
                self._preview.publish()
            self._state.publish()
            for observer in self._observers:
                observer.poll()
            try:
                event = self._events.get(min(next_health_s, next_preview_s) - time.monotonic())
            except Empty:
                continue
            if not self._react(event):
                return

    def _every_second(self) -> None:
        self._publish_health()
        self._look_for_calibration()
        if (known := self._taught.changed()) is not None:
            self._references.know(known)
        published = self._state.published or self._state.source
        self._service.tick(published, self._latest_health["delivered_fps"])

    def _react(self, event: Event) -> bool:
        """Do what an event demands; return whether to go on."""
        if isinstance(event, Crash):
            event.error.add_note(f"in thread {event.thread}")
            raise event.error
        if isinstance(event, tuple):
            self._requests.handle(*event)
        elif event == "reload":
            self._reload()
        elif isinstance(event, Step):
            if self.active.step(event):
                self._changed()
        elif isinstance(event, SourceState):
            self._state.source = event
            if event.state == "ended":
                _log.info("the frame source has no more frames")
                self._recorder.end(SOURCE_ENDED)
                return False
        return event != "stop"

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
                # Without one that runs, the reason of every frame is why this file cannot be
                # used.
                self.active.use(Reason(ReasonCode.NOT_CALIBRATED, f"not calibrated: {error}"))
                self._publish_info()
        else:
            self._document, settings = document, document.settings
            # References first, since they may use another calibration than the file's; then the
            # reconstructor; then those that only take note.
            self._references.reload(calibration, reference_file.path_beside(settings.calibration))
            self.active.reload(
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
        reconstructor = self.active.reconstructor
        return reconstructor if isinstance(reconstructor, Reason) else None

    def _look_for_calibration(self) -> None:
        """Use a calibration that has appeared; an unusable one is reported once."""
        path = self._document.settings.calibration
        if self._missing() is not None and self._calibration_watch.written(path):
            self._reload()

    def _shut_down(self) -> None:
        """Finish what is in progress, account for the rest, publish the end and disconnect."""
        began_s = time.monotonic()

        def left_s(due_s: float) -> float:
            return max(0.0, began_s + due_s - time.monotonic())

        notify_stopping()
        self._events.close()
        stops = [(THREADS_STOPPED_S, self._pipeline.stop), (FRAMES_SENT_S, self._give_up_frames)]
        stops += [(observer.stop_s, observer.stop) for observer in self._observers]
        # By their deadlines, which follow the way of a frame: first what makes frames, then what
        # carries them on, then the robot's line and last the link, which send the end of all.
        for due_s, stop in sorted(stops, key=itemgetter(0)):
            stop(left_s(due_s))
        # After the ledger was closed: the last message proves that no frame is pending.
        self._publish_health()
        stopped = Reason(ReasonCode.STOPPED, "stopped")
        self._state.publish(replace(self._state.source, state="ended", reason=stopped))
        self.link.stop(left_s(LINK_STOPPED_S))
        _log.info("stopped: %s", self.ledger.counts().as_dict())

    def _give_up_frames(self, timeout_s: float) -> None:
        given_up = self.ledger.close(timeout_s)
        if given_up:
            _log.warning("stopped without sending %s still in progress", counted(given_up, "frame"))

    # Other threads call these: they count or enqueue and do nothing else.

    def _on_mqtt_request(self, request: Request) -> None:
        self._events.request(request, partial(self._reply, request))

    def _reply(self, request: Request, outcome: RequestResult | Mapping[str, Any] | Reason) -> None:
        if isinstance(outcome, Reason):
            _log.info("rejected req/%s: %s", request.verb, outcome)
        self.link.reply(request, requests.encode_reply(request, outcome))

    def _on_outcome(self, stream: str, seq: int, outcome: PayloadOutcome) -> None:
        # Other streams are extras; a frame's outcome is that of its height.
        if stream == "height":
            self.ledger.settle(seq, "failed" if outcome == "refused" else outcome)

    def _use(self, calibration: Calibration) -> None:
        self.active.use(calibration)
        # Judging the images of a reference leaves 7 MB of freed heap, which the service's limit of
        # memory would count.
        return_free_memory()
        self._changed()

    def _changed(self) -> None:
        """Record and publish that the reconstructor was replaced."""
        reconstructor = self.active.reconstructor
        if not isinstance(reconstructor, Reason):
            self._recorder.reconstructs_with(
                reconstructor.profile.name, reconstructor.calibration.crc32
            )
        self._publish_info()

    def _source_changed(self, state: SourceState) -> None:
        for observer in self._observers:
            observer.source_changed(state)

    def _publish_info(self) -> None:
        settings, reference = self._document.settings, self._references.info()
        info = encoded_info(settings, self.active, reference)
        self.link.set_retained("info", info)
        self._home_assistant.announce(self.active.choices)

    def _status(self) -> dict[str, Any]:
        """The latest ``health`` and the state, for ``req/status``."""
        camera = self._state.now()
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
        self.active.log_late()
        self._publisher.fps = self._latest_health["delivered_fps"]
        self.link.set_retained("health", codec.encode_json(self._latest_health), qos=0)
