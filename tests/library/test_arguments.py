"""load, open, read, listen and Sensor: what is of another kind is the library's own error,
in one line.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tacshade_edge as ts
from support.calibrated_sensor import calibrated
from tacshade_edge.calibration.files import calibration_file

CLOSED = "127.0.0.1:1"


def refused(made: Callable[[], object], name: str, expected: str) -> None:
    with pytest.raises(
        ts.ConfigError, match=rf"(?s)^{name}: found .*, expected {re.escape(expected)}"
    ) as error:
        made()
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 250


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> ts.Sensor:
    path = tmp_path_factory.mktemp("sensor") / "cal.npz"
    calibration_file.save(path, calibrated())
    return ts.load(path)


NO_TEXT: list[Any] = [[], 5, b"x", np.zeros((0, 0), np.uint8), {1}]


@pytest.mark.parametrize(
    "value", [*NO_TEXT, None, "", "a\0b", "\ud800", "x" * 300, "a/" * 3000], ids=repr
)
def test_what_is_no_path(value: Any, sensor: ts.Sensor) -> None:
    refused(lambda: ts.load(value), "calibration", "a path")
    refused(lambda: ts.open(value), "source", "a path")
    refused(lambda: ts.read(value), "recording", "a path")
    refused(lambda: ts.decode_file(value), "path", "a path")
    refused(lambda: sensor.reconstruct(value), "image", "a path") if not isinstance(
        value, np.ndarray
    ) else None
    refused(
        lambda: ts.listen(CLOSED, "drawn", ca_file=value), "ca_file", "a path"
    ) if value is not None else None


@pytest.mark.parametrize("value", NO_TEXT, ids=repr)
def test_what_is_nothing_that_is_asked_for(value: Any, tmp_path: Path) -> None:
    calibration_file.save(tmp_path / "cal.npz", calibrated())
    refused(
        lambda: ts.load(tmp_path / "cal.npz", profile=value),
        "profile",
        "one of accurate, balanced, fast, paper",
    )
    refused(lambda: ts.Sensor(value, "fast"), "calibration", "what tacshade_edge.load reads")
    refused(lambda: ts.open("/dev/video99", value), "sensor", "what tacshade_edge.load gives")
    refused(lambda: ts.read(tmp_path, value), "sensor", "what tacshade_edge.load gives")
    refused(lambda: ts.decode(value), "payload", "bytes") if not isinstance(value, bytes) else None


@pytest.mark.parametrize(
    "value", [*NO_TEXT, None, "\ud800", "a\0b", "x" * 70_000], ids=lambda v: repr(v)[:20]
)
def test_what_is_no_text(value: Any) -> None:
    refused(lambda: ts.listen(value, "drawn"), "broker", "HOST or HOST:PORT")
    refused(lambda: ts.listen(CLOSED, value), "sensor_id", "the sensor_id of a daemon's settings")
    if value is not None:
        refused(lambda: ts.listen(CLOSED, "drawn", username=value), "username", "text")
        refused(
            lambda: ts.listen(CLOSED, "drawn", username="a", password=value), "password", "text"
        )


def test_what_no_broker_takes() -> None:
    refused(lambda: ts.listen("host:0", "drawn"), "broker", "HOST or HOST:PORT")
    for sensor_id in ("", "a/b", "+", "x" * 256):
        refused(lambda: ts.listen(CLOSED, sensor_id), "sensor_id", "the sensor_id of")  # noqa: B023
    with pytest.raises(
        ts.ConfigError, match=r"^password: found a password without a username, expected both$"
    ):
        ts.listen(CLOSED, "drawn", password="word")
