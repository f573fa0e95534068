from __future__ import annotations

import json
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.doctor import fault, ok
from tacshade_edge.doctor.bundle import Seen, without_secrets, write_bundle
from tacshade_edge.errors import DeviceError
from tacshade_edge.settings import Document, load
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.painted_sensor import FREE, painted_calibration

FINDINGS = (ok("clock", "right"), fault("broker", "refuses the user bob or the password", "in /home/bob/pw"))


@pytest.fixture
def document(tmp_path: Path) -> Document:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "pw").write_text("pa55word\n")
    mqtt = "mqtt: {host: hand.example, username: bob, password_file: pw}"
    (tmp_path / "s.yaml").write_text(f"sensor_id: left\ncalibration: c.npz\n{mqtt}\n")
    return load(tmp_path / "s.yaml")


def read(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as bundle:
        return {name: bundle.read(name) for name in bundle.namelist()}


def test_all_that_helps_is_in_it_and_nothing_secret(document: Document, tmp_path: Path) -> None:
    told = {"state": b"online", "health": b'{"note": "pa55word of bob"}', "info": b"\xff"}
    write_bundle(tmp_path / "b.zip", FINDINGS, Seen(document, told, FREE), with_frame=False)
    files = read(tmp_path / "b.zip")
    named = ("findings", "versions", "published", "calibration")
    assert set(files) == {*(f"{name}.json" for name in named), "log.txt", "settings.yaml"}
    everything = b"".join(files.values())
    for secret in (b"pa55word", b"bob", str(tmp_path / "pw").encode()):
        assert secret not in everything
    assert b"host: hand.example" in files["settings.yaml"]
    assert b"username: (left out)" in files["settings.yaml"]
    assert json.loads(files["findings.json"])[1]["found"] == "refuses the user (left out) or the password"
    assert json.loads(files["published.json"])["state"] == "online"
    assert json.loads(files["versions.json"])["packages"]["numpy"]
    facts = json.loads(files["calibration.json"])
    assert facts["geometry"]["calibration_crc32"] == calibration_file.load(tmp_path / "c.npz").crc32


def test_a_frame_only_where_it_was_asked_for(document: Document, tmp_path: Path) -> None:
    write_bundle(tmp_path / "b.zip", FINDINGS, Seen(document, {}, FREE), with_frame=True)
    image = cv2.imdecode(np.frombuffer(read(tmp_path / "b.zip")["frame.png"], np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(image, FREE)
    (tmp_path / "c.npz").unlink()
    write_bundle(tmp_path / "b.zip", FINDINGS, Seen(document), with_frame=True)
    files = read(tmp_path / "b.zip")
    assert "frame.png" not in files
    assert json.loads(files["calibration.json"])["reason"].startswith(str(tmp_path / "c.npz"))


def test_without_settings_and_where_it_cannot_be_written(tmp_path: Path) -> None:
    write_bundle(tmp_path / "b.zip", FINDINGS, Seen(), with_frame=True)
    assert "settings.yaml" not in read(tmp_path / "b.zip")
    with pytest.raises(DeviceError, match="cannot write it"):
        write_bundle(tmp_path / "none" / "b.zip", FINDINGS, Seen(), with_frame=False)


@pytest.mark.parametrize(
    ("text", "rest"),
    [
        ("socket://bob:word@host:7", "socket://(left out)@host:7"),
        ("/home/bob/x.npz '/home/ann'", "/home/(left out)/x.npz '/home/(left out)'"),
        ("a secret and secrets", "a (left out) and (left out)s"),
    ],
)
def test_what_is_left_out(text: str, rest: str) -> None:
    assert without_secrets(text, ("secret",)) == rest
