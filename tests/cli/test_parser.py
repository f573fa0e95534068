"""What is typed and what a shell completes, and a process's exit code, which is the command's."""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.mqtt_rig import free_port
from support.painted_sensor import FREE, painted_calibration
from support.patience import patience
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import COMMANDS, EXIT_CONFIG, main
from tacshade_edge.cli.shared.options import COUNT, FINITE, PORT, POSITIVE, address, path


def usage(words: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit, match="2"):
        main(words.split())
    return capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    ["replay LONG --out x", "export --to csv LONG", "replay no --out x"],
)
def test_a_path_that_cannot_be_looked_at_is_one_line(
    words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.replace("LONG", "n" * 300).split()) == EXIT_CONFIG
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "File name too long\n" in said or "found nothing, expected a " in said


@pytest.mark.parametrize(
    "words", ["reconstruct --plot --out OUT IN", "evaluate --images IN --out OUT"]
)
def test_an_image_may_have_a_name_that_is_not_utf8(tmp_path: Path, words: str) -> None:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "in").mkdir()
    stem = os.fsdecode(b"b\xff\xfe")
    cv2.imwrite(str(tmp_path / "a.png"), FREE)
    (tmp_path / "a.png").rename(tmp_path / "in" / f"{stem}.png")
    np.savez(tmp_path / "in" / f"{stem}.npz", points_mm=np.zeros((0, 3)))
    given = words.replace("IN", str(tmp_path / "in")).replace("OUT", str(tmp_path / "out")).split()
    assert main([*given, "--calibration", str(tmp_path / "c.npz"), "--profile", "fast"]) == 0


@pytest.mark.parametrize(
    "words",
    [
        "xyzzy",
        "run --xyzzy",
        "run --config",
        "bridge foxglove extra",
        "calibrate --sensr S.yaml --out c.npz",
        "replay x --out y --calibration c --profile auto",
        "simulate",
        "simulate --out x --depth nan",
        "simulate --out x --seed -1",
        "bridge",
        "bridge rerun",
        "bridge foxglove --broker mqtt://a",
        "bridge foxglove --listen a:x",
        "bridge ros2 --domain 233",
        "bridge ros2 --domain x",
        "bridge ros2 --router a:x",
        "bridge ros2 --listen a:1",
        "dashboard --http 65536",
        "dashboard --origin hand.example",
        "dashboard --origin https://h/path",
        "record --seconds 1 --name ../a",
        "record --seconds 4000",
        "record --seconds 0",
        "record --seconds soon",
        "evaluate --sensors teapot:1",
        "evaluate --sensors 5,",
        "evaluate --objects ball,teapot",
        "evaluate --presses 5",
        "evaluate --presses -1",
        "evaluate --references 0",
        "evaluate --profile best",
        "evaluate --images x",
        "evaluate --calibration x",
        "evaluate --calibration x --images x --presses 8",
        "evaluate --labels l",
        "evaluate --labels l --images x",
        "evaluate --labels l --images x --presses 9",
        "evaluate --labels l --images x --calibration c --reference r",
        "tradeoff --budget-ms 0",
        "tradeoff --budget-ms nan",
        "tradeoff --images x",
        "tradeoff --report --budget-ms 3",
        "tradeoff --calibration x --images x --objects ball",
        "doctor --with-frame",
        "doctor a.png --bundle b.zip",
        "doctor --calibration c.npz",
        "replay",
        "replay . --out o",
        "replay --out o",
        "replay x --calibration c",
        "replay --against o",
        "replay x --calibration c --mqtt h:1 --config c",
        "replay x --calibration c --out o --loop 0",
        "replay x --calibration c --out o --against ./o",
        "replay x --calibration c --mqtt h:1 --sensor-id a/b",
        "replay x --calibration c --play --out o",
        "reconstruct --calibration c.npz --out o",
    ],
)
def test_words_that_do_not_fit_are_usage_errors(
    capsys: pytest.CaptureFixture[str], words: str
) -> None:
    said = usage(words, capsys)
    assert f"usage: tacshade-edge {words.split()[0].replace('xyzzy', '[-h]')}" in said
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
def test_values(
    read: Callable[[str], object], good: dict[str, object], bad: tuple[str, ...]
) -> None:
    assert {text: read(text) for text in good} == good
    for text in bad:
        with pytest.raises(argparse.ArgumentTypeError, match=r"^found .*, expected "):
            read(text)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_fits_a_screen(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit, match="0"):
        main([command, "--help"])
    assert len(capsys.readouterr().out.splitlines()) <= 40


def test_a_path_may_begin_at_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/somebody")
    assert [path("~/map"), path("b~.png")] == [Path("/home/somebody/map"), Path("b~.png")]


# A library that works without the interpreter's lock and takes it again in a C++ destructor,
# for ever.
IN_A_LIBRARY = """
import cv2, numpy
def blur(*_):
    while True:
        cv2.GaussianBlur(image, (31, 31), 5)
image = numpy.zeros((2000, 2000), numpy.uint8)
"""


def python(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *words]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=patience(30), check=False
    )


@pytest.mark.slow
def test_a_stop_while_the_camera_hangs_in_its_library(tmp_path: Path) -> None:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    cv2.imwrite(str(tmp_path / "0.png"), FREE)
    settings = tmp_path / "settings.yaml"
    source = "source: {kind: files, path: 0.png, fps: 100, loop: true}"
    settings.write_text(
        f"calibration: c.npz\n{source}\nmqtt: {{host: 127.0.0.1, port: {free_port()}}}\n"
    )
    code = (
        f"{IN_A_LIBRARY}\nfrom tacshade_edge.cli.entry import entry\n"
        "from tacshade_edge.camera import file_source\n"
        "file_source.FilesSource.read = lambda self: print('hangs', flush=True) or blur()\nentry()"
    )
    command = [sys.executable, "-c", code, "run", "--config", str(settings)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "hangs\n"
        child.send_signal(signal.SIGTERM)
        _, errors = child.communicate(timeout=patience(20))
    assert child.returncode == 0, errors
    assert "stopping without grab" in errors
    assert "stopped: " in errors.splitlines()[-1]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stop_before_the_daemon_is_there_is_a_stop(number: signal.Signals) -> None:
    code = (
        "import os, sys\n"
        "from tacshade_edge.__main__ import entry\n"
        "assert 'argparse' not in sys.modules\n"
        "from tacshade_edge.cli import entry as process\n"
        f"process.main = lambda: os.kill(os.getpid(), {number:d}) or 1\n"
        "entry()"
    )
    assert python(code, "run").returncode == 0
    assert python(code, "replay").returncode in (-number, 1), (
        "any other command reports that it was cut off"
    )


@pytest.mark.parametrize(
    ("limit", "value", "found"),
    [
        (
            "RLIMIT_AS",
            1023 << 20,
            "found at most 1023 MiB of address space",
        ),  # at 500, OpenCV crashes while it is loaded
        ("RLIMIT_NOFILE", 127, "found at most 127 open files"),
    ],
)
def test_too_low_a_limit_is_reported_before_a_library_crashes(
    limit: str, value: int, found: str
) -> None:
    code = f"import resource\nresource.setrlimit(resource.{limit}, ({value}, {value}))\n"
    if python(f"{code}print(resource.getrlimit(resource.{limit})[0])").stdout != f"{value}\n":
        pytest.skip(
            "this limit is not kept here: QEMU's emulation of a user space has none of the "
            "address space"
        )
    done = python(
        f"{code}from tacshade_edge.__main__ import entry\nentry()", "run", "--config", "/none"
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (78, "", 1)
    assert done.stderr.startswith(f"tacshade-edge: {found}")


ASK = """
source {script}
COMP_WORDS=({typed}); COMP_CWORD={last}; COMP_LINE='{typed}'; COMP_POINT=${{#COMP_LINE}}
$(complete -p tacshade-edge | sed "s/.*-F \\([^ ]*\\) .*/\\1/")
printf "%s\\n" "${{COMPREPLY[@]}}"
"""


def completed(script: Path, typed: str) -> list[str]:
    """What bash offers for the last word."""
    asked = ASK.format(script=script, typed=typed, last=len(typed.split()) - 1)
    return subprocess.run(
        ("bash", "-c", asked), capture_output=True, text=True, check=True
    ).stdout.split()


@pytest.mark.skipif(find_spec("shtab") is None, reason="shtab is not installed")
@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes_commands_and_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "tacshade-edge"
    script.write_text(capsys.readouterr().out)
    assert set(completed(script, "tacshade-edge re")) == {
        name for name in COMMANDS if name.startswith("re")
    }
    assert completed(script, "tacshade-edge replay --cal") == ["--calibration"]
    assert completed(script, "tacshade-edge completion z") == ["zsh"]
