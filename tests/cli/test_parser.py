"""A mistyped word is answered with the nearest one that there is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tacshade_edge.cli import main
from tacshade_edge.cli.parser import Parser


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("calibrat", "did you mean calibrate?"),
        ("Doctor", "did you mean doctor?"),
        ("run --confg x.yaml", "run: error: unrecognized arguments: --confg x.yaml; did you mean --config?"),
        ("run --confg=x.yaml", "run: error: unrecognized arguments: --confg=x.yaml; did you mean --config?"),
        ("calibrate --sensr S.yaml --out c.npz", "did you mean --sensor?"),
        ("bridge foxglov", "did you mean foxglove?"),
        ("bridge foxglove --brokr h:1", "bridge foxglove: error: unrecognized arguments: --brokr h:1; did you mean"),
        ("reconstruct --profile acurate --calibration c.npz --out o i.png", "did you mean accurate?"),
    ],
)
def test_the_nearest_word_is_named(capsys: pytest.CaptureFixture[str], words: str, said: str) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(words.split())
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    ["xyzzy", "run --xyzzy", "simulate", "run --config", "bridge foxglove extra", "reconstruct --calib c.npz"],
)
def test_nothing_is_guessed_where_no_word_is_near(capsys: pytest.CaptureFixture[str], words: str) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(words.split())
    assert "did you mean" not in capsys.readouterr().err


def test_a_path_may_begin_at_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/somebody")
    parser = Parser()
    parser.add_argument("--out", type=Path)
    parser.add_argument("images", type=Path, nargs="*")
    found = parser.parse_args(["--out=~/map", "~/a.png", "b~.png"])
    assert (found.out, found.images) == (Path("/home/somebody/map"), [Path("/home/somebody/a.png"), Path("b~.png")])
