"""Runs every check in order; no other module knows them all.

Checks that may hang run in threads with a time limit: broker, serial ports, disk, clock, board and USB in parallel,
then the camera's node, its frames, and what is computed from them. All end within 20 s, whatever hangs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TypeVar

from tacshade_edge.doctor import calibration
from tacshade_edge.doctor.board import check_board
from tacshade_edge.doctor.broker import DaemonState, check_broker, judge_daemon
from tacshade_edge.doctor.bundle import Seen
from tacshade_edge.doctor.camera import check_csi, check_device, check_frames, check_other_source, list_cameras
from tacshade_edge.doctor.capture import Captured, capture
from tacshade_edge.doctor.clock import check_clock
from tacshade_edge.doctor.disk import check_disk
from tacshade_edge.doctor.finding import Finding, fault
from tacshade_edge.doctor.limits import start, wait_for
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.doctor.serial import check_serial
from tacshade_edge.doctor.settings import check_settings
from tacshade_edge.doctor.usb import check_usb
from tacshade_edge.factories import links, sources
from tacshade_edge.settings import Document, Rpicam, Source, V4l2, load_all

T = TypeVar("T")
Findings = tuple[Finding, ...]

MACHINE_S, NODE_S, CSI_S, CAPTURE_S, JUDGE_S = 7.0, 2.0, 3.0, 7.0, 3.0
_STATE_FOLDER = Path("/var/lib/tacshade-edge")
_REPLUG = "unplug the camera and plug it in again; if the problem remains, reboot"
_AGAIN = "run it again; if nothing changes, reboot; then report it with this line"


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
