"""``tacshade-edge demo``: simulated sensors or a hand, the real daemon,
a private broker and the dashboard.
"""

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

from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli.commands.dashboard import ANY, in_url, is_loopback, make_token
from tacshade_edge.cli.shared.options import PORT, add_flag, add_option, need
from tacshade_edge.lab.demo import demo_hand, touchpad
from tacshade_edge.lab.demo.child import Child, broker_command, free_port, wait_for_port
from tacshade_edge.lab.demo.demo_hand import make_calibration

FPS: Final = 20  # a laptop draws a simulated frame in 10 to 40 ms, rarely in up to 170
HTTP: Final = 8080
START_S: Final = 30.0
CHECK_PERIOD_S: Final = 0.5
STOP_SIGNALS: Final = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)

_SETTINGS = """\
sensor_id: demo
calibration: calibration.npz
source: {{kind: simulated, fps: {fps}}}
recorder: {{folder: recordings}}
mqtt: {{host: 127.0.0.1, port: {port}}}
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    text = f"port to serve the page on (default: {HTTP}, or any free port if {HTTP} is in use)"
    add_option(parser, "--http", "PORT", text, PORT)
    text = "address to listen on (default: this machine only)"
    add_option(parser, "--listen", "ADDRESS", text, str, default="127.0.0.1")
    add_flag(parser, "--hand", "show a five-fingered hand that holds a bottle")
    add_option(parser, "--seconds", "N", "stop after N seconds", float, default=math.inf)


def run(args: argparse.Namespace) -> int:
    """Run until Ctrl-C, SIGTERM, SIGHUP (the terminal closes), or for ``--seconds``."""
    need("demo", "demo", "websockets")  # before a minute of work
    asked = threading.Event()

    def stop(*_: object) -> None:
        """Interrupt the current work and stop the children;
        a second Ctrl-C does not interrupt that.
        """
        for number in STOP_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        asked.set()
        raise KeyboardInterrupt

    def end_if_asked() -> None:
        """Raise the interrupt again if it was lost, as it is when raised in a destructor
        or a library's callback.
        """
        if asked.is_set():
            raise KeyboardInterrupt

    for number in STOP_SIGNALS:
        signal.signal(number, stop)
    me = [sys.executable, "-m", "tacshade_edge"]
    host = args.listen
    http = _free(host, HTTP) if args.http is None else args.http
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
        (folder / "recordings").mkdir()
        page = [
            *me,
            "dashboard",
            "--broker",
            f"127.0.0.1:{mqtt}",
            "--http",
            str(http),
            "--host",
            host,
        ]
        page += ["--recordings", str(folder / "recordings")]
        path = f"#hand/{demo_hand.HAND_ID}" if args.hand else ""
        if not is_loopback(host):
            # The sensor is simulated, so anyone with the address may control it.
            path = f"login#{make_token(folder / 'token')}"
            page += ["--token-file", str(folder / "token"), "--allow-control"]
        dashboard = start("dashboard", page)
        print("Calibrating a simulated sensor on simulated ball presses ...", flush=True)
        calibration_file.save(folder / "calibration.npz", make_calibration())
        end_if_asked()
        if args.hand:
            settings = demo_hand.write(folder, mqtt)
            what = "Five simulated fingers hold a bottle, which soon moves"
        else:
            settings = folder / "settings.yaml"
            settings.write_text(_SETTINGS.format(fps=FPS, port=mqtt), encoding="utf-8")
            what = "A simulated sensor presses and drags objects; soon a second one stitches a map"
        end_if_asked()
        wait_for_port(broker, mqtt, START_S)
        start("daemon", [*me, "run", "--config", str(settings)])
        wait_for_port(dashboard, http, START_S, "127.0.0.1" if host in ANY else host)
        name = socket.gethostname() if host in ANY else host
        print(f"{what}: open http://{in_url(name)}:{http}/{path}", flush=True)
        if not is_loopback(host):
            print(
                "No encryption: others on the network can read the address and the page.",
                flush=True,
            )
        print(
            f"Other programs can listen to the broker 127.0.0.1:{mqtt}.\nPress Ctrl-C to stop.",
            flush=True,
        )
        if args.hand:
            other, period_s = demo_hand.play(folder), demo_hand.STEP_S
        else:
            other = touchpad.hand(
                folder, mqtt, lambda config: start("map", [*me, "run", "--config", str(config)])
            )
            period_s = CHECK_PERIOD_S
        stack.callback(other.close)
        deadline_s = time.monotonic() + args.seconds
        while (left_s := deadline_s - time.monotonic()) > 0:
            time.sleep(min(period_s, left_s))
            end_if_asked()
            for child in children:
                child.check()
            next(other)
    return 0


def _free(host: str, port: int) -> int:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return free_port()
    return port
