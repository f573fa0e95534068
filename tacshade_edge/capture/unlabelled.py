"""Pictures that need no label: the untouched sensor for a while, and touches of anything,
anywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from tacshade_edge.calibration.files.capture_folder import CaptureFolder
from tacshade_edge.calibration.presses.press_check import Judgement
from tacshade_edge.calibration.reference.stillness import block_means
from tacshade_edge.capture.change import ChangeFromRest, change_grey
from tacshade_edge.capture.live import STILL_FRAMES, Live, Terminal
from tacshade_edge.quoting import counted
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.types import F32, U8, Frame

REST_S: Final = 45.0
REST_PICTURES: Final = 300
REST_LEAST: Final = 20
"""Fewer pictures of the untouched sensor are not kept."""
TOUCHES: Final = 20
SETTLED_S: Final = 0.3
"""A touch is taken once the picture has stood still for this long."""
_UNTOUCHED_S: Final = 1.0
_OTHER_PART: Final = 0.5
"""Another touch differs from the one before by at least this part of that one's change
from rest.
"""
_JUDGED_MAX: Final = 20
_SKIP: Final = "skip"

_REST_TEXT = f"""{REST_S:.0f} s of the untouched sensor show where a touch begins.
Keep everything off the skin.
If a robot holds the sensor, let it move as in use.
Enter starts, Enter again ends it early, skip leaves it out:"""
_TOUCHES_TEXT = f"""{TOUCHES} touches of anything, anywhere, light and firm,
show how this skin looks when touched.
They need no numbers. Hold each for a moment.
Enter starts, while nothing touches; Enter again ends it early, skip leaves it out:"""


@dataclass(eq=False)
class Unlabelled:
    """Takes these pictures into the folder of a capture.

    `judge`: whether `calibrate` can use a picture.
    """

    folder: CaptureFolder
    live: Live
    terminal: Terminal
    judge: Callable[[U8], Judgement]

    def take_missing(self) -> str:
        """Take what the folder lacks, if the person does not skip it.

        A person who types anything else, such as a press, skips all of it: returns that line, else
        an empty one. Raises InputEnded, DeviceError.
        """
        instead = "" if self.folder.rest_pictures() else self.take_rest()
        if instead or len(self.folder.touch_pictures()) >= TOUCHES:
            return instead
        return self.take_touches()

    def take_rest(self) -> str:
        """Record the untouched sensor; an earlier recording stays until this one is complete.

        Returns and raises like `take_missing`.
        """
        if answer := self.live.ask(_REST_TEXT):
            return _instead(answer)
        taken, seconds = self._record()
        if taken < REST_LEAST:
            expected = f"expected at least {REST_LEAST}"
            self.terminal.say(f"  not kept: found {counted(taken, 'picture')}, {expected}")
            return ""
        self.folder.finish_rest()
        self.terminal.say(
            f"  rest: {counted(taken, 'picture')} of the untouched sensor in {seconds:.0f} s"
        )
        self._warn_of_touched()
        return ""

    def _record(self) -> tuple[int, float]:
        """Store frames at even times for `REST_S` or until a line is typed;
        how many, and for how many seconds.
        """
        # Into a folder beside the old one, which a recording that is too short must not replace.
        self.folder.begin_rest()
        start_ns, taken, seconds = self.live.frame().t_ns, 0, 0.0
        while seconds < REST_S and self.terminal.line() is None:
            frame = self.live.frame()
            seconds = (frame.t_ns - start_ns) / 1e9
            self.live.tell(f"untouched sensor: {min(seconds, REST_S):.0f} of {REST_S:.0f} s")
            # Spread over the whole time: a tremor or a flicker of seconds must be among the
            # pictures.
            if taken < REST_PICTURES and seconds >= taken * REST_S / REST_PICTURES:
                taken += 1
                self.folder.add_rest(taken, np.array(frame.image))
        self.live.tell("")
        return taken, seconds

    def _warn_of_touched(self) -> None:
        """Warn of pictures that look touched; they stay,
        since an unknown print can look so at rest too.
        """
        paths = self.folder.rest_pictures()
        # A judgement runs a network, and the person waits.
        some = paths[:: -(-len(paths) // _JUDGED_MAX)]
        judged = [self.judge(self.folder.picture(path)) for path in some]
        touched = sum(one.in_contact for one in judged)
        if touched:
            found = f"{touched} of {len(some)} look as if something touched the skin"
            self.terminal.say(f"  warning: {found}; if something did, type rest to repeat it")

    def take_touches(self, *, anew: bool = False) -> str:
        """Take touches until there are `TOUCHES` or the person ends it; `anew`: instead of those
        that the folder has. Returns and raises like `take_missing`.
        """
        if answer := self.live.ask(_TOUCHES_TEXT):
            return _instead(answer)
        if anew:
            self.folder.forget_touches()
        # Not the references: the light may have changed since they were taken.
        untouched = self.live.frames(STILL_FRAMES, _UNTOUCHED_S)
        rest = ChangeFromRest([block_means(to_grey(one.image)) for one in untouched])
        before: F32 | None = None
        taken = len(self.folder.touch_pictures())
        while taken < TOUCHES and self.terminal.line() is None:
            frame = self.live.frame()
            blocks = block_means(to_grey(frame.image))
            advice = self._advice(frame, blocks, before, rest)
            if not advice:
                taken += 1
                self.folder.add_touch(np.array(frame.image))
                # So that a touch that stays is not taken again and again.
                before = blocks
                advice = "lift"
            self.live.tell(f"touch {min(taken + 1, TOUCHES)} of {TOUCHES}: {advice}")
        self.live.tell("")
        self.terminal.say(f"  {counted(taken, 'unlabelled touch')}")
        return ""

    def _advice(self, frame: Frame, blocks: F32, before: F32 | None, rest: ChangeFromRest) -> str:
        """What the person should do; empty if the picture shows a new touch that stands still."""
        if not rest.in_contact(blocks):
            return "touch the skin"
        if before is not None:
            other = max(rest.least_grey, _OTHER_PART * rest.grey(before))
            if change_grey(blocks, before) < other:
                return "touch elsewhere"
        if not self.live.stands_still(SETTLED_S):
            return "hold still"
        # Last, because it is the only check that costs more than a frame's time.
        judged = self.judge(np.array(frame.image))
        unusable = judged.moved or judged.unusable
        return f"not taken: {unusable}" if unusable else ""


def _instead(answer: str) -> str:
    """The line that a person typed instead of starting; empty for `_SKIP`."""
    return "" if answer == _SKIP else answer
