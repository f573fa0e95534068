"""What `bridge ros2` refuses before it starts."""

from __future__ import annotations

import pytest

from tacshade_edge.cli import EXIT_CONFIG, main


@pytest.mark.parametrize("domain", ["233", "-1", "left", "1.5"])
def test_a_domain_that_ros_does_not_have(
    domain: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("zenoh", reason="the extra ros2 is not installed")
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    assert main(["bridge", "ros2"]) == EXIT_CONFIG
    (line,) = capsys.readouterr().err.splitlines()
    expected = "expected a whole number from 0 to 232"
    assert line == f"tacshade-edge: ROS_DOMAIN_ID: found '{domain}', {expected}"
