#!/usr/bin/env python3
"""A stand-in for a Raspberry Pi's ``rpicam-vid``:
the same arguments, the same two streams, the same words.

It writes what rpicam-apps' output/output.cpp and file_output.cpp write: a frame, flushed, then its
metadata as lines of ``Name=value`` and an empty one. `STAND_IN` in the environment, a JSON object,
says what it does otherwise:

frames : str       a .npy file of uint8 (N, H, W), shown one after the other, again and again
count : int        ends after so many
lose : [int]       frames that the sensor takes and nobody gets
settle : int       so many first frames have another exposure
exposure : float   times what was asked
extra_bytes : int  more (or fewer) in each frame
records : bool     whether it describes frames
says : str         written to its standard error before it ends with 255, at once
notes : str        a file where it writes its arguments, as JSON
stalls : int       after so many frames it writes nothing more
behind : int       so many first frames come at once, then what it says of them,
                   of the last one a little later
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pytest


CAMERAS = """\
Available cameras
-----------------
0 : imx219 [3280x2464 10-bit RGGB] (/base/soc/i2c0mux/i2c@1/imx219@10)
    Modes: 'SRGGB10_CSI2P' : 640x480 [206.65 fps - (1000, 752)/1280x960 crop]
                             1640x1232 [41.85 fps - (0, 0)/3280x2464 crop]
                             1920x1080 [47.57 fps - (680, 692)/1920x1080 crop]
                             3280x2464 [21.19 fps - (0, 0)/3280x2464 crop]"""


def put_on_path(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make it the program that is found."""
    program = folder / "rpicam-vid"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {__file__} "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")


def arguments() -> argparse.Namespace:
    """What the caller asks for, as the program accepts it."""
    parser = argparse.ArgumentParser()
    for name in ("camera", "width", "height", "shutter", "timeout", "verbose"):
        parser.add_argument(f"--{name}", type=int)
    for name in ("framerate", "gain"):
        parser.add_argument(f"--{name}", type=float)
    for name in ("autofocus-mode", "lens-position", "mode", "awbgains", "denoise"):
        parser.add_argument(f"--{name}")
    for name in ("codec", "output", "metadata", "metadata-format"):
        parser.add_argument(f"--{name}")
    for name in ("nopreview", "flush", "list-cameras"):
        parser.add_argument(f"--{name}", action="store_true")
    return parser.parse_args()


def main() -> int:
    """Do what is asked for, but for what `STAND_IN` says."""
    args = arguments()
    do = json.loads(os.environ.get("STAND_IN", "{}"))
    if notes := do.get("notes"):
        Path(notes).write_text(json.dumps(vars(args)))
    if says := do.get("says"):
        print(says, file=sys.stderr)
        return 255
    if args.list_cameras:
        print(CAMERAS)
        return 0
    form = (args.codec, args.output, args.metadata_format, args.flush)
    assert form == ("yuv420", "-", "txt", True)
    assert args.autofocus_mode == "manual"  # otherwise a lens that moves focuses all the time
    with Path(args.metadata).open("wb", buffering=0) as records:
        show(args, do, records)
    return 0


def show(args: argparse.Namespace, do: dict[str, Any], records: IO[bytes]) -> None:
    """Write frames until nobody reads."""
    shape = (args.height, args.width)
    images = (
        np.load(do["frames"])
        if "frames" in do
        else np.arange(4, dtype=np.uint8)[:, None, None] * np.ones(shape)
    )
    colour_bytes = shape[0] * shape[1] // 2 + do.get("extra_bytes", 0)
    colour, cut = bytes([128]) * max(colour_bytes, 0), min(colour_bytes, 0) or None
    period_ns, behind, waiting = round(1e9 / args.framerate), do.get("behind", 0), b""
    began_ns = time.monotonic_ns()
    for n in range(do.get("count", 1 << 62)):
        stamp_ns = began_ns + n * period_ns
        time.sleep(max(0, stamp_ns + period_ns // 2 - time.monotonic_ns()) / 1e9)
        if n in do.get("lose", ()):
            continue
        if n == do.get("stalls"):
            time.sleep(60)
        image = images[n % len(images)].astype(np.uint8).tobytes()
        sys.stdout.buffer.write(image[:cut] + colour)
        if n + 1 >= behind:
            sys.stdout.buffer.flush()
        text = record(args, do, n, stamp_ns)
        if n + 1 < behind:
            waiting += text
            continue
        if n + 1 == behind:
            records.write(waiting)
            time.sleep(0.3)
        if do.get("records", True):
            records.write(text)


def record(args: argparse.Namespace, do: dict[str, Any], n: int, stamp_ns: int) -> bytes:
    """What the program says of a frame."""
    exposure = do.get("exposure", 1) * args.shutter * (2 if n < do.get("settle", 0) else 1)
    values = {
        "SensorTimestamp": stamp_ns,
        "ExposureTime": round(exposure),
        "AnalogueGain": f"{args.gain:.6f}",
        "FrameDuration": round(1e9 / args.framerate) // 1000,
        "ColourGains": "[ 1.000000, 1.000000 ]",
    }
    if do.get("lens"):
        place = args.lens_position
        values["LensPosition"] = 1.0 if place == "default" else float(place)
    return "".join(f"{key}={value}\n" for key, value in values.items()).encode() + b"\n"


if __name__ == "__main__":
    try:
        sys.exit(main())
    except BrokenPipeError:
        os._exit(255)  # as when nobody reads: ERROR: *** failed to write output bytes ***
