"""Decode the messages of a daemon or a hand, and the files of a replay."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from tacshade_edge.errors import DecodeError
from tacshade_edge.library.arguments import path_of, wrong
from tacshade_edge.recording.runs import payloads
from tacshade_edge.wire import binary
from tacshade_edge.wire.hand_topics import HandObjects
from tacshade_edge.wire.topics import decode_hand

Message = binary.HeightMessage | binary.CloudMessage | binary.ShearMessage | binary.SigmaMessage


def decode(payload: bytes | bytearray | memoryview) -> Message | HandObjects:
    """Decode the payload of one ``height``, ``cloud``, ``shear``, ``sigma``,
    ``map/cloud`` or hand's ``objects``.

    Parameters
    ----------
    payload : bytes-like
        One whole payload in the format of docs/reference/mqtt.md.

    Returns
    -------
    HeightMessage, CloudMessage, ShearMessage, SigmaMessage or HandObjects
        The kind that the payload's header states; HandObjects for JSON.
        Arrays are read-only, lengths in mm.

    Raises
    ------
    DecodeError
        The payload does not follow the format, or its checksum is wrong.
    ConfigError
        The payload is not bytes-like.
    """
    if not isinstance(payload, bytes | bytearray | memoryview):
        raise wrong("payload", payload, "bytes")
    # A memoryview has no `startswith`; the decoders need bytes anyway.
    data = bytes(payload)
    # Binary payloads begin with their magic, so a brace can only be JSON.
    return decode_hand(data) if data.startswith(b"{") else binary.decode(data)


def decode_file(path: str | os.PathLike[str]) -> Iterator[Message]:
    """Decode a replay's file of payloads, one after another:
    ``heights.bin``, ``clouds.bin`` or ``shears.bin``.

    Parameters
    ----------
    path : path
        The file; only one of its messages is in memory at a time.

    Yields
    ------
    HeightMessage, CloudMessage, ShearMessage or SigmaMessage

    Raises
    ------
    ConfigError
        There is no such file.
    DecodeError
        The file is cut short or damaged.
    """
    file = path_of("path", path)
    return _messages(file.parent, file.name)


def _messages(folder: Path, name: str) -> Iterator[Message]:
    for number, payload in enumerate(payloads(folder, name)):
        try:
            message = binary.decode(payload)
        except DecodeError as error:
            raise DecodeError(f"{folder / name}: message {number}: {error}") from None
        yield message
