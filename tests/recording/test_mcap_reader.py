from __future__ import annotations

import contextlib
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("mcap")
import lz4.frame
import zstandard
from mcap.records import Message
from mcap.writer import Writer

from support.mcap_bytes import FOOTER, MAGIC, chunk, described, file_of, flipped, message, record
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.recording.mcap.reader import (
    CHUNK_BYTES_MAX,
    DESCRIPTION_BYTES_MAX,
    SUMMARY_BYTES_MAX,
    McapFile,
    Summary,
    attachments_in,
)
from tacshade_edge.recording.mcap.writer import McapWriter
from tacshade_edge.recording.recording import Recording
from tacshade_edge.types import Frame

Pack = Callable[[bytes], bytes]
PACKINGS: dict[str, Pack] = {
    "zstd": zstandard.ZstdCompressor().compress,
    "lz4": lz4.frame.compress,
    "": bytes,
}


def read(path: Path, content: bytes) -> tuple[list[int], list[str]]:
    """Times of the messages; and what was reported."""
    path.write_bytes(content)
    times, reported = [], []
    with contextlib.closing(McapFile(path)) as file:
        for found in file.records():
            if isinstance(found, Message):
                times.append(found.log_time)
            elif isinstance(found, DecodeError):
                reported.append(str(found))
    return times, reported


@pytest.mark.parametrize("packing", PACKINGS)
def test_a_chunk_that_is_not_what_it_says_is_reported_and_the_next_is_read(
    tmp_path: Path, packing: str
) -> None:
    inside = message(b"a", 5)
    packed, crc = PACKINGS[packing](inside), zlib.crc32(inside)
    good = chunk(packed, packing, len(inside), crc)
    assert read(tmp_path / "a.mcap", file_of(described() + good)) == ([5], [])
    bad = (
        chunk(packed, packing, len(inside) + 1, crc),
        chunk(packed, packing, len(inside) - 1, crc),
        chunk(packed, packing, len(inside), crc ^ 1),
        chunk(packed[:-12], packing, len(inside), crc),
        chunk(b"", packing, len(inside), crc),
        chunk(packed, "gz\x1b", len(inside), crc),
    )
    large = (
        chunk(packed, packing, 2**63, crc),
        chunk(packed, packing, CHUNK_BYTES_MAX + 1, crc),
    )
    for one in (*bad, *large):
        times, reported = read(tmp_path / "a.mcap", file_of(one + good))
        assert times == [5]
        assert len(reported) == 1
        how = "damaged or too large" if one in large else "damaged"
        assert f"skipping the {how} chunk at byte 25: " in reported[0]
        assert reported[0].isprintable()


def test_a_few_bytes_never_become_millions_of_records(tmp_path: Path) -> None:
    inside = message(b"", 5) * (CHUNK_BYTES_MAX // len(message(b"", 5)))
    packed = PACKINGS["zstd"](inside)
    times, reported = read(
        tmp_path / "a.mcap", file_of(chunk(packed, "zstd", len(inside), zlib.crc32(inside)) * 2)
    )
    assert len(times) < 100_000
    assert "expected at most 256 times the file's size" in reported[-1]
    assert len(reported) == 1


def test_a_window_larger_than_a_chunk_is_refused(tmp_path: Path) -> None:
    inside = message(b"a", 5)
    parameters = zstandard.ZstdCompressionParameters(window_log=27, enable_ldm=True)
    packing = zstandard.ZstdCompressor(
        compression_params=parameters
    ).compressobj()  # of a size that it does not state
    packed = packing.compress(inside) + packing.flush()
    times, reported = read(tmp_path / "a.mcap", file_of(chunk(packed, "zstd", len(inside))))
    assert times == []
    assert "too much memory" in reported[0]


def test_a_chunk_in_the_summary_is_not_unpacked(tmp_path: Path) -> None:
    inside = message(b"", 5) * 100_000
    bomb = chunk(PACKINGS["zstd"](inside), "zstd", len(inside), zlib.crc32(inside))
    assert read(tmp_path / "a.mcap", file_of(described() + message(b"a", 7), bomb)) == ([7], [])


def test_a_record_of_unknown_kind_is_reported_and_what_is_behind_it_is_read(tmp_path: Path) -> None:
    content = file_of(described() + record(0x80, b"ours alone") + message(b"a", 3))
    times, reported = read(tmp_path / "a.mcap", content)
    assert (times, len(reported)) == ([3], 1)


def test_files_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for content in (b"", b"a", MAGIC[:7], bytes(8), bytes(1000)):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match="not an MCAP file"):
            McapFile(path)
    for content, damaged in ((MAGIC, 0), (MAGIC + b"\x01", 0), (MAGIC * 2, 0), (MAGIC * 7, 1)):
        times, reported = read(path, content)
        assert times == []
        assert len(reported) == damaged


def test_attachments(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for name, data in (
            ("a", b"first"),
            ("b", b"123456" + bytes(4)),
            ("a", b"last"),
            ("c", b"unasked"),
        ):
            writer.add_attachment(0, 0, name, "text/plain", data)
        writer.finish()
    assert attachments_in(path, {"a": 100, "b": 100, "d": 100}) == (
        {"a": b"last", "b": b"123456" + bytes(4)},
        [],
    )
    whole = path.read_bytes()
    data, name = whole.index(b"123456"), whole.index(b"123456") - 8 - len("text/plain") - 4 - 1
    head = name - 4 - 16 - 9
    for content, bytes_max, expected in (
        (whole, 9, f"{path}: leaving its b out: found 57 bytes, expected at most 9"),
        (
            flipped(whole, data + 2, 3),
            100,
            f"{path}: leaving its b out: its checksum does not match",
        ),
        (flipped(whole, name, 0), 100, f"{path}: leaving its c out: its checksum does not match"),
        # The length of its data; four less would make its last bytes a checksum of 0,
        # which stands for none.
        *(
            (flipped(whole, data - 8 + bit // 8, bit % 8), 100, "its checksum does not match")
            for bit in (0, 33, 63)
        ),
        (whole[: data - 8] + b"\6" + whole[data - 7 :], 100, "its checksum does not match"),
        # The head of its record: the kind, and bits of its length.
        *((flipped(whole, head, bit), 100, "skipping the damaged bytes") for bit in range(8)),
        (flipped(whole, head + 1, 1), 100, "skipping the damaged bytes"),
        (flipped(whole, head + 8, 7), 100, "skipping the damaged bytes"),
    ):
        path.write_bytes(content)
        found, reported = attachments_in(path, {"a": 100, "b": bytes_max})
        assert found == {"a": b"last"}
        assert any(expected in line for line in reported)


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
    assert [
        (found.topic, found.message_encoding, found.metadata) for found in summary.channels.values()
    ] == [("/cam", "protobuf", {"ours": "yes"})]
    assert (summary.counts, summary.span_ns) == ({1: 3}, (40, 90))


def test_every_flipped_bit_of_it_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    content = whole(path)
    footer_at = len(content) - 37
    assert content[footer_at] == FOOTER
    begin = int.from_bytes(content[footer_at + 9 : footer_at + 17], "little")
    for byte in (*range(begin, begin + 40, 3), *range(footer_at - 60, footer_at + 29, 3)):
        summary, damage = summary_of(path, flipped(content, byte, byte % 8))
        assert summary is None
        assert damage == f"{path}: ignoring the damaged or too large index at its end"


def test_what_lies_behind_a_right_checksum(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = described() + message(b"a", 7)
    large = record(0x81, bytes(SUMMARY_BYTES_MAX))
    for junk in (
        large,
        b"x",
        record(3, b"\xff" * 30),
        record(4, b"\xff" * 30),
        record(11, bytes(45)),
        record(8, bytes(3)),
    ):
        summary, damage = summary_of(path, file_of(data, junk))
        assert summary is None
        assert "ignoring the damaged" in damage


def test_descriptions_are_bounded(tmp_path: Path) -> None:
    content = file_of(
        described(topic="/" + "a" * DESCRIPTION_BYTES_MAX) + described() + message(b"a", 5)
    )
    times, reported = read(tmp_path / "a.mcap", content)
    assert times == [5]
    assert len(reported) == 1
    assert "skipping the damaged record" in reported[0]


@pytest.mark.slow
def test_a_noisy_picture_of_the_most_pixels_is_read_or_named_in_a_line(tmp_path: Path) -> None:
    """Noise has no smaller PNG: 17 MB in grey, 50 MB in colour."""
    noise = np.random.default_rng(0).integers(0, 256, (4096, 4096, 3), dtype=np.uint8)
    for image, is_read in ((noise[..., 0], True), (noise, False)):
        png = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 0])[1].tobytes()
        path = tmp_path / "a.mcap"
        with path.open("wb") as stream:
            writer = McapWriter(stream, "left")
            writer.frame("000000.png", Frame(0, 1000, 5, noise[..., 0]), png, 5)
            writer.finish()
        recording = Recording(path)
        if is_read:
            recorded = recording.read()
            assert recorded is not None
            np.testing.assert_array_equal(recorded.frame.image, image)
        else:
            with pytest.raises(DecodeError, match=r"found 50\d+ bytes, expected at most 33554432$"):
                recording.read()
