from __future__ import annotations

import pytest

from tacshade_edge.cli import main
from tacshade_edge.core.profiles import PROFILES


@pytest.mark.parametrize(
    "command",
    [["replay", "x", "--out", "y"], ["reconstruct", "x", "--out", "y"], ["stitch", "--poses", "x", "--out", "y"]],
)
def test_auto_is_refused_with_the_reason(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*command, "--calibration", "c.npz", "--profile", "auto"])
    assert ended.value.code == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "--profile: found auto, which adapts to the clock, so no two runs would be the same; expected one of" in said
    assert all(name in said for name in PROFILES)
