"""decode and decode_file: the literal vectors of the wire, and files of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tacshade_edge as ts

VECTORS = json.loads((Path(__file__).parents[1] / "protocol" / "vectors" / "wire.json").read_text())
SOUND = [v for v in VECTORS if "expect" in v]
DAMAGED = [v for v in VECTORS if "error" in v]
KINDS = {
    "height": (ts.HeightMessage, "height_mm"),
    "cloud": (ts.CloudMessage, "points_mm"),
    "shear": (ts.ShearMessage, "shear_mm"),
    "sigma": (ts.SigmaMessage, "sigma_mm"),
}


@pytest.mark.parametrize("kind_of_bytes", [bytes, bytearray, memoryview])
@pytest.mark.parametrize("sound", SOUND, ids=[v["name"] for v in SOUND])
def test_a_vector_is_what_its_header_says(sound: dict[str, Any], kind_of_bytes: Any) -> None:
    expect = sound["expect"]
    made, name = KINDS[expect["kind"]]
    message = ts.decode(kind_of_bytes(bytes.fromhex(sound["hex"])))
    assert isinstance(message, made)
    values = getattr(message, name)
    wanted = np.array([np.nan if v is None else v for v in expect[name]], np.float32)
    np.testing.assert_allclose(values.ravel(), wanted, atol=1e-6)
    assert not values.flags.writeable
    assert (message.seq, message.t_ns, message.contact) == (expect["seq"], expect["t_ns"], expect["contact"])


@pytest.mark.parametrize("damaged", DAMAGED, ids=[v["name"] for v in DAMAGED])
def test_a_damaged_vector_is_refused(damaged: dict[str, Any]) -> None:
    with pytest.raises(ts.DecodeError, match=damaged["error"]):
        ts.decode(bytes.fromhex(damaged["hex"]))


@pytest.mark.parametrize("payload", [None, 5, 1.5, "TCSH", [], [1], {}, np.zeros((0, 0), np.uint8), object()])
def test_what_is_no_bytes_is_refused(payload: Any) -> None:
    with pytest.raises(ts.ConfigError, match=r"^payload: found .*, expected bytes$"):
        ts.decode(payload)


def test_a_file_gives_its_messages_in_order(tmp_path: Path) -> None:
    payloads = [bytes.fromhex(v["hex"]) for v in SOUND]
    (path := tmp_path / "heights.bin").write_bytes(b"".join(payloads))
    found = list(ts.decode_file(path))
    assert [type(m) for m in found] == [KINDS[v["expect"]["kind"]][0] for v in SOUND]
    assert [m.seq for m in found] == [v["expect"]["seq"] for v in SOUND]
    path.write_bytes(b"")
    assert list(ts.decode_file(str(path))) == []


def test_a_damaged_file_gives_what_is_before(tmp_path: Path) -> None:
    first, second = (bytes.fromhex(v["hex"]) for v in SOUND[:2])
    (path := tmp_path / "heights.bin").write_bytes(first + second[:-1] + bytes([second[-1] ^ 1]) + first)
    messages = ts.decode_file(path)
    assert next(messages).seq == SOUND[0]["expect"]["seq"]
    with pytest.raises(ts.DecodeError, match=r"heights\.bin: message 1: .*CRC-32"):
        next(messages)
    path.write_bytes(first[:-1])
    with pytest.raises(ts.DecodeError, match=rf"heights\.bin: cut short after {len(first) - 1} bytes"):
        list(ts.decode_file(path))
    path.write_bytes(first[:84] + b"\xff" * 4 + first[88:] + bytes(1000))
    with pytest.raises(
        ts.DecodeError, match=r"heights\.bin, byte 84: found 4294967295 payload bytes, expected at most"
    ):
        list(ts.decode_file(path))
    with pytest.raises(ts.ConfigError, match=r"nothing\.bin: No such file"):
        list(ts.decode_file(tmp_path / "nothing.bin"))
    with pytest.raises(ts.ConfigError, match="Is a directory"):
        list(ts.decode_file(tmp_path))


@pytest.mark.parametrize("path", [None, 5, [], b"heights.bin", "", "a\0b", np.zeros((0, 0))])
def test_what_is_no_path_is_refused_before_anything_is_read(path: Any) -> None:
    with pytest.raises(ts.ConfigError, match=r"^path: found .*, expected a path$"):
        ts.decode_file(path)
