"""tools/testbed/robot.py: where its link may be."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tools.testbed import robot


def test_a_link_that_the_settings_refuse_is_refused_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["robot.py", "--link", str(tmp_path / "robot")])
    with pytest.raises(SystemExit, match="2"):
        robot.main()
    said = capsys.readouterr().err
    assert f"--link: found {tmp_path}/robot, expected a path such as /dev/shm/robot: serial.device takes" in said
    assert not (tmp_path / "robot").exists()
