"""docs/tutorials/notebook.md: its cells run in their order as they are written."""

from __future__ import annotations

import glob
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacshade_edge.cli import main

PAGE = Path(__file__).parents[2] / "docs/tutorials/notebook.md"
CELLS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.M)


def command(line: str) -> None:
    """Run a notebook's `!` line."""
    program, *words = shlex.split(line.removeprefix("!"))
    assert program == "tacshade-edge"
    assert main([each for word in words for each in sorted(glob.glob(word)) or [word]]) == 0


def executed(cells: list[str]) -> dict[str, Any]:
    """The names that the cells leave behind, run as a notebook does;
    `_` is the last expression that stands alone.
    """
    names: dict[str, Any] = {}
    for number, cell in enumerate(cells):
        if cell.startswith("!"):
            for line in cell.splitlines():
                command(line)
            continue
        exec(compile(cell, f"cell {number}", "exec"), names)
        if re.fullmatch(r"\w+", last := cell.splitlines()[-1]):
            names[f"shown {number}"] = eval(last, names)
    return names


@pytest.mark.slow
def test_the_cells_run_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib", reason="the extra studies is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names = executed(CELLS)
    shown = [value for name, value in names.items() if name.startswith("shown ")]
    assert "image/png" in shown[0]._repr_html_()
    table = shown[1]
    assert [row["image"] for row in table] == [f"00{k}_ball.png" for k in range(3)] + [
        f"00{k}_cylinder.png" for k in range(3, 6)
    ]
    assert all(row["reason"] == "" and row["contact"] and row["area_mm2"] > 1 for row in table)
    assert np.abs(names["found_mm"] - names["true_mm"]).mean() < 0.5
    assert np.abs(names["errors_mm"]).mean() < 0.4
    assert 0.7 < names["within"] <= 1
    assert 0.1 < np.mean(names["depth_mm"] > 0) <= 1
    printed = capsys.readouterr().out
    for line in ("mean error of the depth: ", "of the cells within 2 sigma", "frames in contact"):
        assert line in printed
    import matplotlib.pyplot as plt

    assert len(plt.get_fignums()) == 2
    plt.close("all")
