"""``tacshade-edge demo``: a simulated hand, the real daemon, a private broker and the dashboard, all on loopback."""

from __future__ import annotations

import argparse
import math
import signal
import socket
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

from tacshade_edge.cli.demo_broker import broker_command
from tacshade_edge.cli.demo_child import Child, free_port, wait_for_port
from tacshade_edge.cli.demo_sensor import make_calibration
from tacshade_edge.devices.files import calibration_file

FPS: Final = 20  # a laptop draws a simulated frame in 10 to 40 ms, few of them in up to 170
PORT: Final = 8080
START_S: Final = 30.0
CHECK_PERIOD_S: Final = 0.5
STOP_SIGNALS: Final = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)

_SETTINGS = """\
sensor_id: demo
calibration: calibration.npz
source: {{kind: simulated, fps: {fps}}}
mqtt: {{host: 127.0.0.1, port: {port}}}
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add = parser.add_argument
    add("--http", type=int, metavar="PORT", help=f"the page's port (default: {PORT}, or any free one)")
    add("--seconds", type=float, default=math.inf, metavar="N", help="end by itself after N seconds")


def run(args: argparse.Namespace) -> int:
    """Run until Ctrl-C, SIGTERM, the terminal's end, or ``--seconds``."""
    asked = threading.Event()

    def stop(*_: object) -> None:
        """Leave what is being done and stop the children; a second Ctrl-C does not interrupt that."""
        for number in STOP_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        asked.set()
        raise KeyboardInterrupt

    def end_if_asked() -> None:
        """Leave now where the exception was lost: what a destructor or a library's callback raises goes nowhere."""
        if asked.is_set():
            raise KeyboardInterrupt

    for number in STOP_SIGNALS:
        signal.signal(number, stop)
    me = [sys.executable, "-m", "tacshade_edge"]
    http = _free(PORT) if args.http is None else args.http
    with suppress(KeyboardInterrupt), ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tacshade-demo-")))
        children: list[Child] = []

        def start(name: str, command: list[str]) -> Child:
            child = Child(name, command, folder)
            stack.callback(child.stop)  # the last started is stopped first
            children.append(child)
            return child

        mqtt = free_port()
        broker = start("broker", broker_command(folder, mqtt))
        dashboard = start("dashboard", [*me, "dashboard", "--broker", f"127.0.0.1:{mqtt}", "--http", str(http)])
        print("Calibrating a simulated sensor on simulated ball presses ...", flush=True)
        calibration_file.save(folder / "calibration.npz", make_calibration())
        end_if_asked()
        settings = folder / "settings.yaml"
        settings.write_text(_SETTINGS.format(fps=FPS, port=mqtt), encoding="utf-8")
        wait_for_port(broker, mqtt, START_S)
        start("daemon", [*me, "run", "--config", str(settings)])
        wait_for_port(dashboard, http, START_S)
        print(f"A simulated hand presses one object after another: open http://127.0.0.1:{http}/", flush=True)
        print("Ctrl-C ends.", flush=True)
        deadline_s = time.monotonic() + args.seconds
        while (left_s := deadline_s - time.monotonic()) > 0:
            time.sleep(min(CHECK_PERIOD_S, left_s))
            end_if_asked()
            for child in children:
                child.check()
    return 0


def _free(port: int) -> int:
    """The port itself, or another one when it is taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return free_port()
    return port
