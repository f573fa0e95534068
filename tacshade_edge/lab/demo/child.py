"""A process that a command starts: its output goes to a file, and it never outlives the command."""

from __future__ import annotations

import ctypes
import importlib.util
import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from tacshade_edge.errors import DeviceError
from tacshade_edge.version import how_to_install

_PR_SET_PDEATHSIG: Final = 1
_POLL_S: Final = 0.02
_STOP_S: Final = 3.0


def free_port() -> int:
    with socket.socket() as probe:
        # The port is free only until somebody else takes it; the child then fails, and the demo
        # says so.
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Child:
    """A process with a log file in `folder`, in its own session:
    Ctrl-C reaches only the command `of`, which stops it.

    On Linux, the kernel sends it SIGTERM if the command dies in any other way.
    """

    def __init__(
        self, name: str, command: Sequence[str], folder: Path, *, of: str = "demo"
    ) -> None:
        self.name, self.of = name, of
        self._log = folder / f"{name}.log"
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                # The kernel keeps this promise even if the demo is killed, which no handler
                # survives.
                preexec_fn=_die_with_parent if sys.platform == "linux" else None,
            )

    @property
    def output(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace")

    def check(self) -> None:
        """Raise DeviceError, with the last line of output, if the process has ended."""
        code = self._process.poll()
        if code is not None:
            lines = [line for line in self.output.splitlines() if line.strip()]
            raise DeviceError(
                f"{self.of}: the {self.name} exited with status {code}: "
                f"{lines[-1] if lines else 'no output'}"
            )

    def stop(self) -> None:
        """Stop the process with SIGTERM, or with SIGKILL after 3 s."""
        self._process.terminate()
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def wait_for_port(child: Child, port: int, timeout_s: float, host: str = "127.0.0.1") -> None:
    """Wait until a process accepts connections on this port.

    Raises DeviceError if it ends, or after `timeout_s`.
    """
    deadline_s = time.monotonic() + timeout_s
    while True:
        child.check()
        with suppress(OSError), socket.create_connection((host, port), timeout=timeout_s):
            return
        if time.monotonic() > deadline_s:
            raise DeviceError(
                f"{child.of}: the {child.name} did not listen on port {port} "
                f"within {timeout_s:.0f} s"
            )
        time.sleep(_POLL_S)


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


_SBIN = "/usr/sbin"  # Debian's mosquitto, which is not on every user's PATH

# The broker keeps two segments of messages for each topic:
# enough for the newest full-size maps, not for a history.
_EMBEDDED = """\
id = 0
[router]
id = 0
max_connections = 64
max_outgoing_packet_count = 200
max_segment_size = 8388608
max_segment_count = 2
[v5.1]
name = "demo"
listen = "127.0.0.1:{port}"
next_connection_delay_ms = 1
[v5.1.connections]
connection_timeout_ms = 5000
max_payload_size = 4194304
max_inflight_count = 100
"""
# As systemd/mosquitto-tacshade.conf: a page that stalls may not fill the memory with maps.
_MOSQUITTO = """\
listener {port} 127.0.0.1
allow_anonymous true
persistence false
max_queued_messages 20
set_tcp_nodelay true
"""


def broker_command(folder: Path, port: int) -> list[str]:
    """Write a broker's settings and return the command that serves MQTT 5 on this loopback port.

    Raises DeviceError.
    """
    # mosquitto first: it is what boards run, and it needs no extra.
    mosquitto = shutil.which("mosquitto", path=f"{os.environ.get('PATH', os.defpath)}:{_SBIN}")
    settings = folder / ("mosquitto.conf" if mosquitto else "broker.toml")
    text = (_MOSQUITTO if mosquitto else _EMBEDDED).format(port=port)
    if mosquitto and os.getuid() == 0:
        # A change of user would clear the promise of the kernel to stop it with us.
        text += "user root\n"
    settings.write_text(text, encoding="utf-8")
    if mosquitto:
        return [mosquitto, "-c", str(settings)]
    if importlib.util.find_spec("iotcore") is None:
        expected = f"expected mosquitto or the `demo` extra's broker: {how_to_install('demo')}"
        raise DeviceError(f"found no broker, {expected}")
    return [sys.executable, "-m", __name__, str(settings)]


if __name__ == "__main__":
    from iotcore import Broker

    # rumqttd logs a span of level ERROR for every message.
    logging.getLogger("rumqttd").setLevel(logging.CRITICAL)
    Broker(config_path=sys.argv[1]).run_forever()
