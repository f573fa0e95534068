"""The dialogue of a capture: look, references, presses. Every press can be undone, and a later run continues."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from tacshade_edge.capture.live import STILL_FRAMES, Live, Terminal, rest_grey_of
from tacshade_edge.capture.robot_place import Name, RobotPlaces
from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.core.calibration.presses.press_check import Judgement, PressCheck
from tacshade_edge.core.calibration.quality import GRADED_PROFILE
from tacshade_edge.core.calibration.reference.references import block_means
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import load_network
from tacshade_edge.storage.tables.capture_folder import CaptureFolder, Stated, next_number, stated
from tacshade_edge.storage.tables.presses import BALL
from tacshade_edge.types import U8, Calibration, Frame

REFERENCES = STILL_FRAMES
REFERENCES_S = 3.0

_HELP = """  Press the indenter in and hold it, type what it is, then Enter; the picture is taken once it stands still:
    ball RADIUS_MM DEPTH_MM X_MM Y_MM    a ball; without X_MM Y_MM the picture gives its place
    NAME DEPTH_MM X_MM Y_MM              an indenter of INDENTERS.yaml
    DEPTH_MM X_MM Y_MM                   the same indenter as before
    ball RADIUS_MM, or NAME              depth and place from the robot, once you have typed one press with it
  Enter alone takes the press suggested in brackets.
    undo [NUMBER]   remove the last press, or that one, and suggest it again
    skip            leave out the suggested press of the plan
    references      take the references again
    done            end"""


class Session:
    """One run of the command on a folder that may already hold an earlier run's presses. `plan`: presses to suggest one
    after the other; if empty, the person types each. `names`: all indenters except the ball. `robot`: gives place and
    depth if a robot presses.
    """

    def __init__(
        self,
        folder: CaptureFolder,
        sensor: Sensor,
        live: Live,
        terminal: Terminal,
        plan: Sequence[Stated],
        names: Mapping[str, Indenter | float],
        robot: RobotPlaces | None,
    ) -> None:
        self._folder = folder
        self._sensor = sensor
        self._live = live
        self._terminal = terminal
        self._plan = list(plan)
        self._names = names
        self._robot = robot
        self._taken = folder.taken()
        self._again: Stated | None = None  # a press that was undone or not taken

    def run(self) -> None:
        """Take references if there are none, then presses until the person ends the run. Raises InputEnded,
        DeviceError, ConfigError (the folder keeps what was taken before).
        """
        images = self._folder.references()
        unloaded = self._checked_again(images) if len(images) >= REFERENCES else None
        self._use(unloaded or self._take_references())
        while True:
            match self._live.ask(self._prompt()).split():
                case ["done"]:
                    return
                case ["help" | "?"]:
                    self._terminal.say(_HELP)
                case ["references"]:
                    self._use(self._take_references())
                case ["undo", *numbers]:
                    self._undo(numbers)
                case ["skip"]:
                    self._skip()
                case words:
                    self._press(words)

    def _use(self, unloaded: Calibration) -> None:
        """Judge presses from now on by a calibration from references."""
        self._check = PressCheck(unloaded, load_network(GRADED_PROFILE))

    def _keep(self, image: U8, press: Stated) -> str:
        """Save a press that `calibrate` would accept; return why it would not, or an empty string."""
        judged = self._check.judge(image)
        if reason := _refusal(judged):
            return reason
        added = self._folder.add(self._taken, image, press)
        self._taken = [*self._taken, added]
        warning = f"; {judged.changed} since the references were taken" if judged.changed else ""
        self._terminal.say(f"  {added.image}: {press}{warning}")
        return ""

    def _checked_again(self, images: Sequence[U8]) -> Calibration | None:
        try:
            unloaded = self._unloaded(images)
        except ConfigError as error:
            self._terminal.say(f"cannot use this folder's references: {error}")
            return None
        presses = "1 press" if len(self._taken) == 1 else f"{len(self._taken)} presses"
        self._terminal.say(f"this folder already has {len(images)} references and {presses}")
        return unloaded

    def _take_references(self) -> Calibration:
        while True:
            self._live.ask(
                f"Adjust lens and light until disc, focus and contrast are good. Make sure that nothing touches the "
                f"skin; Enter takes {REFERENCES} references.",
                with_figures=True,
            )
            images = [np.array(frame.image) for frame in self._live.frames(REFERENCES, REFERENCES_S)]
            try:
                unloaded = self._unloaded(images)
            except ConfigError as error:
                self._terminal.say(f"  rejected: {error}")
                if not self._live.has_circle:
                    self._terminal.say("  or state visible_circle in SENSOR.yaml: the page shows rows and columns")
                continue
            self._folder.write_references(images)
            self._terminal.say(f"  {REFERENCES} references, noise {unloaded.noise_grey:.2f} grey levels")
            return unloaded

    def _unloaded(self, images: Sequence[U8]) -> Calibration:
        """Calibrate from references alone. Raises ConfigError if the images cannot serve as references."""
        rest_grey = rest_grey_of([block_means(to_grey(image)) for image in images])
        result = calibrate(self._sensor, images)
        for warning in result.warnings:
            self._terminal.say(f"  warning: {warning}")
        self._live.rest_grey = rest_grey
        return result.calibration

    def _prompt(self) -> str:
        number = f"press {next_number(self._taken)}"
        if offer := self._offer():
            left = f", {len(self._left())} planned presses left" if self._plan else ""
            return f"{number}{left} [{offer}]:"
        if name := self._at_robot():
            return f"{number} [{' '.join(name).strip()}, where the robot holds it]:"
        if self._plan:
            return f"all planned presses are taken; {number}, or done:"
        return f"{number} (ball RADIUS_MM DEPTH_MM X_MM Y_MM, undo, done, help):"

    def _left(self) -> list[Stated]:
        """Planned presses that are not taken yet, in their order."""
        taken = Counter(one.stated for one in self._taken)
        left = []
        for press in self._plan:
            if taken[press]:
                taken[press] -= 1
            else:
                left.append(press)
        return left

    def _offer(self) -> Stated | None:
        """The press that Enter alone takes."""
        return self._again or next(iter(self._left()), None)

    def _skip(self) -> None:
        offer = self._offer()
        if offer is None:
            self._terminal.say("  no press is suggested")
            return
        if offer in self._plan:
            self._plan.remove(offer)
        self._again = None

    def _undo(self, numbers: Sequence[str]) -> None:
        chosen = [one for one in self._taken if [str(one.number)] == list(numbers)] if numbers else self._taken[-1:]
        if not chosen:
            here = ", ".join(str(one.number) for one in self._taken) or "none"
            self._terminal.say(f"  found no press {' '.join(numbers)}, expected one of those taken: {here}")
            return
        self._folder.remove(self._taken, chosen[0])
        self._taken = [one for one in self._taken if one is not chosen[0]]
        # The robot may have moved since: the next press needs its new pose.
        self._again = None if self._at_robot() else chosen[0].stated
        self._terminal.say(f"  removed {chosen[0].image}")

    def _press(self, words: Sequence[str]) -> None:
        try:
            asked = self._asked(words)
        except ConfigError as error:
            self._terminal.say(f"  {error} (type help)")
            return
        if (frame := self._live.still_frame()) is None:
            return
        try:
            press = asked if isinstance(asked, Stated) else self._stated_by_robot(asked, frame)
        except ConfigError as error:
            self._terminal.say(f"  not taken: {error}")
            return
        reason = self._keep(np.array(frame.image), press)
        self._again = press if reason and press is asked else None
        if reason:
            self._terminal.say(f"  not taken: {reason}")
            return
        if self._robot and press is asked and (unknown := self._robot.learn(press.columns, frame)):
            self._terminal.say(f"  cannot find the next place from the robot's poses: {unknown}")

    def _at_robot(self) -> Name | None:
        """The last press's indenter if the robot gives place and depth of its next press, otherwise None."""
        if not self._robot or not self._taken:
            return None
        indenter, radius_mm, *_ = self._taken[-1].stated.columns
        return (indenter, radius_mm) if self._robot.known((indenter, radius_mm)) else None

    def _stated_by_robot(self, name: Name, frame: Frame) -> Stated:
        """Return the press of an indenter at the robot's pose. Raises ConfigError."""
        assert self._robot is not None
        return stated("press", self._robot.columns(name, frame), self._names, self._sensor.skin_radius_mm)

    def _asked(self, words: Sequence[str]) -> Stated | Name:
        """Return the typed press, completed from the last one; only its indenter if the robot gives the rest. Raises
        ConfigError.
        """
        if not words:
            if offer := self._offer():
                return offer
            if name := self._at_robot():
                return name
            raise ConfigError("found an empty line, expected a line with an indenter")
        indenter, radius_mm, rest = self._indenter(words)
        if not rest and self._robot:
            if self._robot.known((indenter, radius_mm)):
                return indenter, radius_mm
            raise ConfigError(f"found no press of {indenter} in this run, expected a first press with depth, x and y")
        if len(rest) not in (1, 3):
            raise ConfigError(
                f"found {len(rest)} values after the indenter, expected 1 (depth) or 3 (depth, x, y), in mm"
            )
        depth_mm, x_mm, y_mm = rest if len(rest) == 3 else (rest[0], "", "")
        columns = (indenter, radius_mm, depth_mm, x_mm, y_mm)
        return stated("press", columns, self._names, self._sensor.skin_radius_mm)

    def _indenter(self, words: Sequence[str]) -> tuple[str, str, Sequence[str]]:
        """Return the indenter's name, its radius and the remaining words."""
        if words[0] == BALL:
            return BALL, words[1] if len(words) > 1 else "", words[2:]
        if words[0] in self._names:
            return words[0], "", words[1:]
        if not words[0].replace(".", "").replace("-", "").isdigit():
            raise ConfigError(f"indenter: found {words[0]!r}, expected {' or '.join((BALL, *sorted(self._names)))}")
        if not self._taken:
            raise ConfigError("found no indenter before the numbers, expected one")
        indenter, radius_mm, *_ = self._taken[-1].stated.columns
        return indenter, radius_mm, words


def _refusal(judged: Judgement) -> str:
    """Return why `calibrate` would leave a press out; empty if it would not."""
    if judged.unusable:
        return f"the picture is unusable: {judged.unusable}"
    if judged.moved:
        return f"{judged.moved} since the references were taken: fasten the camera and take the references again"
    return "" if judged.in_contact else "nothing touches the skin in the picture"
