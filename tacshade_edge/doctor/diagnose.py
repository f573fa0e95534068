"""Runs every check in order; no other module knows them all.

Checks that may hang run in threads with a time limit: broker, serial ports, disk, clock, board and USB in parallel,
then the camera's node, its frames, and what is computed from them. All end within 20 s, whatever hangs.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from functools import partial
from pathlib import Path
from typing import TypeVar

from tacshade_edge.doctor import Finding, calibration, fault, ok
from tacshade_edge.doctor.board import check_board, check_clock, check_disk
from tacshade_edge.doctor.broker import DaemonState, check_broker, judge_daemon
from tacshade_edge.doctor.bundle import Seen
from tacshade_edge.doctor.camera import (
    Captured,
    capture,
    check_csi,
    check_device,
    check_frames,
    check_other_source,
    list_cameras,
)
from tacshade_edge.doctor.machine import AS_SERVICE, Machine
from tacshade_edge.doctor.ports import check_serial, check_usb
from tacshade_edge.errors import ConfigError
from tacshade_edge.factories import links, sources
from tacshade_edge.regular_files import open_regular
from tacshade_edge.settings import Document, Rpicam, Source, V4l2, load, load_all

T = TypeVar("T")
Findings = tuple[Finding, ...]

MACHINE_S, NODE_S, CSI_S, CAPTURE_S, JUDGE_S = 7.0, 2.0, 3.0, 7.0, 3.0
_STATE_FOLDER = Path("/var/lib/tacshade-edge")
_REPLUG = "unplug the camera and plug it in again; if the problem remains, reboot"
_AGAIN = "run it again; if nothing changes, reboot; then report it with this line"
SETTINGS = "settings"
_UNTIL = "until then, doctor does not check {}"


def diagnose(
    config: Path, machine: Machine, seen: Seen | None = None, sensor_id: str | None = None
) -> Iterator[Finding]:
    """Run all checks that are possible; yield each finding as soon as it is known, and fill `seen` with the data.

    The first finding is on the settings file; the checks that need no settings also run without them.
    """
    finding, document, broker_usable = check_settings(config, sensor_id)
    yield finding
    seen = Seen() if seen is None else seen
    seen.document = document
    settings = document.settings if document else None
    deadline_s = time.monotonic() + MACHINE_S
    folder = Path(settings.calibration).parent if settings else _STATE_FOLDER
    robot = (settings.serial.device if settings.serial else None) if settings else ""
    parts: dict[str, Callable[[], Findings]] = {
        "serial": lambda: check_serial(machine, robot),
        "disk": lambda: check_disk(folder, machine),
        "clock": check_clock,
        "board": lambda: check_board(machine),
        "usb": lambda: check_usb(_cameras(document), machine),
    }
    broker = start(lambda: _ask_broker(document, machine)) if document and broker_usable else None
    running = {name: start(check) for name, check in parts.items()}
    daemon = DaemonState()
    if broker:
        findings, daemon = wait_for(broker, deadline_s, _no_broker)
        seen.published = daemon.published
        yield from findings
    for name, check in running.items():
        yield from wait_for(check, deadline_s, _failed(name, _AGAIN))
    if document is None:
        yield from _limited(lambda: (list_cameras(machine),), NODE_S, _failed("camera", _AGAIN))
    else:
        yield from _sensor(document, daemon, machine, seen)


def _cameras(document: Document | None) -> list[V4l2]:
    """Return the V4L2 sources of all sensors in the settings file: they share the machine's ports."""
    documents = () if document is None else load_all(document.path) if document.several else (document,)
    return [other.settings.source for other in documents if isinstance(other.settings.source, V4l2)]


def _sensor(document: Document, daemon: DaemonState, machine: Machine, seen: Seen) -> Iterator[Finding]:
    """Check the source, and its frames against the calibration."""
    source = document.settings.source
    found: Findings = ()
    if isinstance(source, V4l2):
        found = _limited(partial(check_device, source, machine), NODE_S, _failed("camera", _REPLUG))
        yield from found
    elif isinstance(source, Rpicam):
        found = _limited(partial(check_csi, source), CSI_S, _failed("camera", _AGAIN))
        yield from found
    captured = Captured()
    if not any(finding.state == "fault" for finding in found):
        captured, found = _limited(lambda: _watch(source, daemon, machine), CAPTURE_S, _no_frames)
        seen.image = captured.images[-1] if captured.images else None
        yield from found
    yield from _limited(lambda: _judge(document, captured), JUDGE_S, _failed("calibration", _AGAIN))


def _watch(source: Source, daemon: DaemonState, machine: Machine) -> tuple[Captured, Findings]:
    captured = capture(sources.make_source(source))
    if not isinstance(source, V4l2 | Rpicam):
        return captured, check_other_source(captured, source.fps)
    silent = "nothing, it is not on this broker" if machine.daemon() else ""
    return captured, check_frames(source, captured, machine, str(daemon) if daemon.alive else silent)


def _judge(document: Document, captured: Captured) -> Findings:
    known, findings = calibration.load(document)
    if known is None or not captured.images:
        return findings
    camera = isinstance(document.settings.source, V4l2 | Rpicam)
    return (*findings, *calibration.check_images(known, captured.images, camera))


def _ask_broker(document: Document, machine: Machine) -> tuple[Findings, DaemonState]:
    sensor_id = document.settings.sensor_id
    findings, daemon = check_broker(links.broker_address(document), sensor_id)
    if any(finding.state == "fault" for finding in findings):
        return findings, daemon
    return (*findings, judge_daemon(daemon, machine.daemon(), sensor_id)), daemon


def _no_broker(why: str) -> tuple[Findings, DaemonState]:
    fix = "check mqtt.host, the network and the name server"
    return (fault("broker", why, fix),), DaemonState()


def _no_frames(why: str) -> tuple[Captured, Findings]:
    return Captured(), (fault("camera frames", why, _REPLUG),)


def _failed(check: str, fix: str) -> Callable[[str], Findings]:
    return lambda why: (fault(check, why, fix),)


def _limited(job: Callable[[], T], limit_s: float, failed: Callable[[str], T]) -> T:
    return wait_for(start(job), time.monotonic() + limit_s, failed)


def check_settings(config: Path, sensor_id: str | None = None) -> tuple[Finding, Document | None, bool]:
    """Read the settings, those of one sensor if the file has several; None if they are unusable.

    The last value is whether the broker's settings are usable, including its password and certificate files.
    """
    try:
        document = load(config, sensor_id)
    except ConfigError as error:
        until = _UNTIL.format("the configured camera, the calibration or the broker")
        more = f" (and {len(error.others)} more: tacshade-edge check-config {config})" if error.others else ""
        return fault(SETTINGS, f"{error}{more}", f"{_fix(config)}; {until}"), None, False
    try:
        links.check_broker_files(document)
        links.make_link(document, on_request=lambda _: None, on_outcome=lambda *_: None)
    except ConfigError as error:
        return fault(SETTINGS, str(error), f"fix that line; {_UNTIL.format('the broker')}"), document, False
    return ok(SETTINGS, f"{config}, sensor {document.settings.sensor_id}"), document, True


def _fix(config: Path) -> str:
    try:
        open_regular(config, sys.maxsize).close()
    except PermissionError:
        return f"run doctor with sudo, or as the service's user: {AS_SERVICE}"
    except OSError:
        by_capture = "tacshade-edge capture DIR writes settings for this camera; pass them as --config DIR/config.yaml"
        return f"{by_capture}, or copy config/default.yaml to {config}"
    return "fix that line (config/default.yaml explains every key)"


def start(job: Callable[[], T]) -> Future[T]:
    """Run a job in a thread that does not keep the process alive."""
    future: Future[T] = Future()

    def work() -> None:
        try:
            future.set_result(job())
        except Exception as error:  # noqa: BLE001 (a defect of one check must not hide what the others found)
            future.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return future


def wait_for(future: Future[T], deadline_s: float, failed: Callable[[str], T]) -> T:
    """Return the job's result, or ``failed(why)`` if it raised or did not end by `deadline_s` (``time.monotonic``)."""
    try:
        error = future.exception(max(0.0, deadline_s - time.monotonic()))
    except FutureTimeoutError:
        return failed("no answer in time")
    return future.result() if error is None else failed(f"the check itself failed: {type(error).__name__}: {error}")
