"""``tacshade-edge demo``: simulated sensors, the real daemon for each, a private broker and the dashboard.

All listen on loopback, except the page with ``--listen``. With ``--hand``, the five fingers of a hand replace the two
single sensors: one board cannot run all of them.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Generator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

from tacshade_edge.cli.shared.dashboard_access import is_loopback, make_token
from tacshade_edge.demo import hand as demo_hand
from tacshade_edge.demo import touchpad
from tacshade_edge.demo.broker import broker_command
from tacshade_edge.demo.child import Child, free_port, wait_for_port
from tacshade_edge.demo.sensor import make_calibration
from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.version import how_to_install

FPS: Final = 20  # a laptop draws a simulated frame in 10 to 40 ms, rarely in up to 170
PORT: Final = 8080
START_S: Final = 30.0
CHECK_PERIOD_S: Final = 0.5
ANY: Final = ("0.0.0.0", "::")
ELSEWHERE: Final = ("192.0.2.1", 9)  # an address reserved for documentation (RFC 5737)
STOP_SIGNALS: Final = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)

_SETTINGS = """\
sensor_id: demo
calibration: calibration.npz
source: {{kind: simulated, fps: {fps}}}
recorder: {{folder: recordings}}
mqtt: {{host: 127.0.0.1, port: {port}}}
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add = parser.add_argument
    add(
        "--http",
        type=int,
        metavar="PORT",
        help=f"port to serve the page on (default: {PORT}, or any free port if {PORT} is in use)",
    )
    add(
        "--listen",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="address to listen on, such as 0.0.0.0 (default: 127.0.0.1, this machine only)",
    )
    add(
        "--hand",
        action="store_true",
        help="instead of two separate sensors, show a five-fingered hand that holds a bottle",
    )
    add("--seconds", type=float, default=math.inf, metavar="N", help="stop after N seconds")


def run(args: argparse.Namespace) -> int:
    """Run until Ctrl-C, SIGTERM, SIGHUP (the terminal closes), or for ``--seconds``."""
    if importlib.util.find_spec("websockets") is None:  # the page needs it; check before a minute of work
        raise ConfigError(f"demo: the package websockets is not installed; to install it: {how_to_install('demo')}")
    asked = threading.Event()

    def stop(*_: object) -> None:
        """Interrupt the current work and stop the children; a second Ctrl-C does not interrupt that."""
        for number in STOP_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        asked.set()
        raise KeyboardInterrupt

    def end_if_asked() -> None:
        """Raise the interrupt again if it was lost, as it is when raised in a destructor or a library's callback."""
        if asked.is_set():
            raise KeyboardInterrupt

    for number in STOP_SIGNALS:
        signal.signal(number, stop)
    me = [sys.executable, "-m", "tacshade_edge"]
    host = args.listen
    http = _free(host, PORT) if args.http is None else args.http
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
        page = [*me, "dashboard", "--broker", f"127.0.0.1:{mqtt}", "--http", str(http), "--host", host]
        page += ["--recordings", str(folder / "recordings")]
        login = ""
        if not is_loopback(host):
            # The sensor is simulated, so anyone with the address may control it.
            token_file = folder / "token"
            login = f"login#{make_token(token_file)}"
            page += ["--token-file", str(token_file), "--allow-control"]
        dashboard = start("dashboard", page)
        print("Calibrating a simulated sensor on simulated ball presses ...", flush=True)
        calibration_file.save(folder / "calibration.npz", make_calibration())
        end_if_asked()
        if args.hand:
            settings = demo_hand.write(folder, mqtt)
        else:
            settings = folder / "settings.yaml"
            settings.write_text(_SETTINGS.format(fps=FPS, port=mqtt), encoding="utf-8")
        end_if_asked()
        wait_for_port(broker, mqtt, START_S)
        start("daemon", [*me, "run", "--config", str(settings)])
        names = addresses(host)
        wait_for_port(dashboard, http, START_S, "127.0.0.1" if host in ANY else host)
        page_of = login or (f"#hand/{demo_hand.HAND_ID}" if args.hand else "")
        shown = " or ".join(f"http://{f'[{name}]' if ':' in name else name}:{http}/{page_of}" for name in names)
        what = (
            "Five simulated fingers hold a bottle"
            if args.hand
            else "A simulated sensor presses and drags objects; soon a second one stitches a map"
        )
        print(f"{what}: open {shown}", flush=True)
        if login:
            print("No encryption: others on the network can read the address and the page.", flush=True)
        print(f"Other programs can listen to the broker 127.0.0.1:{mqtt}.", flush=True)
        print("Press Ctrl-C to stop.", flush=True)
        other: Generator[None, None, None]
        if args.hand:
            other = demo_hand.play(folder)
        else:
            other = touchpad.hand(folder, mqtt, lambda config: start("map", [*me, "run", "--config", str(config)]))
        stack.callback(other.close)
        period_s = demo_hand.STEP_S if args.hand else CHECK_PERIOD_S
        deadline_s = time.monotonic() + args.seconds
        while (left_s := deadline_s - time.monotonic()) > 0:
            time.sleep(min(period_s, left_s))
            end_if_asked()
            for child in children:
                child.check()
            next(other)
    return 0


def addresses(host: str) -> tuple[str, ...]:
    """Return the hosts under which to open the page: `host`, or for a wildcard this machine's address and name."""
    if host not in ANY:
        return (host,)
    with socket.socket(type=socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.connect(ELSEWHERE)  # sends nothing, only looks up the route
        return probe.getsockname()[0], socket.gethostname()
    return (socket.gethostname(),)


def _free(host: str, port: int) -> int:
    """Return the port itself, or another free one if it is taken."""
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return free_port()
    return port
