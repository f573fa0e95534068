"""Runs every check in order, those that may hang in threads;
all end within 20 s, whatever hangs.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from pathlib import Path

from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import ageing_file
from tacshade_edge.camera.sources import make_source
from tacshade_edge.doctor import Finding, Findings, calibration_check, fault, ok
from tacshade_edge.doctor.ageing_check import check_ageing
from tacshade_edge.doctor.board import check_board, check_clock, check_disk
from tacshade_edge.doctor.broker_check import check_broker, judge_daemon
from tacshade_edge.doctor.bundle import Seen
from tacshade_edge.doctor.camera_check import (
    capture,
    check_device,
    check_frames,
    check_other_source,
    list_cameras,
)
from tacshade_edge.doctor.machine import AS_SERVICE, Machine
from tacshade_edge.doctor.package_check import check_packages
from tacshade_edge.doctor.port_checks import check_serial, check_usb
from tacshade_edge.errors import ConfigError
from tacshade_edge.mqtt import links
from tacshade_edge.regular_files import open_regular
from tacshade_edge.settings import Document, Source, V4l2, load, load_all

MACHINE_S, NODE_S, CAPTURE_S, JUDGE_S = 7.0, 3.0, 7.0, 3.0
_STATE_FOLDER = Path("/var/lib/tacshade-edge")
_REPLUG = "unplug the camera and plug it in again; if the problem remains, reboot"
_AGAIN = "run it again; if nothing changes, reboot; then report it with this line"
SETTINGS = "settings"
_UNTIL = "until then, doctor does not check {}"


def diagnose(
    config: Path, machine: Machine, seen: Seen | None = None, sensor_id: str | None = None
) -> Iterator[Finding]:
    """Yield each finding as soon as it is known, the settings' first,
    and fill `seen` with the data.
    """
    finding, document, broker_usable = check_settings(config, sensor_id)
    yield finding
    seen = Seen() if seen is None else seen
    seen.document = document
    settings = document.settings if document else None
    # Where the daemon writes; without settings, where it would.
    folder = Path(settings.calibration).parent if settings else _STATE_FOLDER
    robot = (settings.serial.device if settings.serial else None) if settings else ""
    checks: list[tuple[str, str, Callable[[], Findings]]] = [
        ("serial", _AGAIN, lambda: check_serial(machine, robot)),
        ("disk", _AGAIN, lambda: check_disk(folder)),
        ("clock", _AGAIN, check_clock),
        ("board", _AGAIN, lambda: check_board(machine)),
        ("usb", _AGAIN, lambda: check_usb(_cameras(document), machine)),
        ("packages", _AGAIN, check_packages),
    ]
    if document and broker_usable:
        fix = "check mqtt.host, the network and the name server"
        # First, because what a daemon publishes explains what holds the camera.
        checks.insert(0, ("broker", fix, lambda: _check_broker(document, machine, seen)))
    deadline_s = time.monotonic() + MACHINE_S
    # All at once: each may hang in a driver or a name server, and their limits would add up.
    running = [(start(job), name, fix) for name, fix, job in checks]
    for each in running:
        yield from wait_for(*each, deadline_s)
    if document is None:
        yield from _limited("camera", _AGAIN, NODE_S, lambda: (list_cameras(machine),))
        return
    found = list(_limited("camera", _REPLUG, NODE_S, lambda: _check_camera(document, machine)))
    yield from found
    # A driver may hang on a node that is no camera.
    if not any(finding.state == "fault" for finding in found):
        yield from _limited(
            "camera frames", _REPLUG, CAPTURE_S, lambda: _check_frames(document, machine, seen)
        )
    yield from _limited("calibration", _AGAIN, JUDGE_S, lambda: _check_calibration(document, seen))


def _cameras(document: Document | None) -> list[V4l2]:
    """Return the V4L2 sources of all sensors in the settings file:
    they share the machine's ports.
    """
    documents = (
        () if document is None else load_all(document.path) if document.several else (document,)
    )
    found = [sized_source(other) for other in documents]
    return [source for source in found if isinstance(source, V4l2)]


def sized_source(document: Document) -> Source:
    """The source of the settings, with the size that the daemon requests of a camera."""
    source = document.settings.source
    # The calibration is read only for a size that the settings do not state.
    return source if source.sized() is source else source.sized(loading.image_size_px(document))


def _check_camera(document: Document, machine: Machine) -> Findings:
    source = document.settings.source
    if isinstance(source, V4l2):
        return check_device(source, machine)
    return source.inspect()


def _check_frames(document: Document, machine: Machine, seen: Seen) -> Findings:
    source = sized_source(document)
    captured = seen.captured = capture(make_source(source))
    if not source.is_camera:
        return check_other_source(captured, source.fps)
    silent = "nothing, it is not on this broker" if machine.daemon() else ""
    return check_frames(
        source, captured, machine, str(seen.daemon) if seen.daemon.alive else silent
    )


def _check_calibration(document: Document, seen: Seen) -> Findings:
    known, findings = calibration_check.load(document)
    if known is None:
        return findings
    history = ageing_file.path_beside(document.settings.calibration)
    findings = (*findings, *check_ageing(history, known))
    if not seen.captured.images:
        return findings
    is_camera = document.settings.source.is_camera
    return (*findings, *calibration_check.check_images(known, seen.captured.images, live=is_camera))


def _check_broker(document: Document, machine: Machine, seen: Seen) -> Findings:
    sensor_id = document.settings.sensor_id
    findings, seen.daemon = check_broker(links.broker_address(document), sensor_id)
    if any(finding.state == "fault" for finding in findings):
        return findings
    return (*findings, judge_daemon(seen.daemon, machine.daemon(seen.daemon.pid), sensor_id))


def check_settings(
    config: Path, sensor_id: str | None = None
) -> tuple[Finding, Document | None, bool]:
    """Read the settings, None if unusable; the last value is whether those
    of the broker are usable.
    """
    try:
        document = load(config, sensor_id)
    except ConfigError as error:
        until = _UNTIL.format("the configured camera, the calibration or the broker")
        more = (
            f" (and {len(error.others)} more: tacshade-edge check-config {config})"
            if error.others
            else ""
        )
        return fault(SETTINGS, f"{error}{more}", f"{_fix(config)}; {until}"), None, False
    try:
        links.check_link(document)
    except ConfigError as error:
        return (
            fault(SETTINGS, str(error), f"fix that line; {_UNTIL.format('the broker')}"),
            document,
            False,
        )
    return ok(SETTINGS, f"{config}, sensor {document.settings.sensor_id}"), document, True


def _fix(config: Path) -> str:
    try:
        open_regular(config, sys.maxsize).close()
    except PermissionError:
        return f"run doctor with sudo, or as the service's user: {AS_SERVICE}"
    except OSError:
        by_capture = (
            "tacshade-edge capture DIR writes settings for this camera; pass them as --config "
            "DIR/config.yaml"
        )
        return f"{by_capture}, or copy config/default.yaml to {config}"
    return "fix that line (config/default.yaml explains every key)"


def start(job: Callable[[], Findings]) -> Future[Findings]:
    """Run a check in a thread that does not keep the process alive."""
    future: Future[Findings] = Future()

    def work() -> None:
        try:
            future.set_result(job())
        # A defect of one check must not hide what the others found.
        except Exception as error:  # noqa: BLE001
            future.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return future


def wait_for(future: Future[Findings], check: str, fix: str, deadline_s: float) -> Findings:
    """Return what the check found, or a fault if it broke or did not end by `deadline_s`
    (``time.monotonic``).
    """
    try:
        error = future.exception(max(0.0, deadline_s - time.monotonic()))
    except FutureTimeoutError:
        return (fault(check, "no answer in time", fix),)
    if error is None:
        return future.result()
    return (fault(check, f"the check itself failed: {type(error).__name__}: {error}", fix),)


def _limited(check: str, fix: str, limit_s: float, job: Callable[[], Findings]) -> Findings:
    return wait_for(start(job), check, fix, time.monotonic() + limit_s)
