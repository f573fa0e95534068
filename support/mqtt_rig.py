"""A real mosquitto on a free loopback port, and a subscriber that records messages."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.properties import Properties

from support.patience import patience, wait_until


def certificate(folder: Path) -> tuple[Path, Path]:
    """Write ``cert.pem`` and ``key.pem`` as in docs/how-to/opening.md; return their paths."""
    cert, key = folder / "cert.pem", folder / "key.pem"
    options = (
        "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=localhost"
    )
    names = ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(cert)]
    subprocess.run(["openssl", *options.split(), *names], check=True, capture_output=True)
    return cert, key


MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Broker:
    """A mosquitto with its own configuration; starts on request and always on the same port.

    Small messages go out at once, as with ``systemd/mosquitto-tacshade.conf``: otherwise each waits
    up to 40 ms for the subscriber's acknowledgement of the previous one.
    """

    def __init__(
        self,
        folder: Path,
        *,
        users: dict[str, str] | None = None,
        tls: bool = False,
        more: tuple[str, ...] = (),
    ) -> None:
        assert MOSQUITTO is not None
        self.port = free_port()
        self._config = folder / "mosquitto.conf"
        self._process: subprocess.Popen[bytes] | None = None
        lines = [f"listener {self.port} 127.0.0.1", "persistence false", "set_tcp_nodelay true"]
        lines += ["max_queued_messages 20", *more]
        if tls:
            self.ca, key = certificate(folder)
            lines += [f"certfile {self.ca}", f"keyfile {key}"]
        if os.getuid() == 0:
            lines.append("user root")
        if users is None:
            lines.append("allow_anonymous true")
        else:
            passwords = folder / "passwords"
            passwords.touch(0o600)
            for name, word in users.items():
                subprocess.run(
                    ["mosquitto_passwd", "-b", passwords, name, word],
                    check=True,
                    capture_output=True,
                )
            lines += ["allow_anonymous false", f"password_file {passwords}"]
        self._config.write_text("\n".join(lines) + "\n")

    @property
    def pid(self) -> int:
        """The id of the running process."""
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        assert MOSQUITTO is not None
        self._process = subprocess.Popen(
            [MOSQUITTO, "-c", self._config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        wait_until(self._accepts, 10, "mosquitto accepts connections")

    def stop(self) -> None:
        if self._process is not None:
            self._process.send_signal(signal.SIGCONT)
            self._process.terminate()
            self._process.wait(patience(10))
            self._process = None

    def kill(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait(patience(10))
        self._process = None

    def stall(self) -> None:
        """Suspend mosquitto: the kernel still accepts connections and bytes,
        but mosquitto does nothing.
        """
        self._signal(signal.SIGSTOP)

    def resume(self) -> None:
        self._signal(signal.SIGCONT)

    def _signal(self, number: signal.Signals) -> None:
        assert self._process is not None
        self._process.send_signal(number)

    def _accepts(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, "mosquitto ended"
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()


class Subscriber:
    """A subscriber, by default with MQTT 3.1.1; it keeps every message in order and reconnects
    by itself.

    With `page`, it connects as a browser does: over WebSocket, through the dashboard's port.
    """

    def __init__(
        self, port: int, topics: str = "#", *, v5: bool = False, page: bool = False
    ) -> None:
        self.messages: list[MQTTMessage] = []
        self._subscribed = threading.Event()
        protocol = MQTTProtocolVersion.MQTTv5 if v5 or page else MQTTProtocolVersion.MQTTv311
        transport: Literal["websockets", "tcp"] = "websockets" if page else "tcp"
        self.client = Client(CallbackAPIVersion.VERSION2, protocol=protocol, transport=transport)
        if page:  # paho's own origin says https
            own = {"Origin": f"http://127.0.0.1:{port}"}
            self.client.ws_set_options(path="/mqtt", headers=lambda defaults: {**defaults, **own})
        self.client.reconnect_delay_set(1, 1)
        self.client.on_connect = lambda client, *_: client.subscribe(topics, qos=1)
        # Without `self`: in a cycle, the collector can reach the client's sockets
        # before the client closes them.
        messages, subscribed = self.messages, self._subscribed
        self.client.on_subscribe = lambda *_: subscribed.set()
        self.client.on_message = lambda _client, _data, message: messages.append(message)
        self.client.connect_async("127.0.0.1", port, keepalive=5)

    def __enter__(self) -> Subscriber:
        self.client.loop_start()
        assert self._subscribed.wait(patience(10))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.client.disconnect()
        self.client.loop_stop()

    def publish(
        self,
        topic: str,
        payload: bytes,
        qos: int = 1,
        properties: Properties | None = None,
        **other: Any,
    ) -> None:
        self.client.publish(topic, payload, qos, properties=properties, **other)

    def of(self, topic: str) -> list[bytes]:
        return [bytes(m.payload) for m in list(self.messages) if m.topic == topic]

    def wait_for(self, topic: str, count: int = 1, timeout_s: float = 5) -> list[bytes]:
        wait_until(
            lambda: len(self.of(topic)) >= count,
            timeout_s,
            f"{count} x {topic}, got {len(self.of(topic))}",
        )
        return self.of(topic)

    def wait_for_last(self, topic: str, payload: bytes, timeout_s: float = 5) -> None:
        """Wait until a topic's latest payload is this one."""
        try:
            wait_until(
                lambda: self.of(topic)[-1:] == [payload], timeout_s, f"{payload!r} last of {topic}"
            )
        except AssertionError as error:
            error.add_note(f"received: {self.of(topic)}")
            raise


class BridgeProcess:
    """``tacshade-edge bridge KIND`` for a broker on this machine, on a free port,
    at the `url` that it prints.
    """

    def __init__(self, kind: str, broker_port: int, log: Path, *words: str) -> None:
        self._command = [
            sys.executable,
            "-m",
            "tacshade_edge",
            "bridge",
            kind,
            "--listen",
            "127.0.0.1:0",
        ]
        self._command += ["--broker", f"127.0.0.1:{broker_port}", *words]
        self._log = log

    def __enter__(self) -> BridgeProcess:
        with self._log.open("w") as stream:
            self.process = subprocess.Popen(
                self._command, stdout=subprocess.PIPE, stderr=stream, text=True
            )
        assert self.process.stdout is not None
        found = re.search(r"\w+://\S+", self.process.stdout.readline())
        assert found, self.log()
        self.url = found[0]
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.process.kill()
        self.process.communicate()

    @property
    def port(self) -> int:
        """The port that it listens on."""
        found = re.search(r":(\d+)", self.url)
        assert found
        return int(found[1])

    def log(self) -> str:
        return self._log.read_text(errors="replace")

    def page(self) -> str:
        """The page that Prometheus gets. Raises OSError if there is no answer."""
        with urllib.request.urlopen(self.url, timeout=patience(10)) as answer:
            text: str = answer.read().decode()
            return text

    def peak_mb(self) -> float:
        """Its peak memory in MB."""
        return self._status("VmHWM") / 1024

    def threads(self) -> int:
        return self._status("Threads")

    def stopped_s(self) -> float:
        """Send SIGTERM; return the seconds until it ends."""
        began_s = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(patience(30))
        assert code == 0, f"exit {code}: {self.log()}"
        return time.monotonic() - began_s

    def _status(self, name: str) -> int:
        found = re.search(rf"{name}:\s+(\d+)", Path(f"/proc/{self.process.pid}/status").read_text())
        assert found
        return int(found[1])
