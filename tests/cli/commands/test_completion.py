"""What a shell completes, asked of a real bash."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tacshade_edge.cli import COMMANDS, EXIT_CONFIG, main

pytest.importorskip("shtab", reason="shtab is not installed")

ASK = """
source {script}; COMP_WORDS=({typed}); COMP_CWORD={last}; COMP_LINE='{typed}'; COMP_POINT=${{#COMP_LINE}}
$(complete -p tacshade-edge | sed "s/.*-F \\([^ ]*\\) .*/\\1/")
printf "%s\\n" "${{COMPREPLY[@]}}"
"""


def completed(script: Path, typed: str) -> list[str]:
    """What bash offers for the last word."""
    asked = ASK.format(script=script, typed=typed, last=len(typed.split()) - 1)
    return subprocess.run(("bash", "-c", asked), capture_output=True, text=True, check=True).stdout.split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes_commands_and_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "tacshade-edge"
    script.write_text(capsys.readouterr().out)
    assert set(completed(script, "tacshade-edge re")) == {name for name in COMMANDS if name.startswith("re")}
    assert completed(script, "tacshade-edge replay --cal") == ["--calibration"]
    assert completed(script, "tacshade-edge completion z") == ["zsh"]


def test_without_its_package_it_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == EXIT_CONFIG
    assert "pip install '.[completion]' in the clone" in capsys.readouterr().err
