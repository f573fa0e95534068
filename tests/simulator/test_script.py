import pytest

from tacshade_edge.simulator.objects import OBJECTS, ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.script import Script, demonstration


def test_a_turn_is_pause_approach_hold_release() -> None:
    script = Script((Press(ball(), depth_mm=4.0),), approach=3, hold=2, release=1, pause=2)
    depths = [sum(p.depth_mm for p in script.at(k)) for k in range(script.period)]
    assert depths == pytest.approx([0, 0, 1, 2, 3, 4, 4, 2])
    assert script.at(script.period + 5) == script.at(5)


def test_presses_come_in_turn() -> None:
    script = demonstration(2.0, ("cube", "ring"))
    names = [script.at(k)[0].shape.name for k in range(script.period) if script.at(k)]
    assert names[0] == "cube"
    assert names[-1] == "ring"
    assert max(p.depth_mm for k in range(script.period) for p in script.at(k)) == 2.0


def test_the_demonstration_shows_every_object() -> None:
    assert [p.shape.name for p in demonstration().presses] == list(OBJECTS)


@pytest.mark.parametrize("change", [{"presses": ()}, {"hold": 0}])
def test_an_empty_script_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="script needs"):
        Script(**({"presses": (Press(ball()),)} | change))
