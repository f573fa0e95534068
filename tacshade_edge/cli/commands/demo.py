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
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli.commands.dashboard import ANY, in_url, is_loopback, make_token
from tacshade_edge.cli.shared.options import PORT, add_flag, add_option, need, sensor_id
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.lab.demo import demo_hand, touchpad
from tacshade_edge.lab.demo.child import Child, broker_command, free_port, wait_for_port
from tacshade_edge.lab.demo.demo_hand import make_calibration

# A laptop draws a simulated frame in 10 to 40 ms, rarely in up to 170.
FPS: Final = 20
HTTP: Final = 8080
START_S: Final = 30.0
CHECK_PERIOD_S: Final = 0.5
STOP_SIGNALS: Final = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)

_ME: Final = (sys.executable, "-m", "tacshade_edge")
_TOKEN: Final = "token"
_SENSOR_ID: Final = "demo"

_SETTINGS = """\
sensor_id: {sensor_id}
calibration: calibration.npz
source: {{kind: simulated, fps: {fps}}}
recorder: {{folder: recordings}}
mqtt: {{host: 127.0.0.1, port: {port}, home_assistant: {announced}}}
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    text = f"port to serve the page on (default: {HTTP}, or any free port if {HTTP} is in use)"
    add_option(parser, "--http", "PORT", text, PORT)
    text = "address to listen on (default: this machine only)"
    add_option(parser, "--listen", "ADDRESS", text, str, default="127.0.0.1")
    text = "port of the demo's broker on this machine (default: any free one)"
    add_option(parser, "--port", "PORT", text, PORT, default=0)
    add_flag(parser, "--home-assistant", "announce the sensors to Home Assistant at this broker")
    # A hand's sensors have its fingers' names.
    one = parser.add_mutually_exclusive_group()
    text = f"the simulated sensor's name (default: {_SENSOR_ID})"
    add_option(one, "--sensor", "ID", text, sensor_id, default=_SENSOR_ID)
    add_flag(one, "--hand", "show a five-fingered hand that holds a bottle")
    add_option(parser, "--seconds", "N", "stop after N seconds", float, default=math.inf)


def run(args: argparse.Namespace) -> int:
    """Run until Ctrl-C, SIGTERM, SIGHUP (the terminal closes), or for ``--seconds``."""
    # The page needs it; said before a minute of work.
    need("demo", "demo", "websockets")
    if args.sensor == touchpad.SENSOR_ID:
        found = "found the name of the demo's other sensor, expected another"
        raise ConfigError(f"--sensor {args.sensor}: {found}")
    interrupt = _Interrupt()
    mqtt = _broker_port(args.port)
    http = _free(args.listen, HTTP) if args.http is None else args.http
    with suppress(KeyboardInterrupt), ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="tacshade-demo-")))
        (folder / "recordings").mkdir()
        children = _Children(folder, stack)
        # A broker of its own: whoever has one already must not find strange sensors there.
        broker = children.start("broker", broker_command(folder, mqtt))
        token = None if is_loopback(args.listen) else make_token(folder / _TOKEN)
        page = _page_command(args.listen, http, mqtt, folder)
        dashboard = children.start("dashboard", [*_ME, *page])
        print("Calibrating a simulated sensor on simulated ball presses ...", flush=True)
        calibration_file.save(folder / "calibration.npz", make_calibration())
        interrupt.check()
        settings = _write_settings(args, folder, mqtt)
        interrupt.check()
        # A daemon that finds no broker waits for a second before it tries again.
        wait_for_port(broker, mqtt, START_S)
        children.start("daemon", [*_ME, "run", "--config", str(settings)])
        local = "127.0.0.1" if args.listen in ANY else args.listen
        wait_for_port(dashboard, http, START_S, local)
        _say_where(args, http, mqtt, token)
        _play(args, children, interrupt, mqtt)
    return 0


class _Interrupt:
    """Turns the signals that end the demo into one KeyboardInterrupt."""

    def __init__(self) -> None:
        self._is_asked = False
        for number in STOP_SIGNALS:
            signal.signal(number, self._stop)

    def check(self) -> None:
        """Raise the interrupt again if it was lost, as it is when raised in a destructor
        or a library's callback.
        """
        if self._is_asked:
            raise KeyboardInterrupt

    def _stop(self, *_: object) -> None:
        # A second Ctrl-C must not interrupt the stopping of the children, which would then stay.
        for number in STOP_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        self._is_asked = True
        raise KeyboardInterrupt


class _Children:
    """The processes of the demo; the last started is stopped first."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder = folder
        self.stack = stack
        self._all: list[Child] = []

    def start(self, name: str, command: list[str]) -> Child:
        child = Child(name, command, self.folder)
        self.stack.callback(child.stop)
        self._all.append(child)
        return child

    def check(self) -> None:
        """Raise DeviceError if one has ended by itself."""
        for child in self._all:
            child.check()


def _page_command(host: str, http: int, mqtt: int, folder: Path) -> list[str]:
    broker, recordings = f"127.0.0.1:{mqtt}", str(folder / "recordings")
    page = ["dashboard", "--broker", broker, "--http", str(http), "--host", host]
    page += ["--recordings", recordings]
    if not is_loopback(host):
        # The sensor is simulated, so anyone with the address may control it.
        page += ["--token-file", str(folder / _TOKEN), "--allow-control"]
    return page


def _write_settings(args: argparse.Namespace, folder: Path, mqtt: int) -> Path:
    if args.hand:
        return demo_hand.write(folder, mqtt, home_assistant=args.home_assistant)
    path = folder / "settings.yaml"
    announced = str(args.home_assistant).lower()
    text = _SETTINGS.format(sensor_id=args.sensor, fps=FPS, port=mqtt, announced=announced)
    path.write_text(text, encoding="utf-8")
    return path


def _say_where(args: argparse.Namespace, http: int, mqtt: int, token: str | None) -> None:
    """Print the address to open, with the token if the page needs one."""
    what = "A simulated sensor presses and drags objects; soon a second one stitches a map"
    path = ""
    if args.hand:
        what = "Five simulated fingers hold a bottle, which soon moves"
        path = f"#hand/{demo_hand.HAND_ID}"
    if token is not None:
        path = f"login#{token}"
    name = socket.gethostname() if args.listen in ANY else args.listen
    print(f"{what}: open http://{in_url(name)}:{http}/{path}", flush=True)
    if token is not None:
        print("No encryption: others on the network can read the address and the page.", flush=True)
    print(
        f"Other programs can listen to the broker 127.0.0.1:{mqtt}.\nPress Ctrl-C to stop.",
        flush=True,
    )


def _play(args: argparse.Namespace, children: _Children, interrupt: _Interrupt, mqtt: int) -> None:
    """Move the hand or stitch the map, step by step, until the time is over."""
    if args.hand:
        other, period_s = demo_hand.play(children.folder), demo_hand.STEP_S
    else:
        other = touchpad.hand(
            children.folder,
            mqtt,
            lambda config: children.start("map", [*_ME, "run", "--config", str(config)]),
        )
        period_s = CHECK_PERIOD_S
    children.stack.callback(other.close)
    deadline_s = time.monotonic() + args.seconds
    while (left_s := deadline_s - time.monotonic()) > 0:
        time.sleep(min(period_s, left_s))
        interrupt.check()
        children.check()
        next(other)


def _broker_port(asked: int) -> int:
    """Return the port for the demo's broker; 0 asks for any. Raises DeviceError if it is in use."""
    if asked == 0:
        return free_port()
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(("127.0.0.1", asked))
    except OSError as error:
        raise DeviceError(
            f"--port {asked}: {error.strerror}, expected a port that no other broker uses"
        ) from None
    return asked


def _free(host: str, port: int) -> int:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        # As the dashboard does: a port whose last connections time out is free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return free_port()
    return port
