"""open and read: every frame of a recording, the newest of a camera."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import tacshade_edge as ts
from support.calibrated_sensor import calibrated, pressed, unloaded
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.errors import DecodeError, DeviceError
from tacshade_edge.library import frames
from tacshade_edge.types import Frame


@pytest.fixture(scope="module")
def sensor() -> ts.Sensor:
    return ts.Sensor(calibrated(), "fast")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Free, pressed, damaged, free; with its calibration."""
    calibration_file.save(tmp_path / "calibration.npz", calibrated())
    for k, image in enumerate((unloaded(), pressed("ball", 2.0).image, None, unloaded())):
        path = tmp_path / f"{k:06}.png"
        if image is None:
            path.write_bytes(b"no image")
        else:
            cv2.imwrite(str(path), image)
    rows = [f"{k:06}.png,{1000 + k * 10**8},,,,,,,," for k in range(4)]
    (tmp_path / "frames.csv").write_text(
        "\n".join(["image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz,pose_error_us", *rows]) + "\n"
    )
    return tmp_path


def test_a_recording_gives_every_frame(recording: Path, caplog: pytest.LogCaptureFixture) -> None:
    with ts.read(recording) as results:
        found = list(results)
        assert [(r.seq, r.t_ns, r.in_contact) for r in found] == [
            (0, 1000, False),
            (1, 100_001_000, True),
            (3, 300_001_000, False),
        ]
        assert found[1].objects[0].id is not None
        assert results.passed_over == 1
    assert [record.message.count("000002.png") for record in caplog.records] == [1]
    assert next(results, None) is None
    (recording / "frames.csv").rename(recording / "frames.csv.part")
    caplog.clear()
    ts.read(recording)
    assert caplog.messages == [f"{recording}: the recording was cut off; reading what is whole"]


def test_a_recording_without_its_calibration_needs_a_sensor(
    recording: Path, sensor: ts.Sensor
) -> None:
    (recording / "calibration.npz").unlink()
    with pytest.raises(ts.ConfigError, match=r"contains no calibration\.npz; pass a sensor"):
        ts.read(recording)
    assert next(ts.read(recording, sensor)).profile == "fast"


def test_a_settings_file_opens_its_source(recording: Path, sensor: ts.Sensor) -> None:
    settings = recording / "config.yaml"
    # Slow enough for a busy machine: a reader that is slower than its source misses frames.
    text = "calibration: calibration.npz\nprofile: fast\nsource: {kind: files, path: ., fps: 4}\n"
    settings.write_text(text)
    with ts.open(settings) as results:
        assert [r.in_contact for r in results] == [False, True, False]
        assert results.passed_over == 1
    settings.write_text(text.replace("profile: fast", "profile: auto\nlatency_budget_ms: 20"))
    with pytest.raises(ts.ConfigError, match=r"config\.yaml:2: profile: found auto"):
        ts.open(settings)
    assert next(ts.open(settings, sensor)).profile == "fast"


def test_what_is_no_source_is_reported(tmp_path: Path, sensor: ts.Sensor) -> None:
    with pytest.raises(ts.ConfigError, match=r"expected a settings file \(\.yaml\) or a device"):
        ts.open(tmp_path, sensor)
    with pytest.raises(ts.DeviceError, match="/dev/video99"):
        ts.open("/dev/video99", sensor)


class Buffered:
    """A camera whose driver kept frames while nobody read; its clock is the test's."""

    dropped = 5

    def __init__(self, ages_ms: list[float | Exception], now_ns: int) -> None:
        self._ages_ms = iter(ages_ms)
        self._now_ns = now_ns
        self.opened = 0

    def open(self) -> None:
        self.opened += 1

    def read(self) -> Frame | None:
        age_ms = next(self._ages_ms, None)
        if isinstance(age_ms, Exception):
            raise age_ms
        return (
            None
            if age_ms is None
            else Frame(0, self._now_ns - round(age_ms * 1e6), 0, np.array(unloaded()))
        )

    def close(self) -> None:
        pass

    def describe(self) -> dict[str, str | int | float]:
        return {}


def test_the_newest_wins(
    sensor: ts.Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_ns = 10**12
    monkeypatch.setattr(frames.time, "monotonic_ns", lambda: now_ns)
    ages: list[float | Exception] = [
        500,
        300,
        DecodeError("torn"),
        20,
        5,
        DeviceError("lost"),
        *[900.0] * 9,
        5,
        900,
    ]
    source = Buffered(ages, now_ns)
    monkeypatch.setattr(frames, "make_source", lambda *_: source)
    (tmp_path / "config.yaml").write_text("source: {kind: simulated, fps: 30}\n")
    results = ts.open(tmp_path / "config.yaml", sensor)
    assert [round((now_ns - next(results).t_ns) / 1e6) for _ in range(2)] == [20, 5]
    assert results.passed_over == 5 + 3
    with pytest.raises(ts.DeviceError, match="lost"):
        next(results)
    assert round((now_ns - next(results).t_ns) / 1e6) == 900  # always late: taken as it is
    assert source.opened == 2
    assert round((now_ns - next(results).t_ns) / 1e6) == 5
    assert next(results, None) is None  # the source ends
