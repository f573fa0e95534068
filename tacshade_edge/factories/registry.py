"""From settings to devices: the one table of sources, and what can be checked without opening anything."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacshade_edge.devices import fixes
from tacshade_edge.devices.base import FrameSource
from tacshade_edge.devices.camera import v4l2_node
from tacshade_edge.devices.mqtt.client import BrokerAddress
from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.devices.mqtt.outlet import PayloadOutcome
from tacshade_edge.errors import ConfigError
from tacshade_edge.factories import calibrations
from tacshade_edge.protocol.messages import Request
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.regular_files import read_regular
from tacshade_edge.settings import Document, Files, Hand, Rpicam, Serial, Settings, Simulated, Source, V4l2
from tacshade_edge.storage.tables.frame_table import table_in
from tacshade_edge.types import Calibration

_PASSWORD_BYTES_MAX = 1 << 16

if TYPE_CHECKING:
    from tacshade_edge.devices.serial.port import SerialPort


def _v4l2(source: V4l2) -> FrameSource:
    from tacshade_edge.devices.camera.v4l2 import V4l2Source

    return V4l2Source(
        device=source.device,
        width_px=source.width_px,
        height_px=source.height_px,
        fps=source.fps,
        fourcc=source.fourcc,
        exposure=source.exposure,
    )


def _rpicam(source: Rpicam) -> FrameSource:
    from tacshade_edge.devices.camera.rpicam import RpicamSource

    return RpicamSource(
        camera=source.camera,
        width_px=source.width_px,
        height_px=source.height_px,
        fps=source.fps,
        exposure_us=source.exposure_us,
        gain=source.gain,
    )


def _files(source: Files) -> FrameSource:
    from tacshade_edge.storage.recording.image_source import FilesSource

    return FilesSource(path=Path(source.path), fps=source.fps, loop=source.loop)


def _simulated(source: Simulated) -> FrameSource:
    from tacshade_edge.devices.camera.simulated import SimulatedSource

    if source.pressed is None:
        return SimulatedSource(fps=source.fps)
    from tacshade_edge.storage.tables.pressed_file import PressedFile

    return SimulatedSource(fps=source.fps, script=PressedFile(Path(source.pressed)))


# The modules are imported on demand: a camera needs no simulator.
SOURCES: dict[type, Callable[[Any], FrameSource]] = {
    V4l2: _v4l2,
    Rpicam: _rpicam,
    Files: _files,
    Simulated: _simulated,
}


def make_source(source: Source) -> FrameSource:
    """The frame source that the settings name, not opened."""
    return SOURCES[type(source)](source)


def make_serial_port(settings: Serial | None) -> SerialPort | None:
    """The robot's port that the settings name, not opened; None where there is no robot, and pyserial is not needed."""
    if settings is None:
        return None
    from tacshade_edge.devices.serial.port import SerialPort

    return SerialPort(settings.device, settings.baud)


def frames_have_poses(settings: Settings) -> bool:
    """Whether a robot tells them, or the source's folder has a table that may."""
    source = settings.source
    return settings.serial is not None or (isinstance(source, Files) and table_in(Path(source.path)) is not None)


def find_calibration(document: Document, *, store: bool = False) -> Calibration | Reason:
    """Load the calibration as `load_calibration`, or tell that there is none yet, and how it is made.

    Raises
    ------
    ConfigError
        There is a file, and it cannot be used.
    """
    path = document.settings.calibration
    try:
        os.stat(path)
    except FileNotFoundError:
        text = f"not calibrated: found no file {path}; {how_to_calibrate(document)}"
        return Reason(ReasonCode.NOT_CALIBRATED, text)
    except OSError:
        pass  # the loading tells it
    return load_calibration(document, store=store)


def how_to_calibrate(document: Document) -> str:
    """The commands that make the calibration of the settings."""
    return (
        f"while nothing else has the camera, tacshade-edge capture DIR --config {document.path} takes what it needs; "
        "then tacshade-edge calibrate --sensor DIR/SENSOR.yaml --reference DIR/reference_*.png "
        f"--presses DIR/PRESSES.csv --out {document.settings.calibration}"
    )


def load_calibration(document: Document, *, store: bool = False) -> Calibration:
    """Load the calibration that the settings name, and check that it fits the source.

    `store` is of `calibrations.load`.

    Raises
    ------
    ConfigError
    """
    settings = document.settings
    try:
        calibration = calibrations.load(settings.calibration, store=store)
    except ConfigError as error:
        raise ConfigError(f"{document.where('calibration')}: {error}") from error
    source = settings.source
    expected = (calibration.image_width_px, calibration.image_height_px)
    size: tuple[int, int] | None = None
    if isinstance(source, V4l2 | Rpicam):
        key, size = "width_px", (source.width_px, source.height_px)
    elif isinstance(source, Files):
        key, size = "path", _first_size(document, source)
    if size is not None and size != expected:
        raise ConfigError(
            f"{document.where('source', key)}: found {size[0]}x{size[1]} px, "
            f"expected {expected[0]}x{expected[1]} px, the size of the calibration's images"
        )
    return calibration


def _first_size(document: Document, source: Files) -> tuple[int, int] | None:
    from tacshade_edge.storage.recording.image_source import first_size_px

    try:
        return first_size_px(Path(source.path))
    except ConfigError as error:
        raise ConfigError(f"{document.where('source', 'path')}: {error}") from None


def read_password(document: Document) -> str | None:
    """First line of the password file; None without one. Raises ConfigError."""
    mqtt = document.settings.mqtt
    if mqtt.password_file is None:
        return None
    where = document.where("mqtt", "password_file")
    if mqtt.username is None:
        raise ConfigError(f"{where}: found a password without a user name, expected mqtt.username too")
    return password_in(mqtt.password_file, where)


def password_in(path: str | Path, where: str) -> str:
    """First line of a password file that `where` names. Raises ConfigError."""
    try:
        text = read_regular(path, _PASSWORD_BYTES_MAX).decode()
        password = text.partition("\n")[0].rstrip("\r")
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigError(f"{where}: {path}: {reason}, expected a file with the password") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{where}: {path}: found no UTF-8 text, expected the password") from error
    if not password:
        raise ConfigError(f"{where}: {path}: found an empty first line, expected the password")
    return password


def how_to_fix(source: Source, code: ReasonCode) -> str | None:
    """What a person does about a source's state; None where that is not known, or the reason itself says it."""
    of_cameras = {V4l2: fixes.OF_USB_CAMERAS, Rpicam: fixes.OF_CSI_CAMERAS}.get(type(source), {})
    return of_cameras.get(code) or fixes.OF_FRAMES.get(code)


def check_files(document: Document) -> None:
    """Check the paths of the source and the serial port, the files of the broker's settings. Raises ConfigError."""
    check_source(document)
    check_broker_files(document)
    check_serial(document)


def check_serial(document: Document) -> None:
    """Check that the robot's port, if it is there, can be one. Raises ConfigError."""
    if (settings := document.settings.serial) is None:
        return
    from tacshade_edge.devices.serial.port import check_kind

    try:
        check_kind(settings.device)
    except ConfigError as error:
        raise ConfigError(f"{document.where('serial', 'device')}: {error}") from None


def check_source(document: Document) -> None:
    """Check the path of the source. Raises ConfigError."""
    source = document.settings.source
    if isinstance(source, Files):
        _first_size(document, source)
    elif isinstance(source, V4l2):
        try:
            v4l2_node.check_kind(source.device)
        except ConfigError as error:
            raise ConfigError(f"{document.where('source', 'device')}: {error}") from None


def check_broker_files(document: Document) -> None:
    """Check the files of the broker's settings. Raises ConfigError."""
    mqtt = document.settings.mqtt
    if mqtt.ca_file is not None and not Path(mqtt.ca_file).is_file():
        raise ConfigError(f"{document.where('mqtt', 'ca_file')}: found no file {mqtt.ca_file}, expected a PEM file")
    read_password(document)


def make_link(
    document: Document, on_request: Callable[[Request], None], on_outcome: Callable[[str, int, PayloadOutcome], None]
) -> MqttLink:
    """The link to the broker that the settings name, not started. Raises ConfigError."""
    sensor_id = document.settings.sensor_id
    return _link(document, f"tacshade/{sensor_id}", f"tacshade-{sensor_id}", on_request, on_outcome)


def make_hand_link(
    hand: Hand, on_request: Callable[[Request], None], on_outcome: Callable[[str, int, PayloadOutcome], None]
) -> MqttLink:
    """The link of the hand's own topics, not started; its client's id is none that a sensor can have.

    Raises
    ------
    ConfigError
    """
    hand_id = hand.hand_id
    return _link(hand.common, f"tacshade/hand/{hand_id}", f"tacshade-hand.{hand_id}", on_request, on_outcome)


def _link(
    document: Document,
    base_topic: str,
    client_id: str,
    on_request: Callable[[Request], None],
    on_outcome: Callable[[str, int, PayloadOutcome], None],
) -> MqttLink:
    try:
        return MqttLink(
            **broker_address(document),
            base_topic=base_topic,
            client_id=client_id,
            on_request=on_request,
            on_outcome=on_outcome,
        )
    except ConfigError as error:
        raise ConfigError(f"{document.where('mqtt')}: {error}") from error


def broker_address(document: Document) -> BrokerAddress:
    """The broker that the settings name, with the password. Raises ConfigError."""
    mqtt = document.settings.mqtt
    return BrokerAddress(
        host=mqtt.host,
        port=mqtt.port,
        username=mqtt.username,
        password=read_password(document),
        tls_ca=mqtt.ca_file,
    )
