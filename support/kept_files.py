"""The files that the program promises to keep: how each is written, and what is found in it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from support.painted_sensor import FREE, TOUCHED, painted_calibration
from tacshade_edge.calibration.ageing.wears import COLUMNS, History
from tacshade_edge.calibration.files import (
    ageing_file,
    calibration_file,
    objects_file,
    reference_file,
)
from tacshade_edge.calibration.files.capture_folder import CaptureFolder
from tacshade_edge.calibration.files.labels import LabelFolder, LabelRow, read_labels
from tacshade_edge.calibration.files.press_table import Stated
from tacshade_edge.calibration.files.reference_file import StoredReference
from tacshade_edge.recording.exports.table_export import csv_export, ply_export
from tacshade_edge.recording.recording import RecordedFrame, Recording
from tacshade_edge.recording.runs import RunWriter, payloads, read_summary
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.stitching.map_files import write_map
from tacshade_edge.stitching.stitcher import Raster
from tacshade_edge.types import Frame, KnownObject, Reconstruction

OLD, NEW = "old", "new"
SMALL = np.zeros((8, 8), np.uint8)
CALIBRATION = painted_calibration()


@dataclass(frozen=True)
class Kept:
    """A file: how it is written with what, and what it is found to hold."""

    write: Callable[[Path, str], None]
    read: Callable[[Path], str]
    news: Callable[[Path], set[str]] = lambda _: set()
    """What may be there beside the old and the new one: what was acknowledged before the error."""


def write_calibration(folder: Path, what: str) -> None:
    made = replace(CALIBRATION, noise_grey=1.0 if what == OLD else 2.0)
    calibration_file.save(folder / "cal.npz", made)


def read_calibration(folder: Path) -> str:
    return OLD if calibration_file.load(folder / "cal.npz").noise_grey == 1.0 else NEW


def write_reference(folder: Path, what: str) -> None:
    stored = StoredReference(CALIBRATION, 1 if what == OLD else 2)
    reference_file.save(folder / "cal.reference.npz", CALIBRATION, stored)


def read_reference(folder: Path) -> str:
    found = reference_file.load(folder / "cal.reference.npz", CALIBRATION)
    assert found is not None
    return OLD if found.wall_ns == 1 else NEW


def write_history(folder: Path, what: str) -> None:
    looks = np.full((1, len(COLUMNS)), float(what == NEW), np.float32)
    history = History(np.array([20_000], np.int32), looks)
    ageing_file.save(folder / "cal.ageing.npz", CALIBRATION, history)


def read_history(folder: Path) -> str:
    found = ageing_file.load(folder / "cal.ageing.npz", CALIBRATION)
    return NEW if found.looks[0, 0] else OLD


def write_objects(folder: Path, what: str) -> None:
    known = {"fast": (KnownObject(what, np.ones((2, 3), np.float32)),)}
    objects_file.save(folder / "cal.objects.npz", known)


def read_objects(folder: Path) -> str:
    (known,) = objects_file.load(folder / "cal.objects.npz")["fast"]
    return known.name


def write_presses(folder: Path, what: str) -> None:
    capture = CaptureFolder(folder)
    if what == OLD:
        capture.write(capture.sensor, "skin_radius_mm: 20\n")
    capture.add(capture.taken(), SMALL, Stated(("ball", "4", "1", "0", "0")))


def read_captured(folder: Path) -> str:
    return OLD if len(CaptureFolder(folder).taken()) == 1 else NEW


def write_labels(folder: Path, what: str) -> None:
    labels = LabelFolder(folder)
    rows = labels.rows()
    labels.write([*rows, LabelRow(labels.add_image(SMALL), {"force_z_n": 1.0}, "1")])


def read_labelled(folder: Path) -> str:
    rows = read_labels(folder / "LABELS.csv", folder)
    assert all(row.path.is_file() for row in rows)
    return OLD if len(rows) == 1 else NEW


def write_rest(folder: Path, what: str) -> None:
    capture = CaptureFolder(folder)
    capture.begin_rest()
    for number in range(2 if what == OLD else 3):
        capture.add_rest(number, SMALL)
    capture.finish_rest()


def read_rest(folder: Path) -> str:
    # An earlier one is removed before the new one gets its name.
    return {0: "none", 2: OLD, 3: NEW}[len(CaptureFolder(folder).rest_pictures())]


def a_raster(what: str) -> Raster:
    return Raster(np.full((4, 5), 1 if what == OLD else 2, np.float32), 0.0, 0.0, 0.25)


def write_a_map(folder: Path, what: str) -> None:
    write_map(folder, a_raster(what), {"of": what})


def read_map(folder: Path) -> str:
    """Without a manifest, the files may be of two maps, and are made again."""
    if not (folder / "map.json").exists():
        return "none"
    what = str(json.loads((folder / "map.json").read_text())["of"])
    with np.load(folder / "map.npz") as found:
        np.testing.assert_array_equal(found["z_mm"], a_raster(what).z_mm)
    return what


FRAMES = [Frame(k, 500 + k, 0, image) for k, image in enumerate((FREE, TOUCHED, FREE))]


def results() -> list[tuple[RecordedFrame, Reconstruction]]:
    made = make_reconstructor(CALIBRATION, PROFILES["fast"])
    return [(RecordedFrame(f"{each.seq}.png", each, 0), made.step(each)) for each in FRAMES]


RESULTS = results()


def write_run(folder: Path, what: str) -> None:
    run = RunWriter(folder / "run", calibration_crc32=1)
    try:
        for each in RESULTS[: 2 if what == OLD else 3]:
            run.add(*each)
        run.finish({})
    finally:
        run.discard()


def read_run(folder: Path) -> str:
    # An earlier run is removed at once.
    if not (folder / "run/summary.json").exists():
        return "none"
    count = len(read_summary(folder / "run"))
    assert len(list(payloads(folder / "run", "heights.bin"))) == count
    return OLD if count == 2 else NEW


def write_csv(folder: Path, what: str) -> None:
    if what == NEW:
        with csv_export(folder / "new.csv", ()) as add:
            for each in RESULTS:
                add(*each)


def read_csv(folder: Path) -> str:
    if not (folder / "new.csv").exists():
        return OLD
    assert len((folder / "new.csv").read_text().splitlines()) == 1 + len(RESULTS)
    return NEW


def write_mcap(folder: Path, what: str) -> None:
    from tacshade_edge.recording.exports.mcap_export import mcap_export

    about = {"sensor_id": "left", "profile": "fast", "content": {"settings.yaml": b"a: 1\n" * 999}}
    if what == NEW:
        with mcap_export(folder / "new.mcap", calibration=CALIBRATION, **about) as add:  # type: ignore[arg-type]
            for each in RESULTS:
                add(*each)


def read_mcap(folder: Path) -> str:
    if not (folder / "new.mcap").exists():
        return OLD
    recording = Recording(folder / "new.mcap")
    assert not recording.cut_off
    assert not recording.damage
    found = list(iter(recording.next_entry, None))
    for entry, frame in zip(found, FRAMES, strict=True):
        np.testing.assert_array_equal(entry.picture(), frame.image)
    return NEW


def write_ply(folder: Path, what: str) -> None:
    if what == NEW:
        with ply_export(folder / "ply") as add:
            for each in RESULTS:
                add(*each)


def read_ply(folder: Path) -> str:
    if not (folder / "ply").exists():
        return OLD
    (found,) = (folder / "ply").iterdir()
    with ply_export(folder / "again") as add:
        add(*RESULTS[1])
    assert found.read_bytes() == (folder / "again" / found.name).read_bytes()
    return NEW


KEPT = {
    "calibration": Kept(write_calibration, read_calibration),
    "reference": Kept(write_reference, read_reference),
    "history": Kept(write_history, read_history),
    "objects": Kept(write_objects, read_objects),
    "presses": Kept(write_presses, read_captured),
    "labels": Kept(write_labels, read_labelled),
    "rest": Kept(write_rest, read_rest, lambda _: {"none"}),
    "map": Kept(write_a_map, read_map, lambda _: {"none"}),
    "run": Kept(write_run, read_run, lambda _: {"none"}),
    "csv": Kept(write_csv, read_csv),
    "ply": Kept(write_ply, read_ply),
}
if find_spec("mcap") and find_spec("foxglove_schemas_protobuf"):
    KEPT["mcap"] = Kept(write_mcap, read_mcap)
