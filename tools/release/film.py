#!/usr/bin/env python3
"""The README's film: the page of the demo's hand over one round, in a headless browser.

::

    .venv/bin/python -m tools.release.film [FILE]

FILE is docs/images/hand.webp unless given. It begins once the round has been drawn, and shows every moment
as long as it took.
"""

from __future__ import annotations

import argparse
import io
import itertools
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from PIL import Image

from tacshade_edge.demo.hand import script
from tools.testbed.browser import browser

SIZE_PX: Final = (1100, 900)
WIDTH_PX: Final = 720
QUALITY: Final = 45
DRAWN_S: Final = 40.0
"""Time in s after which the demo has drawn its round."""
BYTES_MAX: Final = 2_000_000


def main() -> None:
    """Film the page, write the file and print its figures."""
    parser = argparse.ArgumentParser(description="The film of the README.")
    default = Path(__file__).resolve().parents[2] / "docs/images/hand.webp"
    parser.add_argument("file", type=Path, nargs="?", default=default, metavar="FILE", help="docs/images/hand.webp")
    args = parser.parse_args()
    words = (sys.executable, "-u", "-m", "tacshade_edge", "demo", "--hand")
    with tempfile.TemporaryDirectory() as folder:
        demo = subprocess.Popen(
            words, cwd=folder, stdout=subprocess.PIPE, text=True, env=os.environ | {"BROWSER": "true"}
        )
        try:
            pictures, shown_ms = film(address(demo), Path(folder, "profile"))
        finally:
            demo.send_signal(signal.SIGINT)
            demo.wait(20)
    height_px = round(WIDTH_PX * pictures[0].height / pictures[0].width)
    small = [each.resize((WIDTH_PX, height_px), Image.Resampling.LANCZOS) for each in pictures]
    small[0].save(
        *(args.file, "WEBP"),
        save_all=True,
        append_images=small[1:],
        duration=shown_ms,
        loop=0,
        quality=QUALITY,
        method=6,
    )
    size = args.file.stat().st_size
    print(
        f"{args.file}: {len(small)} pictures of {WIDTH_PX}x{height_px} px, {sum(shown_ms) / 1000:.0f} s, {size} bytes"
    )
    if size > BYTES_MAX:
        sys.exit(f"film: {size} bytes, expected at most {BYTES_MAX}")


def address(demo: subprocess.Popen[str]) -> str:
    """The page's address as the demo prints it."""
    assert demo.stdout is not None
    for line in demo.stdout:
        if found := re.search(r"http://\S+", line):
            return found[0]
    sys.exit("film: the demo ended without an address")


def film(page: str, profile: Path) -> tuple[list[Image.Image], list[int]]:
    """Pictures over one round of the demo, and how long each is shown, in ms."""
    pictures, at_s = [], []
    with browser(profile, size_px=SIZE_PX) as driver:
        driver.get(page)
        time.sleep(DRAWN_S)
        end_s = time.monotonic() + script().times_s[-1]
        while time.monotonic() < end_s:
            at_s.append(time.monotonic())
            pictures.append(Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB"))
    at_s.append(time.monotonic())
    return pictures, [round(1000 * (later - one)) for one, later in itertools.pairwise(at_s)]


if __name__ == "__main__":
    main()
