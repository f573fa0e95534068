from __future__ import annotations

import contextlib
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from support.browser import CHROMIUM, DRIVER, browser, errors
from support.mqtt_rig import MOSQUITTO, Subscriber
from support.patience import patience, wait_until
from tacshade_edge.lab.demo import demo_hand
from tacshade_edge.lab.demo.child import free_port
from tacshade_edge.mqtt.listener import listen
from tacshade_edge.settings import load_hand
from tacshade_edge.wire import binary
from tacshade_edge.wire.sensor_topics import Contact
from tacshade_edge.wire.topics import decode_hand

# As on a machine without mosquitto.
WITHOUT_MOSQUITTO = (
    "import shutil, sys; shutil.which = lambda *a, **k: None; from tacshade_edge.cli import main; "
)
COMMANDS = {
    "mosquitto": [sys.executable, "-m", "tacshade_edge", "demo"],
    "embedded": [sys.executable, "-c", WITHOUT_MOSQUITTO + "sys.exit(main(sys.argv[1:]))", "demo"],
}
BROKER = re.compile(r"Other programs can listen to the broker 127\.0\.0\.1:(\d+)\.\n")
ADDRESS = re.compile(r"http://\S+?:(\d+)/(login#\S+)?")


@contextlib.contextmanager
def demo(
    command: list[str], folder: Path
) -> Iterator[tuple[subprocess.Popen[str], tuple[str, str]]]:
    """A running demo with its files in `folder`, and the port and path of its page.

    Killed, it leaves no process.
    """
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(folder)},
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("Calibrating")
        line = process.stdout.readline()
        found = ADDRESS.search(line)
        assert found, (
            line,
            process.poll(),
            process.stderr and process.poll() and process.stderr.read(),
        )
        if found[2]:
            assert process.stdout.readline().startswith("No encryption")
        line = process.stdout.readline()
        broker = BROKER.fullmatch(line)
        assert broker, line
        socket.create_connection(("127.0.0.1", int(broker[1]))).close()
        assert process.stdout.readline() == "Press Ctrl-C to stop.\n"
        yield process, (found[1], found[2] or "")
    finally:
        process.kill()
        process.communicate()
        wait_until(lambda: not running(folder), 10, "every process of the demo is gone")


def running(folder: Path) -> list[str]:
    """Command lines of the processes that were started with this folder."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            line = entry.read_bytes().replace(b"\0", b" ").decode(errors="replace")
            if str(folder) in line:
                found.append(line)
    return found


def heights(page: Subscriber) -> list[binary.HeightMessage]:
    decoded = [
        binary.decode(bytes(m.payload)) for m in list(page.messages) if m.topic.endswith("/height")
    ]
    return [message for message in decoded if isinstance(message, binary.HeightMessage)]


@pytest.mark.slow
def test_a_browser_sees_moving_maps_and_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    pytest.importorskip("iotcore")
    with demo(COMMANDS["embedded"], tmp_path) as (process, (port, _)):
        with Subscriber(int(port), "tacshade/#", page=True) as page:
            wait_until(lambda: len(heights(page)) >= 20, 30, "20 height maps")
            maps = heights(page)
        assert running(tmp_path)
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=patience(20))
        assert (process.returncode, out, errors) == (0, "", "")
    depths = [float(np.nanmax(message.height_mm)) for message in maps]
    assert maps[0].height_mm.shape == (112, 112)
    assert 1.0 < max(depths) < 6.0  # 3 mm is pressed
    assert len(set(depths)) > 5  # it moves
    assert running(tmp_path) == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_the_listener_of_the_readme_hears_it_and_home_assistant_finds_it(tmp_path: Path) -> None:
    port = free_port()
    words = ["--port", str(port), "--sensor", "tacshade", "--home-assistant"]
    with demo([*COMMANDS["mosquitto"], *words], tmp_path):
        with (
            Subscriber(port, "homeassistant/#") as found,
            listen(f"localhost:{port}", "tacshade", ["contact"]) as messages,
        ):
            message = messages.get(patience(20))
            assert message is not None
            assert isinstance(message.value, Contact)
            depth = "homeassistant/sensor/tacshade/depth/config"
            wait_until(lambda: depth in {m.topic for m in found.messages}, 20, "announced")
        again = subprocess.run(
            [*COMMANDS["mosquitto"], "--port", str(port)],
            capture_output=True,
            text=True,
            timeout=patience(60),
            check=False,
        )
    assert (again.returncode, again.stdout) == (1, "")
    assert re.fullmatch(
        rf"tacshade-edge: --port {port}: Address already in use, expected .*\n", again.stderr
    )


@pytest.mark.parametrize(
    ("words", "code"), [("demo-map", 78), ("a/b", 2), ("hand", 2), ("tacshade --hand", 2)]
)
def test_a_name_that_no_sensor_of_the_demo_can_have(words: str, code: int) -> None:
    command = [*COMMANDS["mosquitto"], "--sensor", *words.split()]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=patience(60), check=False
    )
    assert (done.returncode, done.stdout) == (code, "")
    assert "--sensor" in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_a_hand_of_five_holds_a_bottle_and_what_it_feels_lies_on_it(tmp_path: Path) -> None:
    with demo([*COMMANDS["mosquitto"], "--hand"], tmp_path) as (process, _):
        (settings,) = tmp_path.glob("tacshade-demo-*/hand.yaml")
        hand = load_hand(settings)
        assert hand is not None
        assert hand.fingers == tuple(demo_hand.FINGERS)
        with Subscriber(
            hand.common.settings.mqtt.port, f"tacshade/hand/{hand.hand_id}/objects"
        ) as seen:

            def all_hold() -> bool:
                reported = [decode_hand(bytes(message.payload)) for message in seen.messages[-1:]]
                return bool(reported) and all(
                    finger.objects for finger in reported[0].fingers.values()
                )

            wait_until(all_hold, 60, "all fingers hold it")
            fingers = decode_hand(bytes(seen.messages[-1].payload)).fingers
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=patience(20)) == ("", "")
    for name, finger in fingers.items():
        centroid_mm = np.array(finger.objects[0].centroid_mm)
        assert abs(float(demo_hand.BOTTLE.sdf(centroid_mm[None])[0])) < 2.0, (
            name
        )  # it may be closing
        inwards = demo_hand.place_of(name).rotation[:, 2]
        assert np.dot(finger.objects[0].normal, inwards) > 0.9, name
    assert running(tmp_path) == []


@pytest.mark.slow
def test_a_signal_while_it_starts_leaves_nothing(tmp_path: Path) -> None:
    leader, follower = pty.openpty()
    process = subprocess.Popen(
        COMMANDS["embedded"],
        stdout=follower,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    os.close(follower)
    assert os.read(leader, 100).startswith(b"Calibrating")
    process.send_signal(signal.SIGHUP)
    _, errors = process.communicate(timeout=patience(20))
    os.close(leader)
    assert (process.returncode, errors) == (0, b"")
    assert running(tmp_path) == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_port_in_use_is_one_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        command = [*COMMANDS["embedded"], "--http", str(port)]
        env = {**os.environ, "TMPDIR": str(tmp_path)}
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=patience(60), check=False, env=env
        )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert re.match(rf"tacshade-edge: demo: the dashboard .*port {port}", done.stderr), done.stderr
    assert tempfile.gettempdir() not in done.stderr


@pytest.mark.browser
@pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="Chromium or its driver is not installed")
@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_the_page_draws_the_presses_on_another_machine_with_the_token_that_is_printed(
    tmp_path: Path,
) -> None:
    profile = tmp_path / "chromium"
    with (
        demo([*COMMANDS["mosquitto"], "--listen", "0.0.0.0"], tmp_path) as (_, (port, path)),
        browser(profile) as page,
    ):
        page.get(f"http://127.0.0.1:{port}/{path}")
        peaks: set[float] = set()

        def moves() -> bool:
            peaks.add(
                page.execute_script(
                    "return window.tacshade?.seq == null ? 0 : tacshade.drawnPeak()"
                )
            )
            return 0 in peaks and len(peaks) > 5 and 1.0 < max(peaks) < 8.0

        wait_until(moves, 60, "depths that change on the canvas")
        pad = (
            "return [...document.querySelectorAll('#sensors button')].find((t) => t.textContent "
            "=== 'demo-map')"
        )
        wait_until(lambda: page.execute_script(pad), 60, "the other sensor")
        page.execute_script(f"{pad}.click()")  # at once: tabs are drawn anew as hands come
        presses = "return tacshade.stitched?.presses ?? 0"
        wait_until(lambda: page.execute_script(presses) >= 4, 60, "a map grows on the page")
        assert errors(page) == []
