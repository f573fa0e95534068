from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tacshade_edge.devices.camera.simulated import SimulatedSource
from tacshade_edge.devices.camera.v4l2 import V4l2Source
from tacshade_edge.factories.sources import SOURCES, make_source
from tacshade_edge.settings import Files, Settings, Simulated, Source, V4l2
from tacshade_edge.storage.recording.image_source import FilesSource


@pytest.mark.parametrize(
    ("settings", "source"), [(V4l2(), V4l2Source), (Files(path="a"), FilesSource), (Simulated(), SimulatedSource)]
)
def test_each_kind_of_source_is_made_from_its_settings(settings: Source, source: type) -> None:
    assert isinstance(make_source(settings), source)


def test_every_kind_in_the_settings_has_a_source() -> None:
    assert set(SOURCES) == set(Source.__args__)
    assert isinstance(Settings().source, V4l2)


def test_a_camera_needs_no_simulator(tmp_path: Path) -> None:
    code = (
        "import sys; from tacshade_edge.factories.sources import make_source; from tacshade_edge.settings import V4l2;"
        "make_source(V4l2()); print([m for m in sys.modules if 'simulat' in m])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.strip() == "[]"
