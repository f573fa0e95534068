"""Lines on stderr that are not the log's, as the journal gets them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


def said(tmp_path: Path, *words: str, journal: bool) -> tuple[int, list[str]]:
    """Exit code and stderr of Python with these words, as a file that may be the journal's."""
    path = tmp_path / "stderr"
    with path.open("w") as stream:
        found = os.fstat(stream.fileno())
        of_journal = {"JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"} if journal else {}
        done = subprocess.run(
            (sys.executable, *words), stderr=stream, env=os.environ | of_journal, check=False
        )
    return done.returncode, path.read_text().splitlines()


@pytest.mark.parametrize("journal", [False, True])
def test_a_mistake_in_the_settings_is_an_error_of_the_journal(
    tmp_path: Path, journal: bool
) -> None:
    words = ("-m", "tacshade_edge", "run", "--config", str(tmp_path / "none.yaml"))
    code, lines = said(tmp_path, *words, journal=journal)
    assert code == 78
    assert len(lines) == 1
    assert lines[0].startswith(f"{'<3>' if journal else ''}tacshade-edge: {tmp_path}/none.yaml: ")


def test_every_line_of_a_traceback_has_its_priority(tmp_path: Path) -> None:
    program = (
        "import sys; from tacshade_edge.cli import entry; entry.main = lambda: 1 / 0; entry.entry()"
    )
    code, lines = said(tmp_path, "-c", program, journal=True)
    assert code == 1
    assert lines[0] == "<3>Traceback (most recent call last):"
    assert lines[-1] == "<3>ZeroDivisionError: division by zero"
    assert all(line.startswith("<3>") for line in lines)
