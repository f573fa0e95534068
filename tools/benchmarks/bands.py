#!/usr/bin/env python3
"""Measure what processing an image in bands that fit the cache would save in the pixel steps before the network.

::

    .venv/bin/python -m tools.benchmarks.bands [--rounds 40]

The OpenCV calls between camera and gate (halving, the check's two norms, mask, threshold, integral image) run in turn
over the whole image and over bands of several heights. Between two frames the program reads 16 MB of other memory,
since at 60 frames a second other work fills the caches. Figures are medians of CPU time in microseconds.
"""

from __future__ import annotations

import argparse
import time

import cv2
import numpy as np

from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import I32, U8

SIZES = {"640x480, halved": (480, 640, True), "640x480": (480, 640, False), "1280x960": (960, 1280, False)}
BANDS = (16, 32, 64, 128)
"""Heights of the bands in camera rows; even, so that each band can be halved separately."""


class Steps:
    """The pixel steps for one image size, with their buffers."""

    def __init__(self, height: int, width: int, halve: bool) -> None:
        rng = np.random.default_rng(0)
        per = 2 if halve else 1
        rows, cols = height // per, width // per
        self.image: U8 = rng.integers(0, 256, (height, width), np.uint8)
        self._halve = halve
        self._grey, self._masked, self._white = (np.empty((rows, cols), np.uint8) for _ in range(3))
        self._mask: U8 = np.full((rows, cols), 255, np.uint8)
        self._threshold: U8 = rng.integers(90, 160, (rows, cols), np.uint8)
        self._total: I32 = np.zeros((rows + 1, cols + 1), np.int32)

    def run(self, band_rows: int) -> None:
        """Process the image in bands of `band_rows` camera rows."""
        per = 2 if self._halve else 1
        for first in range(0, self.image.shape[0], band_rows):
            taken = self.image[first : first + band_rows]
            at = slice(first // per, first // per + taken.shape[0] // per)
            grey, masked, white, mask = (each[at] for each in (self._grey, self._masked, self._white, self._mask))
            if self._halve:
                cv2.resize(taken, grey.shape[::-1], dst=grey, interpolation=cv2.INTER_AREA)
            else:
                grey = taken
            cv2.norm(grey, cv2.NORM_L1, mask)
            cv2.norm(grey, cv2.NORM_L2SQR, mask)
            cv2.bitwise_and(grey, mask, dst=masked)
            cv2.compare(masked, self._threshold[at], cv2.CMP_GT, dst=white)
            cv2.bitwise_and(white, 1, dst=white)
            # Each band gets its own integral image; adding the rows above it is not counted here.
            self._total[at.start + 1 : at.stop + 1] = cv2.integral(white)[1:]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="The pixel steps before the network, whole and in bands.")
    parser.add_argument("--rounds", type=int, default=40)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    other: U8 = np.ones(16 << 20, np.uint8)
    rows = []
    for name, size in SIZES.items():
        steps = Steps(*size)
        ways = {"whole": size[0], **{str(band): band for band in BANDS}}
        taken: dict[str, list[float]] = {way: [] for way in ways}
        for _ in range(args.rounds):
            for way, band in ways.items():
                other.sum()
                start = time.thread_time_ns()
                steps.run(band)
                taken[way].append((time.thread_time_ns() - start) / 1e3)
        rows.append([name, *(f"{np.median(each[1:]):.0f}" for each in taken.values())])
    print(markdown(["picture", "whole", *(f"{band} rows" for band in BANDS)], rows))


if __name__ == "__main__":
    main()
