"""What a user gets wrong, as the user meets it: a child process, one line on stderr, the exit code.

Every line of the settings' own check is in tests/settings/test_load.py; here is one of each kind.
"""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import pytest

from tacshade_edge.cli import main
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import free_port
from tools.testbed.painted_sensor import FREE, painted_calibration
from tools.testbed.patience import patience, wait_until

pytestmark = pytest.mark.slow  # a process each: over half a minute in all
COMMAND = [sys.executable, "-m", "tacshade_edge"]
FILES = "kind: files, path: images, loop: true"
CAMERA = "kind: v4l2, width_px: 160, height_px: 120"
SENSOR = "skin_radius_mm: 20\nvisible_half_angle_deg: 50\npolarity: bright\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration, images and descriptions that are good, and the same damaged."""
    made = tmp_path_factory.mktemp("bad_input")
    calibration_file.save(made / "good.npz", painted_calibration())
    calibration = (made / "good.npz").read_bytes()
    (made / "cut.npz").write_bytes(calibration[:-300])
    flipped = bytearray(calibration)
    flipped[len(calibration) // 2] ^= 0xFF
    (made / "flipped.npz").write_bytes(flipped)
    (made / "images").mkdir()
    (made / "empty").mkdir()
    (made / "large").mkdir()
    cv2.imwrite(str(made / "images" / "good.png"), FREE)
    cv2.imwrite(str(made / "large" / "large.png"), cv2.resize(FREE, (320, 240)))
    (made / "cut.png").write_bytes((made / "images" / "good.png").read_bytes()[:1000])
    (made / "text.png").write_text("no image\n")
    (made / "SENSOR.yaml").write_text(SENSOR)
    (made / "unknown.yaml").write_text(SENSOR + "colour: red\n")
    (made / "type.yaml").write_text(SENSOR.replace("20", "twenty"))
    header = "image,indenter,radius_mm,depth_mm,x_mm,y_mm\n"
    (made / "PRESSES.csv").write_text(header + "cut.png,ball,4.5,2,,\n")
    return made


def settings(
    folder: Path,
    *,
    name: str = "s.yaml",
    source: str = FILES,
    calibration: str = "good.npz",
    port: int | str = 1,
    more: str = "",
) -> str:
    text = f"calibration: {calibration}\nsource: {{{source}}}\nmqtt: {{host: 127.0.0.1, port: {port}}}\n{more}"
    (folder / name).write_text(text)
    return name


def refused(folder: Path, words: list[str], code: int) -> str:
    """The one line on stderr of a command that must refuse."""
    done = subprocess.run(
        [*COMMAND, *words], cwd=folder, capture_output=True, text=True, timeout=patience(60), check=False
    )
    assert done.returncode == code, done.stderr
    assert done.stderr.startswith("tacshade-edge: ")
    assert done.stderr.count("\n") == 1, done.stderr
    return done.stderr.removeprefix("tacshade-edge: ").rstrip("\n")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"source": CAMERA + ", device: /dev/null"}, "s.yaml:2: source.device: camera /dev/null: found another kind"),
        ({"source": CAMERA + ", device: /dev/shm"}, "s.yaml:2: source.device: camera /dev/shm: found a directory"),
        ({"source": "kind: files, path: large"}, "s.yaml:2: source.path: found 320x240 px"),
        ({"calibration": "flipped.npz"}, "s.yaml:1: calibration: {folder}/flipped.npz: "),
        ({"more": "colour: red\n"}, "s.yaml:4: colour: found an unknown key"),
    ],
)
def test_settings_that_cannot_work(folder: Path, given: dict[str, str], said: str) -> None:
    line = refused(folder, ["run", "--config", settings(folder, **given)], 78)
    assert line.replace(f"{folder}/s.yaml", "s.yaml").startswith(said.replace("{folder}", str(folder)))


CALIBRATE = ["calibrate", "--out", "o.npz", "--sensor"]
RECONSTRUCT = ["reconstruct", "--out", "o", "--calibration"]
GOOD = "images/good.png"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([*CALIBRATE, "unknown.yaml", "--reference", GOOD], 78, "unknown.yaml:4: colour: found an unknown key"),
        ([*CALIBRATE, "type.yaml", "--reference", GOOD], 78, "type.yaml:1: skin_radius_mm: found twenty"),
        ([*CALIBRATE, "none.yaml", "--reference", GOOD], 78, "none.yaml: No such file or directory, expected a "),
        (
            [*CALIBRATE, "SENSOR.yaml", "--reference", GOOD, "cut.png"],
            78,
            "--reference: cut.png: found an image cut short after 1000 bytes",
        ),
        (
            [*CALIBRATE, "SENSOR.yaml", "--reference", GOOD, "large/large.png"],
            78,
            "--reference: large/large.png: found 320x240 px",
        ),
        (
            [*CALIBRATE, "SENSOR.yaml", "--reference", GOOD, "--presses", "PRESSES.csv"],
            78,
            "PRESSES.csv:2: image: cut.png: found an image cut short after 1000 bytes",
        ),
        ([*RECONSTRUCT, "flipped.npz", GOOD], 78, "flipped.npz: "),
        ([*RECONSTRUCT, "text.png", GOOD], 78, "text.png: the file is damaged or not a calibration"),
        ([*RECONSTRUCT, "good.npz", GOOD, "cut.png"], 1, "cut.png: found an image cut short after 1000 bytes"),
        ([*RECONSTRUCT, "good.npz", "text.png", GOOD], 1, "text.png: found 9 bytes that are not an image"),
        ([*RECONSTRUCT, "good.npz", "none.png", GOOD], 1, "none.png: No such file or directory, expected an image"),
        ([*RECONSTRUCT, "good.npz", "large/large.png", GOOD], 1, "large/large.png: invalid: size: found 320x240 px"),
        (["simulate", "--out", "o", "--objects", "teapot"], 78, "--objects: found 'teapot'"),
        (["simulate", "--out", "SENSOR.yaml"], 1, "SENSOR.yaml: cannot write it: File exists"),
    ],
)
def test_files_that_cannot_be_used(
    folder: Path, words: list[str], code: int, said: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(folder)
    assert main(words) == code
    printed = capsys.readouterr().err
    assert printed.startswith(f"tacshade-edge: {said}")
    assert printed.count("\n") == 1, printed


@contextmanager
def running(folder: Path, config: str) -> Iterator[Path]:
    """`run` that goes on; the file of its stderr. It must end cleanly and without a traceback."""
    said = folder / f"{config}.stderr"
    with said.open("w") as errors:
        child = subprocess.Popen([*COMMAND, "run", "--config", config], cwd=folder, stderr=errors)
    try:
        yield said
        assert child.poll() is None
        child.send_signal(signal.SIGTERM)
        assert child.wait(patience(20)) == 0
        assert "Traceback" not in said.read_text()
    finally:
        child.kill()
        child.wait()


def lines_with(said: Path, text: str) -> list[str]:
    """Without their time stamps."""
    lines = (re.sub(r"^\d{4}-\S+ ", "", line) for line in said.read_text().splitlines())
    return [line for line in lines if text in line]


def test_a_camera_that_is_not_there_is_waited_for(folder: Path) -> None:
    config = settings(folder, name="missing.yaml", source=CAMERA + ", device: /dev/video99")
    with running(folder, config) as said:
        wait_until(lambda: lines_with(said, "/dev/video99"), 20, "the line")
        threading.Event().wait(1)  # three more attempts
    (told,) = lines_with(said, "/dev/video99")
    assert told.startswith("WARNING tacshade_edge.daemon.app: source away: camera /dev/video99: no such device")
    assert "; to fix it: " in told


def test_images_that_cannot_be_decoded_are_told_once(folder: Path) -> None:
    config = settings(folder, name="undecodable.yaml", source="kind: files, path: cut.png, loop: true, fps: 240")
    with running(folder, config) as said:
        wait_until(lambda: lines_with(said, "cut.png"), 20, "the line")
    line = f"source away: {folder}/cut.png: found an image cut short after 1000 bytes"
    (told,) = lines_with(said, "cut.png")
    assert told.startswith(f"WARNING tacshade_edge.daemon.app: {line}")
    assert "'published': 0" in said.read_text()


@contextmanager
def something_else(answer: bytes) -> Iterator[tuple[int, list[socket.socket]]]:
    """A server that is no broker: its port, and the connections it got. Mute without an answer."""
    connections: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    peer, _ = server.accept()
                except OSError:  # shut down
                    return
                connections.append(peer)
                if answer:
                    peer.sendall(answer)
                    peer.close()

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield server.getsockname()[1], connections
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join(patience(10))
            for peer in connections:
                peer.close()


@pytest.mark.parametrize(
    "answer",
    [
        pytest.param(b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\n\r\n", id="http"),
        pytest.param(bytes(range(256)), id="garbage"),
        pytest.param(b"", id="mute"),  # given up after the keepalive of 10 s
    ],
)
def test_a_port_where_no_broker_listens(folder: Path, answer: bytes) -> None:
    with something_else(answer) as (port, connections):
        with running(folder, settings(folder, name="port.yaml", port=port)) as said:
            wait_until(lambda: len(connections) >= 3, 60, "it goes on trying")
        told = lines_with(said, f"127.0.0.1:{port}: accepts")
    assert len(told) == 1
    expected = f"WARNING tacshade_edge.devices.mqtt.link: 127.0.0.1:{port}: accepts connections but does not "
    assert told[0].startswith(expected)


def test_a_port_where_nothing_listens(folder: Path) -> None:
    port = free_port()
    with running(folder, settings(folder, name="nothing.yaml", port=port)) as said:
        wait_until(lambda: lines_with(said, "refused"), 20, "the line")
        threading.Event().wait(1.5)  # another attempt
    told = f"WARNING tacshade_edge.devices.mqtt.link: 127.0.0.1:{port}: Connection refused; to fix it: "
    (line,) = lines_with(said, "refused")
    assert line.startswith(told)
