"""Checks the camera: its node and names, the modes it offers, and the frames that it delivers."""

from __future__ import annotations

import contextlib
import os
import time
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from tacshade_edge.camera import v4l2_node
from tacshade_edge.camera.csi_camera import csi_cameras
from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.camera.v4l2_node import AUTOMATICS, Lock
from tacshade_edge.doctor import Finding, Findings, fault, ok, warning
from tacshade_edge.doctor.machine import Machine, may_use, permission_fix
from tacshade_edge.errors import DeviceError, TacshadeError
from tacshade_edge.fixes import OF_FRAMES
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.frame_check import PictureJudge, first_reason
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.settings import Source, V4l2
from tacshade_edge.types import U8, Disc

_FOURCCS = ("MJPG", "YUYV", "NV12", "GREY")
# 29.97 is 30, and a frame may be missing at either end.
_RATE_PART = 0.9
_RATE_FRAMES = 10  # of fewer, a single late one decides
# The start of a stream may cost a frame.
_LOST_PART = 0.05
_AGE_MAX_S = 0.5
_STOP = (
    "to check the camera itself, stop the daemon (sudo systemctl stop tacshade-edge) and start it "
    "again afterwards"
)
_CONNECT = "is the camera connected? sudo dmesg shows what the kernel saw"
_BUSY_MACHINE = "stop whatever else is keeping this machine busy, or lower source.fps"
# Best first. This project's udev rules add the names by USB port in /dev/tacshade.
_NAMES = ("/dev/v4l/by-id", "/dev/tacshade", "/dev/v4l/by-path")
# A Raspberry Pi's own nodes: its CSI receivers,
# and those that every Pi has with or without a camera.
_CSI_RECEIVERS = ("unicam", "rp1-cfe")
_OWN_NODES = (*_CSI_RECEIVERS, "bcm2835-isp", "bcm2835-codec", "pispbe", "rpi-hevc-dec", "rpivid")
CSI_FIX = (
    "a Raspberry Pi's own (CSI, ribbon cable) camera is read through rpicam-vid: "
    "set source: {kind: rpicam, camera: 0}"
)
FRAMES = 30
LIMIT_S = 3.0
# The last ones, because a camera may still be settling during the first.
_IMAGES_KEPT = 10
_SETTLING = 5


def list_cameras(machine: Machine) -> Finding:
    """List the machine's cameras if no settings name one."""
    cameras = [_labelled(name, machine) for name in found_cameras(machine)]
    cameras += [
        f"{{kind: rpicam, camera: {number}}} ({name})" for number, name in csi_cameras().items()
    ]
    if cameras:
        return ok("camera", f"found {', '.join(cameras)}")
    return warning("camera", "found no USB camera on this machine", _choose(machine))


def check_device(source: V4l2, machine: Machine) -> Findings:
    """Check that the configured node exists, is a usable camera and has a stable name;
    a fault rules out frames.
    """
    device = source.device
    path, name = machine.at(device), card_name(device, machine)
    if not path.exists():
        return (fault("camera", f"{device}: no such device", _choose(machine)),)
    if name.startswith(_OWN_NODES):
        return (
            fault(
                "camera", f"{device}: this node belongs to the Raspberry Pi's own {name}", CSI_FIX
            ),
        )
    if not may_use(path) and not path.is_dir():
        return (
            fault("camera", f"{device}: no permission to open it", permission_fix(path, "video")),
        )
    try:
        card = v4l2_node.check_node(str(path))
    except TacshadeError as error:
        return (fault("camera", str(error).removeprefix("camera "), _choose(machine)),)
    findings = [ok("camera", f"{device}: {card}")]
    stable = stable_name(device, machine)
    # The kernel numbers nodes in the order in which cameras answer.
    if stable and not device.startswith(("/dev/v4l/", "/dev/tacshade/")):
        found = f"{device} may name a different camera after you plug cameras in again"
        findings.append(warning("camera name", found, f"set source.device: {stable}"))
    return (*findings, _check_format(source, str(path)))


def _check_format(source: V4l2, node: str) -> Finding:
    """Check that the driver lists the configured format;
    the frames show whether it offers size and rate.
    """
    try:
        formats = v4l2_node.formats(node)
    except DeviceError as error:
        return fault(
            "camera format",
            str(error).removeprefix("camera "),
            "unplug the camera and plug it in again",
        )
    if source.fourcc in formats:
        return ok("camera format", source.fourcc)
    usable = [code for code in _FOURCCS if code in formats]
    fix = f"set source.fourcc: {' or '.join(usable)}" if usable else "use another camera"
    found = f"the camera does not offer {source.fourcc}; it offers {', '.join(formats) or 'none'}"
    return fault("camera format", found, fix)


def check_frames(
    source: Source, captured: Captured, machine: Machine, daemon_state: str
) -> Findings:
    """Judge what a camera delivered, or why nothing;
    `daemon_state` is what a daemon here publishes, or empty.
    """
    findings: list[Finding] = []
    if captured.error:
        if busy := _busy(source, captured.error, machine, daemon_state):
            return (busy,)
        fix = source.how_to_fix(ReasonCode.LOST) or _CONNECT
        findings.append(
            fault(
                "camera frames", str(captured.error).partition(": ")[2] or str(captured.error), fix
            )
        )
    if not captured.t_ns:
        return tuple(findings)
    assert source.fps is not None  # a camera's
    fix = (
        "set source.exposure below the frame period, "
        "or choose a smaller size or a rate that the camera offers"
    )
    findings += [check_rate("camera frames", source.fps, captured, fix), _check_stamps(captured)]
    return (*findings, *_check_locks(captured), check_picture(captured.images[-1]))


def check_other_source(captured: Captured, fps: float | None) -> Findings:
    """Judge what files, which without `fps` have their own times, or the simulated sensor gave."""
    if captured.error:
        return (
            fault("source", str(captured.error), "correct source.path or the files that it names"),
        )
    if not captured.images:
        return (fault("source", "delivered no image", "choose another source.path"),)
    if len(captured.t_ns) < _RATE_FRAMES or fps is None:
        return (ok("source", f"{len(captured.t_ns)} frames"), check_picture(captured.images[-1]))
    return (check_rate("source", fps, captured, _BUSY_MACHINE), check_picture(captured.images[-1]))


def check_picture(image: U8) -> Finding:
    """Judge whether an image shows anything, without knowing the sensor."""
    grey = to_grey(image)
    height, width = grey.shape
    disc = Disc((height - 1) / 2, (width - 1) / 2, min(height, width) / 2)
    if reason := first_reason(PictureJudge(None, disc_mask(height, width, disc)).measured(grey)):
        return fault(
            "picture", reason.text, OF_FRAMES.get(reason.code, OF_FRAMES[ReasonCode.NO_CONTRAST])
        )
    return ok(
        "picture",
        f"{width}x{height} px, mean grey {grey.mean():.0f}, standard deviation {grey.std():.0f}",
    )


def _busy(source: Source, error: Reason, machine: Machine, daemon_state: str) -> Finding | None:
    """Return a finding on the program that holds the camera; None if none does."""
    holders, daemon = [], None
    if isinstance(source, V4l2):
        with contextlib.suppress(TacshadeError):
            # The error may have passed: what counts is whether somebody holds it now.
            if not v4l2_node.is_busy(str(machine.at(source.device))):
                return None
            holders, daemon = machine.holders(source.device), machine.daemon()
    elif error.code is not ReasonCode.IN_USE:
        return None
    if daemon_state and (daemon in holders or not holders):
        return warning(
            "camera frames", f"the daemon is using the camera and reports: {daemon_state}", _STOP
        )
    if holders:
        return fault(
            "camera frames",
            f"{holders[0]} is using the camera",
            f"end that program: kill {holders[0].pid}",
        )
    fix = (
        "end that program; with sudo, doctor names the one that uses a USB camera, "
        "and `pgrep -a rpicam` a CSI camera's"
    )
    return fault("camera frames", "another program is using the camera", fix)


def check_rate(check: str, set_fps: float, captured: Captured, fix: str) -> Finding:
    lost = f", {captured.dropped} lost" if captured.dropped else ""
    found = f"{captured.fps:.1f} frames/s, {set_fps:g} requested{lost}"
    if captured.fps < _RATE_PART * set_fps:
        return warning(check, found, fix)
    if captured.dropped > _LOST_PART * len(captured.t_ns):
        return warning(check, found, "use fourcc MJPG, a separate USB port or a shorter cable")
    return ok(check, found)


def _check_stamps(captured: Captured) -> Finding:
    age_s = (
        max(
            arrived - taken
            for taken, arrived in zip(captured.t_ns, captured.arrived_ns, strict=True)
        )
        / 1e9
    )
    clock = captured.described.get("time_stamps", "on arrival")
    found = f"time stamps: {clock}; frames up to {1e3 * age_s:.0f} ms old"
    if any(later <= earlier for earlier, later in pairwise(captured.t_ns)):
        return warning(
            "camera time", f"{found} and out of order", "update the kernel, or use another camera"
        )
    if clock not in ("kernel", "sensor"):
        fix = (
            "use a camera that runs on the uvcvideo driver, whose kernel time stamps match poses "
            "more accurately"
        )
        return warning("camera time", found, fix)
    return (
        warning("camera time", found, _BUSY_MACHINE)
        if age_s > _AGE_MAX_S
        else ok("camera time", found)
    )


def _check_locks(captured: Captured) -> list[Finding]:
    findings = []
    for key in ("exposure", "white_balance", *AUTOMATICS):
        lock, label = captured.described.get(f"{key}_lock"), key.replace("_", " ")
        if key in AUTOMATICS and lock in (None, Lock.NO_CONTROL):
            continue
        missing = " in this driver" if lock == Lock.NO_CONTROL else ""
        found = f"{label}: {captured.described.get(key) or lock or 'not known'}{missing}"
        fix = (
            f"changes in {label} look like touches; lock {label} (`v4l2-ctl -d DEVICE -L`), or use "
            "another camera"
        )
        is_automatic = lock == Lock.AUTOMATIC
        findings.append(
            warning("camera control", found, fix) if is_automatic else ok("camera control", found)
        )
    return findings


def _choose(machine: Machine) -> str:
    """Return the fix for a missing configured camera."""
    if cameras := found_cameras(machine):
        return (
            "set source.device to one of: "
            f"{', '.join(_labelled(name, machine) for name in cameras)}"
        )
    if has_csi_receiver(machine):
        return CSI_FIX
    return "plug a camera in (lsusb lists it if USB sees it); doctor found none"


def _labelled(name: str, machine: Machine) -> str:
    card = card_name(name, machine)
    return f"{name} ({card})" if card else name


def card_name(device: str, machine: Machine) -> str:
    """Return the driver's name for the node; empty if the kernel has no such node."""
    node = os.path.basename(os.path.realpath(machine.at(device)))
    return machine.read(f"/sys/class/video4linux/{node}/name")


def has_csi_receiver(machine: Machine) -> bool:
    return any(
        card_name(f"/dev/{node.name}", machine).startswith(_CSI_RECEIVERS)
        for node in _nodes(machine)
    )


def stable_name(device: str, machine: Machine) -> str:
    """Return the node's name that survives replugging; empty if there is none."""
    target = os.path.realpath(machine.at(device))
    paths = (
        path
        for folder in _NAMES
        for path in machine.names(folder)
        if os.path.realpath(path) == target
    )
    return next(map(machine.name_of, paths), "")


def found_cameras(machine: Machine) -> list[str]:
    """Return a device name for each camera, the stable one if it has one."""
    names = []
    for node in _nodes(machine):
        device = f"/dev/{node.name}"
        # A USB camera's nodes with higher indices carry metadata.
        first = machine.read(f"/sys/class/video4linux/{node.name}/index") in ("", "0")
        if first and not card_name(device, machine).startswith(_OWN_NODES):
            names.append(stable_name(device, machine) or device)
    return names


def _nodes(machine: Machine) -> list[Path]:
    return machine.names("/dev", "video[0-9]*")


@dataclass(frozen=True, slots=True, eq=False)
class Captured:
    """Frames and facts from a source; all times are of CLOCK_MONOTONIC."""

    images: tuple[U8, ...] = ()  # at most the last ten, (H, W) or (H, W, 3)
    t_ns: tuple[int, ...] = ()  # when each frame was taken, as the source reports
    arrived_ns: tuple[int, ...] = ()  # when each was read
    dropped: int = 0  # as the source counts
    described: dict[str, str | int | float] = field(
        default_factory=dict
    )  # the mode, as in `status/camera`
    error: Reason | None = None  # why the source did not open or failed

    @property
    def fps(self) -> float:
        """Frames per second, measured without the first frames, which often come late;
        0 if there are too few.
        """
        # While exposure and buffers settle, frames come late and in bursts.
        t_ns = self.t_ns[_SETTLING:]
        return (
            1e9 * (len(t_ns) - 1) / (t_ns[-1] - t_ns[0])
            if len(t_ns) > 1 and t_ns[-1] > t_ns[0]
            else 0.0
        )


def capture(source: FrameSource) -> Captured:
    """Open a source, read 30 frames or as many as come within 3 s, and close it."""
    images: deque[U8] = deque(maxlen=_IMAGES_KEPT)
    t_ns, arrived_ns = list[int](), list[int]()
    described, error = dict[str, str | int | float](), None
    try:
        source.open()
        deadline_s = time.monotonic() + LIMIT_S
        while (
            len(t_ns) < FRAMES
            and time.monotonic() < deadline_s
            and (frame := source.read()) is not None
        ):
            images.append(frame.image)
            t_ns.append(frame.t_ns)
            arrived_ns.append(time.monotonic_ns())
        described = source.describe()
    except TacshadeError as failure:
        error = failure.reason
    finally:
        source.close()
    return Captured(tuple(images), tuple(t_ns), tuple(arrived_ns), source.dropped, described, error)
