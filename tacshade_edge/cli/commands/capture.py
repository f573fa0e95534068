"""``tacshade-edge capture``: takes a sensor's references and presses, or labelled frames,
together with the user.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shlex
import sys
from collections.abc import Iterator, Mapping

import msgspec
import yaml

from tacshade_edge.calibration.files.capture_folder import REFERENCES, CaptureFolder
from tacshade_edge.calibration.files.indenter_file import read_indenters, write_printables
from tacshade_edge.calibration.files.labels import LABELS, LabelFolder
from tacshade_edge.calibration.files.press_table import BALL, press_rows, read_plan
from tacshade_edge.calibration.files.sensor_file import check_value, read_sensor
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.calibration.presses.press_selection import MIN_PRESSES
from tacshade_edge.camera import v4l2_node
from tacshade_edge.camera.csi_camera import csi_cameras
from tacshade_edge.camera.sources import best_size, make_source
from tacshade_edge.camera.v4l2 import FOURCCS
from tacshade_edge.camera.v4l2_node import Lock
from tacshade_edge.capture.capture_session import CaptureSession
from tacshade_edge.capture.label_session import LabelSession
from tacshade_edge.capture.live import InputEnded, Live, Terminal
from tacshade_edge.capture.page import Page
from tacshade_edge.capture.robot_place import PoseAt, RobotLabels, RobotPlaces
from tacshade_edge.capture.scale import BAUD, Scale, scale_port
from tacshade_edge.cli.shared.options import NEXT_FIT, add_option, add_sensor
from tacshade_edge.doctor.camera_check import CSI_FIX, found_cameras, has_csi_receiver
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files.targets import check_folder, one_at_a_time
from tacshade_edge.quoting import counted
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.ports import check_serial, make_serial_port
from tacshade_edge.settings import Rpicam, Serial, Source, V4l2, check_source, load
from tacshade_edge.types import Frame, Pose, Skin

_CALIBRATION = "calibration.npz"
_QUESTIONS = {
    "skin_radius_mm": "Radius of the undeformed skin, mm (pad: the skin is flat):",
    "visible_half_angle_deg": (
        "Half angle of the part of the skin that the camera sees, at the skin's centre, degrees:"
    ),
    "camera_distance_mm": "Distance of the lens behind the skin's centre, mm (Enter if unknown):",
    "polarity": (
        "Does a press show more white (bright, a TacShade) or less (dark, "
        "a TacTip)? (Enter if unknown)"
    ),
}
_PAD_QUESTIONS = {
    "visible_radius_mm": "Radius of the circle of skin that the camera sees, mm:",
    "camera_distance_mm": "Distance of the lens behind the untouched skin, mm (Enter if unknown):",
    "polarity": _QUESTIONS["polarity"],
}
LEAST_TOUCHES = 8
"""What `calibrate --touches` needs (`lab.fitting.explained`, which a capture does not import)."""
# `calibrate` does without either of them.
_MAY_BE_EMPTY = ("camera_distance_mm", "polarity")
# What a robot is told that asks for the sensor's status meanwhile.
_CAPTURING = Reason(
    ReasonCode.NOT_CALIBRATED,
    "not calibrated: tacshade-edge capture is taking references and presses",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    what = parser.add_mutually_exclusive_group(required=True)
    text = "folder to write to; an interrupted capture continues where it stopped"
    add_option(what, "folder", "DIR", text, nargs="?")
    text = (
        "write printable indenters (STL), INDENTERS.yaml and a plan of presses (PLAN.csv), "
        "then exit"
    )
    add_option(what, "--indenters", "DIR", text)
    text = (
        "add labelled frames to DIR/LABELS.csv; you type the labels, "
        "or a robot or scale supplies them"
    )
    add_option(what, "--labels", "DIR", text)
    text = (
        "with --labels: read a scale on this serial port; the scale must send numbers with units "
        f"at {BAUD} baud"
    )
    add_option(parser, "--scale", "DEVICE[:BAUD]", text, str)
    camera = parser.add_mutually_exclusive_group()
    add_option(camera, "--camera", "DEVICE", "camera to use, if the machine has several", str)
    add_option(camera, "--config", "FILE", "settings file whose `source` is the camera")
    add_sensor(parser)
    text = "suggest the presses in this table, which has the same columns as PRESSES.csv"
    add_option(parser, "--plan", "PLAN.csv", text)


def run(args: argparse.Namespace) -> int:
    """Take references and presses, or labelled frames, and print the commands that use them."""
    if args.indenters is not None:
        for path in write_printables(args.indenters):
            print(path)
        return 0
    if args.scale is not None and args.labels is None:
        raise ConfigError("--scale: found no --labels DIR, expected both options")
    if args.labels is not None and args.plan:
        raise ConfigError("--labels: found --plan too, expected --labels without it")
    folder = CaptureFolder(args.labels or args.folder)
    source, serial = _source(args, folder)
    _check(args, folder)
    # Made only once the camera is known: a mistake in the options leaves no folder behind.
    folder.make()
    # Two that take pictures in turn would overwrite each other's.
    with one_at_a_time(folder.path, "capture", "filling"):
        return _take(args, folder, source, serial)


def _take(
    args: argparse.Namespace, folder: CaptureFolder, source: Source, serial: Serial | None
) -> int:
    terminal = Terminal(0, sys.stdout)
    try:
        indenters = read_indenters(folder.indenters) if folder.indenters.exists() else {}
        sensor = _sensor(folder, terminal)
        plan = list(read_plan(args.plan, indenters, sensor.skin_radius_mm)) if args.plan else []
        with (
            _camera(folder, source, serial, terminal, sensor) as live,
            _robot_poses(serial) as pose_at,
        ):
            if args.labels is None:
                places = RobotPlaces(sensor, pose_at) if pose_at else None
                CaptureSession(folder, sensor, live, terminal, plan, indenters, places).run()
            else:
                labels = RobotLabels(sensor, pose_at) if pose_at else None
                with _scale(args.scale) as scale:
                    LabelSession(LabelFolder(args.labels), live, terminal, scale, labels).run()
    except InputEnded:
        # The input's end (Ctrl-D) is an answer: that was all. What comes next is said as usual.
        terminal.say("")
    except KeyboardInterrupt:
        words = (
            "tacshade-edge capture "
            f"{'--labels ' if args.labels else ''}{shlex.quote(str(folder.path))}"
        )
        terminal.say(f"\neverything taken so far is kept; to continue, run: {words}")
        raise
    except DeviceError as error:
        # All that was taken is on the disk.
        again = f"to continue in {folder.path}, run the same command again"
        raise DeviceError(f"{error}; {again}", code=error.code) from None
    _say_next(folder, terminal, labels=args.labels is not None)
    return 0


def _check(args: argparse.Namespace, folder: CaptureFolder) -> None:
    """Refuse a folder that cannot be filled, or a plan that is none, before the first question.

    Raises ConfigError and DeviceError.
    """
    check_folder(folder.path, (folder.settings.name, folder.presses.name, LABELS))
    if args.plan:
        press_rows(args.plan)


@contextlib.contextmanager
def _scale(device: str | None) -> Iterator[Scale | None]:
    """Open the scale; yields None without one."""
    if device is None:
        yield None
        return
    with contextlib.closing(Scale(scale_port(device))) as scale:
        scale.open()
        yield scale


@contextlib.contextmanager
def _camera(
    folder: CaptureFolder,
    chosen: Source,
    serial: Serial | None,
    terminal: Terminal,
    sensor: StatedSensor,
) -> Iterator[Live]:
    """Open the camera and its page; write the daemon's settings if there are none."""
    with (
        contextlib.closing(make_source(chosen)) as source,
        contextlib.closing(Page()) as page,
    ):
        source.open()
        described = source.describe()
        terminal.say("camera: " + ", ".join(f"{name} {value}" for name, value in described.items()))
        # The capture goes on: some cameras have no lock, and steady light needs none.
        if described.get("exposure_lock") == Lock.AUTOMATIC:
            terminal.say(
                "warning: the driver does not lock the exposure, "
                "and changes in exposure look like touches"
            )
        if not folder.settings.exists():
            folder.write(folder.settings, _settings_text(chosen, serial, described))
        terminal.say(f"live picture: {page.address}")
        yield Live(source, terminal, page, sensor.visible_circle)


@contextlib.contextmanager
def _robot_poses(serial: Serial | None) -> Iterator[PoseAt | None]:
    """Serve the robot's serial line as the daemon does, but requests have no effect;
    yields None without a robot.
    """
    if serial is None or (port := make_serial_port(serial)) is None:
        yield None
        return
    # Most captures have no robot.
    from tacshade_edge.robot.robot import Robot

    statuses: list[bytes] = []
    state = {"source": "streaming", "health": {}}
    robot = Robot(
        port,
        lambda *_: None,
        lambda: state,
        statuses.append,
        lambda: _CAPTURING,
        lambda: _CAPTURING,
    )

    def pose_at(frame: Frame) -> Pose | str:
        if (pose := robot.with_interpolated_pose(frame).pose) is not None:
            return pose
        robot.poll()
        status = json.loads(statuses[-1])
        why = status["reason"] or f"clock {status.get('sync')}"
        return (
            f"the robot reported no pose for this picture ({serial.device} is {status['state']}: "
            f"{why})"
        )

    robot.start()
    try:
        yield pose_at
    finally:
        robot.stop(1.0)


def _source(args: argparse.Namespace, folder: CaptureFolder) -> tuple[Source, Serial | None]:
    """The camera and robot of the settings, else the camera of --camera, else the only one.

    Raises ConfigError.
    """
    device: str | None = args.camera
    # A capture that goes on uses the camera that it began with.
    path = folder.settings if args.config is None and folder.settings.exists() else args.config
    if path is not None:
        document = load(path, args.sensor)
        check_source(document)
        check_serial(document)
        source = document.settings.source.sized()
        if device is not None and not (isinstance(source, V4l2) and source.device == device):
            found = f"found another source in {document.where('source')}"
            raise ConfigError(
                f"--camera {device}: {found}, expected this camera; edit or delete that file"
            )
        return source, document.settings.serial
    if device is None:
        machine = Machine()
        cameras, csi = found_cameras(machine), list(csi_cameras())
        if not cameras and len(csi) == 1:
            return Rpicam(camera=csi[0]).sized(), None
        # With several, taking the first would sooner or later calibrate the wrong sensor.
        if len(cameras) != 1:
            fix = f"; {CSI_FIX}" if not cameras and has_csi_receiver(machine) else ""
            found = ", ".join(cameras) or "no camera"
            raise ConfigError(
                f"found {found}, expected one, or --camera DEVICE, or --config with a source{fix}"
            )
        device = cameras[0]
    v4l2_node.check_node(device)
    offered = v4l2_node.formats(device)
    # The first is the best: several cameras in YUYV overrun one USB port, in MJPG they do not.
    known = [code for code in FOURCCS if code in offered]
    if not known:
        found = f"found {', '.join(offered) or 'none'}, expected one of {', '.join(FOURCCS)}"
        raise ConfigError(f"--camera {device}: pixel formats: {found}")
    width_px, height_px = best_size(v4l2_node.frame_sizes(device, known[0]))
    size = {"width_px": width_px, "height_px": height_px}
    camera = {"kind": "v4l2", "device": device, "fourcc": known[0], **size}
    return msgspec.convert(camera, V4l2), None


def _settings_text(chosen: Source, serial: Serial | None, described: Mapping[str, object]) -> str:
    """The daemon's settings for this sensor, with the exposure at which the camera was locked."""
    locked = described.get("exposure_lock") == Lock.LOCKED
    value = described.get("exposure_value")
    # The daemon has to lock the exposure at which the references were taken, whatever the light is
    # when it starts; 1 is the least that the setting takes.
    if isinstance(chosen, V4l2) and locked and isinstance(value, float) and value >= 1:
        chosen = msgspec.structs.replace(chosen, exposure=round(value))
    found = "".join(f"#   {name}: {value}\n" for name, value in described.items())
    keys = {
        "calibration": _CALIBRATION,
        "source": msgspec.to_builtins(chosen),
        "recorder": {"folder": "recordings"},
    }
    keys |= (
        {"serial": msgspec.to_builtins(serial), "stitching": {"folder": "sessions"}}
        if serial
        else {}
    )
    text = yaml.safe_dump(keys, sort_keys=False, allow_unicode=True)
    return (
        "# Settings for `tacshade-edge run` and to continue this capture.\n"
        f"{text}# As the camera reported:\n"
        f"{found}"
    )


def _sensor(folder: CaptureFolder, terminal: Terminal) -> StatedSensor:
    """Read SENSOR.yaml; if there is none, ask the user for its values first.

    Raises ConfigError, InputEnded.
    """
    if not folder.sensor.exists():
        values = _answers(terminal, _QUESTIONS, "dome")
        if values is None:
            values = {"skin": "pad", **(_answers(terminal, _PAD_QUESTIONS, "pad") or {})}
        folder.write(folder.sensor, yaml.safe_dump(values, sort_keys=False))
    return read_sensor(folder.sensor)


def _answers(
    terminal: Terminal, questions: Mapping[str, str], skin: Skin
) -> dict[str, float | str] | None:
    """The user's values for the keys of a dome or a pad; None if a dome turns out to be a pad.

    Raises InputEnded.
    """
    values: dict[str, float | str] = {}
    for key, question in questions.items():
        while key not in values:
            terminal.ask(question)
            text = terminal.wait()
            # The question offers this answer: a flat skin has other dimensions to ask for.
            if text == "pad" and key == "skin_radius_mm":
                return None
            if not text and key in _MAY_BE_EMPTY:
                break
            try:
                values[key] = check_value(key, text, skin)
            except ConfigError as error:
                terminal.say(f"  {error}")
    return values


def _say_next(folder: CaptureFolder, terminal: Terminal, *, labels: bool) -> None:
    """Print the commands that come next, for the user to copy."""
    at = shlex.quote(str(folder.path))
    words = (
        f"tacshade-edge calibrate --sensor {at}/{folder.sensor.name} --reference {at}/{REFERENCES}"
    )
    if folder.rest_pictures():
        words += f" --rest {at}/{folder.rest.name}"
    # Labels may be taken with a calibration that is elsewhere.
    if not list(folder.path.glob(REFERENCES)):
        terminal.say(f"no references yet; to take them, run: tacshade-edge capture {at}")
        if not labels:
            return
    taken = [] if labels else folder.taken()
    fit = "" if labels else " --fit"
    if not labels and len(folder.touch_pictures()) >= LEAST_TOUCHES:
        fit += f" --touches {at}/{folder.touches.name}"
    if labels:
        words += f" --labels {at}/{LABELS}"
    elif len(taken) >= MIN_PRESSES:
        words += f" --presses {at}/{folder.presses.name}"
        # Without other shapes, no INDENTERS.yaml may be there to name.
        if any(one.stated.columns[0] != BALL for one in taken):
            words += f" --indenters {at}/{folder.indenters.name}"
    else:
        more = (
            f"a scale from presses needs {MIN_PRESSES}, 20 to 40 are better; "
            "run the same command to take more"
        )
        terminal.say(f"{counted(len(taken), 'press')}: {more}")
    calibrate = f"{'next:' if labels else NEXT_FIT}\n  {words}{fit} --out {at}/{_CALIBRATION}"
    terminal.say(f"{calibrate}\n  tacshade-edge run --config {at}/{folder.settings.name}")
