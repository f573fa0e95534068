from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

pytest.importorskip("mcap")
from mcap.writer import Writer
from support.mcap_bytes import FOOTER, described, file_of, flipped, message, record

from tacshade_edge.storage.recording.mcap.records import McapFile
from tacshade_edge.storage.recording.mcap.summary import SUMMARY_BYTES_MAX, Summary, channel_in


def summary_of(path: Path, content: bytes) -> tuple[Summary | None, str]:
    path.write_bytes(content)
    with contextlib.closing(McapFile(path)) as file:
        return file.summary, file.damage


def whole(path: Path) -> bytes:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=10)
        writer.start()
        schema = writer.register_schema("a.B", "protobuf", bytes(20_000))
        channel = writer.register_channel("/cam", "protobuf", schema, {"ours": "yes"})
        for t_ns in (40, 70, 90):
            writer.add_message(channel, t_ns, b"something", t_ns)
        writer.add_attachment(0, 0, "a", "text/plain", b"1")
        writer.finish()
    return path.read_bytes()


def test_what_the_end_says_of_the_rest(tmp_path: Path) -> None:
    content = whole(tmp_path / "a.mcap")
    summary, damage = summary_of(tmp_path / "a.mcap", content)
    assert summary is not None
    assert damage == ""
    assert {schema.name for schema in summary.schemas.values()} == {"a.B"}
    assert [(found.topic, found.encoding, found.metadata) for found in summary.channels.values()] == [
        ("/cam", "protobuf", {"ours": "yes"})
    ]
    assert (summary.counts, summary.span_ns, summary.in_chunks) == ({1: 3}, (40, 90), True)
    assert [content[start] for start in summary.starts] == [6, 6, 6, 9]


def test_every_flipped_bit_of_it_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    content = whole(path)
    footer_at = len(content) - 37
    assert content[footer_at] == FOOTER
    begin = int.from_bytes(content[footer_at + 9 : footer_at + 17], "little")
    for byte in (*range(begin, begin + 40), *range(footer_at - 60, footer_at + 29)):
        summary, damage = summary_of(path, flipped(content, byte, byte % 8))
        assert summary is None
        assert damage == f"{path}: ignoring the damaged index at its end"


def test_what_lies_behind_a_right_checksum(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = described() + message(b"a", 7)
    for junk in (b"x", record(3, b"\xff" * 30), record(4, b"\xff" * 30), record(11, bytes(45)), record(8, bytes(3))):
        summary, damage = summary_of(path, file_of(data, junk))
        assert summary is None
        assert "ignoring the damaged index" in damage
    summary, damage = summary_of(path, file_of(data, record(0x81, bytes(SUMMARY_BYTES_MAX))))
    assert summary is None
    assert damage == f"{path}: ignoring the index at its end, which exceeds 16 MiB"


def test_names_are_bounded() -> None:
    body = bytes(4) + (5000).to_bytes(4, "little") + bytes(6000)
    with pytest.raises(ValueError, match="found a name of 5000 bytes, expected at most 4096"):
        channel_in(body)
    with pytest.raises(ValueError, match="ends within its metadata"):
        channel_in(bytes(12) + (100).to_bytes(4, "little"))
