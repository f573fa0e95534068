"""What a sensor's process loads by itself, and so has for itself."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = r"""
import os, sys
from pathlib import Path
import tacshade_edge.cli.commands.run
from tacshade_edge.daemon.supervisor import Supervisor
from tacshade_edge.factories import links
from tacshade_edge.settings import load_all
from tacshade_edge.version import installed_version


def work(document):
    before = set(sys.modules)
    links.make_link(document, lambda request: None, lambda stream, seq, outcome: None)
    installed_version()
    line = f"{document.settings.sensor_id} {sorted(set(sys.modules) - before)}\n"
    os.write(1, line.encode())  # whole, beside the other process's
    os._exit(0)

Supervisor(load_all(Path(sys.argv[1]))).run(work)
"""


@pytest.mark.slow
def test_a_forked_process_imports_nothing_for_its_link(tmp_path: Path) -> None:
    sensors = "".join(
        f"  {name}: {{calibration: {name}.npz, source: {{kind: simulated}}}}\n" for name in ("thumb", "index")
    )
    (tmp_path / "hand.yaml").write_text(
        f"mqtt: {{host: 127.0.0.1}}\nrecorder: {{folder: recs}}\nstitching: {{folder: maps}}\nsensors:\n{sensors}"
    )
    command = (sys.executable, "-c", PROGRAM, tmp_path / "hand.yaml")
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert sorted(done.stdout.splitlines()) == ["index []", "thumb []"]
