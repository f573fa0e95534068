"""What a new verb of the robot's line does without another line: grammar, help, answer."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.robot_motion import RobotMotion
from tacshade_edge.robot.serial_commands import SerialCommands
from tacshade_edge.robot.serial_link import SerialLink
from tacshade_edge.robot.touch_events import TouchEvents
from tacshade_edge.robot.verbs import Command


@pytest.fixture
def say() -> Callable[[str], str]:
    """What a robot's line is answered."""
    link, missing = SerialLink(), Reason(ReasonCode.NOT_CALIBRATED, "not calibrated")
    commands = SerialCommands(
        RobotMotion(),
        lambda *_: None,
        lambda: {"source": "streaming", "health": {"delivered_fps": 29.97}},
        lambda: missing,
        lambda: missing,
        lambda: None,
        TouchEvents(115200, lambda: None),
    )

    def answer(line: str) -> str:
        for received in link.receive(line.encode() + b"\n", 0):
            assert isinstance(received, Command)
            commands.handle(received, link)
        commands.send_answers(link)
        return link.take_output().decode().partition("*")[0]

    return answer


def test_it_is_executed_and_answered(say: Callable[[str], str]) -> None:
    assert say("#1 rate hz") == "OK 1 rate=29.97"
    assert say("#2 RATE MS") == "OK 2 rate=33.367"
    assert say("#1 rate hz") == "OK 1 rate=29.97"
    assert say("#3 rate") == "ERR 3 ARGS expected RATE HZ|MS"
    assert say("#3 rate s") == "ERR 3 ARGS expected RATE HZ|MS"
    assert say("help rate") == "OK - RATE HZ|MS"
    assert " RATE;" in say("help")
