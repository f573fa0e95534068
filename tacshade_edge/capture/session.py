"""The dialogue of a capture: look, references, presses. Every press can be undone, and a later run continues."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.capture.live import STILL_FRAMES, Live, Terminal
from tacshade_edge.capture.robot_place import Name, RobotPlaces
from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.core.calibration.presses.press_check import Judgement, PressCheck
from tacshade_edge.core.calibration.quality import GRADED_PROFILE, advice
from tacshade_edge.core.calibration.reference.references import REST_MOST_GREY, block_means, motion_grey
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import load_network
from tacshade_edge.quoting import did_you_mean
from tacshade_edge.storage.tables.capture_folder import (
    CaptureFolder,
    Stated,
    TakenPress,
    next_number,
    stated,
)
from tacshade_edge.storage.tables.presses import BALL, known_press
from tacshade_edge.storage.tables.tables import number
from tacshade_edge.types import U8, Calibration, Frame


@dataclass(frozen=True, slots=True)
class _Taken:
    """A press as `quality.Pressed` requires it."""

    place_mm: tuple[float, float]
    depth_mm: float
    radius_mm: float
    indenter: str


class Advice:
    """Advice on the next press; it caches each press's place, which may have to be found in the picture. `indenters`:
    from INDENTERS.yaml.
    """

    def __init__(self, folder: CaptureFolder, indenters: Mapping[str, Indenter | float]) -> None:
        self._folder = folder
        self._indenters = indenters
        self._known: dict[TakenPress, _Taken] = {}

    def text(self, taken: Sequence[TakenPress], check: PressCheck) -> str:
        """Return one line of advice; empty before the first press. Raises ConfigError (the table has something other
        than a number, or a picture cannot be read).
        """
        # Forget a press that was undone: another picture may get its name.
        self._known = {press: self._known.get(press) or self._look_at(press, check) for press in taken}
        return advice(list(self._known.values()), check.geometry) if taken else ""

    def _look_at(self, press: TakenPress, check: PressCheck) -> _Taken:
        indenter, radius_text, depth_text, x_text, y_text, *_ = press.stated.columns
        depth_mm = number(press.image, "depth_mm", depth_text)
        if x_text:
            place_mm = number(press.image, "x_mm", x_text), number(press.image, "y_mm", y_text)
        else:
            place_mm = check.located_mm(self._folder.picture(press), depth_mm)
        known = self._indenters.get(indenter)
        if indenter == BALL:
            return _Taken(place_mm, depth_mm, number(press.image, "radius_mm", radius_text), "")
        if isinstance(known, float):
            return _Taken(place_mm, depth_mm, known, "")
        return _Taken(place_mm, depth_mm, 0.0, indenter)


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
    look            print the camera's current figures
    done            end"""


class Session:
    """One run of the command on a folder that may already hold an earlier run's presses. `plan`: presses to suggest one
    after the other; if empty, the person types each. `indenters`: all indenters except the ball. `robot`: gives place
    and depth if a robot presses.
    """

    def __init__(
        self,
        folder: CaptureFolder,
        sensor: Sensor,
        live: Live,
        terminal: Terminal,
        plan: Sequence[Stated],
        indenters: Mapping[str, Indenter | float],
        robot: RobotPlaces | None = None,
    ) -> None:
        self._folder = folder
        self._sensor = sensor
        self._live = live
        self._terminal = terminal
        self._plan = list(plan)
        self._names = indenters
        self._robot = robot
        self._advice = Advice(folder, indenters)
        self._taken = folder.taken()
        self._taken_back: Stated | None = None
        self._circle = live.circle  # the circle used to judge the references

    @property
    def taken(self) -> Sequence[TakenPress]:
        """The presses in the table."""
        return self._taken

    @property
    def circle_changed(self) -> bool:
        """Whether the stated visible circle has changed since the references were judged."""
        return self._live.circle != self._circle

    def run(self) -> None:
        """Take references if there are none, then presses until the person ends the run. Raises InputEnded,
        DeviceError, ConfigError (the folder keeps what was taken before).
        """
        check = self._check(self.unloaded())
        self._advise(check)
        while True:
            answer = self._live.ask(self._prompt())
            if self.circle_changed:
                # Every place found in a picture depends on the circle.
                self._advice = Advice(self._folder, self._names)
                check = self._check(self.unloaded())
                self._advise(check)
            match answer.split():
                case ["done"]:
                    return
                case ["help" | "?"]:
                    self._terminal.say(_HELP)
                case ["look"]:
                    self._terminal.say(f"  {self._live.figures()}")
                case ["references"]:
                    check = self._check(self._take_references())
                case ["undo", *numbers]:
                    self._undo(numbers)
                    self._advise(check)
                case ["skip"]:
                    self._skip()
                case words:
                    self._press(words, check)

    def unloaded(self) -> Calibration:
        """Return the calibration from the references, taking them first if there are none. Raises as `run`."""
        images = self._folder.references()
        checked = self._checked_again(images) if len(images) >= REFERENCES else None
        return checked or self._take_references()

    def keep(self, image: U8, press: Stated, check: PressCheck) -> str:
        """Save a press that `calibrate` would accept; return why it would not, or an empty string."""
        judged = check.judge(image)
        if reason := _refusal(judged):
            return reason
        added = self._folder.add(self._taken, image, press)
        self._taken = [*self._taken, added]
        warning = f"; {judged.changed} since the references were taken" if judged.changed else ""
        self._terminal.say(f"  {added.image}: {press}{warning}")
        if asked := check.question(known_press(added.image, image, press.row(), self._names)):
            self._terminal.say(f"  {asked} (undo removes it)")
        return ""

    def _check(self, unloaded: Calibration) -> PressCheck:
        return PressCheck(unloaded, load_network(GRADED_PROFILE))

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
                    self._terminal.say("  to set the circle, click three points on the dome's rim on the page")
                continue
            self._folder.write_references(images)
            self._terminal.say(f"  {REFERENCES} references, noise {unloaded.noise_grey:.2f} grey levels")
            return unloaded

    def _unloaded(self, images: Sequence[U8]) -> Calibration:
        """Calibrate from references alone. Raises ConfigError if the images cannot serve as references."""
        rest_grey = motion_grey([block_means(to_grey(image)) for image in images])
        if rest_grey > REST_MOST_GREY:
            found = f"found a change of {rest_grey:.1f} grey levels, expected at most {REST_MOST_GREY:g}"
            raise ConfigError(f"the picture is moving or too noisy: {found}")
        self._circle = self._live.circle
        result = calibrate(replace(self._sensor, visible_circle=self._circle), images)
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
        return self._taken_back or next(iter(self._left()), None)

    def _skip(self) -> None:
        offer = self._offer()
        if offer is None:
            self._terminal.say("  no press is suggested")
            return
        if offer in self._plan:
            self._plan.remove(offer)
        self._taken_back = None

    def _undo(self, numbers: Sequence[str]) -> None:
        chosen = [one for one in self._taken if [str(one.number)] == list(numbers)] if numbers else self._taken[-1:]
        if not chosen:
            here = ", ".join(str(one.number) for one in self._taken) or "none"
            self._terminal.say(f"  found no press {' '.join(numbers)}, expected one of those taken: {here}")
            return
        self._folder.remove(self._taken, chosen[0])
        self._taken = [one for one in self._taken if one is not chosen[0]]
        # The robot may have moved since: the next press needs its new pose.
        self._taken_back = None if self._at_robot() else chosen[0].stated
        self._terminal.say(f"  removed {chosen[0].image}")

    def _press(self, words: Sequence[str], check: PressCheck) -> None:
        try:
            asked = self._asked(words)
        except ConfigError as error:
            self._terminal.say(f"  {error} (type help)")
            return
        frame = self._live.still_frame()
        if frame is None:
            self._terminal.say("  cancelled: took no picture")
            return
        try:
            press = asked if isinstance(asked, Stated) else self._stated_by_robot(asked, frame)
        except ConfigError as error:
            self._terminal.say(f"  not taken: {error}")
            return
        if reason := self.keep(np.array(frame.image), press, check):
            self._terminal.say(f"  not taken: {reason}")
            self._taken_back = press if press is asked else None
            return
        self._taken_back = None
        if self._robot and press is asked and (unknown := self._robot.learn(press.columns, frame)):
            self._terminal.say(f"  cannot find the next place from the robot's poses: {unknown}")
        self._advise(check)

    def _advise(self, check: PressCheck) -> None:
        """Show which press helps most next; print it only if no planned press is left."""
        self._live.note = self._advice.text(self._taken, check)
        if self._live.note and not self._left():
            self._terminal.say(f"  {self._live.note}")

    def _at_robot(self) -> Name | None:
        """The last press's indenter if the robot gives place and depth of its next press, otherwise None."""
        if not self._robot or not self._taken:
            return None
        name = self._taken[-1].stated.columns[:2]
        return (name[0], name[1]) if self._robot.known((name[0], name[1])) else None

    def _stated_by_robot(self, name: Name, frame: Frame) -> Stated:
        """Return the press of an indenter at the robot's pose. Raises ConfigError."""
        if self._robot is None:
            raise AssertionError("nobody asked for a robot's pose")
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
            names = (BALL, *sorted(self._names))
            meant = did_you_mean(words[0], names)
            raise ConfigError(f"indenter: found {words[0]!r}, expected {' or '.join(names)}{meant}")
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
