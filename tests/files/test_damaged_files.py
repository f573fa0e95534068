"""Files of every kind that we read, damaged: reading gives a value or one line,
and what has a checksum reports it.
"""

from __future__ import annotations

import io
import logging
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import at_most
from support.networks import fitted_with

from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import calibration_file, reference_file
from tacshade_edge.calibration.files.calibration_file import packed
from tacshade_edge.calibration.files.indenter_file import read_indenters
from tacshade_edge.calibration.files.labels import read_labels
from tacshade_edge.calibration.files.press_table import read_presses
from tacshade_edge.calibration.files.reference_file import LearntLimits, StoredReference, limited
from tacshade_edge.calibration.files.sensor_file import read_sensor
from tacshade_edge.calibration.inputs import Inputs, KnownPress, StatedSensor
from tacshade_edge.errors import DecodeError, TacshadeError
from tacshade_edge.files import npz
from tacshade_edge.files.images import read_image
from tacshade_edge.files.meshes import read_stl, stl_bytes
from tacshade_edge.files.npz import Content
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
from tacshade_edge.types import Frame, Pose, RestLimits
from tools.testbed.bumpy_surface import grid_poses, press_of
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

CONFIG = Path(__file__).parents[2] / "config" / "default.yaml"
SENSOR_ID = "finger"
LINE_CHARS_MAX = 2000
_log = logging.getLogger("tacshade_edge.damaged_files")
Files = dict[str, bytes]
JUNK = (
    None,
    True,
    0,
    -1,
    2**31,
    2**63,
    2**64,
    0.0,
    -0.0,
    1e-300,
    1e300,
    float("nan"),
    float("inf"),
    45.0,
    "",
    "x",
    "nan",
    "\x00",
    "\n\x1b[31m",
    "../../x",
    "a" * 5000,
    [],
    {},
    [None],
    [0.0] * 7,
    [1e300] * 7,
    {"a": 1},
)
WORDS = (
    "",
    "0",
    "-1",
    "1e300",
    "nan",
    "inf",
    "9" * 400,
    "0x10",
    "1_0",
    "null",
    "~",
    "[]",
    "{}",
    "[[[",
    "&a [*a]",
    "*a",
    "!!python/object:os.system",
    "\t",
    "\x00",
    "\x1b[2J",
    "'",
    '"',
    ",",
    ":",
    "#",
    "- -",
    "é",
    "٣",
    "[" * 100_000,
)


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


@cache
def kinds() -> dict[str, Kind]:
    """Every kind of file, made once."""
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
    with TemporaryDirectory() as name:
        root, plain = Path(name), painted_calibration()
        sensor = StatedSensor(20.0, 30.0, 50.0, "bright")
        inputs = Inputs(sensor, (FREE, FREE), (KnownPress("press", TOUCHED, 4.0, 1.5, 0.0, 0.0),))
        for kind, calibration in (
            ("calibration", plain),
            ("fitted calibration", fitted_with("fast", plain, 0.0)),
        ):
            calibration_file.save(root / "c.npz", calibration, inputs)
            made[kind] = Kind(
                {"c.npz": (root / "c.npz").read_bytes()}, read_calibration, checked=True
            )
        learnt = LearntLimits(*[RestLimits(120, 1e-4, 0.03, 0.01, 0.3)] * 2)
        limits = {"fast": learnt}
        reference = StoredReference(limited(plain, limits), 5, limits=limits)
        reference_file.save(root / "c.reference.npz", plain, reference)
        files = {"c.reference.npz": (root / "c.reference.npz").read_bytes()}
        made["stored reference"] = Kind(files, read_reference, checked=True)
        session = StitchFile.create(
            root / "session/one", SessionInfo("one", 5, 77, 20.0, SENSOR_ID)
        )
        for k, pose in enumerate(grid_poses()[:3]):
            session.append(press_of(pose, k), pose)
        session.close()
        files = inside(root / "session")
        made["session"] = Kind(
            files, read_session, (f"one/{SESSION}", f"one/{PRESSES}"), checked=True
        )
        recorder, mcap = RecordingWriter(root / "rec"), io.BytesIO()
        recorder.begin("sensor_id: a\n", packed(plain))
        writer = McapWriter(mcap, "left", chunk_bytes=1 << 14)
        writer.attach("calibration.npz", packed(plain), 5)
        for k, image in enumerate((FREE, TOUCHED, FREE, TOUCHED)):
            pose = Pose(1000 + 7 * k, 0.1, -3.0, 1.0, 0.6, 0.0, -0.8, 0.0) if k % 2 else None
            frame = Frame(k, 1000 + 7 * k, 5, image, pose, 4 if pose else 0)
            recorder.add(frame, png_of(image))
            writer.frame(f"{k:06d}.png", frame, png_of(image), 5)
        recorder.finish({"frames": 4})
        writer.finish()
        files = inside(root / "rec")
        damaged = tuple(name for name in files if not name.endswith((".yaml", ".npz")))
        made["recording"] = Kind(files, partial(read_recording, ""), damaged, checked=True)
        made["MCAP"] = Kind(
            {"a.mcap": mcap.getvalue()}, partial(read_recording, "a.mcap"), checked=True
        )
    return made


NAMES = (
    *TEXTS,
    "own.stl",
    *PICTURES,
    "calibration",
    "fitted calibration",
    "stored reference",
    "session",
)
NAMES += ("recording", "MCAP")


@st.composite
def damage(draw: st.DrawFn, content: bytes, text: bool) -> bytes:
    """Damage in one place: flipped bits, a cut, a hole, other bytes, an impossible number,
    or another word.
    """
    at = draw(st.integers(0, len(content)) | st.integers(0, min(len(content), 200)))
    size = draw(st.integers(1, 64))
    way = draw(
        st.sampled_from(("flip", "cut", "hole", "put", "zeros", "number", *("word",) * 6 * text))
    )
    rest = content[at + size :]
    if way == "word":
        words = content.replace(b",", b" , ").replace(b"\n", b" \n ").split(b" ")
        words[draw(st.integers(0, len(words) - 1))] = draw(st.sampled_from(WORDS)).encode()
        return b" ".join(words).replace(b" , ", b",").replace(b" \n ", b"\n")
    if way == "flip":
        return (
            content[:at]
            + bytes(byte ^ 1 << draw(st.integers(0, 7)) for byte in content[at : at + 1])
            + content[at + 1 :]
        )
    put = {
        "put": draw(st.binary(min_size=size, max_size=size)),
        "zeros": bytes(size),
        "number": draw(st.sampled_from((b"\xff" * 4, b"\xff\xff\xff\x7f", b"\x7f\xff\xff\xff"))),
    }
    return content[:at] + put.get(way, b"") + (b"" if way == "cut" else rest)


@contextmanager
def warnings_kept() -> Iterator[list[str]]:
    """Keep the log's warnings instead of writing them."""
    lines: list[str] = []
    handler, logger = logging.Handler(logging.WARNING), logging.getLogger("tacshade_edge")
    handler.emit = lambda record: lines.append(record.getMessage())  # type: ignore[method-assign]
    logger.addHandler(handler)
    logger.propagate = False
    try:
        yield lines
    finally:
        logger.removeHandler(handler)
        logger.propagate = True


def read(kind: Kind, changed: Files) -> tuple[Any, list[str]]:
    """Read files as the program does; the value is None and the last line is the error
    if it refuses them.
    """
    with TemporaryDirectory(dir="/dev/shm") as name, warnings_kept() as lines:
        for path, content in (kind.files | changed).items():
            (Path(name) / path).parent.mkdir(parents=True, exist_ok=True)
            (Path(name) / path).write_bytes(content)
        try:
            return kind.read(Path(name)), lines
        except TacshadeError as error:
            return None, [*lines, str(error)]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=at_most(200))
@given(data=st.data())
def test_a_damaged_file_is_used_or_refused_in_one_line(name: str, data: st.DataObject) -> None:
    kind = kinds()[name]
    good, _ = read(kind, {})
    assert good is not None
    file = data.draw(st.sampled_from(kind.damaged or tuple(kind.files)[:1]))
    content = kind.files[file]
    for _ in range(data.draw(st.sampled_from((1, 1, 2, 5)))):
        content = data.draw(damage(content, file.endswith((".yaml", ".csv", ".json"))))
    value, lines = read(kind, {file: content})
    assert all("\n" not in line and len(line) < LINE_CHARS_MAX for line in lines)
    # Presses that are cut off between two of them are presses that were not written yet.
    begun = name == "session" and value is not None and value == good[: len(value)]
    assert value == good or lines or begun or not kind.checked


@pytest.mark.slow
@pytest.mark.parametrize("name", ["calibration", "fitted calibration", "stored reference"])
@settings(max_examples=at_most(200))
@given(data=st.data())
def test_wrong_content_behind_a_right_checksum_is_used_or_refused_in_one_line(
    name: str, data: st.DataObject
) -> None:
    kind = kinds()[name]
    ((file, packed),) = kind.files.items()
    with TemporaryDirectory() as folder:
        (Path(folder) / file).write_bytes(packed)
        content = npz.read(str(Path(folder) / file), "", "")
    meta, arrays = dict(content.meta), dict(content.arrays)
    part = data.draw(st.sampled_from(("meta", "inner", "array", "gone")))
    key = data.draw(st.sampled_from(sorted(arrays if part == "array" else meta)))
    junk = st.sampled_from(JUNK)
    if part == "array":
        shape = data.draw(st.lists(st.sampled_from((0, 1, 2, 7, 119, 120, 160)), max_size=3))
        arrays[key] = np.full(
            shape,
            data.draw(st.sampled_from((0, 1, 255))),
            data.draw(st.sampled_from(("u1", "f4", "U3"))),
        )
    elif part == "inner" and isinstance(meta[key], dict) and meta[key]:
        meta[key] = {**meta[key], data.draw(st.sampled_from(sorted(meta[key]))): data.draw(junk)}
    elif part == "gone":
        del meta[key]
    else:
        meta[key] = data.draw(junk)
    _, lines = read(kind, {file: Content(meta, arrays).packed()})
    assert all("\n" not in line and len(line) < LINE_CHARS_MAX for line in lines)


@pytest.mark.parametrize("sides", [(0, 1), (8193, 8193), (30_000, 30_000), (2**31 - 1, 2**32 - 1)])
def test_a_png_that_states_another_size_behind_a_right_checksum(sides: tuple[int, int]) -> None:
    kind = kinds()[".png"]
    ((file, content),) = kind.files.items()
    head = struct.pack(">4s2I5B", b"IHDR", *sides, 8, 0, 0, 0, 0)
    value, lines = read(
        kind, {file: content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:]}
    )
    assert value is None
    assert "\n" not in lines[-1]
