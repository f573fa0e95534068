from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import pytest

from tacshade_edge.doctor.settings import check_settings


@pytest.mark.parametrize(
    ("text", "usable", "said"),
    [
        ("sensor: a\n", False, ":1: sensor: found an unknown key"),
        ("source: {kind: simulated}\nmqtt: {ca_file: no.pem}\n", True, ":2: mqtt.ca_file: found no file"),
        ("mqtt: {ca_file: s.yaml}\n", True, ":1: mqtt: CA certificate file"),
        ("mqtt: {username: a, password_file: none}\n", True, ":1: mqtt.password_file: "),
    ],
)
def test_bad_settings(tmp_path: Path, text: str, usable: bool, said: str) -> None:
    config = tmp_path / "s.yaml"
    config.write_text(text)
    finding, document, broker = check_settings(config)
    assert finding.state == "fault"
    assert finding.found.startswith(f"{config}{said}")
    assert finding.fix.startswith("fix that line")
    assert (document is not None, broker) == (usable, False)


def test_no_file(tmp_path: Path) -> None:
    finding, document, _ = check_settings(tmp_path / "none.yaml")
    assert finding.fix.startswith("tacshade-edge capture DIR writes settings for this camera")
    assert document is None


def test_good_settings(tmp_path: Path) -> None:
    config = tmp_path / "s.yaml"
    config.write_text("sensor_id: left\n")
    finding, document, broker = check_settings(config)
    assert (finding.state, finding.found) == ("ok", f"{config}, sensor left")
    assert document is not None
    assert broker


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become someone else")
def test_settings_that_this_user_may_not_read() -> None:
    """As the service's own folder is."""
    folder = Path(tempfile.mkdtemp())
    (folder / "s.yaml").write_text("sensor_id: left\n")
    folder.chmod(0o700)
    os.seteuid(65534)
    try:
        finding, _, _ = check_settings(folder / "s.yaml")
    finally:
        os.seteuid(0)
        shutil.rmtree(folder)
    assert finding.state == "fault"
    assert finding.fix.startswith("run doctor with sudo")
