"""The end of a process: its exit code is the command's, whatever its threads are doing."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import free_port
from tools.testbed.painted_sensor import FREE, painted_calibration
from tools.testbed.patience import patience

# A library that works without the interpreter's lock and takes it again in a C++ destructor, for ever.
IN_A_LIBRARY = """
import cv2, numpy
def blur(*_):
    while True:
        cv2.GaussianBlur(image, (31, 31), 5)
image = numpy.zeros((2000, 2000), numpy.uint8)
"""


def python(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=patience(30), check=False)


@pytest.mark.slow
@pytest.mark.parametrize("code", [0, 78])
def test_a_thread_inside_a_library_does_not_change_the_exit_code(code: int) -> None:
    """Taken down under it, the interpreter ended in SIGABRT, "terminate called without an active exception"."""
    done = python(
        f"{IN_A_LIBRARY}\nimport threading\nfrom tacshade_edge.cli.entry import leave\n"
        f"threading.Thread(target=blur, daemon=True).start()\nprint('said', end='')\nleave({code})"
    )
    assert (done.returncode, done.stdout, done.stderr) == (code, "said", "")


@pytest.mark.slow
def test_a_stop_while_the_camera_hangs_in_its_library(tmp_path: Path) -> None:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    cv2.imwrite(str(tmp_path / "0.png"), FREE)
    settings = tmp_path / "settings.yaml"
    source = "source: {kind: files, path: 0.png, fps: 100, loop: true}"
    settings.write_text(f"calibration: c.npz\n{source}\nmqtt: {{host: 127.0.0.1, port: {free_port()}}}\n")
    code = (
        f"{IN_A_LIBRARY}\nfrom tacshade_edge.cli.entry import entry\n"
        "from tacshade_edge.storage.recording import image_source\n"
        "image_source.FilesSource.read = lambda self: print('hangs', flush=True) or blur()\nentry()"
    )
    command = [sys.executable, "-c", code, "run", "--config", str(settings)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
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
        "import os, sys\nfrom tacshade_edge.__main__ import entry\nassert 'argparse' not in sys.modules\n"
        "from tacshade_edge.cli import entry as process\n"
        f"process.main = lambda: os.kill(os.getpid(), {number:d}) or 1\nentry()"
    )
    assert python(code, "run").returncode == 0
    assert python(code, "replay").returncode in (-number, 1), "any other command tells that it was cut off"


@pytest.mark.parametrize(
    ("limit", "value", "found"),
    [
        (
            "RLIMIT_AS",
            1023 << 20,
            "found 1023 MiB of address space",
        ),  # at 500, OpenCV's loading was a segmentation fault
        ("RLIMIT_NOFILE", 12, "found at most 12 open files"),
        ("RLIMIT_NOFILE", 127, "found at most 127 open files"),
    ],
)
def test_too_low_a_limit_is_told_before_a_library_crashes(limit: str, value: int, found: str) -> None:
    code = f"import resource\nresource.setrlimit(resource.{limit}, ({value}, {value}))\n"
    if python(f"{code}print(resource.getrlimit(resource.{limit})[0])").stdout != f"{value}\n":
        pytest.skip("this limit is not kept here: QEMU's emulation of a user space has none of the address space")
    done = python(f"{code}from tacshade_edge.__main__ import entry\nentry()", "run", "--config", "/none")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (78, "", 1)
    assert done.stderr.startswith(f"tacshade-edge: {found}")


def test_a_defect_is_a_traceback_and_exit_1() -> None:
    done = python("from tacshade_edge.cli import entry\nentry.main = lambda: 1 / 0\nentry.entry()", "run")
    assert done.returncode == 1
    assert done.stderr.rstrip().endswith("ZeroDivisionError: division by zero")
