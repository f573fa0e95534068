"""What libjpeg and libpng write about odd pictures."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import ctypes, logging, struct, zlib
import cv2, numpy as np
from tacshade_edge.cli.shared.logs import start_logging

start_logging(logging.INFO)
data = bytearray(cv2.imencode(".jpg", np.arange(240 * 320, dtype=np.uint32).astype(np.uint8).reshape(240, 320))[1])
data[-2:-2] = b"\\0" * 7
for _ in range(100):
    assert cv2.imdecode(np.frombuffer(data, np.uint8), 0) is not None
png = cv2.imencode(".png", np.zeros((9, 9), np.uint8))[1].tobytes()
profile = b"iCCPx" + bytes(2) + b"junk"
chunk = struct.pack(">I", len(profile) - 4) + profile + struct.pack(">I", zlib.crc32(profile))
assert cv2.imdecode(np.frombuffer(png[:33] + chunk + png[33:], np.uint8), 0) is not None
libc = ctypes.CDLL(None)
libc.fputs(b"from another library\\n", ctypes.c_void_p.in_dll(libc, "stderr"))
"""


def test_a_camera_that_damages_every_picture_does_not_flood_the_log() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=120, check=True)
    lines = done.stderr.splitlines()
    assert 1 <= sum("libjpeg: Corrupt JPEG data" in line for line in lines) < 20, lines[:5]
    assert any(" libpng warning: iCCP" in line for line in lines), lines[-5:]
    assert "left out" in done.stderr
    assert "from another library" in lines


@pytest.mark.parametrize(
    ("crash", "says"),
    [
        ("faulthandler.enable(); ctypes.string_at(0)", "Fatal Python error: Segmentation fault"),
        ("ctypes.pythonapi.Py_FatalError(b'an invariant')", "an invariant"),
        ("libc.__assert_fail(b'an invariant', b'file.c', 1, b'f')", "Assertion `an invariant' failed"),
        ("libc.fputs(b'an invariant', stderr); libc.abort()", "an invariant"),
        ("print(libc.fileno(stderr), file=sys.stderr); os.abort()", "2\n"),
    ],
)
def test_a_crash_still_prints_why(crash: str, says: str) -> None:
    program = (
        PROGRAM.partition("data =")[0]
        + f"""
import faulthandler, os, sys
libc = ctypes.CDLL(None)
stderr = ctypes.c_void_p.in_dll(libc, "stderr")
{crash}
"""
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode < 0
    assert says in done.stderr
