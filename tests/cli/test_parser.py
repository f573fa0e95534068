"""A mistyped word is answered with the nearest one that there is, and a value with what was expected."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import pytest

from tacshade_edge.cli import COMMANDS, main
from tacshade_edge.cli.parser import Parser
from tacshade_edge.cli.shared.options import COUNT, FINITE, PORT, POSITIVE, address


def usage(words: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit, match="2"):
        main(words.split())
    return capsys.readouterr().err


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
        ("replay x --out y --calibration c --profile auto", "auto, which adapts to the clock"),
    ],
)
def test_the_nearest_word_is_named(capsys: pytest.CaptureFixture[str], words: str, said: str) -> None:
    assert said in usage(words, capsys)


@pytest.mark.parametrize("words", ["xyzzy", "run --xyzzy", "run --config", "bridge foxglove extra"])
def test_nothing_is_guessed_where_no_word_is_near(capsys: pytest.CaptureFixture[str], words: str) -> None:
    assert "did you mean" not in usage(words, capsys)


@pytest.mark.parametrize(
    "words",
    [
        *("simulate", "simulate --out x --depth nan", "simulate --out x --seed -1"),
        *("bridge", "bridge rerun", "bridge foxglove --broker mqtt://a", "bridge foxglove --listen a:x"),
        *("dashboard --http 65536", "dashboard --origin hand.example", "dashboard --origin https://h/path"),
        *("record --seconds 1 --name ../a", "record --seconds 4000", "record --seconds 0", "record --seconds soon"),
        *("evaluate --sensors teapot:1", "evaluate --sensors 5,", "evaluate --objects ball,teapot"),
        *("evaluate --presses 5", "evaluate --presses -1", "evaluate --references 0", "evaluate --profile best"),
        *("evaluate --images x", "evaluate --calibration x", "evaluate --calibration x --images x --presses 8"),
        *("evaluate --labels l", "evaluate --labels l --images x", "evaluate --labels l --images x --presses 9"),
        *("evaluate --labels l --images x --calibration c --reference r", "tradeoff --budget-ms 0"),
        *("tradeoff --budget-ms nan", "tradeoff --images x", "tradeoff --report --budget-ms 3"),
        *(
            "tradeoff --report --json",
            "tradeoff --calibration x --images x --objects ball",
            "doctor --with-frame",
            "doctor a.png --bundle b.zip",
            "doctor --calibration c.npz",
        ),
        *("replay", "replay rec --out o", "replay --out o", "replay x --calibration c", "replay --against o"),
        *("replay x --calibration c --mqtt h:1 --config c", "replay x --calibration c --out o --loop 0"),
        *("replay x --calibration c --out o --against ./o", "replay x --calibration c --mqtt h:1 --sensor-id a/b"),
        *("replay x --calibration c --play --out o", "reconstruct --calibration c.npz --out o"),
    ],
)
def test_words_that_do_not_fit_are_usage_errors(capsys: pytest.CaptureFixture[str], words: str) -> None:
    said = usage(words, capsys)
    assert f"usage: tacshade-edge {words.split()[0]}" in said
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("read", "good", "bad"),
    [
        (FINITE, {"-1.5": -1.5}, ("nan", "inf", "", "x")),
        (POSITIVE, {"1e-3": 1e-3}, ("0", "-1", "1e7", "nan")),
        (COUNT, {"0": 0, "7": 7}, ("-1", "1.5", str(2**31))),
        (PORT, {"0": 0, "65535": 65535}, ("65536", "-1")),
        (
            address(),
            {"h:1": ("h", 1), "[::1]:1883": ("::1", 1883)},
            ("h", "h:", ":1", "h:70000", "mqtt://h:1", "a@h:1", "h:0"),
        ),
        (address(9), {"h": ("h", 9), "h:0": ("h", 0)}, ("h:x", "")),
    ],
)
def test_values(read: Callable[[str], object], good: dict[str, object], bad: tuple[str, ...]) -> None:
    assert {text: read(text) for text in good} == good
    for text in bad:
        with pytest.raises(argparse.ArgumentTypeError, match=r"^found .*, expected "):
            read(text)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_fits_a_wide_screen(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    with pytest.raises(SystemExit, match="0"):
        main([command, "--help"])
    assert len(capsys.readouterr().out.splitlines()) <= 50


def test_a_path_may_begin_at_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/somebody")
    parser = Parser()
    parser.add_argument("--out", type=Path)
    parser.add_argument("images", type=Path, nargs="*")
    found = parser.parse_args(["--out=~/map", "~/a.png", "b~.png"])
    assert (found.out, found.images) == (Path("/home/somebody/map"), [Path("/home/somebody/a.png"), Path("b~.png")])
