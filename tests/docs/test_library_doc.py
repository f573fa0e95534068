"""docs/reference/library.md: its examples run as they are written,
with the simulated sensor and a real broker.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import tacshade_edge as ts
from support.calibrated_sensor import FULL, calibrated, pressed, unloaded
from support.mqtt_rig import Broker, Subscriber
from support.patience import patience
from support.recordings import record_hand
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main

TEXT = (Path(__file__).parents[2] / "docs/reference/library.md").read_text()
README = (Path(__file__).parents[2] / "README.md").read_text()
REPLAY = (Path(__file__).parents[2] / "docs/how-to/replay.md").read_text()
EXAMPLES = dict(
    re.findall(r"^## ([^\n]+)\n[^#]*?```python\n(.*?)```", TEXT, re.DOTALL | re.MULTILINE)
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as a person would have it: calibration, settings, an image, a recording."""
    pytest.importorskip("matplotlib", reason="the extra studies is not installed")
    folder = tmp_path_factory.mktemp("library")
    (recording := folder / "recording").mkdir()
    for path in (folder / "cal.npz", recording / "calibration.npz"):
        calibration_file.save(path, calibrated(FULL, 0))
    for path in (folder / "press.png", recording / "1.png"):
        cv2.imwrite(str(path), pressed("cube", 2.0, FULL).image)
    cv2.imwrite(str(recording / "0.png"), unloaded(FULL))
    (folder / "config.yaml").write_text(
        "calibration: cal.npz\nsource: {kind: simulated}\nsensor_id: left-index\n"
    )
    return folder


def run(title: str, folder: Path, monkeypatch: pytest.MonkeyPatch, **other: str) -> dict[str, Any]:
    """What an example leaves behind."""
    return executed(EXAMPLES[title], title, folder, monkeypatch, **other)


def executed(
    code: str, title: str, folder: Path, monkeypatch: pytest.MonkeyPatch, **other: str
) -> dict[str, Any]:
    for written, here in other.items():
        assert code.count(written) == 1
        code = code.replace(written, here)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, Any] = {}
    exec(compile(code, title, "exec"), names)
    return names


def test_an_image(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run("An image to a picture", made, monkeypatch)
    assert re.fullmatch(r"1 object\(s\), deepest [12]\.\d\d mm\n", capsys.readouterr().out)
    drawn = cv2.imread(str(made / "press_height.png"))
    assert drawn is not None
    assert drawn.std() > 10


def test_a_camera(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = run("A camera", made, monkeypatch)
    assert names["r"].depth_max_mm > 0.1
    assert names["sensor"].passed_over >= 0


def test_a_recording(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    depth_mm = run("A recording", made, monkeypatch)["depth_mm"]
    assert depth_mm[0] == 0
    assert depth_mm[1] > 1


def test_a_hand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for recording in record_hand(tmp_path):
        recording.rename(tmp_path / "grasp")
        (finger := tmp_path / "rec" / recording.name).mkdir(parents=True)
        (tmp_path / "grasp").rename(finger / "grasp")
    run("A hand", tmp_path, monkeypatch)
    printed = capsys.readouterr().out.splitlines()
    assert printed
    assert all(re.fullmatch(r"\d+ \(.*\) \(.*\)", line) for line in printed)


def test_messages_and_files(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(made / "recording"), "--out", str(made / "RUN")]) == 0
    capsys.readouterr()
    run("Messages and files, decoded", made, monkeypatch)
    rows, cols = ts.load(made / "cal.npz").reconstruct(made / "press.png").height_mm.shape
    printed = capsys.readouterr().out.splitlines()
    assert [line.split(maxsplit=2)[::2] for line in printed] == [
        [str(k), f"({rows}, {cols})"] for k in (0, 1)
    ]
    (code,) = re.findall(r"```python\n(.*?)```", REPLAY, re.DOTALL)
    executed(code, "replay.md", made, monkeypatch)
    said = [line.split()[:2] for line in capsys.readouterr().out.splitlines()]
    assert [what for _, what in said[:2] + said[4:]] == ["deepest", "deepest", "dragged", "dragged"]


def test_the_formula_from_a_cell_to_millimetres(made: Path) -> None:
    """The page's equation, with its names."""
    r = ts.load(made / "cal.npz").reconstruct(made / "press.png")
    g, d = r.geometry, r.geometry.camera_distance_mm
    assert d is not None
    i, j = np.indices(r.height_mm.shape)
    u = (r.col0 + j * r.step_px - g.disc.col_c) / g.f_px
    v = (r.row0 + i * r.step_px - g.disc.row_c) / g.f_px
    k = 1 + u**2 + v**2
    s = (d + np.sqrt(k * (g.skin_radius_mm - r.height_mm) ** 2 - d**2 * (u**2 + v**2))) / k
    np.testing.assert_allclose(np.stack((s * u, s * v, s - d), axis=-1), r.skin_mm(), atol=1e-3)


def test_the_marked_keys_are_those_that_the_command_writes(made: Path, tmp_path: Path) -> None:
    rows = re.findall(r"^\| ([^|]*•[^|]*)\|", TEXT, re.MULTILINE)
    words = [
        "--calibration",
        str(made / "cal.npz"),
        "--out",
        str(tmp_path),
        str(made / "press.png"),
    ]
    assert main(["reconstruct", *words]) == 0
    with np.load(tmp_path / "press.npz") as written:
        assert sorted(re.findall(r"`(\w+)`", " ".join(rows))) == sorted(written.files)


class PrintedError(Exception):
    """Ends the README's loop, which has no end of its own."""


def first_line_of_the_readme(address: str) -> tuple[Any, ...]:
    """What the README's three lines print first."""
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert code.count('"localhost:1883", "tacshade"') == 1

    def shown(*values: Any) -> None:
        raise PrintedError(*values)

    with pytest.raises(PrintedError) as printed:
        exec(
            code.replace('"localhost:1883", "tacshade"', f'"{address}", "left-index"'),
            {"print": shown},
        )
    return printed.value.args


@pytest.mark.broker
def test_a_running_sensor(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Broker(tmp_path) as broker:
        settings = made / "run.yaml"
        settings.write_text(
            (made / "config.yaml").read_text() + f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
        )
        daemon = subprocess.Popen(
            [sys.executable, "-m", "tacshade_edge", "run", "--config", str(settings)]
        )
        try:
            address = {"localhost:1883": f"127.0.0.1:{broker.port}"}
            with Subscriber(broker.port) as seen:
                seen.wait_for("tacshade/left-index/contact", 1, 30)
            names = run("A running sensor", made, monkeypatch, **address)
            first = first_line_of_the_readme(address["localhost:1883"])
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait(patience(10))
    assert first[0] >= 0
    assert first[1] >= 0
    assert names["r"].points_mm.shape[0] > 10
    assert names["r"].geometry.skin_radius_mm == FULL.skin_radius_mm
