"""The inputs to damage: a good example of every kind of file, and the program's own way to read it."""

from __future__ import annotations

import logging
import random
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import msgspec
import numpy as np

from tacshade_edge.core.calibration.inputs import Inputs, KnownPress, Sensor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.daemon.stitching.session import Session
from tacshade_edge.errors import DecodeError
from tacshade_edge.factories import calibrations
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.settings import load
from tacshade_edge.settings.printer_file import read_printer
from tacshade_edge.settings.sensor_file import read_sensor
from tacshade_edge.storage import checked_npz
from tacshade_edge.storage.calibration import calibration_file, reference_file
from tacshade_edge.storage.calibration.reference_file import StoredReference
from tacshade_edge.storage.checked_npz import Content
from tacshade_edge.storage.images import read_image
from tacshade_edge.storage.meshes.stl import read_stl, stl_bytes
from tacshade_edge.storage.recording.recorder import Recorder, png_of
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.storage.stitching.stitch_file import PRESSES, SESSION, SessionInfo, StitchFile, open_session
from tacshade_edge.storage.tables.indenters import read_indenters
from tacshade_edge.storage.tables.labels import read_labels
from tacshade_edge.storage.tables.poses_table import read_poses
from tacshade_edge.storage.tables.pressed_file import PressedFile
from tacshade_edge.storage.tables.presses import read_presses
from tacshade_edge.types import Calibration, Frame, Pose, Reconstruction
from tools.testbed.bumpy_surface import grid_poses, press_of
from tools.testbed.fitted import fitted_with
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

_log = logging.getLogger("tacshade_edge.faults")
SENSOR_ID = "finger"
CONFIG = Path(__file__).parents[2] / "config" / "default.yaml"
Files = dict[str, bytes]
Junk = Callable[[random.Random], Any]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of input.

    Attributes
    ----------
    files : mapping of str to bytes
        A good example: content by path below a folder.
    damaged : tuple of str
        The files that may be damaged, one at a time.
    read : callable
        ``read(folder)`` returns a comparable value as the program reads it, or raises one of its three exceptions.
    checked : bool
        Whether it has a checksum, so that damage never gives another value without a warning.
    sealed : callable or None
        ``sealed(draw, junk)`` returns files with wrong content behind right checksums.
    text : bool
        Whether the files are text.
    """

    files: Files
    damaged: tuple[str, ...]
    read: Callable[[Path], Any]
    checked: bool = False
    sealed: Callable[[random.Random, Junk], Files] | None = None
    text: bool = False


class Warnings(logging.Handler):
    """Keeps the warnings of the log."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record's text."""
        self.lines.append(record.getMessage())


@contextmanager
def warnings_kept() -> Iterator[Warnings]:
    """Keep the log's warnings instead of writing them."""
    handler, logger = Warnings(), logging.getLogger("tacshade_edge")
    logger.addHandler(handler)
    logger.propagate = False
    try:
        yield handler
    finally:
        logger.removeHandler(handler)
        logger.propagate = True


def make_kinds() -> dict[str, Kind]:
    """Make every kind of input except MCAP."""
    with TemporaryDirectory() as folder:
        root = Path(folder)
        kinds = {**_calibrations(root), **_texts(), **_pictures(), "session": _session(root)}
        return {**kinds, "recording": _recording(root)}


def bytes_of(value: Any) -> int:
    """Compute the CRC-32 of an array, for comparison."""
    return zlib.crc32(np.ascontiguousarray(value).tobytes(), zlib.crc32(str(value.shape).encode()))


def _inside(folder: Path) -> Files:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# Calibrations and stored references.


def _calibrations(root: Path) -> dict[str, Kind]:
    plain = painted_calibration()
    sensor = Sensor(20.0, 30.0, 50.0, "bright")
    inputs = Inputs(sensor, (FREE, FREE), (KnownPress("press", TOUCHED, 4.0, 1.5, 0.0, 0.0),))
    kinds: dict[str, Kind] = {}
    for name, calibration in (("calibration", plain), ("calibration fitted", fitted_with("fast", plain, 0.0))):
        calibration_file.save(root / "c.npz", calibration, inputs)
        content, _ = checked_npz.read(str(root / "c.npz"), "", "")
        files = {"c.npz": (root / "c.npz").read_bytes()}
        kinds[name] = Kind(files, ("c.npz",), _read_calibration, True, partial(_sealed_npz, "c.npz", content))
    stored = StoredReference(calibration_file.with_crc(plain), 5)
    reference_file.save(root / "c.reference.npz", plain, stored)
    content, _ = checked_npz.read(str(root / "c.reference.npz"), "", "")
    name = "c.reference.npz"
    files = {name: (root / name).read_bytes()}
    read = partial(_read_reference, plain)
    kinds["stored reference"] = Kind(files, (name,), read, True, partial(_sealed_npz, name, content))
    for path in root.iterdir():
        path.unlink()
    return kinds


def _read_calibration(folder: Path) -> Any:
    calibration = calibrations.load(folder / "c.npz")
    inputs = calibration_file.inputs_in(folder / "c.npz")
    _use(calibration)
    images = () if inputs is None else (*inputs.references, *inputs.renewed, *(p.image for p in inputs.presses))
    return calibration.crc32, [bytes_of(image) for image in images]


def _read_reference(calibrated: Calibration, folder: Path) -> Any:
    found = reference_file.load(folder / "c.reference.npz", calibrated)
    if found is None:
        return None
    _use(found.calibration)
    return found.calibration.crc32, found.wall_ns


_USED: set[int] = set()


def _use(calibration: Calibration) -> None:
    """Reconstruct a frame with a calibration as the daemon would, once for each calibration."""
    if calibration.crc32 in _USED:
        return
    _USED.add(calibration.crc32)
    shape = (calibration.image_height_px, calibration.image_width_px)
    image = TOUCHED if shape == TOUCHED.shape else np.full(shape, 90, np.uint8)
    result = make_reconstructor(calibration, PROFILES["fast"]).step(Frame(0, 0, 0, image))
    assert not (isinstance(result, Reconstruction) and np.isinf(result.height.height_mm).any())


def _sealed_npz(name: str, content: Content, draw: random.Random, junk: Junk) -> Files:
    meta, arrays = dict(content.meta), dict(content.arrays)
    for _ in range(draw.choice((1, 1, 1, 3))):
        part = draw.choice(("meta", "meta", "meta", "inner", "array", "gone"))
        if part == "array":
            name = draw.choice(list(arrays))
            arrays[name] = _other_array(draw) if draw.random() < 0.5 else _other_values(draw, arrays[name])
        elif part == "gone":
            (meta if draw.random() < 0.7 or not arrays else arrays).pop(draw.choice(list(meta)), None)
        elif part == "meta":
            meta[draw.choice(list(meta) or ["version"])] = junk(draw)
        else:
            key = draw.choice(list(meta) or ["version"])
            meta[key] = _inner(draw, meta.get(key), junk)
    return {name: Content(meta, arrays).packed()}


def _inner(draw: random.Random, value: Any, junk: Junk) -> Any:
    """Replace a part of a value, at any depth, with junk."""
    if isinstance(value, dict) and value:
        key = draw.choice(list(value))
        return {**value, key: _inner(draw, value[key], junk)}
    if isinstance(value, list) and value:
        at = draw.randrange(len(value))
        return [*value[:at], _inner(draw, value[at], junk), *value[at + 1 :]]
    return junk(draw)


def _other_array(draw: random.Random) -> Any:
    shape = tuple(draw.choice((0, 1, 2, 7, 119, 120, 160, 161)) for _ in range(draw.randrange(4)))
    kind = draw.choice(("u1", "u1", "u1", "f4", "f8", "i8", "b1", "c8", "U3"))
    return np.full(shape, draw.choice((0, 1, 255)), kind)


def _other_values(draw: random.Random, array: Any) -> Any:
    """Replace the values of an array, such as references, images of presses or weights, with as many others."""
    factor = draw.choice((0, -1, 1e3, 1e10, 1e30, np.nan, np.inf))
    with np.errstate(all="ignore"):
        return (
            (array * factor).astype(array.dtype)
            if array.dtype.kind == "f"
            else np.full_like(array, draw.choice((0, 1)))
        )


# Files that a person writes, and tables.

_POSE_ROW = "1,2,3,0.6,0,-0.8,0"
_TEXTS: dict[str, tuple[str, str, Callable[[Path], Any]]] = {
    "SENSOR.yaml": (
        "SENSOR.yaml",
        "skin_radius_mm: 20\ncamera_distance_mm: 14.5\nvisible_half_angle_deg: 50\npolarity: dark\n"
        "alpha: 3\nbinarisation: otsu\nflange_T_sensor: [1, -2, 30.5, 0, 0.6, 0.8, 0]\n",
        read_sensor,
    ),
    "PRINTER.yaml": (
        "PRINTER.yaml",
        "x_mm: [0, 200]\ny_mm: [0, 200]\nz_mm: [20, 180]\nstart_mm: [100, 100, 60]\nfeed_mm_s: 20\nbaud: 250000\n",
        read_printer,
    ),
    "INDENTERS.yaml": (
        "INDENTERS.yaml",
        "small: {shape: ball, radius_mm: 3}\nflat: {shape: cylinder, radius_mm: 4, length_mm: 20}\n"
        "square:\n  shape: box\n  length_mm: 6\n  width_mm: 5.5\nrod: {shape: bar, radius_mm: 2, length_mm: 14}\n"
        "tip: {shape: cone, angle_deg: 90}\nown: {shape: mesh, file: own.stl}\n",
        lambda path: sorted(read_indenters(path)),
    ),
    "PRESSES.csv": (
        "PRESSES.csv",
        "image,indenter,radius_mm,depth_mm,x_mm,y_mm,yaw_deg\na.png,ball,4.5,2,1,-3,\na.png,ball,3,1.25,,,0\n",
        lambda path: [(p.radius_mm, p.depth_mm, p.x_mm, p.y_mm, p.yaw_deg) for p in read_presses(path)[0]],
    ),
    "POSES.csv": (
        "POSES.csv",
        f"image,x_mm,y_mm,z_mm,qw,qx,qy,qz\na.png,{_POSE_ROW}\na.png,{_POSE_ROW}\n",
        lambda path: [(str(p.path.name), p.base_T_flange.seven()) for p in read_poses(path)],
    ),
    "labels": (
        "labels.csv",
        "image,depth_mm,tilt_x_deg,tilt_y_deg,shear_x_mm,shear_y_mm\na.png,2.5,,,0.5,-1\na.png,,1,2,,\n",
        lambda path: [dict(found.known) for found in read_labels(path, path.parent)],
    ),
    "pressed": (
        "pressed.csv",
        "indenter,radius_mm,depth_mm,x_mm,y_mm\nball,6,2.5,1,-3\ncube,,2,0,0\n",
        lambda path: [(p.depth_mm, p.x_mm, p.y_mm) for p in PressedFile(path).at(0)],
    ),
}


def _texts() -> dict[str, Kind]:
    triangle = np.array([[[0.0, 0.0, 3.0], [4.0, 0.0, 3.0], [0.0, 4.0, 5.0]]] * 4)
    beside = {"a.png": _encoded(".png", FREE), "own.stl": stl_bytes(triangle)}
    kinds = {
        kind: Kind({name: text.encode(), **beside}, (name,), partial(_read_text, name, read), text=True)
        for kind, (name, text, read) in _TEXTS.items()
    }
    for name, text in (("settings", CONFIG.read_text()), ("settings, short", "sensor_id: a\nprofile: fast\n")):
        kinds[name] = Kind({"s.yaml": text.encode()}, ("s.yaml",), lambda f: load(f / "s.yaml").settings, text=True)
    kinds["STL"] = Kind(
        {"own.stl": beside["own.stl"]}, ("own.stl",), lambda folder: bytes_of(read_stl(folder / "own.stl"))
    )
    return kinds


def _read_text(name: str, read: Callable[[Path], Any], folder: Path) -> Any:
    return read(folder / name)


# Images.


def _encoded(suffix: str, image: Any, *options: int) -> bytes:
    return cv2.imencode(suffix, image, options)[1].tobytes()


def _pictures() -> dict[str, Kind]:
    colour = cv2.cvtColor(TOUCHED, cv2.COLOR_GRAY2BGR)
    kinds = {}
    for suffix in (".png", ".jpg", ".bmp", ".tiff", ".webp", ".pgm", ".ppm"):
        name = f"a{suffix}"
        data = _encoded(suffix, TOUCHED if suffix in (".png", ".pgm") else colour)
        sealed = partial(_sealed_png, data) if suffix == ".png" else None
        kinds[suffix[1:]] = Kind({name: data}, (name,), partial(_read_picture, name), sealed=sealed)
    return kinds


def _read_picture(name: str, folder: Path) -> Any:
    return bytes_of(read_image(folder / name))


def _sealed_png(data: bytes, draw: random.Random, _junk: Junk) -> Files:
    """Make a PNG with other sizes and bit depths, and a right checksum of its first chunk."""
    sides = (0, 1, 119, 161, 8192, 8193, 30_000, 2**31 - 1, 2**32 - 1)
    head = struct.pack(">4s2I5B", b"IHDR", draw.choice(sides), draw.choice(sides), *draw.choices(range(17), k=5))
    return {"a.png": data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:]}


# Sessions and recordings.


def _session(root: Path) -> Kind:
    file = StitchFile.create(root / "one", SessionInfo("one", 5, 77, 20.0, SENSOR_ID))
    for k, pose in enumerate(grid_poses()[:3]):
        file.append(press_of(pose, k), pose)
    file.close()
    files = _inside(root)
    names = (f"one/{SESSION}", f"one/{PRESSES}")
    return Kind(files, names, _read_session, True, partial(_sealed_session, files))


def _read_session(folder: Path) -> Any:
    """Read a session as the daemon resumes it, which also makes the map."""
    if open_session(folder, SENSOR_ID) is None:
        return None
    _, presses = StitchFile.resume(folder / "one")
    Session.resume(folder, SENSOR_ID)
    return [(bytes_of(p.points_mm), bytes_of(p.normals), bytes_of(p.confidence), pose.seven()) for p, pose in presses]


def _sealed_session(files: Files, draw: random.Random, junk: Junk) -> Files:
    if draw.random() < 0.5:
        info = {**msgspec.json.decode(files[f"one/{SESSION}"]), "crc32": 0}
        info[draw.choice(list(info))] = junk(draw)
        if "crc32" in info and draw.random() < 0.9:
            info["crc32"] = zlib.crc32(msgspec.json.encode({**info, "crc32": 0}))
        return {f"one/{SESSION}": msgspec.json.encode(info)}
    values = np.frombuffer(draw.randbytes(8 * 12), "<f8")
    if draw.random() < 0.5:
        odd = (np.nan, np.inf, 1e300, 1e6, -1e6, 0.0, 1.0)
        values = np.array([draw.choice(odd) for _ in range(12)], "<f8")
    points = np.frombuffer(draw.randbytes(28 * 5), "<f4")
    if draw.random() < 0.5:
        points = np.array([draw.choice((np.nan, -1e6, 1e6, 0.0, 1e-30, 5.0)) for _ in range(35)], "<f4")
    body = values.tobytes() + points.tobytes()
    record = struct.pack("<4sII", b"TCSP", len(body), zlib.crc32(body)) + body
    return {f"one/{PRESSES}": files[f"one/{PRESSES}"] + record}


def _recording(root: Path) -> Kind:
    folder = root / "rec"
    recorder = Recorder(folder, free_floor_bytes=0)
    recorder.begin("sensor_id: a\n", painted_calibration())
    for k, image in enumerate((FREE, TOUCHED, FREE, TOUCHED)):
        pose = Pose(1000 + 7 * k, 0.1, -3.0, 1.0, 0.6, 0.0, -0.8, 0.0) if k % 2 else None
        recorder.add(Frame(k, 1000 + 7 * k, 5, image, pose, 4 if pose else 0), png_of(image))
    recorder.event(1001, "source", {"state": "away"})
    recorder.finish({"frames": 4})
    files = {name: data for name, data in _inside(root).items() if name.startswith("rec/")}
    damaged = tuple(name for name in files if not name.endswith((".yaml", ".npz")))
    return Kind(files, damaged, _read_recording, checked=True)


def _read_recording(folder: Path) -> Any:
    recording = Recording(folder / "rec")
    read: list[Any] = []
    if recording.damage:
        _log.warning("%s", recording.damage)  # `replay` and `export` print this line
    while True:
        try:
            if (recorded := recording.read()) is None:
                return read
        except DecodeError as error:
            _log.warning("frame passed over: %s", error)  # the daemon counts such a frame as `failed`
            continue
        frame = recorded.frame
        read.append((frame.t_ns, bytes_of(frame.image), frame.pose))


@dataclass(slots=True)
class Read:
    """The result of reading one input: the value or the error, and the warnings."""

    value: Any = None
    error: str = ""
    told: list[str] = field(default_factory=list)
