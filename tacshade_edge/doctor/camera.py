"""Checks the camera: its node and names, the modes it offers, and the frames that it delivers."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import time
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from tacshade_edge.core.frame_check import PictureJudge, first_reason
from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.devices.base import FrameSource
from tacshade_edge.devices.camera import v4l2_node
from tacshade_edge.devices.camera.rpicam import PROGRAM
from tacshade_edge.devices.camera.v4l2_node import AUTOMATICS, Lock
from tacshade_edge.devices.fixes import RIBBON_CABLE, USB_CABLE
from tacshade_edge.doctor import Finding, fault, ok, warning
from tacshade_edge.doctor.machine import Machine, may_use, permission_fix
from tacshade_edge.errors import DeviceError, TacshadeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import Rpicam, V4l2
from tacshade_edge.types import U8, Disc

_FOURCCS = ("MJPG", "YUYV", "NV12", "GREY")
_RATE_PART = 0.9
_RATE_OFF = 0.01  # counts 29.97 as 30
_LOST_PART = 0.05  # a stream's start may cost a frame
_AGE_MAX_S = 0.5
_SIZES_SHOWN = 8
_STOP = "to check the camera itself, stop the daemon (sudo systemctl stop tacshade-edge) and start it again afterwards"
_PICTURE_FIXES = {
    ReasonCode.BLACK: "switch the sensor's light on, take the lens cap off, or raise source.exposure",
    ReasonCode.SATURATED: "dim the sensor's light, or lower source.exposure",
    ReasonCode.NO_CONTRAST: "is the camera inside the sensor, in focus, with its light on?",
}
# Best first. This project's udev rules add the names by USB port in /dev/tacshade.
_NAMES = ("/dev/v4l/by-id", "/dev/tacshade", "/dev/v4l/by-path")
# A Raspberry Pi's own nodes: its CSI receivers, and those that every Pi has with or without a camera.
CSI_RECEIVERS = ("unicam", "rp1-cfe")
_OWN_NODES = (*CSI_RECEIVERS, "bcm2835-isp", "bcm2835-codec", "pispbe", "rpi-hevc-dec", "rpivid")
CSI_FIX = (
    "a Raspberry Pi's own (CSI, ribbon cable) camera is read through rpicam-vid: set source: {kind: rpicam, camera: 0}"
)
_LIST_S = 2.5
_WHOLE = 0.9  # of the pixels of the mode that reads most
FRAMES = 30
LIMIT_S = 3.0
_IMAGES_KEPT = 10  # the last ones, because a camera may still be settling during the first
_SETTLING = 5


def list_cameras(machine: Machine) -> Finding:
    """List the machine's cameras if no settings name one."""
    cameras = [_labelled(name, machine) for name in found_cameras(machine)]
    cameras += [f"{{kind: rpicam, camera: {number}}} ({name})" for number, name in csi_cameras().items()]
    if cameras:
        return ok("camera", f"found {', '.join(cameras)}")
    if has_csi_receiver(machine):
        return warning("camera", "found a CSI receiver but no USB camera", CSI_FIX)
    fix = "plug in a camera; lsusb lists every USB camera that the machine detects"
    return warning("camera", "found no camera on this machine", fix)


def check_device(source: V4l2, machine: Machine) -> tuple[Finding, ...]:
    """Check that the configured node exists, is a usable camera and has a stable name; a fault rules out frames."""
    device = source.device
    path = machine.at(device)
    if not path.exists():
        return (fault("camera", f"{device}: no such device", _choose(machine)),)
    if is_csi(device, machine):
        found = f"{device}: this node belongs to the Raspberry Pi's own {card_name(device, machine)}"
        return (fault("camera", found, CSI_FIX),)
    if not may_use(path) and not path.is_dir():
        return (fault("camera", f"{device}: no permission to open it", permission_fix(path, "video")),)
    try:
        card = v4l2_node.check_node(str(path))
    except TacshadeError as error:
        return (fault("camera", _bare(error), _choose(machine)),)
    findings = [ok("camera", f"{device}: {card}")]
    stable = stable_name(device, machine)
    if stable and not device.startswith(("/dev/v4l/", "/dev/tacshade/")):
        fix = f"set source.device: {stable}"
        found = f"{device} may name a different camera after you plug cameras in again"
        findings.append(warning("camera name", found, fix))
    return (*findings, _check_format(source, str(path)))


def check_csi(source: Rpicam) -> tuple[Finding, ...]:
    """Check that rpicam-vid lists the configured camera, and that its mode reads the whole sensor."""
    if not shutil.which(PROGRAM):
        return (fault("camera", f"found no program {PROGRAM}", "sudo apt install rpicam-apps-lite"),)
    cameras = csi_cameras()
    if name := cameras.get(source.camera):
        listed = f"camera {source.camera} of {PROGRAM}: {name}"
        return (_check_mode(source, listed, _csi_modes(source.camera)) or ok("camera", listed),)
    found = ", ".join(f"{number} ({name})" for number, name in cameras.items()) or "none"
    fix = f"set source.camera to a listed camera; {RIBBON_CABLE}" if cameras else RIBBON_CABLE
    return (fault("camera", f"{PROGRAM} does not list camera {source.camera}; it lists {found}", fix),)


def _check_format(source: V4l2, node: str) -> Finding:
    """Check that the driver lists the configured format; the frames show whether it offers size and rate."""
    try:
        formats = v4l2_node.formats(node)
    except DeviceError as error:
        return fault("camera format", _bare(error), "unplug the camera and plug it in again")
    if source.fourcc in formats:
        return ok("camera format", source.fourcc)
    usable = [code for code in _FOURCCS if code in formats]
    fix = f"set source.fourcc: {' or '.join(usable)}" if usable else "use another camera"
    found = f"the camera does not offer {source.fourcc}; it offers {', '.join(formats) or 'none'}"
    return fault("camera format", found, fix)


def check_frames(source: V4l2 | Rpicam, captured: Captured, machine: Machine, daemon_state: str) -> tuple[Finding, ...]:
    """Judge what a camera delivered, or why it delivered nothing.

    `daemon_state` is the state that the running daemon publishes; empty if none runs here.
    """
    if captured.error and (busy := _busy(source, captured.error, machine, daemon_state)):
        return (busy,)
    findings: list[Finding] = []
    if captured.error:
        fix = USB_CABLE if isinstance(source, V4l2) else RIBBON_CABLE
        name = f"camera {source.device}: " if isinstance(source, V4l2) else f"camera {source.camera} of {PROGRAM}: "
        findings.append(fault("camera frames", str(captured.error).removeprefix(name), fix))
    if not captured.t_ns:
        return tuple(findings)
    findings += [_check_rate(source.fps, captured), _check_stamps(captured)]
    findings += _check_locks(captured)
    return (*findings, check_picture(captured.images[-1]))


def check_other_source(captured: Captured, fps: float) -> tuple[Finding, ...]:
    """Judge what a source other than a camera delivered: files or the simulated sensor."""
    if captured.error:
        return (fault("source", str(captured.error), "correct source.path or the files that it names"),)
    what = captured.described.get("path", captured.described.get("device", "source"))
    if not captured.images:
        return (fault("source", f"{what}: delivered no image", "choose another source.path"),)
    if len(captured.t_ns) < 10:
        return (ok("source", f"{what}: {len(captured.t_ns)} frames"), check_picture(captured.images[-1]))
    return (_check_rate(fps, captured, check="source", what=f"{what}: "), check_picture(captured.images[-1]))


def check_picture(image: U8) -> Finding:
    """Judge whether an image shows anything, without knowing the sensor."""
    grey = to_grey(image)
    height, width = grey.shape
    disc = Disc((height - 1) / 2, (width - 1) / 2, min(height, width) / 2)
    reason = first_reason(PictureJudge(None, disc_mask(height, width, disc)).measured(grey))
    if not reason:
        return ok("picture", f"{width}x{height} px, mean grey {grey.mean():.0f}, standard deviation {grey.std():.0f}")
    return fault("picture", reason.text, _PICTURE_FIXES.get(reason.code, _PICTURE_FIXES[ReasonCode.NO_CONTRAST]))


def _busy(source: V4l2 | Rpicam, error: Reason, machine: Machine, daemon_state: str) -> Finding | None:
    """Return a finding on the program that holds the camera; None if none does."""
    if isinstance(source, Rpicam):
        if error.code is not ReasonCode.IN_USE:
            return None
        if daemon_state:
            return warning("camera frames", f"the daemon is using the camera and reports: {daemon_state}", _STOP)
        fix = f"find and end that program: pgrep -a {PROGRAM.partition('-')[0]}"
        return fault("camera frames", "another program is using the camera", fix)
    device = source.device
    with contextlib.suppress(TacshadeError):
        if not v4l2_node.is_busy(str(machine.at(device))):
            return None
        daemon, holders = machine.daemon(), machine.holders(device)
        if daemon_state and (daemon in holders or not holders):
            return warning("camera frames", f"the daemon is using the camera and reports: {daemon_state}", _STOP)
        if not holders:
            fix = "run doctor with sudo to find the program, then end that program"
            return fault("camera frames", "another program is using the camera", fix)
        who = holders[0]
        return fault("camera frames", f"{who} is using the camera", f"end that program: kill {who.pid}")
    return None


def _check_rate(set_fps: float, captured: Captured, check: str = "camera frames", what: str = "") -> Finding:
    lost = f", {captured.dropped} lost" if captured.dropped else ""
    found = f"{what}{captured.fps:.1f} frames/s, {set_fps:g} requested{lost}"
    if captured.fps < _RATE_PART * set_fps:
        fix = "lower source.fps, or stop whatever else is keeping this machine busy"
        if check == "camera frames":
            fix = (
                "set source.exposure below the frame period, or choose a smaller size or a rate that the camera offers"
            )
        return warning(check, found, fix)
    if captured.dropped > _LOST_PART * len(captured.t_ns) and check == "camera frames":
        return warning(check, found, "use fourcc MJPG, a separate USB port or a shorter cable")
    return ok(check, found)


def _check_stamps(captured: Captured) -> Finding:
    age_s = max(arrived - taken for taken, arrived in zip(captured.t_ns, captured.arrived_ns, strict=True)) / 1e9
    found = f"time stamps: {captured.described.get('time_stamps', 'on arrival')}; frames up to {1e3 * age_s:.0f} ms old"
    if any(later <= earlier for earlier, later in pairwise(captured.t_ns)):
        return warning("camera time", f"{found} and out of order", "update the kernel, or use another camera")
    if captured.described.get("time_stamps") not in ("kernel", "sensor"):
        fix = "use a camera that runs on the uvcvideo driver, whose kernel time stamps match poses more accurately"
        return warning("camera time", found, fix)
    if age_s > _AGE_MAX_S:
        return warning("camera time", found, "stop whatever else is keeping this machine busy, or lower source.fps")
    return ok("camera time", found)


def _check_locks(captured: Captured) -> list[Finding]:
    findings = []
    for key in ("exposure", "white_balance", *AUTOMATICS):
        lock, label = captured.described.get(f"{key}_lock"), key.replace("_", " ")
        if key in AUTOMATICS and lock in (None, Lock.NO_CONTROL):
            continue
        found = f"{label}: {captured.described.get(key) or lock or 'not known'}"
        if lock == Lock.NO_CONTROL:
            found += " in this driver"
        if lock == Lock.AUTOMATIC:
            fix = f"changes in {label} look like touches; lock {label} (`v4l2-ctl -d DEVICE -L`), or use another camera"
            findings.append(warning("camera control", found, fix))
        else:
            findings.append(ok("camera control", found))
    return findings


def _choose(machine: Machine) -> str:
    """Return the fix for a missing configured camera."""
    cameras = found_cameras(machine)
    if cameras:
        return f"set source.device to one of: {', '.join(_labelled(name, machine) for name in cameras)}"
    none = "plug a camera in (lsusb lists it if USB sees it); doctor found none"
    return CSI_FIX if has_csi_receiver(machine) else none


def _labelled(name: str, machine: Machine) -> str:
    card = card_name(name, machine)
    return f"{name} ({card})" if card else name


def _bare(error: TacshadeError) -> str:
    return str(error).removeprefix("camera ")


def _check_mode(source: Rpicam, listed: str, modes: dict[tuple[int, int], int]) -> Finding | None:
    """Warn if the sensor's mode reads only a part of it; `modes` are their sizes and the pixels that each reads."""
    if source.sensor_mode:
        width, height = map(int, source.sensor_mode.split(":"))
    else:
        width, height = source.width_px, source.height_px
    mode = min((size for size in modes if size[0] >= width and size[1] >= height), default=None)
    whole = max(modes.values(), default=0)
    if mode is None or modes[mode] > _WHOLE * whole:
        return None
    found = f"{listed}; the mode {mode[0]}:{mode[1]} reads {100 * modes[mode] / whole:.0f} % of the sensor, its middle"
    others = ", ".join(f"{wide}:{high}" for (wide, high), read in sorted(modes.items()) if read > _WHOLE * whole)
    return warning("camera", found, f"set source.sensor_mode to a mode that reads all of it: {others}")


def csi_cameras() -> dict[int, str]:
    """Return number and name of each CSI camera that ``rpicam-vid --list-cameras`` lists; none without the program."""
    found = re.findall(r"^(\d+) : (.*?)(?: \(/.*\))?$", _csi_list(), re.MULTILINE)
    return {int(number): name for number, name in found}


def _csi_modes(camera: int) -> dict[tuple[int, int], int]:
    """Return the size of each mode of a CSI camera, and how many pixels of the sensor it reads."""
    of_this = re.split(r"^(\d+) : .*$", _csi_list(), flags=re.MULTILINE)
    about = dict(zip(of_this[1::2], of_this[2::2], strict=True)).get(str(camera), "")
    modes = re.findall(r"(\d+)x(\d+) \[.*?/(\d+)x(\d+) crop\]", about)
    return {(int(width), int(height)): int(wide) * int(high) for width, height, wide, high in modes}


def _csi_list() -> str:
    try:
        words = (PROGRAM, "--list-cameras")
        done = subprocess.run(words, capture_output=True, text=True, errors="replace", timeout=_LIST_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout


def card_name(device: str, machine: Machine) -> str:
    """Return the driver's name for the node; empty if the kernel has no such node."""
    node = os.path.basename(os.path.realpath(machine.at(device)))
    return machine.read(f"/sys/class/video4linux/{node}/name")


def is_csi(device: str, machine: Machine) -> bool:
    """Whether the node is one of a Raspberry Pi's own and no USB camera's."""
    return card_name(device, machine).startswith(_OWN_NODES)


def has_csi_receiver(machine: Machine) -> bool:
    """Whether the machine has a CSI receiver's node."""
    return any(card_name(f"/dev/{node.name}", machine).startswith(CSI_RECEIVERS) for node in _nodes(machine))


def stable_name(device: str, machine: Machine) -> str:
    """Return the node's name that survives replugging; empty if there is none."""
    target = os.path.realpath(machine.at(device))
    for folder in _NAMES:
        for path in machine.names(folder):
            if os.path.realpath(path) == target:
                return machine.name_of(path)
    return ""


def found_cameras(machine: Machine) -> list[str]:
    """Return a device name for each camera, the stable one if it has one."""
    names = []
    for node in _nodes(machine):
        device = f"/dev/{node.name}"
        # A USB camera's nodes with higher indices carry metadata.
        first = machine.read(f"/sys/class/video4linux/{node.name}/index") in ("", "0")
        if first and not is_csi(device, machine):
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
    described: dict[str, str | int | float] = field(default_factory=dict)  # the mode, as in `status/camera`
    error: Reason | None = None  # why the source did not open or failed

    @property
    def fps(self) -> float:
        """Frames per second, measured without the first frames, which often come late; 0 if there are too few."""
        t_ns = self.t_ns[_SETTLING:]
        return 1e9 * (len(t_ns) - 1) / (t_ns[-1] - t_ns[0]) if len(t_ns) > 1 and t_ns[-1] > t_ns[0] else 0.0


def capture(source: FrameSource) -> Captured:
    """Open a source, read 30 frames or as many as come within 3 s, and close it."""
    images: deque[U8] = deque(maxlen=_IMAGES_KEPT)
    t_ns, arrived_ns = list[int](), list[int]()
    described, error = dict[str, str | int | float](), None
    try:
        source.open()
        deadline_s = time.monotonic() + LIMIT_S
        while len(t_ns) < FRAMES and time.monotonic() < deadline_s and (frame := source.read()) is not None:
            images.append(frame.image)
            t_ns.append(frame.t_ns)
            arrived_ns.append(time.monotonic_ns())
        described = source.describe()
    except TacshadeError as failure:
        error = failure.reason
    finally:
        source.close()
    return Captured(tuple(images), tuple(t_ns), tuple(arrived_ns), source.dropped, described, error)
