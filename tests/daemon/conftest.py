"""A small painted sensor and a scripted frame source: the outside, behind our own interface."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest

from tacshade_edge.core.greyscale import binarise
from tacshade_edge.devices.calibration_file import with_crc
from tacshade_edge.errors import TacshadeError
from tacshade_edge.types import U8, Calibration, Disc, Frame, Geometry

HEIGHT, WIDTH, PITCH_PX = 120, 160, 8.0
DISC = Disc(59.5, 79.5, 52.0)


def painted(*, touched: bool = False) -> U8:
    """White markers on a dark disc; larger markers in the middle where touched."""
    image = np.full((HEIGHT, WIDTH), 30, dtype=np.uint8)
    for i, row in enumerate(np.arange(4, HEIGHT, PITCH_PX)):
        for col in np.arange(4 + (i % 2) * PITCH_PX / 2, WIDTH, PITCH_PX):
            pressed = touched and np.hypot(row - DISC.row_c, col - DISC.col_c) < 20
            cv2.circle(image, (round(col), round(row)), 3 if pressed else 2, 200, -1)
    return image


def painted_calibration() -> Calibration:
    grey = painted()
    rows, cols = np.ogrid[:HEIGHT, :WIDTH]
    mask = (np.hypot(rows - DISC.row_c, cols - DISC.col_c) <= DISC.radius_px).astype(np.uint8)
    return with_crc(
        Calibration(
            geometry=Geometry(20.0, 30.0, 50.0, DISC),
            polarity="bright",
            binarisation="adaptive",
            image_height_px=HEIGHT,
            image_width_px=WIDTH,
            pitch_px=PITCH_PX,
            reference_white=255 * binarise(grey, mask, "adaptive", PITCH_PX),
            reference_grey=grey,
            noise_grey=0.5,
            alpha=15.0,
            table_grey=np.array([0, 60], dtype=np.float32),
            table_depth_mm=np.array([0, 3], dtype=np.float32),
        )
    )


FREE, TOUCHED, BLACK = painted(), painted(touched=True), np.zeros((HEIGHT, WIDTH), dtype=np.uint8)

Step = U8 | TacshadeError | Callable[[], None] | None


class ScriptedSource:
    """Plays one script per opening: an image is a frame, an error is raised, a callable is called, None ends.

    An error as a whole script is raised by `open`; a script that is used up loses the device.
    """

    def __init__(self, *scripts: Iterable[Step] | TacshadeError) -> None:
        self._scripts = iter(scripts)
        self._steps: Iterator[Step] = iter(())
        self._seq = 0
        self.dropped = 0
        self.opened_ns: list[int] = []
        self.is_open = False

    def open(self) -> None:
        self.opened_ns.append(time.monotonic_ns())
        script = next(self._scripts, [None])
        if isinstance(script, TacshadeError):
            raise script
        self._steps = iter(script)
        self.is_open = True

    def read(self) -> Frame | None:
        for step in self._steps:
            if isinstance(step, TacshadeError):
                raise step
            if step is None:
                return None
            if callable(step):
                step()
                continue
            self._seq += 1
            return Frame(seq=self._seq - 1, t_ns=time.monotonic_ns(), wall_ns=time.time_ns(), image=step)
        raise AssertionError("the script of this opening is used up; end it with None or an error")

    def close(self) -> None:
        self.is_open = False

    def describe(self) -> dict[str, str | int | float]:
        return {"script": "test"}


def wait_until(condition: Callable[[], bool], seconds: float = 10.0) -> None:
    """Poll `condition` until it holds or the deadline passes."""
    deadline = time.monotonic() + seconds
    pause = threading.Event()
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true in time"
        pause.wait(0.005)


@pytest.fixture(scope="session")
def calibration() -> Calibration:
    return painted_calibration()


@dataclass(frozen=True)
class Pictures:
    free: U8 = field(default_factory=lambda: FREE)
    touched: U8 = field(default_factory=lambda: TOUCHED)
    black: U8 = field(default_factory=lambda: BLACK)


@pytest.fixture(scope="session")
def pictures() -> Pictures:
    return Pictures()


@pytest.fixture(name="wait_until")
def wait_until_fixture() -> Callable[..., None]:
    return wait_until


@pytest.fixture
def scripted() -> type[ScriptedSource]:
    return ScriptedSource
