"""The capture time in a preview, which JPEG's decoders skip."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tacshade_edge.wire.stamped_jpeg import capture_wall_ns, stamped


def test_a_decoder_skips_the_time() -> None:
    picture = np.arange(48, dtype=np.uint8).reshape(6, 8)
    _, jpeg = cv2.imencode(".jpg", picture)
    with_time = stamped(jpeg.tobytes(), 1_700_000_000_000_000_000)
    assert capture_wall_ns(with_time) == 1_700_000_000_000_000_000
    np.testing.assert_array_equal(
        cv2.imdecode(np.frombuffer(with_time, np.uint8), 0), cv2.imdecode(jpeg, 0)
    )


@pytest.mark.parametrize(
    "jpeg",
    [
        b"",
        b"\xff\xd8\xff\xe0\0\x10JFIF",
        b"\xff\xd8\xff\xfe\0\x0awall_ns=",
        b"\xff\xd8\xff\xfe\0\xffwall_ns=" + b"9" * 21,
    ],
)
def test_without_a_time(jpeg: bytes) -> None:
    assert capture_wall_ns(jpeg) is None
