"""Boards' brokers that send to a central one over TLS, with the files of ``config/fleet``,
on loopback.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from support.mqtt_rig import Broker, free_port
from support.patience import wait_until

FILES = Path(__file__).parents[1] / "config" / "fleet"
USER, WORD = "dashboard", "seen"


class ConfiguredBroker(Broker):
    """A mosquitto with a complete configuration; `port` is one of its listeners."""

    def __init__(self, config: Path, port: int, text: str) -> None:
        self.port = port
        self._config = config
        self._process = None
        config.write_text(text + ("user root\n" if os.getuid() == 0 else ""))

    @property
    def pid(self) -> int:
        """The id of its process."""
        assert self._process is not None
        return self._process.pid


def certify(folder: Path, stem: str, name: str, *words: str) -> None:
    """Write ``STEM.pem`` and ``STEM.key`` for a common name, as docs/how-to/many-boards.md says."""
    options = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2"
    command = [
        "openssl",
        *options.split(),
        "-subj",
        f"/CN={name}",
        "-keyout",
        f"{stem}.key",
        "-out",
        f"{stem}.pem",
    ]
    subprocess.run([*command, *words], cwd=folder, check=True, capture_output=True)


def central(folder: Path) -> ConfiguredBroker:
    """The central broker; boards connect to `port`,
    the user `USER` to the port of `people_port`.
    """
    certify(folder, "ca", "fleet")
    certify(
        folder,
        "central",
        "127.0.0.1",
        "-CA",
        "ca.pem",
        "-CAkey",
        "ca.key",
        "-addext",
        "subjectAltName=IP:127.0.0.1",
    )
    passwords = folder / "passwords"
    passwords.touch(0o600)
    subprocess.run(
        ["mosquitto_passwd", "-b", passwords, USER, WORD], check=True, capture_output=True
    )
    (folder / "central.acl").write_bytes((FILES / "central.acl").read_bytes())
    (folder / "central.acl").chmod(0o600)
    port, people = free_port(), free_port()
    kept = (
        f"persistence true\npersistence_location {folder}/\n"  # as Debian's mosquitto.conf has it
    )
    text = kept + (FILES / "central.conf").read_text().replace("/etc/mosquitto/fleet", str(folder))
    text = text.replace("listener 8883", f"listener {port} 127.0.0.1").replace(
        "listener 8884", f"listener {people} 127.0.0.1"
    )
    return ConfiguredBroker(folder / "central.conf", port, text)


def people_port(folder: Path) -> int:
    """The port on which a folder's central broker requires a password."""
    return int(
        re.findall(r"^listener (\d+)", (folder / "central.conf").read_text(), re.MULTILINE)[1]
    )


def board(folder: Path, name: str, central_port: int) -> ConfiguredBroker:
    """A board's broker, for this machine only, which sends to the central one
    with its own certificate.
    """
    certify(folder, name, name, "-CA", "ca.pem", "-CAkey", "ca.key")
    text = (
        (FILES / "board.conf").read_text().replace("/etc/mosquitto/fleet/board", str(folder / name))
    )
    text = text.replace("/etc/mosquitto/fleet", str(folder)).replace(
        "CENTRAL:8883", f"127.0.0.1:{central_port}"
    )
    port = free_port()
    own = f"max_queued_messages 20\nlistener {port} 127.0.0.1\nallow_anonymous true\n"
    return ConfiguredBroker(folder / f"{name}.conf", port, own + text.replace("BOARD", name))


class CentralClient:
    """A client of the central broker: the user `USER`,
    or a board (`name`) by its certificate from a folder.
    """

    def __init__(
        self,
        folder: Path,
        port: int,
        hear: Callable[[MQTTMessage], None],
        name: str | None = None,
        *topics: str,
    ) -> None:
        # With a session that outlasts a cut: the boards may be back before this client.
        self.client = Client(
            CallbackAPIVersion.VERSION2, client_id=f"fleet-{name or USER}", clean_session=not topics
        )
        files = () if name is None else (str(folder / f"{name}.pem"), str(folder / f"{name}.key"))
        self.client.tls_set(str(folder / "ca.pem"), *files)
        if name is None:
            self.client.username_pw_set(USER, WORD)
        self.client.reconnect_delay_set(1, 1)
        if topics:
            self.client.on_connect = lambda client, *_: client.subscribe(
                [(topic, 1) for topic in topics]
            )
        self.client.on_message = lambda _client, _data, message: hear(message)
        self.client.connect_async("127.0.0.1", port, keepalive=10)

    def __enter__(self) -> Client:
        self.client.loop_start()
        wait_until(self.client.is_connected, 10, "a connection to the central broker")
        return self.client

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.client.disconnect()
        self.client.loop_stop()
