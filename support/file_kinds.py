"""Files of every kind that we read: a good example of each, and how the program reads it."""

from __future__ import annotations

import io
import logging
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from support.bumpy_surface import grid_poses, press_of
from support.networks import fitted_with
from support.painted_sensor import FREE, TOUCHED, painted_calibration
from tacshade_edge.calibration import loading
from tacshade_edge.calibration.ageing.wears import COLUMNS, History
from tacshade_edge.calibration.files import ageing_file, calibration_file, reference_file
from tacshade_edge.calibration.files.calibration_file import packed
from tacshade_edge.calibration.files.indenter_file import read_indenters
from tacshade_edge.calibration.files.labels import read_labels
from tacshade_edge.calibration.files.press_table import read_presses
from tacshade_edge.calibration.files.reference_file import LearntLimits, StoredReference, limited
from tacshade_edge.calibration.files.sensor_file import read_sensor
from tacshade_edge.calibration.inputs import Inputs, KnownPress, StatedSensor
from tacshade_edge.errors import DecodeError
from tacshade_edge.files.images import read_image
from tacshade_edge.files.meshes import read_stl, stl_bytes
from tacshade_edge.lab.pressed_file import PressedFile
from tacshade_edge.recording.frame_table import read_poses
from tacshade_edge.recording.mcap.writer import McapWriter
from tacshade_edge.recording.recorder import RecordingWriter, png_of
from tacshade_edge.recording.recording import Recording
from tacshade_edge.settings import load
from tacshade_edge.stitching.stitch_file import (
    PRESSES,
    SESSION,
    SessionInfo,
    StitchFile,
    open_session,
)
from tacshade_edge.types import Calibration, Frame, Pose, RestLimits

CONFIG = Path(__file__).parents[1] / "config" / "default.yaml"
SENSOR_ID = "finger"
_log = logging.getLogger("tacshade_edge.damaged_files")
Files = dict[str, bytes]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of file: a good example (content by path below a folder),
    and how the program reads it as a value.

    `damaged` are the files to damage, one at a time, the first one if empty; a `checked` one has a
    checksum, so that damage never gives another value without a warning.
    """

    files: Files
    read: Callable[[Path], Any]
    damaged: tuple[str, ...] = ()
    checked: bool = False


def crc_of(value: Any) -> int:
    return zlib.crc32(np.ascontiguousarray(value).tobytes(), zlib.crc32(str(value.shape).encode()))


def read_calibration(folder: Path) -> Any:
    calibration, inputs = (
        loading.load(folder / "c.npz"),
        calibration_file.inputs_in(folder / "c.npz"),
    )
    images = (
        ()
        if inputs is None
        else (*inputs.references, *inputs.renewed, *(p.image for p in inputs.presses))
    )
    return calibration.crc32, [crc_of(image) for image in images]


def read_reference(folder: Path) -> Any:
    found = reference_file.load(folder / "c.reference.npz", painted_calibration())
    return found and (found.calibration.crc32, found.wall_ns)


def read_session(folder: Path) -> Any:
    if open_session(folder, SENSOR_ID) is None:
        return None
    presses = StitchFile.resume(folder / "one")[1]
    return [
        (crc_of(p.points_mm), crc_of(p.normals), crc_of(p.confidence), pose.seven())
        for p, pose in presses
    ]


def read_recording(name: str, folder: Path) -> Any:
    recording, read = Recording(folder / name), list[Any]()
    if recording.damage:
        _log.warning("%s", recording.damage)  # `replay` and `export` print this line
    if recording.cut_off:
        _log.warning("it was cut off")
    while True:
        try:
            if (recorded := recording.read()) is None:
                return read
        except DecodeError as error:
            _log.warning("%s", error)  # the daemon counts such a frame as `failed`
            continue
        read.append((recorded.frame.t_ns, crc_of(recorded.frame.image), recorded.frame.pose))


def inside(folder: Path) -> Files:
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


POSE = "1,2,3,0.6,0,-0.8,0"
TEXTS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "SENSOR.yaml": (
        "skin_radius_mm: 20\ncamera_distance_mm: 14.5\nvisible_half_angle_deg: 50\npolarity: dark\n"
        "alpha: 3\nbinarisation: otsu\nflange_T_sensor: [1, -2, 30.5, 0, 0.6, 0.8, 0]\n",
        read_sensor,
    ),
    "INDENTERS.yaml": (
        (
            "small: {shape: ball, radius_mm: 3}\n"
            "flat: {shape: cylinder, radius_mm: 4, length_mm: 20}\n"
            "square:\n"
            "  shape: box\n"
            "  length_mm: 6\n"
            "  width_mm: 5.5\n"
            "rod: {shape: bar, radius_mm: 2, length_mm: 14}\n"
            "tip: {shape: cone, angle_deg: 90}\n"
            "own: {shape: mesh, file: own.stl}\n"
        ),
        lambda path: sorted(read_indenters(path)),
    ),
    "PRESSES.csv": (
        (
            "image,indenter,radius_mm,depth_mm,x_mm,y_mm,yaw_deg\n"
            "a.png,ball,4.5,2,1,-3,\n"
            "a.png,ball,3,1.25,,,0\n"
        ),
        lambda path: [
            (p.radius_mm, p.depth_mm, p.x_mm, p.y_mm, p.yaw_deg) for p in read_presses(path)[0]
        ],
    ),
    "POSES.csv": (
        f"image,x_mm,y_mm,z_mm,qw,qx,qy,qz\na.png,{POSE}\na.png,{POSE}\n",
        lambda path: [p.base_T_flange.seven() for p in read_poses(path)],
    ),
    "labels.csv": (
        (
            "image,depth_mm,tilt_x_deg,tilt_y_deg,shear_x_mm,shear_y_mm\n"
            "a.png,2.5,,,0.5,-1\n"
            "a.png,,1,2,,\n"
        ),
        lambda path: [dict(found.known) for found in read_labels(path, path.parent)],
    ),
    "pressed.csv": (
        "indenter,radius_mm,depth_mm,x_mm,y_mm\nball,6,2.5,1,-3\ncube,,2,0,0\n",
        lambda path: [(p.depth_mm, p.x_mm, p.y_mm) for p in PressedFile(path).at(0)],
    ),
    "settings.yaml": (CONFIG.read_text(), lambda path: load(path).settings),
}
PICTURES = (".png", ".jpg", ".bmp", ".tiff", ".webp", ".pgm", ".ppm")
NAMES = (
    *TEXTS,
    "own.stl",
    *PICTURES,
    "calibration",
    "fitted calibration",
    "stored reference",
    "history of references",
    "session",
    "recording",
    "MCAP",
)


@cache
def kinds() -> dict[str, Kind]:
    """Every kind of file by its name in `NAMES`, made once."""
    with TemporaryDirectory() as name:
        root, plain = Path(name), painted_calibration()
        return {
            **_tables_and_pictures(),
            "calibration": _calibration(root, plain),
            "fitted calibration": _calibration(root, fitted_with("fast", plain, 0.0)),
            "stored reference": _stored_reference(root, plain),
            "history of references": _history(root, plain),
            "session": _session(root),
            **_recordings(root, plain),
        }


def _tables_and_pictures() -> dict[str, Kind]:
    triangle = np.array([[[0.0, 0.0, 3.0], [4.0, 0.0, 3.0], [0.0, 4.0, 5.0]]] * 4)
    beside = {"a.png": cv2.imencode(".png", FREE)[1].tobytes(), "own.stl": stl_bytes(triangle)}
    made = {
        name: Kind(
            {name: text.encode(), **beside},
            lambda folder, name=name, read=read: read(folder / name),
        )
        for name, (text, read) in TEXTS.items()
    }
    made["own.stl"] = Kind(
        {"own.stl": beside["own.stl"]}, lambda folder: crc_of(read_stl(folder / "own.stl"))
    )
    for suffix in PICTURES:
        shown = TOUCHED if suffix in (".png", ".pgm") else cv2.cvtColor(TOUCHED, cv2.COLOR_GRAY2BGR)
        content = cv2.imencode(suffix, shown)[1].tobytes()
        made[suffix] = Kind(
            {f"a{suffix}": content},
            lambda folder, suffix=suffix: crc_of(read_image(folder / f"a{suffix}")),
        )
    return made


def _calibration(root: Path, calibration: Calibration) -> Kind:
    sensor = StatedSensor(20.0, 30.0, 50.0, "bright")
    inputs = Inputs(sensor, (FREE, FREE), (KnownPress("press", TOUCHED, 4.0, 1.5, 0.0, 0.0),))
    calibration_file.save(root / "c.npz", calibration, inputs)
    return Kind({"c.npz": (root / "c.npz").read_bytes()}, read_calibration, checked=True)


def read_history(folder: Path) -> Any:
    found = ageing_file.load(folder / "c.ageing.npz", painted_calibration())
    return found.days.tolist(), found.looks.tolist()


def _history(root: Path, calibration: Calibration) -> Kind:
    looks = np.full((2, len(COLUMNS)), 0.25, np.float32)
    history = History(np.array([20_000, 20_002], np.int32), looks)
    ageing_file.save(root / "c.ageing.npz", calibration, history)
    files = {"c.ageing.npz": (root / "c.ageing.npz").read_bytes()}
    return Kind(files, read_history, checked=True)


def _stored_reference(root: Path, calibration: Calibration) -> Kind:
    limits = {"fast": LearntLimits(*[RestLimits(120, 1e-4, 0.03, 0.01, 0.3)] * 2)}
    reference = StoredReference(limited(calibration, limits), 5, limits=limits)
    reference_file.save(root / "c.reference.npz", calibration, reference)
    files = {"c.reference.npz": (root / "c.reference.npz").read_bytes()}
    return Kind(files, read_reference, checked=True)


def _session(root: Path) -> Kind:
    info = SessionInfo("one", 5, 77, 20.0, SENSOR_ID)
    session = StitchFile.create(root / "session/one", info)
    for k, pose in enumerate(grid_poses()[:3]):
        session.append(press_of(pose, k), pose)
    session.close()
    damaged = (f"one/{SESSION}", f"one/{PRESSES}")
    return Kind(inside(root / "session"), read_session, damaged, checked=True)


def _recordings(root: Path, calibration: Calibration) -> dict[str, Kind]:
    """The same frames as a folder and as MCAP."""
    recorder, mcap = RecordingWriter(root / "rec"), io.BytesIO()
    recorder.begin("sensor_id: a\n", packed(calibration))
    writer = McapWriter(mcap, "left", chunk_bytes=1 << 14)
    writer.attach("calibration.npz", packed(calibration), 5)
    for k, image in enumerate((FREE, TOUCHED, FREE, TOUCHED)):
        pose = Pose(1000 + 7 * k, 0.1, -3.0, 1.0, 0.6, 0.0, -0.8, 0.0) if k % 2 else None
        frame = Frame(k, 1000 + 7 * k, 5, image, pose, 4 if pose else 0)
        recorder.add(frame, png_of(image))
        writer.frame(f"{k:06d}.png", frame, png_of(image), 5)
    recorder.finish({"frames": 4})
    writer.finish()
    files = inside(root / "rec")
    damaged = tuple(name for name in files if not name.endswith((".yaml", ".npz")))
    whole = mcap.getvalue()
    return {
        "recording": Kind(files, partial(read_recording, ""), damaged, checked=True),
        "MCAP": Kind({"a.mcap": whole}, partial(read_recording, "a.mcap"), checked=True),
    }
