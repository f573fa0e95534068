from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest
from mqtt_rig import wait_until
from painted_sensor import FREE, TOUCHED, painted_calibration

import tacshade_edge.cli.record as command
from tacshade_edge.cli import main
from tacshade_edge.devices import calibration_file
from tacshade_edge.devices.images import read_image
from tacshade_edge.devices.recording import read_table


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "images").mkdir()
    for i, image in enumerate([FREE] * 3 + [TOUCHED] * 5):
        cv2.imwrite(str(tmp_path / "images" / f"{i}.png"), image)
    return tmp_path


@pytest.fixture(autouse=True)
def signals() -> Iterator[None]:
    """The command takes the signals of its process, which is ours here."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def words(folder: Path, seconds: str = "30", source: str = "kind: files, path: images, fps: 50") -> list[str]:
    (folder / "s.yaml").write_text(f"calibration: c.npz\nsource: {{{source}}}\n")
    return ["record", "--config", str(folder / "s.yaml"), "--out", str(folder / "rec"), "--seconds", seconds]


def about(folder: Path) -> dict[str, Any]:
    read: dict[str, Any] = json.loads((folder / "rec" / "recording.json").read_text())
    return read


def test_a_recording_has_all_that_a_replay_needs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words(folder)) == 0
    rec = folder / "rec"
    assert capsys.readouterr().out == f"{rec}: {about(folder)['frames']} frames (source ended)\n"
    rows = read_table(rec / "frames.csv")
    assert len(rows) == about(folder)["frames"] == 8 - about(folder)["superseded"]
    assert rows[0].t_ns == about(folder)["first_t_ns"]
    images = [read_image(rec / row.image).tobytes() for row in rows]
    assert set(images) <= {FREE.tobytes(), TOUCHED.tobytes()}
    assert images[-1] == TOUCHED.tobytes()  # the last frame was waited for
    assert (rec / "settings.yaml").read_bytes() == (folder / "s.yaml").read_bytes()
    given = ["replay", str(rec), "--calibration", str(rec / "calibration.npz"), "--out", str(folder / "run")]
    assert main(given) == 0
    records = json.loads((folder / "run" / "summary.json").read_text())
    assert [r["t_ns"] for r in records] == [row.t_ns for row in rows]
    assert records[-1]["contact"]


def test_the_time_ends_it(folder: Path) -> None:
    assert main(words(folder, "0.3", "kind: files, path: images, fps: 50, loop: true")) == 0
    assert about(folder)["ending"] == "time"
    rows = read_table(folder / "rec" / "frames.csv")
    assert (rows[-1].t_ns - rows[0].t_ns) / 1e9 < 5


def test_a_disk_at_its_floor_ends_it(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "FREE_FLOOR_BYTES", 2**62)
    assert main(words(folder)) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert f"{folder / 'rec'}: stopped with less than" in err
    assert about(folder)["ending"] == "disk"
    assert about(folder)["frames"] == 0


def test_nothing_came(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words(folder, "0.2", "kind: v4l2, device: /dev/video99, width_px: 160, height_px: 120")) == 1
    assert "source away: camera /dev/video99: no such device" in capsys.readouterr().err


def test_a_folder_in_use_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "rec").mkdir()
    (folder / "rec" / "note.txt").touch()
    assert main(words(folder)) == 78
    assert "rec: found note.txt in it, expected a new or empty folder" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main(words(folder, "0"))
    assert stop.value.code == 2


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(folder: Path, number: signal.Signals) -> None:
    given = words(folder, "60", "kind: files, path: images, fps: 50, loop: true")
    child = subprocess.Popen([sys.executable, "-m", "tacshade_edge", *given], stderr=subprocess.PIPE, text=True)
    try:
        wait_until(lambda: (folder / "rec" / "000010.png").exists(), 30, "ten frames")
        child.send_signal(number)
        _, errors = child.communicate(timeout=20)
    finally:
        child.kill()
    assert (child.returncode, errors) == (0, "")
    assert about(folder)["ending"] == "stopped"
    assert len(read_table(folder / "rec" / "frames.csv")) == about(folder)["frames"] > 10
    assert not list((folder / "rec").glob("*.part"))
