"""Camera and dialogue together: every wait keeps reading frames,
so that picture and figures stay current.
"""

from __future__ import annotations

import os
import select
import shutil
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TextIO

import cv2
import numpy as np

from tacshade_edge.calibration.reference.pattern import Pattern, find_pattern, view
from tacshade_edge.calibration.reference.stillness import (
    REST_MOST_GREY,
    block_means,
    motion_grey,
    stands_still,
)
from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.capture.page import Page, Shown
from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.types import F32, U8, Disc, Frame

_CLEAR: Final = "\r\x1b[K"


class InputEnded(Exception):  # noqa: N818 (no error: it ends the work as a line does)
    """The person ended the dialogue (Ctrl-D), or the pipe in place of a person has closed."""


class Terminal:
    """A terminal that reads lines from a file descriptor and writes lines to a stream.

    `descriptor`: source of the lines, such as standard input.
    """

    def __init__(self, descriptor: int, out: TextIO) -> None:
        self._descriptor = descriptor
        self._out = out
        self._is_live = out.isatty()
        self._typed = b""
        self._shown = ""

    def line(self) -> str | None:
        """Return the next typed line, stripped; None if there is none yet. Raises InputEnded."""
        # Never block here: frames must go on being read, or the driver's queue fills with old ones.
        if b"\n" not in self._typed and select.select([self._descriptor], [], [], 0)[0]:
            data = os.read(self._descriptor, 4096)
            if not data:
                raise InputEnded
            self._typed += data
        line, end, rest = self._typed.partition(b"\n")
        if not end:
            return None
        # The person's Enter has moved the cursor on, so there is nothing left to clear.
        self._typed, self._shown = rest, ""
        return line.decode(errors="replace").strip()

    def wait(self) -> str:
        """Wait for the next line and return it; nothing else runs meanwhile. Raises InputEnded."""
        while (line := self.line()) is None:
            select.select([self._descriptor], [], [])
        return line

    def say(self, text: str, end: str = "\n") -> None:
        """Print a line; it replaces one printed by `show`."""
        print(f"{_CLEAR if self._shown else ''}{text}", end=end, file=self._out, flush=True)
        self._shown = ""

    def ask(self, text: str) -> None:
        """Print a prompt for the person's line."""
        self.say(text, end=" ")

    def show(self, text: str) -> None:
        """Show a line that the next one replaces; only if the output is a terminal."""
        if self._is_live and text != self._shown:
            print(
                f"{_CLEAR}{text[: shutil.get_terminal_size().columns - 1]}",
                end="",
                file=self._out,
                flush=True,
            )
            self._shown = text


# The picture counts as still after `STILL_S` without motion,
# judged from as many frames as motion at rest is.
STILL_S, STILL_FRAMES = 0.8, 10
# If a slow camera delivers fewer in `STILL_S`, a longer time is compared.
_LEAST_FRAMES = 5
# Enough for `STILL_S` at 80 frames a second.
_PAST_FRAMES = 64
# People cannot read figures that change faster, and encoding a JPEG costs frames.
_FIGURES_S, _PICTURE_S = 0.5, 0.2
# Finding the circle takes up to a second on a small board.
_PATTERN_S = 4.0
# A hand needs a few seconds to hold still; a hint before that would only hurry it.
_HINT_S = 5.0
# A bad frame is skipped; a camera that sends as many in a row does not recover by itself.
_UNUSABLE_MAX = 100


def rest_grey_of(blocks: Sequence[F32]) -> float:
    """Return the motion of pictures at rest in grey levels.

    Raises ConfigError if it is too large.
    """
    if (rest_grey := motion_grey(blocks)) > REST_MOST_GREY:
        found = (
            f"found a change of {rest_grey:.1f} grey levels, expected at most {REST_MOST_GREY:g}"
        )
        raise ConfigError(f"the picture is moving or too noisy: {found}")
    return rest_grey


@dataclass(eq=False)
class Live:
    """An open source whose frames are read during every wait."""

    source: FrameSource
    terminal: Terminal
    page: Page
    circle: Disc | None  # that SENSOR.yaml states; None to find it in the picture
    # `motion_grey` of the `STILL_FRAMES` frames taken at rest; 0 before that
    rest_grey: float = 0.0

    def __post_init__(self) -> None:
        # Time in ns and block means of past frames: a sixteenth of what grey frames would take.
        self._past: deque[tuple[int, F32]] = deque(maxlen=_PAST_FRAMES)
        self._pattern: Pattern | None = None
        self._no_pattern = "looking for the disc"
        self._looking = False  # whether the person may be adjusting lens and circle
        self._focus_best = 0.0
        self._text = self._task = ""
        self._pattern_due_s = self._figures_due_s = self._picture_due_s = 0.0

    def frame(self) -> Frame:
        """Read the next frame.

        Raises DeviceError (the camera was lost, delivers only unusable pictures, changed its size,
        or the source has ended).
        """
        for _ in range(_UNUSABLE_MAX):
            try:
                frame = self.source.read()
            except DecodeError as error:
                self.terminal.show(str(error))
                continue
            if frame is None:
                raise DeviceError("the frame source has no more frames")
            self._take(frame)
            return frame
        raise DeviceError(f"found {_UNUSABLE_MAX} unusable pictures in a row")

    def ask(self, text: str, *, with_figures: bool = False) -> str:
        """Ask for a line and read frames until the person has typed it.

        Raises InputEnded, and as `frame`. `with_figures`: show the figures live in place of a
        prompt, for questions that only Enter answers.
        """
        self._looking = with_figures
        (self.terminal.say if with_figures else self.terminal.ask)(text)
        while True:
            self.frame()
            if with_figures:
                self.terminal.show(self._text)
            if (line := self.terminal.line()) is not None:
                self._looking = False
                return line

    def still_frame(self) -> Frame | None:
        """Return the frame once the picture stands still; None if a line was typed first.

        Raises as `frame`.
        """
        # Frames from before the question show how the indenter came, not how it is held.
        self._past.clear()
        began_s, hinted = time.monotonic(), False
        while True:
            frame = self.frame()
            motion = self._motion_grey()
            if motion is not None and stands_still(motion, self.rest_grey):
                return frame
            if self.terminal.line() is not None:
                self.terminal.say("  cancelled: took no picture")
                return None
            if not hinted and motion is not None and time.monotonic() - began_s > _HINT_S:
                hinted = True
                figures = f"{motion:.1f} grey levels, {self.rest_grey:.1f} at rest"
                self.terminal.say(
                    f"  the picture still moves ({figures}): clamp the indenter; Enter cancels"
                )

    def tell(self, task: str) -> None:
        """Show the person a task and its progress, on the page above the figures and
        in the terminal.
        """
        self._task = task
        if task:
            self.terminal.show(task)

    def stands_still(self, seconds: float) -> bool:
        """Whether the picture has stood still for so long."""
        motion = self._motion_grey(seconds)
        return motion is not None and stands_still(motion, self.rest_grey)

    def frames(self, count: int, seconds: float) -> list[Frame]:
        """Return `count` frames spread over at least `seconds`."""
        taken = [self.frame()]
        while len(taken) < count:
            frame = self.frame()
            # By the frames' own times, because reading may lag behind the camera.
            if (frame.t_ns - taken[0].t_ns) / 1e9 >= seconds * len(taken) / (count - 1):
                taken.append(frame)
        return taken

    @property
    def has_circle(self) -> bool:
        """Whether a visible circle is stated, or found with a pattern in it."""
        return self.circle is not None or self._pattern is not None

    def _motion_grey(self, seconds: float = STILL_S) -> float | None:
        """Motion within the last seconds, in grey levels; None until enough frames have come."""
        newest_ns, _ = self._past[-1]
        recent = [blocks for t_ns, blocks in self._past if newest_ns - t_ns <= 1e9 * seconds]
        if len(recent) < _LEAST_FRAMES:
            recent = [blocks for _, blocks in self._past][-_LEAST_FRAMES - 1 :]
        if len(recent) == len(self._past) < _PAST_FRAMES:
            return None  # the frames do not reach back far enough yet
        # As many frames as at rest, because the greatest difference grows with their number.
        spread = np.linspace(0, len(recent) - 1, STILL_FRAMES).round().astype(int)
        return motion_grey([recent[k] for k in spread])

    def _take(self, frame: Frame) -> None:
        grey, now_s = to_grey(frame.image), time.monotonic()
        if self._past and self._past[-1][1].shape != (grey.shape[0] // 8, grey.shape[1] // 8):
            raise DeviceError(
                f"the camera's picture size changed to {grey.shape[1]}x{grey.shape[0]} px"
            )
        self._past.append((frame.t_ns, block_means(grey)))
        # Once found, the circle is searched again only while lens or light may be changed: a search
        # holds up the frames.
        if now_s >= self._pattern_due_s and (self._looking or self._pattern is None):
            try:
                self._pattern = find_pattern(grey, self.circle)
            except ConfigError as error:
                self._pattern, self._no_pattern = None, str(error)
            # Counted from its end, or a slow board would do nothing else.
            self._pattern_due_s = time.monotonic() + _PATTERN_S
        if now_s >= self._figures_due_s:
            self._text = self._figures_of(grey)
            self._figures_due_s = now_s + _FIGURES_S
        if now_s >= self._picture_due_s:
            disc = self.circle or (self._pattern.disc if self._pattern else None)
            text = "\n".join(filter(None, (self._task, self._text)))
            self.page.shown = Shown(_jpeg(grey, disc), text)
            self._picture_due_s = now_s + _PICTURE_S

    def _figures_of(self, grey: U8) -> str:
        if self._pattern is None:
            return f"no disc: {self._no_pattern} | mean grey {grey.mean():.0f}"
        seen = view(grey, self._pattern)
        self._focus_best = max(self._focus_best, seen.focus)
        figures = [
            f"disc {self._pattern.disc.radius_px:.0f} px",
            f"focus {seen.focus:.3f} (best {self._focus_best:.3f})",
            f"contrast {seen.contrast_grey:.0f}",
            f"saturated {100 * seen.saturated_part:.0f} %",
        ]
        if seen.advice:
            figures.insert(0, seen.advice)
        return " | ".join(figures)


def _jpeg(grey: U8, disc: Disc | None) -> bytes:
    """Encode the picture as JPEG, with the circle drawn in."""
    picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    if disc is not None:
        centre = (round(disc.col_c), round(disc.row_c))
        cv2.circle(picture, centre, round(disc.radius_px), (0, 200, 255), 1, cv2.LINE_AA)
    return bytes(cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, 80))[1].tobytes())
