from __future__ import annotations

import contextlib
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("mcap")
import lz4.frame
import zstandard
from mcap.records import Message
from mcap.writer import CompressionType, Writer
from support.mcap_bytes import FOOTER, MAGIC, chunk, described, file_of, flipped, message, record

from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.recording.mcap.reader import (
    CHUNK_BYTES_MAX,
    DESCRIPTION_BYTES_MAX,
    SUMMARY_BYTES_MAX,
    Damage,
    McapFile,
    Summary,
    attachments_in,
)

Pack = Callable[[bytes], bytes]
PACKINGS: dict[str, Pack] = {
    "zstd": zstandard.ZstdCompressor().compress,
    "lz4": lz4.frame.compress,
    "": bytes,
}


def read(path: Path, content: bytes) -> tuple[list[int], list[str]]:
    """Times of the messages; and what was told."""
    path.write_bytes(content)
    times, told = [], []
    with contextlib.closing(McapFile(path)) as file:
        for found in file.records():
            if isinstance(found, Message):
                times.append(found.log_time)
            elif isinstance(found, Damage):
                told.append(str(found.error))
    return times, told


@pytest.mark.parametrize("packing", PACKINGS)
def test_chunks_of_every_packing(tmp_path: Path, packing: str) -> None:
    inside = described() + message(b"a", 5) + message(b"b", 6)
    content = file_of(chunk(PACKINGS[packing](inside), packing, len(inside), zlib.crc32(inside)))
    assert read(tmp_path / "a.mcap", content) == ([5, 6], [])


@pytest.mark.parametrize("packing", PACKINGS)
def test_a_chunk_that_is_not_what_it_says_is_told_and_the_next_is_read(tmp_path: Path, packing: str) -> None:
    inside = message(b"a", 5)
    packed, crc = PACKINGS[packing](inside), zlib.crc32(inside)
    good = chunk(packed, packing, len(inside), crc)
    bad = (
        chunk(packed, packing, len(inside) + 1, crc),
        chunk(packed, packing, len(inside) - 1, crc),
        chunk(packed, packing, 2**63, crc),
        chunk(packed, packing, CHUNK_BYTES_MAX + 1, crc),
        chunk(packed, packing, len(inside), crc ^ 1),
        chunk(packed[:-12], packing, len(inside), crc),
        chunk(b"", packing, len(inside), crc),
        chunk(packed, "gz\x1b", len(inside), crc),
    )
    for one in bad:
        times, told = read(tmp_path / "a.mcap", file_of(one + good))
        assert times == [5]
        assert len(told) == 1
        assert "skipping the damaged chunk at byte 25" in told[0]
        assert told[0].isprintable()


@pytest.mark.slow
@pytest.mark.parametrize("packing", ["zstd", "lz4"])
def test_a_few_bytes_never_become_millions_of_records(tmp_path: Path, packing: str) -> None:
    inside = message(b"", 5) * (CHUNK_BYTES_MAX // len(message(b"", 5)))
    packed = PACKINGS[packing](inside)
    path = tmp_path / "a.mcap"
    times, told = read(path, file_of(chunk(packed, packing, len(inside), zlib.crc32(inside)) * 2))
    assert len(times) < 100_000
    assert "expected at most 256 times the file's size" in told[-1]
    assert len(told) == 1


def test_many_chunks_of_little_do_not_become_much(tmp_path: Path) -> None:
    inside = message(bytes(1 << 20), 5)
    one = chunk(PACKINGS["zstd"](inside), "zstd", len(inside), zlib.crc32(inside))
    times, told = read(tmp_path / "a.mcap", file_of(one * 200))
    # 16 MiB are free, and 256 times a file of 19 kB
    assert 15 <= len(times) <= 24
    assert len(told) == 1


def test_a_window_larger_than_a_chunk_is_refused(tmp_path: Path) -> None:
    inside = message(b"a", 5)
    parameters = zstandard.ZstdCompressionParameters(window_log=27, enable_ldm=True)
    packing = zstandard.ZstdCompressor(compression_params=parameters).compressobj()  # of a size that it does not tell
    packed = packing.compress(inside) + packing.flush()
    times, told = read(tmp_path / "a.mcap", file_of(chunk(packed, "zstd", len(inside))))
    assert times == []
    assert "too much memory" in told[0]


def test_a_chunk_in_the_summary_is_not_unpacked(tmp_path: Path) -> None:
    inside = message(b"", 5) * 100_000
    bomb = chunk(PACKINGS["zstd"](inside), "zstd", len(inside), zlib.crc32(inside))
    assert read(tmp_path / "a.mcap", file_of(described() + message(b"a", 7), bomb)) == ([7], [])


def test_messages_outside_chunks_are_found_again_after_damage(tmp_path: Path) -> None:
    parts = [described(), *(message(bytes([t_ns]) * 50, t_ns) for t_ns in range(1, 7))]
    content = file_of(b"".join(parts))
    third = 25 + sum(map(len, parts[:3]))
    for byte, bit in ((0, 1), (0, 7), (1, 0), (1, 6), (2, 3), (4, 0), (8, 7)):
        times, told = read(tmp_path / "a.mcap", flipped(content, third + byte, bit))
        assert set(times) >= {1, 4, 5, 6}
        assert len(told) == 1


def test_private_records_are_passed_over_where_the_file_counts_its_messages(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        stream.write(record(0x80, b"ours alone"))
        channel = writer.register_channel("/cam", "protobuf", writer.register_schema("a", "protobuf", b""))
        writer.add_message(channel, 3, b"a", 3)
        writer.finish()
    assert read(path, path.read_bytes()) == ([3], [])
    _, told = read(path, file_of(described() + record(0x80, b"a") + message(b"a", 3)))
    assert len(told) == 1


def test_files_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for content in (b"", b"a", MAGIC[:7], bytes(8), bytes(1000)):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match="not an MCAP file"):
            McapFile(path)
    for content, damaged in ((MAGIC, 0), (MAGIC + b"\x01", 0), (MAGIC * 2, 0), (MAGIC * 7, 1)):
        times, told = read(path, content)
        assert times == []
        assert len(told) == damaged


def test_an_attachment_that_seems_shorter_is_not_taken_for_one_without_a_checksum(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_attachment(0, 0, "a", "text/plain", b"a zip ends so" + bytes(4))
        writer.finish()
    whole = path.read_bytes()
    at = whole.index(b"a zip") - 8
    path.write_bytes(whole[:at] + bytes([17 - 4]) + whole[at + 1 :])
    found, told = attachments_in(path, {"a": 100})
    assert found == {}
    assert told == [f"{path}: leaving its a out: found 13 bytes, expected 17 before its checksum"]


def test_attachments(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for name, data in (("a", b"first"), ("b", b"12345678"), ("a", b"last"), ("c", b"unasked")):
            writer.add_attachment(0, 0, name, "text/plain", data)
        writer.finish()
    assert attachments_in(path, {"a": 100, "b": 100, "d": 100}) == ({"a": b"last", "b": b"12345678"}, [])
    found, told = attachments_in(path, {"a": 100, "b": 7})
    assert found == {"a": b"last"}
    assert told == [f"{path}: leaving its b out: found 8 bytes, expected at most 7"]
    whole = path.read_bytes()
    path.write_bytes(flipped(whole, whole.index(b"12345678") + 2, 3))
    found, told = attachments_in(path, {"a": 100, "b": 100})
    assert found == {"a": b"last"}
    assert told == [f"{path}: leaving its b out: its checksum does not match"]
    path.write_bytes(flipped(whole, whole.index(b"12345678") - 8 - len("text/plain") - 4 - 1, 0))  # its name
    found, told = attachments_in(path, {"a": 100, "b": 100})
    assert found == {"a": b"last"}
    assert told == [f"{path}: leaving its c out: its checksum does not match"]
    for bit in (0, 33, 63):  # of the length of its data
        path.write_bytes(flipped(whole, whole.index(b"12345678") - 8 + bit // 8, bit % 8))
        found, told = attachments_in(path, {"a": 100, "b": 100})
        assert found == {"a": b"last"}
        assert "skipping the damaged" in told[0]


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
    assert [(found.topic, found.message_encoding, found.metadata) for found in summary.channels.values()] == [
        ("/cam", "protobuf", {"ours": "yes"})
    ]
    assert (summary.counts, summary.span_ns, summary.in_chunks) == ({1: 3}, (40, 90), True)


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


def test_descriptions_are_bounded(tmp_path: Path) -> None:
    content = file_of(described(topic="/" + "a" * DESCRIPTION_BYTES_MAX) + described() + message(b"a", 5))
    times, told = read(tmp_path / "a.mcap", content)
    assert times == [5]
    assert len(told) == 1
    assert "skipping the damaged record" in told[0]
