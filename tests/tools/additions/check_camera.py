"""What a new camera does without another line: settings, schema, frames, doctor, fixes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.camera.sources import make_source
from tacshade_edge.doctor.camera_check import capture, check_frames
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.errors import ConfigError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.settings import check_source, file_schema, load, load_all


def settings(folder: Path, text: str) -> Path:
    (folder / "level").write_text("97")
    (folder / "config.yaml").write_text(text.replace("LEVEL", str(folder / "level")))
    return folder / "config.yaml"


def test_it_is_opened_by_the_settings(tmp_path: Path) -> None:
    document = load(settings(tmp_path, "source: {kind: still, device: LEVEL}"))
    check_source(document)
    source = make_source(document.settings.source, (64, 48))
    source.open()
    frame = source.read()
    source.close()
    assert frame is not None
    np.testing.assert_array_equal(frame.image, np.full((48, 64), 97))
    found = document.settings.source
    assert found.sized().size_misfit((64, 48)) == (
        "width_px",
        "found 320x240 px, expected 64x48 px, the size of the calibration's images",
    )
    assert found.how_to_fix(ReasonCode.ABSENT) == "write a grey level into it"
    assert [finding.state for finding in found.inspect()] == ["ok"]
    states = [f.state for f in check_frames(found, capture(make_source(found)), Machine(), "")]
    assert "fault" in states, "one grey is no picture"
    assert "still" in str(file_schema())


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("{kind: still}", "source.device: found nothing, expected a string (the device)"),
        ("{kind: still, device: a, width_px: 64}", "source: found no height_px, expected both"),
        ("{kind: still, device: a, exposure_us: 99999}", "found 99999, expected at most 33333"),
        ("{kind: stil}", "found stil, expected one of"),
    ],
)
def test_a_mistake_is_one_line(tmp_path: Path, source: str, said: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load(settings(tmp_path, f"source: {source}"))
    assert said in str(refused.value)


def test_what_is_no_device_and_what_two_share_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r":1: source.device: .*found a folder"):
        check_source(load(settings(tmp_path, "source: {kind: still, device: /}")))
    sensors = "".join(
        f"  {name}: {{calibration: {name}.npz, source: {{kind: still, device: LEVEL}}}}\n"
        for name in "ab"
    )
    with pytest.raises(ConfigError, match=r"found the same as in sensors\.a\.source"):
        load_all(settings(tmp_path, f"sensors:\n{sensors}"))
