"""Send arbitrary requests and serial lines to the real daemon in this process: where do its files and messages go?

Requests enter where paho delivers them (`MqttLink._on_message`), or through a real broker; lines enter through a pty.
A Python audit hook sees every file that the daemon opens for writing; a subscriber to everything sees its messages.
"""

from __future__ import annotations

import json
import os
import pty
import random
import re
import select
import sys
import threading
import time
import tty
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from paho.mqtt.client import MQTTMessage
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from tacshade_edge.daemon.app import App
from tacshade_edge.factories import calibrations, sources
from tacshade_edge.protocol.serial import cobs
from tacshade_edge.protocol.serial.line import seal
from tacshade_edge.settings import load
from tacshade_edge.storage.calibration import calibration_file
from tools.faults.rig import write_posed_images
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.painted_sensor import painted_calibration
from tools.testbed.patience import wait_until

SENSOR_ID = "finger"
BASE = f"tacshade/{SENSOR_ID}"
MEANT = re.compile(
    rf"{BASE}/(state|info|instance|health|status/(camera|serial|recorder|stitching|rival)|height|cloud|shear|sigma|touch"
    r"|contact|preview|event/slip|map/(revision|final|cloud)|res/[^+#\x00-\x1f\x7f]+)"
)
LOOKED_AT = tuple(f"{BASE}/{part}" for part in ("contact", "health", "res/status"))
_FILE_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")
BLOCK = 500
"""Number of lines sent before the serial line changes its mode."""

_NAMES = (
    *("a", "pad-1", "../../etc/x", "..", ".", "/tmp/x", "a/b", "a\\b", "a\x00b", "x" * 64, "x" * 65, "x" * 5000, "-"),
    *(".hidden", "a\nINFO forged", "\x1b[2J", "é", "con", "~", "$HOME", "%s%n", "", " ", "a b", "*", "COM1:"),
)
_VERBS = (
    *("status", "profile", "record", "stitch", "reference"),
    *("statu", "STATUS", "state", "res", "height", "x" * 300, "\x1b[31m", "a b", "ä", "$SYS", "status\n", "..", "%00"),
)
_WHERE = (
    *(f"{BASE}/state", f"{BASE}/res/ok", f"{BASE}/res/a/b", f"{BASE}/res/", f"{BASE}/res", f"{BASE}/req/stitch"),
    *(f"{BASE}/res/../state", f"{BASE}/res/#", f"{BASE}/res/+", f"{BASE}//res/x", f"{BASE}/height", f"/{BASE}/res/x"),
    *("tacshade/other/res/x", "tacshade/other/req/profile", "home/door", "$SYS/x", "#", "+", "", "/", "\x00"),
    *(f"{BASE}x/res/y", f"{BASE.upper()}/res/x", f"{BASE}/res/\u0000x", f"{BASE}/info", f"{BASE}/status/camera"),
)
_VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 1.5, 1e300, 2**53, 2**64, "", "x", "x" * 4000, [], {}, [[[]]], "fast", "auto", "\ud800"),
    *("balanced", "begin", "add", "end", "abort", "status", "start", "stop", 0.01, 86400, 86401, "1", "../x"),
)


class Written:
    """Counts the paths that this process writes or changes while `watch` is on; an audit hook cannot be removed."""

    def __init__(self) -> None:
        self.paths: Counter[str] = Counter()
        self._on = False
        sys.addaudithook(self._hook)

    def watch(self, on: bool) -> None:
        """Begin or end counting."""
        self._on = on

    def _hook(self, event: str, args: tuple[Any, ...]) -> None:
        if not self._on:
            return
        if event == "open":
            path, mode, flags = args
            writes = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
            if isinstance(path, int) or not (flags & writes or set(str(mode or "r")) & set("wax+")):
                return
            self.paths[os.fsdecode(path)] += 1
        elif event in _CHANGES:
            self.paths.update(os.fsdecode(arg) for arg in args if isinstance(arg, str | bytes | os.PathLike))


_CHANGES = ("os.mkdir", "os.remove", "os.rmdir", "os.rename", "os.symlink", "os.link", "os.truncate", "os.chmod")
WRITTEN = Written()


@dataclass(slots=True)
class Came:
    """The results of the run."""

    sent: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)
    topics: Counter[str] = field(default_factory=Counter)
    took_s: float = 0.0


@dataclass(slots=True)
class Bench:
    """A daemon in threads of this process, a broker, a subscriber to everything, and the robot's end of its line."""

    folder: Path
    app: App
    thread: threading.Thread
    broker: Broker
    seen: Subscriber
    master: int
    slave: int
    topics: Counter[str] = field(default_factory=Counter)
    answered: Counter[str] = field(default_factory=Counter)
    """Topics of replies, including those that were dropped because 16 already waited for the broker."""

    @property
    def alive(self) -> bool:
        """Whether the daemon runs."""
        return self.thread.is_alive()


@contextmanager
def bench() -> Iterator[Bench]:
    """Run a daemon on frames with contacts that come to rest, so that sessions take presses."""
    with TemporaryDirectory() as name, Broker(Path(name)) as broker, Subscriber(broker.port, v5=True) as seen:
        topics = Counter[str]()

        def count(_client: object, _data: object, message: MQTTMessage) -> None:
            topics[message.topic] += 1
            if message.topic in LOOKED_AT:
                seen.messages.append(message)

        seen.client.on_message = count
        folder = Path(name) / "daemon"
        folder.mkdir()
        write_posed_images(folder / "images")
        calibration_file.save(folder / "c.npz", painted_calibration())
        master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        path = folder / "settings.yaml"
        path.write_text(
            f"sensor_id: {SENSOR_ID}\nprofile: fast\ncalibration: c.npz\nserial: {{device: {os.ttyname(slave)}}}\n"
            "source: {kind: files, path: images, fps: 60, loop: true}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
            "recorder: {folder: recs}\nstitching: {folder: maps}\n"
        )
        document = load(path)
        app = App(document, sources.make_source(document.settings.source), calibrations.load_calibration(document))
        WRITTEN.paths.clear()
        WRITTEN.watch(True)
        thread = threading.Thread(target=app.run)
        thread.start()
        one = Bench(folder, app, thread, broker, seen, master, slave, topics)
        send_once = app.link._send_once

        def watched(kind: str, topic: str, payload: bytes, correlation: bytes | None) -> None:
            one.answered[topic] += 1
            send_once(kind, topic, payload, correlation)

        app.link._send_once = watched  # type: ignore[method-assign]
        try:
            wait_until(lambda: seen.of(f"{BASE}/contact"), 30, "frames")
            yield one
        finally:
            app.stop()
            thread.join(30)
            WRITTEN.watch(False)
            os.close(master)
            os.close(slave)


def request(draw: random.Random) -> tuple[str, bytes, str | None, bytes | None]:
    """Draw a request: verb, payload, response topic, correlation data."""
    verb = draw.choice(_VERBS[:5]) if draw.random() < 0.8 else draw.choice(_VERBS)
    if draw.random() < 0.05:
        verb = "".join(c for c in draw.choices("abc/+#\x00äé\n\x1b{}", k=draw.randrange(1, 20)) if c not in "/+#\x00")
    payload = json.dumps(_body(verb, draw)).encode(errors="surrogatepass")
    way = draw.random()
    if way < 0.1:
        payload = payload[: draw.randrange(len(payload) + 1)]
    elif way < 0.2:
        changed = bytearray(payload)
        changed[draw.randrange(len(changed))] = draw.randrange(256)
        payload = bytes(changed)
    elif way < 0.25:
        payload = draw.randbytes(draw.randrange(200))
    elif way < 0.27:
        payload = draw.choice((b"[", b'{"a":', b"1")) * draw.choice((10, 1000, 3000, 5000))
    where = None if draw.random() < 0.5 else draw.choice(_WHERE)
    if where and draw.random() < 0.2:
        at = draw.randrange(len(where))
        where = where[:at] + draw.choice(("/", "res/", "..", "#", "+", "\x00", "\n", "é")) + where[at:]
    correlation = None if draw.random() < 0.7 else draw.randbytes(draw.choice((0, 1, 16, 2000)))
    return verb or "x", payload, where, correlation


def _body(verb: str, draw: random.Random) -> Any:
    """Draw a request's content, which mostly suits the verb but sometimes contains a wrong value."""
    body: dict[str, Any] = {}
    if verb == "profile":
        body["profile"] = draw.choice(("fast", "fast", "balanced", "auto", "nope"))
    elif verb == "record":
        body["action"] = draw.choice(("start", "stop"))
        if body["action"] == "start":
            body |= {"seconds": draw.choice((0.01, 0.1, 1)), "name": draw.choice(_NAMES)}
    elif verb == "stitch":
        body["action"] = draw.choice(("begin", "add", "end", "abort", "status", "status"))
        if body["action"] == "begin":
            body["name"] = draw.choice(_NAMES)
    if draw.random() < 0.5:
        body["transaction"] = draw.choice(_VALUES)
    if draw.random() < 0.3:
        body[draw.choice((*body, "action", "name", "path", "folder"))] = draw.choice(_VALUES)
    return draw.choice(_VALUES) if draw.random() < 0.03 else body


def line(draw: random.Random) -> bytes:
    """Draw a line for the robot's channel, without its end."""
    verb = draw.choice(("HELLO", "SYNC", "POSE", "CAPTURE", "REFERENCE", "STATUS", "HELP", "STITCH", "STITCH", "NOPE"))
    words = {
        "HELLO": lambda: ["1", *draw.sample(("crc=opt", "boot=b1", "crc=req", "x=1"), draw.randrange(2))],
        "SYNC": lambda: [str(draw.choice((0, 1, 10**9, 2**63, 2**64, -1)))],
        "POSE": lambda: [draw.choice(("1", "1e6", "nan", "0", "-1e300", "0.6", "x")) for _ in range(8)],
        "STITCH": lambda: [draw.choice(("BEGIN", "ADD", "END", "ABORT", "STATUS", "x")), draw.choice(_NAMES)],
    }.get(verb, lambda: draw.choices(("", "x", "1", "../x"), k=draw.randrange(2)))()
    text = " ".join((f"#{draw.randrange(70_000)}" if draw.random() < 0.5 else "", verb, *words)).strip()
    data = text.encode(errors="replace")
    if draw.random() < 0.5:
        data = seal(text.replace("\n", " "))[:-1] if text.isascii() else data
    way = draw.random()
    if way < 0.15 and data:
        changed = bytearray(data)
        changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
        data = bytes(changed)
    elif way < 0.2:
        data = draw.randbytes(draw.randrange(300))
    return data


def send_requests(one: Bench, numbers: range, seed: int, came: Came, *, broker: bool) -> None:
    """Send requests in process or, with QoS 0, through the broker."""
    for number in numbers:
        verb, payload, where, correlation = request(random.Random(f"{seed}:request:{number}"))
        properties = None
        if where is not None or correlation is not None:
            properties = Properties(PacketTypes.PUBLISH)
            if where:
                properties.ResponseTopic = where
            if correlation is not None:
                properties.CorrelationData = correlation
        topic = f"{BASE}/req/{verb}"
        if broker:
            # A broker ends the connection of a client that sends an invalid topic.
            if properties is not None and where and (set(where) & set("+#\x00") or not where.isprintable()):
                continue
            if set(topic) & set("+#\x00") or "\ud800" in topic:
                continue
            one.seen.client.publish(topic, payload, 0, properties=properties)
            if number % 20 == 0:
                time.sleep(0.02)  # slowly enough that most requests are answered
        else:
            message = MQTTMessage(0, topic.encode(errors="replace"))
            message.payload, message.properties = payload, properties
            one.app.link._on_message(one.app.link._client, None, message)
        came.sent["through a broker" if broker else "in process"] += 1
        if not one.alive:
            came.problems.append(f"request {number}: the daemon ended")
            return


def send_lines(one: Bench, numbers: range, seed: int, came: Came) -> None:
    """Send lines over the pty as fast as the daemon reads; read and discard the answers."""
    for first in range(numbers.start, numbers.stop, BLOCK):
        binary = (first // BLOCK) % 2 == 1
        data = bytearray(cobs.encode(b"LMODE ASCII") + b"\0" + b"\nMODE ASCII\n")
        if binary:
            data += b"MODE BIN\n"
        for number in range(first, min(first + BLOCK, numbers.stop)):
            raw = line(random.Random(f"{seed}:line:{number}"))
            data += cobs.encode(b"L" + raw) + b"\0" if binary else raw + b"\n"
        view = memoryview(data)
        while view:
            if not one.alive:
                came.problems.append(f"lines {first} to {first + BLOCK}: the daemon ended")
                return
            readable, writable, _ = select.select([one.master], [one.master], [], 1.0)
            if readable:
                os.read(one.master, 65536)
            if writable:
                view = view[os.write(one.master, view[:4096]) :]
        came.sent["serial lines"] += min(BLOCK, numbers.stop - first)
        came.figures["serial_bytes"] = came.figures.get("serial_bytes", 0) + len(data)


def drain(one: Bench, stop: threading.Event) -> None:
    """Read and discard the daemon's answers until `stop`."""
    while not stop.is_set():
        if select.select([one.master], [], [], 0.05)[0]:
            os.read(one.master, 65536)


def judge(one: Bench, came: Came) -> None:
    """Check where the daemon's files and messages went."""
    health = json.loads(one.seen.of(f"{BASE}/health")[-1])
    frames = health["frames"]
    if frames["captured"] != sum(count for name, count in frames.items() if name != "captured"):
        came.problems.append(f"frames do not add up: {frames}")
    came.figures |= {"frames": frames, "mqtt": health["mqtt"], "serial": health["serial"]}
    came.topics = one.topics
    sent = re.compile(rf"{BASE}/req/.*", re.DOTALL)
    for topic in came.topics:
        if not MEANT.fullmatch(topic) and not sent.fullmatch(topic):
            came.problems.append(f"a message on {topic!r}")
    for topic in one.answered:
        if not MEANT.fullmatch(f"{BASE}/{topic}"):
            came.problems.append(f"a reply for {topic!r}")
    came.figures |= {"answers": one.answered.total(), "answer_topics": len(one.answered)}
    folder = str(one.folder)
    for path in WRITTEN.paths:
        if not _meant_file(folder, path):
            came.problems.append(f"a file at {path!r}")


def _meant_file(folder: str, path: str) -> bool:
    if not path.startswith(f"{folder}/"):
        return path.startswith(("/dev/pts/", "/dev/null"))
    room, *rest = path.removeprefix(f"{folder}/").split("/")
    if room in ("recs", "maps"):
        return all(_FILE_NAME.fullmatch(part) and part not in (".", "..") for part in rest) and len(rest) <= 2
    return room.startswith("c.reference.npz")


def run(requests: int, lines: int, through_broker: int, first: int, seed: int) -> Came:
    """Send lines and requests at the same time, then the requests through the broker."""
    came = Came()
    began_s = time.monotonic()
    with bench() as one:
        other = threading.Thread(target=send_lines, args=(one, range(first, first + lines), seed, came))
        other.start()
        send_requests(one, range(first, first + requests), seed, came, broker=False)
        other.join()
        stop = threading.Event()
        drainer = threading.Thread(target=drain, args=(one, stop))
        drainer.start()
        send_requests(one, range(first, first + through_broker), seed + 1, came, broker=True)
        if one.alive:
            # An answer shows that the daemon runs and has processed everything before it.
            for attempt in range(200):
                one.seen.publish(f"{BASE}/req/status", json.dumps({"transaction": f"last {attempt}"}).encode())
                pause = threading.Event()
                pause.wait(0.1)
                if any(
                    b'"last ' in payload and b'"ok":true' in payload for payload in one.seen.of(f"{BASE}/res/status")
                ):
                    break
            else:
                came.problems.append("no answer to a status request at the end")
        health = len(one.seen.of(f"{BASE}/health"))
        if one.alive:
            one.seen.wait_for(f"{BASE}/health", health + 2, 30)
        one.app.stop()
        one.thread.join(30)
        stop.set()
        drainer.join()
        judge(one, came)
    came.took_s = time.monotonic() - began_s
    return came


def table(came: Came) -> str:
    """Write a table of what was sent and what resulted."""
    mqtt, serial = came.figures["mqtt"], came.figures["serial"]
    replies = sum(n for topic, n in came.topics.items() if topic.startswith(f"{BASE}/res/"))
    rows = [
        *(f"| {what} | {count} |" for what, count in came.sent.items()),
        f"| requests understood, refused | {mqtt['requests']}, {mqtt['bad_requests']} |",
        f"| replies and events made, on different topics below `{BASE}` | {came.figures['answers']}, "
        f"{came.figures['answer_topics']} |",
        f"| replies sent, not sent (16 may wait) | {mqtt['replies']}, {mqtt['replies_dropped']} |",
        f"| replies seen, on different topics below `res/` | {replies}, "
        f"{sum(topic.startswith(f'{BASE}/res/') for topic in came.topics)} |",
        f"| bytes of the line, sent and read | {came.figures['serial_bytes']}, {serial['bytes']} |",
        f"| lines understood, damaged, refused | {serial['lines']}, {serial['damaged']}, {serial['refused']} |",
        f"| frames meanwhile | {came.figures['frames']['captured']}, all accounted for |",
        f"| files written to, below the folders of recordings, sessions, reference | {len(WRITTEN.paths)} |",
        f"| files elsewhere, messages on other topics, ends of the daemon | {len(came.problems)} |",
        f"| seconds | {came.took_s:.0f} |",
    ]
    return "\n".join(("| what | count |", "|---|---:|", *rows))
