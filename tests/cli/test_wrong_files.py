"""A sound file of ours, given where another kind is expected: one line that names what it is, or
shows what it begins with, and says what was expected; for each kind and each option that takes one.
"""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from support.file_kinds import kinds
from support.painted_sensor import FREE, TOUCHED, painted_calibration
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main

pytestmark = pytest.mark.slow
CALIBRATE = "calibrate --sensor SENSOR.yaml --reference images --out new.npz"
OPTIONS = {
    "reconstruct images --out new --calibration FILE": "calibration",
    "recognise images --calibration FILE": "calibration",
    "doctor images --calibration FILE": "calibration",
    "simulate --mjcf new --calibration FILE": "calibration",
    "calibrate --reference images --out new.npz --rezero FILE": "calibration",
    "calibrate --reference images --out new.npz --sensor FILE": "SENSOR.yaml",
    "calibrate --sensor SENSOR.yaml --out new.npz --reference FILE": "image",
    f"{CALIBRATE} --presses FILE": "PRESSES.csv",
    f"{CALIBRATE} --presses PRESSES.csv --indenters FILE": "INDENTERS.yaml",
    f"{CALIBRATE} --labels FILE": "LABELS.csv",
    "check-config FILE": "settings",
    "stitch --calibration cal.npz --out new --poses FILE": "POSES.csv",
    "stitch --calibration cal.npz --poses POSES.csv --out new --truth FILE": "map",
    "stitch --calibration cal.npz --out new --recording FILE": "MCAP",
    "replay FILE --calibration cal.npz --out new": "MCAP",
    "export FILE --calibration cal.npz --to csv --out new.csv": "MCAP",
    "reconstruct FILE --calibration cal.npz --out new": "image",
    "backup --restore --config new.yaml FILE": "backup",
    "capture new --config config.yaml --plan FILE": "PRESSES.csv",
}
# What the line has to say of each, where the option expects another.
NAMED = {
    "calibration": "a calibration",
    "stored reference": "a stored reference",
    "history of references": "a history of references",
    "image": "a PNG image",
    "MCAP": "an MCAP file",
    "map": "a map of a surface",
    "truth": "ground truth",
    "SENSOR.yaml": "skin_radius_mm",
    "INDENTERS.yaml": "small",
    "settings": "source",
    "PRESSES.csv": "image,",
    "POSES.csv": "image,",
    "LABELS.csv": "image,",
}
# A recording may be one image, and a table of presses is also one of labels, without any.
ALSO = {("image", "MCAP"), ("image", "backup")}


def packed(**arrays: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All that the commands read, and below `given` a file of each kind."""
    folder = tmp_path_factory.mktemp("stage")
    calibration_file.save(folder / "cal.npz", painted_calibration())
    (folder / "SENSOR.yaml").write_text("skin_radius_mm: 20\nvisible_half_angle_deg: 60\n")
    (folder / "images").mkdir()
    for k in range(3):
        cv2.imwrite(str(folder / "images" / f"{k}.png"), TOUCHED if k else FREE)
    header = "image,indenter,radius_mm,depth_mm,x_mm,y_mm\n"
    (folder / "PRESSES.csv").write_text(f"{header}images/1.png,ball,4,1,0,0\n")
    poses = "image,x_mm,y_mm,z_mm,qw,qx,qy,qz\nimages/1.png,0,0,0,1,0,0,0\n"
    (folder / "POSES.csv").write_text(poses)
    settings = {"source": {"kind": "simulated"}, "calibration": "cal.npz"}
    (folder / "config.yaml").write_text(yaml.safe_dump(settings, sort_keys=False))
    known, flat = kinds(), np.zeros((5, 5), np.float32)
    contents = {
        "calibration": (folder / "cal.npz").read_bytes(),
        "stored reference": known["stored reference"].files["c.reference.npz"],
        "history of references": known["history of references"].files["c.ageing.npz"],
        "image": (folder / "images/1.png").read_bytes(),
        "MCAP": known["MCAP"].files["a.mcap"],
        "map": packed(z_mm=flat, x0_mm=0.0, y0_mm=0.0, step_mm=0.5),
        "truth": packed(height_mm=np.zeros((120, 160), np.float32), contact=flat),
        **{name: (folder / name).read_bytes() for name in ("SENSOR.yaml", "PRESSES.csv")},
        "INDENTERS.yaml": b"small: {shape: ball, radius_mm: 3}\n",
        "POSES.csv": poses.encode(),
        "LABELS.csv": b"image,force_z_n,group\nimages/1.png,1,1\n",
        "settings": (folder / "config.yaml").read_bytes(),
    }
    (folder / "given").mkdir()
    for name, content in contents.items():
        (folder / "given" / name).write_bytes(content)
    return folder


@pytest.mark.parametrize("line", OPTIONS)
def test_a_file_of_another_kind_is_one_line_that_names_it(
    line: str,
    stage: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    record_property: Callable[[str, object], None],
) -> None:
    monkeypatch.chdir(stage)
    others = [name for name in NAMED if name != OPTIONS[line] and (name, OPTIONS[line]) not in ALSO]
    record_property("tried", len(others))
    wrong = []
    for name in others:
        words = [f"given/{name}" if word == "FILE" else word for word in line.split()]
        code = main(words)
        said = capsys.readouterr().err
        shutil.rmtree("new", ignore_errors=True)
        if (
            code not in (1, 78)
            or said.count("\n") != 1
            or not said.startswith("tacshade-edge: ")
            or "expected" not in said
            or NAMED[name] not in said
        ):
            wrong.append(f"{name}: {code}: {said}")
    assert not wrong, "\n".join(wrong)
