import argparse
import sys
from pathlib import Path

import pytest

from tacshade_edge.cli.shared import study
from tacshade_edge.studies.evaluate.picture import PACKAGES


@pytest.mark.parametrize("package", PACKAGES)
def test_without_a_package_the_pictures_are_missing_and_a_line_says_so(
    package: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    args = argparse.Namespace(out=tmp_path)
    assert study.will_draw(args, "figure6.png", PACKAGES)
    assert capsys.readouterr().err == ""
    monkeypatch.setitem(sys.modules, package, None)
    assert not study.will_draw(args, "figure6.png", PACKAGES)
    install = "pip install '.[studies]' in the clone"
    assert capsys.readouterr().err == f"tacshade-edge: figure6.png will be missing without {package}: {install}\n"
    assert not study.will_draw(argparse.Namespace(out=None), "figure6.png", PACKAGES)
    assert capsys.readouterr().err == ""
