"""What a new setting does without another line: schema, range, path, rule, restart."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tacshade_edge.cli import EXIT_CONFIG, main
from tacshade_edge.daemon.reloading import reload
from tacshade_edge.settings import load


def check(folder: Path, text: str) -> int:
    (folder / "config.yaml").write_text(f"source: {{kind: simulated}}\n{text}\n")
    return main(["check-config", str(folder / "config.yaml")])


def test_it_is_accepted_and_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert check(tmp_path, "touch_log: log/touches.csv") == 0
    assert load(tmp_path / "config.yaml").settings.touch_log == str(tmp_path / "log/touches.csv")
    assert capfd.readouterr().out.startswith(f"{tmp_path / 'config.yaml'}: ok")
    for text, said in {
        'touch_log: ""': "touch_log: found",
        "touch_log: null\nhand_id: a": "hand_id: found a, expected it beside sensors only",
        "touch_log: a.npz": "touch_log: found a.npz, expected a name that ends in .csv",
    }.items():
        assert check(tmp_path, text) == EXIT_CONFIG
        (line,) = capfd.readouterr().err.splitlines()
        assert said in line


def test_it_is_in_the_schema(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["check-config", "--schema"]) == 0
    schema = json.loads(capfd.readouterr().out)
    assert schema["$defs"]["Settings"]["properties"]["touch_log"]["default"] is None


def test_it_waits_for_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    path.write_text("source: {kind: simulated}\ntouch_log: a.csv\n")
    running = load(path)
    path.write_text("source: {kind: simulated}\ntouch_log: b.csv\n")
    document, _, waiting = reload(running, calibrated=False)
    assert waiting == ("touch_log",)
    assert document.settings.touch_log == str(tmp_path / "a.csv")
