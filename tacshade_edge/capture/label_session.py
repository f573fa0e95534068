"""The dialogue that takes labelled frames: a person types readings,
or a scale or a robot labels whole presses.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.calibration.files.labels import LabelFolder, LabelRow
from tacshade_edge.calibration.reference.stillness import block_means
from tacshade_edge.capture.change import ChangeFromRest
from tacshade_edge.capture.live import STILL_FRAMES, Live, Terminal, rest_grey_of
from tacshade_edge.capture.robot_place import RobotLabels
from tacshade_edge.capture.scale import ClockOffset, Scale, ScalePress, find_offset, force_at
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files.tables import number
from tacshade_edge.quoting import counted
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.types import QUANTITIES, Frame

_REST_S = 3.0
# Of one press: neighbouring frames show nearly the same, and fill the disk.
_KEPT_EVERY_NS, _KEPT_MAX = 100_000_000, 100
# The first pose after a frame has arrived by then; a pose between two is interpolated.
_POSE_NS = 200_000_000
_NO_IMAGE = np.zeros((1, 1), np.uint8)
_FORCE = "force_z_n"

_HELP = """  Enter            record a press: press, lift, then Enter; needs a scale or a robot
    NAME=VALUE ...   type readings while you hold still: force_z_n=1.2 depth_mm=0.5;
                     takes one picture
    touch            set first touch where the robot holds the skin now: depth and the rest
                     count from there
    undo             remove the last press
    done             end"""


@dataclass(eq=False)
class LabelSession:
    """One run of the command on a folder that may already hold an earlier run's frames.

    `scale`: already open.
    """

    folder: LabelFolder
    live: Live
    terminal: Terminal
    scale: Scale | None
    robot: RobotLabels | None

    def __post_init__(self) -> None:
        self._rows = self.folder.rows()
        self._presses: dict[str, ScalePress] = {}  # this run's presses by group
        self._rest = ChangeFromRest([np.zeros((1, 1), np.float32)])
        self._tare_n = 0.0
        self._unaligned = self._unposed = ""

    def run(self) -> None:
        """Take rest and tare, then labelled frames until the person ends the run.

        Raises InputEnded, DeviceError, ConfigError (the folder keeps what was taken before).
        """
        if self._rows:
            self.terminal.say(
                f"this folder already has {counted(len(self._rows), 'labelled picture')}"
            )
        self._take_rest()
        while True:
            # Above all numbers of the folder: two presses in one group would count as one in cross-
            # validation.
            group = str(
                max((int(row.group) for row in self._rows if row.group.isdecimal()), default=0) + 1
            )
            match self.live.ask(
                f"press {group} (Enter, NAME=VALUE ..., touch, undo, done, help):"
            ).split():
                case ["done"]:
                    break
                case ["help" | "?"]:
                    self.terminal.say(_HELP)
                case ["undo"]:
                    self._undo()
                case ["touch"]:
                    self._confirm_touch()
                case []:
                    self._record(group)
                case words:
                    self._typed(words, group)
        self._end()

    def _take_rest(self) -> None:
        load = " or loads the scale" if self.scale else ""
        while True:
            self.live.ask(
                f"Make sure that nothing touches the skin{load}; Enter takes "
                f"rest{' and tare' if self.scale else ''}."
            )
            # The tare is of readings from now on: before, something may have lain on the scale.
            since_s = time.monotonic()
            blocks = [
                block_means(to_grey(one.image)) for one in self.live.frames(STILL_FRAMES, _REST_S)
            ]
            try:
                self.live.rest_grey = rest_grey_of(blocks)
            except ConfigError as error:
                self.terminal.say(f"  rejected: {error}")
                continue
            self._rest = ChangeFromRest(blocks)
            if self.scale is None or self._tare(self.scale, since_s):
                return

    def _tare(self, scale: Scale, since_s: float) -> bool:
        scale.check()
        tare_n, spread_n = scale.median_n(since_s)
        if math.isnan(tare_n):
            self.terminal.say("  rejected: the scale has sent no reading since you pressed Enter")
            return False
        self._tare_n = tare_n
        self.terminal.say(f"  tare: the scale reads {tare_n:.4f} N, spread {spread_n:.4f} N")
        return True

    def _typed(self, words: Sequence[str], group: str) -> None:
        try:
            known = _parse(words)
        except ConfigError as error:
            self.terminal.say(f"  {error} (type help)")
            return
        if (frame := self.live.still_frame()) is None:
            return
        # A typed reading wins over the robot's: the person had a reason to type it.
        known = {**self._robot_labels(frame), **known}
        self._keep(
            [LabelRow(self.folder.add_image(np.array(frame.image)), known, group, frame.t_ns)]
        )

    def _record(self, group: str) -> None:
        if self.scale is None and not (self.robot and self.robot.knows_first_touch):
            expected = (
                "touch first"
                if self.robot
                else "NAME=VALUE ..., because there is neither a scale nor a robot"
            )
            self.terminal.say(f"  found nothing, expected {expected} (type help)")
            return
        self.terminal.say("  press, then lift; Enter ends the press")
        seen: list[tuple[float, float]] = []
        rows: list[LabelRow] = []
        posed: list[dict[str, float]] = []
        held: deque[Frame] = deque()  # each waits for the robot's pose that follows it
        while self.terminal.line() is None:
            frame = self.live.frame()
            if self.scale is not None:
                self.scale.check()
            blocks = block_means(to_grey(frame.image))
            # Frames without contact too: the rise and fall are what the clock offset is found by.
            seen.append((frame.t_ns / 1e9, self._rest.grey(blocks)))
            due = not rows or frame.t_ns - (rows[-1].t_ns or 0) >= _KEPT_EVERY_NS
            if self._rest.in_contact(blocks) and due and len(rows) < _KEPT_MAX:
                rows.append(
                    LabelRow(self.folder.add_image(np.array(frame.image)), {}, group, frame.t_ns)
                )
                # Without its picture: a long press would hold 100 of them in memory.
                held.append(replace(frame, image=_NO_IMAGE))
            while held and frame.t_ns - held[0].t_ns > _POSE_NS:
                posed.append(self._robot_labels(held.popleft()))
        posed += map(self._robot_labels, held)
        if not rows:
            self.terminal.say("  not taken: the picture shows no contact")
            return
        t_s, changes = np.array(seen).T
        self._presses[group] = ScalePress(t_s, changes)
        self._keep([replace(row, known=known) for row, known in zip(rows, posed, strict=True)])

    def _robot_labels(self, frame: Frame) -> dict[str, float]:
        try:
            return self.robot.labels(frame) if self.robot else {}
        except ConfigError as error:
            self._unposed = str(error)
            return {}

    def _confirm_touch(self) -> None:
        if self.robot is None:
            self.terminal.say("  found no robot, expected serial in the settings")
            return
        if (frame := self.live.still_frame()) is None:
            return
        try:
            self.robot.confirm_first_touch(frame)
        except ConfigError as error:
            self.terminal.say(f"  not taken: {error}")
            return
        self.terminal.say("  set first touch here")

    def _undo(self) -> None:
        if not self._rows or self._rows[-1].t_ns is None:
            self.terminal.say("  nothing to undo since the start")
            return
        group = self._rows[-1].group
        removed = [row for row in self._rows if row.group == group]
        self._rows = [row for row in self._rows if row.group != group]
        # It must no longer count for the clock offset either.
        self._presses.pop(group, None)
        self.folder.write(self._with_force(), removed)
        self.terminal.say(f"  removed press {group}: {counted(len(removed), 'picture')}")

    def _keep(self, rows: Sequence[LabelRow]) -> None:
        self._rows += rows
        # Each time anew: another press makes the clock offset, and so every force, more exact.
        written = self._with_force()
        self.folder.write(written)
        names = ", ".join(
            sorted(
                {name for row in written[-len(rows) :] for name in row.known}, key=QUANTITIES.index
            )
        )
        self.terminal.say(
            f"  press {rows[0].group}: {counted(len(rows), 'picture')} with "
            f"{names or 'no quantity yet'}"
        )
        if self._unposed:
            self.terminal.say(f"  some have no labels from the robot: {self._unposed}")
            self._unposed = ""

    def _with_force(self) -> list[LabelRow]:
        """Return the rows, with the scale's force once its clock offset is known."""
        offset = self._offset()
        if self.scale is None or offset is None:
            return self._rows
        rows, readings = [], self.scale.readings()
        for row in self._rows:
            if row.t_ns is not None and _FORCE not in row.known:
                force_n = force_at(row.t_ns / 1e9 + offset.offset_s, *readings)
                if force_n is not None:
                    row = replace(row, known={**row.known, _FORCE: force_n - self._tare_n})
            rows.append(row)
        return rows

    def _offset(self) -> ClockOffset | None:
        if self.scale is None:
            return None
        try:
            offset = find_offset(list(self._presses.values()), *self.scale.readings())
        except ValueError as error:
            self._unaligned = str(error)
            return None
        self._unaligned = ""
        return offset

    def _end(self) -> None:
        """Print the scale's tare and clock offset.

        Raises DeviceError if the offset cannot be found.
        """
        if self.scale is None:
            return
        self.terminal.say(f"scale: subtracted the tare of {self._tare_n:.4f} N")
        offset = self._offset()
        # Even without an offset: typed and the robot's labels are kept.
        self.folder.write(self._with_force())
        if offset is None:
            raise DeviceError(
                f"cannot match the scale's clock to the camera's: {self._unaligned}; "
                f"the presses in this run have no {_FORCE}"
            )
        self.terminal.say(
            f"scale: its readings come {1e3 * offset.offset_s:.0f} ms after the pictures, "
            f"standard error {1e3 * offset.error_s:.0f} ms from {offset.presses} presses"
        )


def _parse(words: Sequence[str]) -> dict[str, float]:
    """Parse typed readings. Raises ConfigError."""
    known = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals or name not in QUANTITIES:
            raise ConfigError(
                f"found {word[:40]!r}, expected NAME=VALUE, where NAME is one of "
                f"{', '.join(QUANTITIES)}"
            )
        if name in known:
            raise ConfigError(f"{name}: found two values, expected one value")
        known[name] = number("press", name, text)
    return known
