"""The mosquitto drop-in and its ACL as shipped, in a real mosquitto:
who may do what, and how much it holds.
"""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import pytest
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from support.mqtt_rig import MOSQUITTO, free_port
from support.painted_sensor import TOUCHED, painted_calibration
from support.patience import patience, wait_until
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.wire.topics import decode_hand

FILES = Path(__file__).parents[2] / "systemd"
SENSOR, OTHER, DASHBOARD = "thumb", "foot", "dashboard"
PAYLOAD = bytes(38_000)
BURST = 1000  # of PAYLOAD: 38 MB

pytestmark = pytest.mark.broker


@dataclass(frozen=True, slots=True)
class Served:
    """A running broker."""

    port: int
    ca: Path | None
    pid: int


@contextmanager
def mosquitto(folder: Path, text: str, port: int, ca: Path | None) -> Iterator[Served]:
    path = folder / "mosquitto.conf"
    path.write_text(f"user root\n{text}\n")
    with (folder / "mosquitto.log").open("w") as log:
        process = subprocess.Popen([str(MOSQUITTO), "-c", str(path)], stderr=log)
    try:
        wait_until(
            lambda: "running" in (folder / "mosquitto.log").read_text(), 10, "mosquitto runs"
        )
        yield Served(port, ca, process.pid)
    finally:
        process.terminate()
        process.wait(patience(10))
    assert "Error" not in (folder / "mosquitto.log").read_text()


@pytest.fixture
def as_shipped(tmp_path: Path) -> Iterator[Served]:
    """For this machine only, without passwords."""
    port = free_port()
    text = f"port {port}\nallow_anonymous true\n{(FILES / 'mosquitto-tacshade.conf').read_text()}"
    with mosquitto(tmp_path, text, port, None) as served:
        yield served


@pytest.fixture(scope="module")
def filled_in(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """As its comments state, to serve other machines: TLS, passwords, ACL."""
    folder, port = tmp_path_factory.mktemp("filled_in"), free_port()
    key, certificate, passwords = folder / "server.key", folder / "server.crt", folder / "passwd"
    options = (
        "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=localhost"
    )
    names = [
        "-addext",
        "subjectAltName=IP:127.0.0.1",
        "-keyout",
        str(key),
        "-out",
        str(certificate),
    ]
    subprocess.run(["openssl", *options.split(), *names], check=True, capture_output=True)
    passwords.touch(0o600)
    for user in (SENSOR, OTHER, DASHBOARD):
        subprocess.run(
            ["mosquitto_passwd", "-b", passwords, user, f"word of {user}"],
            check=True,
            capture_output=True,
        )
    text = (FILES / "mosquitto-tacshade.conf").read_text().replace("#: ", "")
    for old, new in (
        ("/etc/mosquitto/tacshade.passwd", passwords),
        ("/etc/mosquitto/tacshade.acl", FILES / "mosquitto-tacshade.acl"),
        ("/etc/mosquitto/certs/server.crt", certificate),
        ("/etc/mosquitto/certs/server.key", key),
        ("listener 8883", f"listener {port}"),
    ):
        assert old in text
        text = text.replace(old, str(new))
    with mosquitto(folder, text, port, certificate) as served:
        yield served


class User:
    """One MQTT 5 connection; what it received and sent."""

    def __init__(self, served: Served, name: str | None, password: str | None = None) -> None:
        self.connected: list[str] = []
        self.acknowledged: dict[int, str] = {}
        self.messages: list[MQTTMessage] = []
        self._subscribed = threading.Event()
        self.client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        if served.ca is not None:
            self.client.tls_set(str(served.ca))
        if name is not None:
            self.client.username_pw_set(name, password or f"word of {name}")
        self.client.on_connect = lambda _c, _d, _f, reason, _p: self.connected.append(str(reason))
        self.client.on_publish = lambda _c, _d, mid, reason, _p: self.acknowledged.update(
            {mid: str(reason)}
        )
        self.client.on_subscribe = lambda *_: self._subscribed.set()
        self.client.on_message = lambda _c, _d, message: self.messages.append(message)
        self.client.connect("127.0.0.1", served.port)
        self.client.loop_start()
        wait_until(lambda: self.connected, 10, "an answer to CONNECT")

    def __enter__(self) -> User:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.disconnect()
        self.client.loop_stop()

    def subscribe(self, topics: str) -> None:
        self.client.subscribe(topics, qos=1)
        assert self._subscribed.wait(patience(10))

    def publish(self, topic: str) -> str:
        """The broker's verdict."""
        mid = self.client.publish(topic, b"{}", qos=1).mid
        wait_until(lambda: mid in self.acknowledged, 10, "an answer to PUBLISH")
        return self.acknowledged[mid]

    def topics(self) -> set[str]:
        return {message.topic for message in list(self.messages)}


@pytest.mark.parametrize(
    ("user", "password"),
    [(None, None), (SENSOR, "wrong"), (DASHBOARD, f"word of {SENSOR}"), ("somebody", None)],
)
def test_strangers_are_refused(filled_in: Served, user: str | None, password: str | None) -> None:
    with User(filled_in, user, password) as somebody:
        assert somebody.connected == ["Not authorized"]


@pytest.mark.parametrize(
    ("user", "topic", "may"),
    [
        (SENSOR, f"tacshade/{SENSOR}/state", True),
        (SENSOR, f"tacshade/{SENSOR}/status/camera", True),
        (SENSOR, f"tacshade/{SENSOR}/res/status", True),
        (SENSOR, f"tacshade/{OTHER}/state", False),
        (SENSOR, f"tacshade/{OTHER}/req/reference", False),
        (SENSOR, "tacshade", False),
        (OTHER, f"tacshade/hand/{OTHER}/objects", True),
        (OTHER, "tacshade/hand/palm/objects", False),
        (DASHBOARD, f"tacshade/hand/{OTHER}/objects", False),
        (SENSOR, "home/door", False),
        (DASHBOARD, f"tacshade/{SENSOR}/req/status", True),
        (DASHBOARD, f"tacshade/{OTHER}/req/record/start", True),
        (DASHBOARD, f"tacshade/{SENSOR}/state", False),
        (DASHBOARD, f"tacshade/{SENSOR}/height", False),
        (DASHBOARD, f"tacshade/{SENSOR}/res/status", False),
        (DASHBOARD, "home/door", False),
    ],
)
def test_what_each_may_publish(filled_in: Served, user: str, topic: str, may: bool) -> None:
    with User(filled_in, user) as somebody:
        said = somebody.publish(topic)
    assert said in ({"Success", "No matching subscribers"} if may else {"Not authorized"})


def test_what_each_may_see(filled_in: Served) -> None:
    """A subscription to everything shows what is allowed."""
    with (
        User(filled_in, SENSOR) as sensor,
        User(filled_in, OTHER) as other,
        User(filled_in, DASHBOARD) as dashboard,
    ):
        for user in (other, dashboard):
            user.subscribe("#")
        sensor.publish(f"tacshade/{SENSOR}/state")
        dashboard.publish(f"tacshade/{SENSOR}/req/status")
        dashboard.publish(f"tacshade/{OTHER}/req/status")
        mine = {f"tacshade/{OTHER}/req/status"}
        wait_until(
            lambda: mine <= other.topics() and mine <= dashboard.topics(), 10, "the last message"
        )
        assert other.topics() == mine
        assert dashboard.topics() == mine | {
            f"tacshade/{SENSOR}/{topic}" for topic in ("state", "req/status")
        }


def test_a_hand_its_fingers_and_a_dashboard_work_together(
    filled_in: Served, tmp_path: Path
) -> None:
    """Each part of the real daemon logs in as itself;
    the dashboard sees both fingers and gets answers.
    """
    cv2.imwrite(str(tmp_path / "touched.png"), TOUCHED)
    for user in (SENSOR, OTHER):
        calibration_file.save(tmp_path / f"{user}.npz", painted_calibration())
        (tmp_path / f"{user}.password").write_text(f"word of {user}\n")

    def login(user: str) -> str:
        return f"username: {user}, password_file: {user}.password"

    fingers = [
        (
            f"  {name}: {{calibration: {name}.npz, source: {{kind: files, path: {path}, fps: 20, "
            f"loop: true}}, mqtt: {{{login(name)}}}, hand_T_sensor: [0, 0, 0, 1, 0, 0, 0]}}"
        )
        for name, path in ((SENSOR, "touched.png"), (OTHER, "./touched.png"))
    ]
    config = tmp_path / "config.yaml"
    mqtt = f"host: 127.0.0.1, port: {filled_in.port}, {login(OTHER)}, ca_file: {filled_in.ca}"
    common = f"hand_id: {OTHER}\nmqtt: {{{mqtt}}}"
    config.write_text("\n".join([common, "sensors:", *fingers]) + "\n")
    topic = f"tacshade/hand/{OTHER}/objects"
    with User(filled_in, DASHBOARD) as dashboard:
        dashboard.subscribe("tacshade/#")
        command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(config)]
        daemon = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:

            def both() -> bool:
                last = [m for m in list(dashboard.messages) if m.topic == topic][-1:]
                return any(
                    {f.state for f in decode_hand(m.payload).fingers.values()} == {"contact"}
                    for m in last
                )

            wait_until(both, 30, "the hand reports both fingers")
            wait_until(
                lambda: f"tacshade/{SENSOR}/state" in dashboard.topics(),
                30,
                "the finger hears requests",
            )
            assert dashboard.publish(f"tacshade/{SENSOR}/req/status") == "Success"
            wait_until(
                lambda: f"tacshade/{SENSOR}/res/status" in dashboard.topics(), 10, "an answer"
            )
        finally:
            daemon.terminate()
            _, errors = daemon.communicate(timeout=patience(20))
        assert daemon.returncode == 0, errors
        assert "refuses" not in errors


def resident_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    (resident_kb,) = re.findall(r"^VmRSS:\s+(\d+) kB$", status, re.MULTILINE)
    return int(resident_kb) / 1024


def test_a_subscriber_that_takes_nothing_costs_the_broker_little(as_shipped: Served) -> None:
    with User(as_shipped, None) as stalled, User(as_shipped, None) as publisher:
        stalled.subscribe(f"tacshade/{SENSOR}/height")
        stalled.client.loop_stop()  # connected, and reads no more
        before_mb = resident_mb(as_shipped.pid)
        last = 0
        for _ in range(BURST):
            last = publisher.client.publish(f"tacshade/{SENSOR}/height", PAYLOAD, qos=1).mid
        wait_until(lambda: last in publisher.acknowledged, 30, "the broker took all")
        assert len(publisher.acknowledged) == BURST
        assert resident_mb(as_shipped.pid) - before_mb < BURST * len(PAYLOAD) / 2**20 / 4
