"""A board's backup, restored on another board."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from support.patience import patience
from tacshade_edge.cli import main
from tacshade_edge.daemon import board_backup
from tacshade_edge.files.targets import one_at_a_time


@pytest.fixture
def board(tmp_path: Path) -> Path:
    """A board with one sensor: paths that count from the settings, a map, objects, a history."""
    folder = tmp_path / "board"
    (folder / "maps" / "pad-1").mkdir(parents=True)
    (folder / "config.yaml").write_text(
        "sensor_id: left\ncalibration: cal.npz\nstitching: {folder: maps}\n"
    )
    (folder / "cal.npz").write_bytes(b"calibration")
    (folder / "cal.objects.npz").write_bytes(b"objects")
    (folder / "cal.ageing.npz").write_bytes(b"ageing")
    (folder / "maps" / "pad-1" / "map.ply").write_bytes(b"map")
    return folder


def backed_up(board: Path) -> Path:
    out = board.parent / "board.zip"
    assert main(["backup", str(out), "--config", str(board / "config.yaml")]) == 0
    return out


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_another_board_gets_all_of_it(
    board: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = backed_up(board)
    assert "5 files; passwords and certificates are not in it" in capsys.readouterr().out
    other = tmp_path / "other"
    (other / "maps").mkdir(parents=True)
    (other / "config.yaml").write_text("sensor_id: new\n")
    words = ["backup", "--restore", str(out), "--config", str(other / "config.yaml")]
    assert main(words) == 0
    assert "5 files restored; next: sudo systemctl restart" in capsys.readouterr().out
    assert contents(other) == contents(board) | {"config.yaml.replaced": b"sensor_id: new\n"}
    assert main(words) == 0
    assert capsys.readouterr().out.startswith("0 files restored")


@pytest.mark.slow
def test_of_two_backups_at_once_one_is_whole_and_the_other_is_told(board: Path) -> None:
    (board / "maps" / "pad-1" / "large").write_bytes(os.urandom(32 << 20))
    out = board.parent / "board.zip"
    words = ["backup", str(out), "--config", str(board / "config.yaml")]
    both = [
        subprocess.Popen([sys.executable, "-m", "tacshade_edge", *words], stderr=subprocess.PIPE)
        for _ in range(2)
    ]
    said = [each.communicate(timeout=patience(60))[1].decode() for each in both]
    codes = [each.returncode for each in both]
    assert sorted(codes)[0] == 0
    assert sorted(codes)[1] in (1, 78), said
    refusal = said[codes.index(max(codes))]
    assert re.search(r"another backup \(pid \d+\) is writing|already exists", refusal)
    with zipfile.ZipFile(out) as file:
        assert file.testzip() is None
    assert sorted(path.name for path in out.parent.iterdir()) == ["board", "board.zip"]


@pytest.mark.parametrize("restore", [(), ("--restore",)])
def test_a_second_one_is_told_who_is_there(
    board: Path, restore: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    config, out = board / "config.yaml", backed_up(board)
    with one_at_a_time(config if restore else out, "backup", "busy with"):
        before = contents(board)
        assert main(["backup", *restore, str(out), "--config", str(config)]) == 1
        assert contents(board) == before
    assert f"another backup (pid {os.getpid()}) is busy with" in capsys.readouterr().err


def test_a_backup_that_no_restore_takes_is_not_written(
    board: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with zipfile.ZipFile(backed_up(board)) as file:
        size = sum(each.file_size for each in file.infolist())
    (board.parent / "board.zip").unlink()
    monkeypatch.setattr(board_backup, "_BYTES_MAX", size - 1)
    words = ["backup", str(board.parent / "board.zip"), "--config", str(board / "config.yaml")]
    assert main(words) == 78
    said = capsys.readouterr().err
    assert "expected what a restore takes; keep old folders of maps elsewhere" in said
    assert [path.name for path in board.parent.iterdir()] == ["board"]
    monkeypatch.setattr(board_backup, "_BYTES_MAX", size)
    out = backed_up(board)
    assert main(["backup", "--restore", str(out), "--config", str(board / "config.yaml")]) == 0


def test_a_backup_is_never_overwritten(board: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = backed_up(board)
    assert main(["backup", str(out), "--config", str(board / "config.yaml")]) == 78
    assert f"{out}: already exists, expected a new name" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("left/maps/../../stolen", b"x", "found left/maps/../../stolen, expected a file of one"),
        ("right/calibration.npz", b"x", "found right/calibration.npz, expected a file of one"),
        ("left/other.npz", b"x", "expected a file of one of the sensors in its settings.yaml"),
    ],
)
def test_what_belongs_nowhere_is_refused_before_anything_is_written(
    board: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
    content: bytes,
    said: str,
) -> None:
    out = backed_up(board)
    with zipfile.ZipFile(out, "a") as file:
        file.writestr(name, content)
    config = tmp_path / "other" / "config.yaml"
    assert main(["backup", "--restore", str(out), "--config", str(config)]) == 1
    assert said in capsys.readouterr().err
    assert contents(config.parent) == {}


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda data: data[: len(data) // 2], "not a zip file"),
        (lambda data: data[:60] + bytes([data[60] ^ 255]) + data[61:], "board.zip: "),
        (lambda _: b"", "not a zip file"),
    ],
)
def test_a_damaged_backup_is_one_line(
    board: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: object, said: str
) -> None:
    out = backed_up(board)
    assert callable(damage)
    out.write_bytes(damage(out.read_bytes()))
    config = tmp_path / "other" / "config.yaml"
    assert main(["backup", "--restore", str(out), "--config", str(config)]) == 1
    line = capsys.readouterr().err.splitlines()[-1]
    assert said in line
    assert "expected a file that `tacshade-edge backup` wrote" in line
    assert main(["backup", "--restore", str(tmp_path / "none"), "--config", str(config)]) == 1
    assert "none: No such file or directory, expected a file that" in capsys.readouterr().err
