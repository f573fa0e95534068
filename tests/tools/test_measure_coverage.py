"""How the tests' coverage is summed by room, and when it has fallen."""

from __future__ import annotations

from tools.ci.measure_coverage import by_room, fallen


def test_a_room_is_a_folder_of_the_package_and_is_rounded_down() -> None:
    files = {
        "tacshade_edge/errors.py": (3, 4),
        "tacshade_edge/sensor/look.py": (2, 3),
        "tacshade_edge/sensor/depth/solver.py": (100, 101),
        "tacshade_edge/empty/__init__.py": (0, 0),
        "client/tacshade_client/listener.py": (0, 5),
    }
    assert by_room(files) == {
        "client/tacshade_client": 0,
        "tacshade_edge/sensor": 98,
        "tacshade_edge": 75,
    }


def test_a_share_may_rise_and_a_room_may_go_but_none_falls() -> None:
    assert fallen({"a": 90, "b": 100, "d": 3}, {"a": 91, "b": 99, "c": 100}) == []
    assert fallen({"a": 89}, {"a": 91}) == ["a: the tests run 89 % of it, expected at least 90 %"]
