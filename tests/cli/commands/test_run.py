"""The daemon as its users run it: a child process, its exit code, its lines;
and what it imports.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.mqtt_rig import Broker, Subscriber, free_port
from support.painted_sensor import FREE, TOUCHED, painted_calibration, touched_depth_mm
from support.patience import patience, stretched, wait_until
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.wire import binary

pytestmark = pytest.mark.slow

STOP_S = 2.0
PHASES, PHASE_S = 7, 0.15
"""A start computes for less than a second."""
BASE = "tacshade/tacshade"
IMAGES = "kind: files, path: images, fps: 100, loop: true"
CAMERA = "kind: v4l2, width_px: 160, height_px: 120"
Child = subprocess.Popen[bytes]
Lines = Callable[[], list[str]]
Start = Callable[..., tuple[Child, Lines]]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A calibration, and a looped recording of a press."""
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "images").mkdir()
    for i, image in enumerate([FREE] * 3 + [TOUCHED] * 5):
        cv2.imwrite(str(tmp_path / "images" / f"{i}.png"), image)
    return tmp_path


def settings(
    folder: Path,
    port: int,
    source: str = IMAGES,
    *,
    calibration: str = "c.npz",
    mqtt: str = "",
    more: str = "",
) -> Path:
    path = folder / "settings.yaml"
    broker = f"mqtt: {{host: 127.0.0.1, port: {port}{mqtt}}}"
    path.write_text(f"calibration: {calibration}\nsource: {{{source}}}\n{broker}\n{more}")
    return path


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts `run`, and gives the lines of its log so far, without their time stamps."""
    children: list[Child] = []

    def started(path: Path, *words: str) -> tuple[Child, Lines]:
        command = [sys.executable, "-m", "tacshade_edge", "run", *words, "--config", str(path)]
        log = tmp_path / "log"
        with log.open("wb") as file:
            children.append(subprocess.Popen(command, stderr=file, cwd=tmp_path))
        stamp = re.compile(r"^\d{4}-\S+ ")
        return children[-1], lambda: [stamp.sub("", line) for line in log.read_text().splitlines()]

    yield started
    for child in children:
        child.kill()
        child.wait()


def stop(child: Child, lines: Lines) -> None:
    """A clean end within the promised time."""
    assert child.poll() is None, lines()
    began = time.monotonic()
    child.terminate()
    assert child.wait(patience(20)) == 0, lines()
    assert time.monotonic() - began < stretched(STOP_S)
    assert not any("Traceback" in line for line in lines())


def warnings(lines: Lines, *parts: str) -> list[str]:
    """The warnings with all of these parts."""
    return [
        line
        for line in lines()
        if line.startswith("WARNING ") and all(part in line for part in parts)
    ]


def state(seen: Subscriber) -> str:
    return (seen.of(f"{BASE}/state") or [b""])[-1].decode()


@pytest.mark.broker
def test_a_signal_stops_it_cleanly(folder: Path, start: Start) -> None:
    with Broker(folder) as broker, Subscriber(broker.port) as seen:
        child, lines = start(settings(folder, broker.port))
        seen.wait_for(f"{BASE}/height", 20, 15)
        heights = [binary.decode(p) for p in seen.of(f"{BASE}/height")]
        deepest = max(
            float(np.nanmax(h.height_mm)) for h in heights if isinstance(h, binary.HeightMessage)
        )
        assert deepest == pytest.approx(touched_depth_mm(), abs=0.001)
        assert state(seen) == "online"
        stop(child, lines)
        wait_until(lambda: state(seen) == "stopped", 5, "stopped")
        assert len(lines()) < 10  # state changes, not frames


def cpu_s(pid: int) -> float:
    """How long a process has computed; it ends only when it is waited for."""
    ticks = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def test_a_stop_at_any_moment_of_a_start_is_a_stop(
    folder: Path, start: Start, record_property: Callable[[str, object], None]
) -> None:
    record_property("tried", PHASES)
    path = settings(folder, free_port())
    for phase in range(PHASES):
        child, lines = start(path)
        wait_until(lambda: cpu_s(child.pid) >= phase * PHASE_S, 30, f"phase {phase}")  # noqa: B023
        child.send_signal(signal.SIGTERM)
        # Python itself, before a line of ours, has no handler.
        assert child.wait(patience(20)) in (0, -signal.SIGTERM), lines()
        assert not [line for line in lines() if "Traceback" in line], lines()
    assert not list(folder.rglob("*.part"))


@pytest.mark.broker
def test_a_killed_daemon_leaves_its_last_will(folder: Path, start: Start) -> None:
    with Broker(folder) as broker, Subscriber(broker.port) as seen:
        child, _ = start(settings(folder, broker.port))
        seen.wait_for(f"{BASE}/height", 1, 15)
        child.kill()
        wait_until(lambda: state(seen) == "offline", 5, "offline")


def test_without_broker_and_camera_it_waits_and_says_each_once(folder: Path, start: Start) -> None:
    port = free_port()
    child, lines = start(settings(folder, port, f"{CAMERA}, device: /dev/video99"))
    wait_until(
        lambda: warnings(lines, "/dev/video99") and warnings(lines, "refused"), 20, "the lines"
    )
    threading.Event().wait(1.5)  # more attempts
    stop(child, lines)
    (camera,), (broker,) = warnings(lines, "/dev/video99"), warnings(lines, "refused")
    assert camera.startswith(
        "WARNING tacshade_edge.daemon.sensor_state: source away: camera /dev/video99: "
        "no such device"
    )
    assert broker.startswith(
        f"WARNING tacshade_edge.mqtt.link: 127.0.0.1:{port}: Connection refused"
    )
    assert "; to fix it: " in camera
    assert "; to fix it: " in broker


def test_a_source_that_can_never_work_ends_the_process_with_one_line_and_78(
    folder: Path, start: Start
) -> None:
    (folder / "void").mkdir()
    child, lines = start(settings(folder, free_port(), "kind: files, path: void"))
    assert child.wait(patience(20)) == 78
    (refusal,) = (line for line in lines() if line.startswith("tacshade-edge: "))
    assert f"{folder}/void: found no image" in refusal
    assert "Traceback" not in "".join(lines())


def test_a_defect_in_a_thread_ends_the_process_with_a_traceback(folder: Path) -> None:
    code = (
        "from tacshade_edge.cli.entry import entry; from tacshade_edge.camera import file_source\n"
        "def read(self): raise ZeroDivisionError('a defect')\n"
        "file_source.FilesSource.read = read\n"
        "entry()"
    )
    command = [sys.executable, "-c", code, "run", "--config", str(settings(folder, free_port()))]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=patience(20), check=False
    )
    assert done.returncode == 1
    assert "Traceback" in done.stderr
    assert done.stderr.rstrip().endswith("ZeroDivisionError: a defect\nin thread grab")


@pytest.mark.parametrize("closed", ["0<&-", "1>&-", "2>&-", "0<&- 1>&- 2>&-"])
@pytest.mark.parametrize(
    "words",
    [
        "run --config SETTINGS",
        "check-config SETTINGS",
        "reconstruct --calibration c.npz --out out images",
        "--help",
    ],
)
def test_closed_standard_streams_are_no_failure(folder: Path, words: str, closed: str) -> None:
    path = settings(folder, free_port(), "kind: files, path: images, fps: 100")
    command = f'exec "$0" -m tacshade_edge {words.replace("SETTINGS", path.name)} {closed}'
    done = subprocess.run(
        ["sh", "-c", command, sys.executable],
        cwd=folder,
        capture_output=True,
        timeout=patience(60),
        check=False,
    )
    assert (done.returncode, b"Traceback" in done.stderr) == (0, False), done.stderr.decode()


@pytest.mark.broker
@pytest.mark.parametrize("where", ["2> /dev/full", "> /dev/full 2>&1", "2> >(true)"])
def test_a_log_that_cannot_be_written_ends_no_daemon(folder: Path, where: str) -> None:
    """On a full disk or a reader that has ended: a broker that goes and comes is logged each time,
    and a reload.
    """
    with Broker(folder) as broker, Subscriber(broker.port) as seen:
        path = settings(folder, broker.port)
        command = ["bash", "-c", f'exec "$0" -m tacshade_edge run -v --config "$1" {where}']
        with subprocess.Popen([*command, sys.executable, str(path)], cwd=folder) as child:
            try:
                seen.wait_for(f"{BASE}/height", 5, 20)
                broker.stop()
                broker.start()
                child.send_signal(signal.SIGHUP)
                before = len(seen.of(f"{BASE}/height"))
                seen.wait_for(f"{BASE}/height", before + 5, 20)
            finally:
                child.terminate()
            assert child.wait(patience(20)) == 0
        wait_until(lambda: state(seen) == "stopped", 5, "stopped")


@pytest.mark.broker
def test_quiet_is_silent_while_all_is_well(folder: Path, start: Start) -> None:
    for path in sorted((folder / "images").iterdir())[3:]:
        path.unlink()
    with Broker(folder) as broker, Subscriber(broker.port, "tacshade/+/health") as seen:
        _, lines = start(settings(folder, broker.port), "-q")
        wait_until(
            lambda: (
                b'"without_contact": 0'
                not in b"".join(m.payload for m in seen.messages[-1:])
                != b""
            ),
            20,
        )
        assert lines() == []


# Runs the command to the end of its recording, then prints what was imported.
RUN = """
import json, sys
from tacshade_edge import cli
print(json.dumps([cli.main(sys.argv[1:]), *sys.modules]))
"""
OTHERS = {
    "scipy",
    "matplotlib",
    "skimage",
    "PIL",
    "serial",
    "websockets",
    "iotcore",
    "sklearn",
    "torch",
}
# Other commands; what waits for a reference to be taken, for a camera, for a simulated source;
# what needs poses.
COMMANDS, ON_DEMAND, POSES = (
    "simulator studies dashboard doctor daemon.playback",
    "calibration.calibrate camera.v4l2 lab.simulated_source",
    "stitching.stitcher stitching.press_points stitching.session stitching.session_worker "
    "stitching.stitch_file",
)
OWN = {f"tacshade_edge.{part}" for part in [*COMMANDS.split(), *ON_DEMAND.split()]}
STITCHING = {f"tacshade_edge.{part}" for part in POSES.split()}


def imported(folder: Path, profile: str) -> set[str]:
    source = "kind: files, path: images, fps: 100"
    config = settings(folder, free_port(), source, more=f"profile: {profile}\n")
    command = [sys.executable, "-c", RUN, "run", "--config", str(config)]
    code, *modules = json.loads(
        subprocess.run(command, capture_output=True, text=True, check=True).stdout
    )
    assert code == 0
    return set(modules)


def test_imports_follow_the_settings(folder: Path) -> None:
    """Memory and a quick start are for what the daemon does."""
    network, paper = imported(folder, "fast"), imported(folder, "paper")
    assert "onnxruntime" in network
    assert "onnxruntime" not in paper
    for modules in (network, paper):
        assert "tacshade_edge.camera.file_source" in modules
        assert modules & (OTHERS | OWN | STITCHING) == ({"scipy"} if modules is paper else set())
    (folder / "images" / "frames.csv").write_text(
        "image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0.png,0,0,0,0,1,0,0,0\n"
    )
    posed = imported(folder, "fast")
    assert posed >= STITCHING
    assert posed & (OTHERS | OWN) == set()
