"""Where a broker is, as people write it."""

from __future__ import annotations

import pytest

from tacshade_edge.errors import ConfigError
from tacshade_edge.wire.broker_address import host_and_port


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("board", ("board", 1883)),
        ("board:99", ("board", 99)),
        ("[::1]:99", ("::1", 99)),
        ("127.0.0.1:65535", ("127.0.0.1", 65535)),
    ],
)
def test_a_broker_is_a_host_and_a_port(text: str, found: tuple[str, int]) -> None:
    assert host_and_port(text) == found


@pytest.mark.parametrize(
    "text",
    [
        "",
        ":",
        ":1883",
        "host:",
        "host:0",
        "host:65536",
        "host:٣",
        "host:" + "1" * 5000,
        "h" * 64,
        "a." * 127,
        "mqtt://h",
        "mqtt://h:1883",
        "::1",
        "[::1",
        "h,i",
        "a@h:1883",
        "[h:1]:1883",
        "h\n",
        "h\0",
    ],
)
def test_what_is_none_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(
        ConfigError, match=r"\Abroker: found '[^\n]*', expected HOST or HOST:PORT, such as"
    ) as caught:
        host_and_port(text)
    assert len(str(caught.value)) < 150
