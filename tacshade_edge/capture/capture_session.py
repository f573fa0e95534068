"""The dialogue of a capture: look, references, rest, touches, presses.

Every press can be undone, and a later run continues.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.files.capture_folder import CaptureFolder, next_number
from tacshade_edge.calibration.files.press_table import BALL, Stated, known_press, stated
from tacshade_edge.calibration.indenters import Indenter
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.calibration.presses.press_check import Judgement, PressCheck
from tacshade_edge.calibration.quality import GRADED_PROFILE
from tacshade_edge.calibration.reference.stillness import block_means
from tacshade_edge.calibration.sentences import sentence
from tacshade_edge.capture.live import STILL_FRAMES, Live, Terminal, rest_grey_of
from tacshade_edge.capture.robot_place import Name, RobotPlaces
from tacshade_edge.capture.unlabelled import Unlabelled
from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import counted
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.network import load_network
from tacshade_edge.types import U8, Calibration, Frame

REFERENCES = STILL_FRAMES
REFERENCES_S = 3.0
_DEPTH_AND_PLACE = 3  # values that a person types of a press: depth, x, y

_HELP = """  Press the indenter in and hold it, type what it is, then Enter;
  the picture is taken once it stands still:
    ball RADIUS_MM DEPTH_MM X_MM Y_MM    a ball; without X_MM Y_MM the picture gives its place
    NAME DEPTH_MM X_MM Y_MM              an indenter of INDENTERS.yaml
    DEPTH_MM X_MM Y_MM                   the same indenter as before
    ball RADIUS_MM, or NAME              depth and place from the robot, once you have typed
                                         one press with it
  Enter alone takes the press suggested in brackets.
    undo [NUMBER]   remove the last press, or that one, and suggest it again
    skip            leave out the suggested press
    references      take the references again, then rest and touches
    rest, touches   take these again
    done            end"""


@dataclass(eq=False)
class CaptureSession:
    """One run of the command on a folder that may already hold an earlier run's presses."""

    folder: CaptureFolder
    sensor: StatedSensor
    live: Live
    terminal: Terminal
    plan: list[Stated]  # presses to suggest one after the other; if empty, the person types each
    names: Mapping[str, Indenter | float]  # all indenters except the ball
    robot: RobotPlaces | None  # gives place and depth if a robot presses

    def __post_init__(self) -> None:
        self._taken, self._planned = self.folder.taken(), tuple(self.plan)
        self._again: list[Stated] = []  # presses to suggest before the plan's: rejected or undone
        for one in self._taken:
            # A run that continues must not suggest what an earlier one took.
            if one.stated in self.plan:
                self.plan.remove(one.stated)

    def run(self) -> None:
        """Take references, rest and touches if there are none,
        then presses until the person ends the run.

        Raises InputEnded, DeviceError, ConfigError (the folder keeps what was taken before).
        """
        images = self.folder.references()
        # An interrupted run may have left fewer; presses need the references that they are judged
        # by.
        unloaded = self._checked_again(images) if len(images) >= REFERENCES else None
        # Before rest and touches: they are judged by the references.
        self._use(unloaded or self._take_references())
        typed = self._unlabelled.take_missing()
        while True:
            words = (typed or self.live.ask(self._prompt())).split()
            typed = ""
            match words:
                case ["done"]:
                    return
                case ["help" | "?"]:
                    self.terminal.say(_HELP)
                case ["references"]:
                    self._use(self._take_references())
                    typed = self._unlabelled.take_missing()
                case ["rest"]:
                    typed = self._unlabelled.take_rest()
                case ["touches"]:
                    typed = self._unlabelled.take_touches(anew=True)
                case ["undo", *numbers]:
                    self._undo(numbers)
                case ["skip"]:
                    del (self._again or self.plan)[:1]
                case _:
                    try:
                        self._press(words)
                    except ConfigError as error:
                        self.terminal.say(f"  not taken: {error}")

    def _use(self, unloaded: Calibration) -> None:
        """Judge presses from now on by a calibration from references."""
        self._check = check = PressCheck(unloaded, load_network(GRADED_PROFILE))

        def judge(image: U8) -> Judgement:
            return check.judge(check.look(image))

        self._unlabelled = Unlabelled(self.folder, self.live, self.terminal, judge)

    def _checked_again(self, images: Sequence[U8]) -> Calibration | None:
        try:
            unloaded = self._unloaded(images)
        except ConfigError as error:
            self.terminal.say(f"cannot use this folder's references: {error}")
            return None
        presses = counted(len(self._taken), "press")
        self.terminal.say(f"this folder already has {len(images)} references and {presses}")
        return unloaded

    def _take_references(self) -> Calibration:
        while True:
            self.live.ask(
                (
                    "Adjust lens and light until disc, focus and contrast are good. Make sure that "
                    f"nothing touches the skin; Enter takes {REFERENCES} references."
                ),
                with_figures=True,
            )
            images = [np.array(frame.image) for frame in self.live.frames(REFERENCES, REFERENCES_S)]
            try:
                unloaded = self._unloaded(images)
            except ConfigError as error:
                self.terminal.say(f"  rejected: {error}")
                if not self.live.has_circle:
                    self.terminal.say(
                        "  or state visible_circle in SENSOR.yaml: the page shows rows and columns"
                    )
                continue
            # Only after they were accepted, so that refused ones never replace good ones.
            self.folder.write_references(images)
            # They belong to the old references: lens, light or circle may have changed since.
            self.folder.forget_rest()
            self.folder.forget_touches()
            self.terminal.say(
                f"  {REFERENCES} references, noise {unloaded.noise_grey:.2f} grey levels"
            )
            return unloaded

    def _unloaded(self, images: Sequence[U8]) -> Calibration:
        """Calibrate from references alone.

        Raises ConfigError if the images cannot serve as references.
        """
        # Before the calibration, which a moving picture would make fail for a reason that misleads.
        rest_grey = rest_grey_of([block_means(to_grey(image)) for image in images])
        result = calibrate(self.sensor, images)
        for warning in result.warnings:
            self.terminal.say(f"  warning: {sentence(warning)}")
        self.live.rest_grey = rest_grey
        return result.calibration

    def _prompt(self) -> str:
        number = f"press {next_number(self._taken)}"
        left = f", {counted(len(self.plan), 'planned press')} left" if self.plan else ""
        if suggested := (*self._again, *self.plan):
            return f"{number}{left} [{suggested[0]}]:"
        if name := self._at_robot():
            return f"{number} [{' '.join(name).strip()}, where the robot holds it]:"
        return f"{number} (ball RADIUS_MM DEPTH_MM X_MM Y_MM, undo, done, help):"

    def _undo(self, numbers: Sequence[str]) -> None:
        chosen = (
            [one for one in self._taken if [str(one.number)] == list(numbers)]
            if numbers
            else self._taken[-1:]
        )
        if not chosen:
            here = ", ".join(str(one.number) for one in self._taken) or "none"
            self.terminal.say(
                f"  found no press {' '.join(numbers)}, expected one of those taken: {here}"
            )
            return
        self.folder.remove(self._taken, chosen[0])
        self._taken = [one for one in self._taken if one is not chosen[0]]
        # A robot may have moved since: then the next press needs its new pose.
        if not self._at_robot():
            (self.plan if chosen[0].stated in self._planned else self._again).insert(
                0, chosen[0].stated
            )
        self.terminal.say(f"  removed {chosen[0].image}")

    def _press(self, words: Sequence[str]) -> None:
        """Take a press.

        Raises ConfigError (it is stated wrongly, or `calibrate` would not use its picture).
        """
        # Words first: a press that is stated wrongly must not make the person wait for a picture.
        asked = self._asked(words)
        if (frame := self.live.still_frame()) is None:
            return
        # Only now, because the robot's pose must be that of this frame.
        press = asked if isinstance(asked, Stated) else self._stated_by_robot(asked, frame)
        image = np.array(frame.image)
        if press is asked and press not in (*self._again, *self.plan):
            # Suggested until it is taken, in place of one that was undone.
            self._again[:1] = [press]
        look = self._check.look(image)
        judged = self._check.judge(look)
        if judged.unusable:
            raise ConfigError(f"the picture is unusable: {judged.unusable}")
        if judged.moved:
            fix = "fasten the camera and take the references again"
            raise ConfigError(f"{judged.moved} since the references were taken: {fix}")
        if not judged.in_contact:
            raise ConfigError("nothing touches the skin in the picture")
        # Judged before it is written: `calibrate` would leave it out without a chance to repeat it.
        added = self.folder.add(self._taken, image, press)
        self._taken = [*self._taken, added]
        for suggested in (self._again, self.plan):
            if press in suggested:
                suggested.remove(press)
        warning = f"; {judged.changed} since the references were taken" if judged.changed else ""
        self.terminal.say(f"  {added.image}: {press}{warning}")
        # Asked, not refused: small balls may look larger than they are.
        if question := self._check.question(
            look, known_press(added.image, image, press.row(), self.names)
        ):
            self.terminal.say(f"  {sentence(question)} (undo removes the press)")
        if self.robot and press is asked and (unknown := self.robot.learn(press.columns, frame)):
            self.terminal.say(f"  cannot find the next place from the robot's poses: {unknown}")

    def _at_robot(self) -> Name | None:
        """The last press's indenter if the robot gives place and depth of its next press,
        otherwise None.
        """
        if not self.robot or not self._taken:
            return None
        indenter, radius_mm, *_ = self._taken[-1].stated.columns
        return (indenter, radius_mm) if self.robot.known((indenter, radius_mm)) else None

    def _stated_by_robot(self, name: Name, frame: Frame) -> Stated:
        """Return the press of an indenter at the robot's pose. Raises ConfigError."""
        assert self.robot is not None
        return stated(
            "press", self.robot.columns(name, frame), self.names, self.sensor.skin_radius_mm
        )

    def _asked(self, words: Sequence[str]) -> Stated | Name:
        """Return the typed press, completed from the last one;
        only its indenter if the robot gives the rest.

        Raises ConfigError.
        """
        if not words:
            if suggested := (*self._again, *self.plan):
                return suggested[0]
            if name := self._at_robot():
                return name
            raise ConfigError("found an empty line, expected a line with an indenter")
        indenter, radius_mm, rest = self._indenter(words)
        if not rest and self.robot:
            if self.robot.known((indenter, radius_mm)):
                return indenter, radius_mm
            raise ConfigError(
                f"found no press of {indenter} in this run, expected a first press with depth, "
                "x and y"
            )
        if len(rest) not in (1, _DEPTH_AND_PLACE):
            found = f"found {len(rest)} values after the indenter"
            raise ConfigError(f"{found}, expected 1 (depth) or 3 (depth, x, y), in mm")
        depth_mm, x_mm, y_mm = rest if len(rest) == _DEPTH_AND_PLACE else (rest[0], "", "")
        columns = (indenter, radius_mm, depth_mm, x_mm, y_mm)
        return stated("press", columns, self.names, self.sensor.skin_radius_mm)

    def _indenter(self, words: Sequence[str]) -> tuple[str, str, Sequence[str]]:
        """Return the indenter's name, its radius and the remaining words."""
        if words[0] == BALL:
            return BALL, words[1] if len(words) > 1 else "", words[2:]
        if words[0] in self.names:
            return words[0], "", words[1:]
        # Numbers alone mean the same indenter again; anything else is a name that nobody knows.
        if not words[0].replace(".", "").replace("-", "").isdigit():
            raise ConfigError(
                f"indenter: found {words[0]!r}, expected {' or '.join((BALL, *sorted(self.names)))}"
            )
        if not self._taken:
            raise ConfigError("found no indenter before the numbers, expected one")
        indenter, radius_mm, *_ = self._taken[-1].stated.columns
        return indenter, radius_mm, words
