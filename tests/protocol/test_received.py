"""What a subscriber understands of a hand, and the numbers that it takes for none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.published_sensor import calibration, health

from tacshade_edge.core.geometry.disc import Grid, disc_rays
from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol import messages, received

INFO: dict[str, Any] = json.loads(
    messages.encode_info(version="0", config_digest="0", profile="fast", calibration=calibration())
)
TOUCHES = json.loads((Path(__file__).parent / "vectors" / "touch.json").read_text())


def test_what_a_daemon_tells_is_understood() -> None:
    info = received.decode_info(json.dumps(INFO).encode())
    assert info.geometry is not None
    assert info.geometry.geometry == calibration().geometry
    assert received.decode_health(health()).frames["captured"] == 3
    assert received.decode_status("status/camera", b"") == received.Status()
    assert [received.decode_state(state.encode()) for state in received.STATES] == list(received.STATES)


@pytest.mark.parametrize(
    "key", ["radius_px", "skin_radius_mm", "visible_half_angle_deg", "camera_distance_mm", "row_c", "image_width_px"]
)
@pytest.mark.parametrize("value", ["0", "-1e9", "1e308", "1e999", "1e-300", "1" + "0" * 400, '"x"', "[]"])
def test_a_geometry_that_no_sensor_has_is_refused(key: str, value: str) -> None:
    changed = json.dumps({**INFO, "geometry": {**INFO["geometry"], key: "?"}}).replace('"?"', value).encode()
    if key == "row_c" and value in ("0", "1e-300"):
        assert received.decode_info(changed).geometry is not None
        return
    with pytest.raises(DecodeError, match=r"^info: "):
        received.decode_info(changed)


@pytest.mark.parametrize("extreme", [0, 1])
def test_rays_of_the_extremes_that_are_taken_are_numbers(extreme: int) -> None:
    ends = {
        "skin_radius_mm": (0.1, 1e4),
        "camera_distance_mm": (1e-5, 1e5),
        "visible_half_angle_deg": (1e-3, 90),
        "radius_px": (1, 1e5),
    }
    for ones in range(2 ** len(ends)):
        values = {key: pair[ones >> at & 1] for at, (key, pair) in enumerate(ends.items())}
        geometry = {**INFO["geometry"], **values, **({"camera_distance_mm": None} if extreme else {})}
        info = received.decode_info(json.dumps({**INFO, "geometry": geometry}).encode())
        assert info.geometry is not None
        rays = disc_rays(Grid(4, 4, 0.0, 0.0, 1.0), info.geometry.geometry)
        assert abs(rays.u).max() < 1e12


@pytest.mark.parametrize("vector", TOUCHES, ids=lambda vector: str(vector["name"]))
def test_a_touch_is_understood_or_refused(vector: dict[str, Any]) -> None:
    payload = vector["payload"].encode()
    if "error" in vector:
        with pytest.raises(DecodeError, match=r"^touch: .*; expected the format in docs/reference/mqtt.md"):
            received.decode_touch(payload)
        return
    touch = received.decode_touch(payload)
    assert {key: getattr(touch, key) for key in vector["expect"]} == vector["expect"]


@pytest.mark.parametrize("sent", [b"", b"on line", b"online\n", b"\xff", b"x" * 10_000_000])
def test_a_state_that_is_none_is_refused_in_one_line(sent: bytes) -> None:
    with pytest.raises(DecodeError, match="expected one of online, degraded, stopped, offline") as refused:
        received.decode_state(sent)
    assert len(str(refused.value)) < 200


@pytest.mark.parametrize(
    "changed",
    [
        {"frames": {"published": -1}},
        {"frames": {'a"} 1\nforged{x="': 1}},
        {"frames": {f"k{n}": 0 for n in range(65)}},
        {"uptime_s": 1e300},
        {"stages_ms": {"solve": {"p50": 0, "p99": None}}},
        {"invalid_reason_code": "torn\n"},
    ],
)
def test_a_health_that_no_daemon_tells_is_refused(changed: dict[str, Any]) -> None:
    with pytest.raises(DecodeError, match=r"^health: "):
        received.decode_health(json.dumps({**json.loads(health()), **changed}).encode())
