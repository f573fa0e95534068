"""Measure many boards on one machine: messages, bytes and processor time at a central broker, and what cut links lose.

::

    .venv/bin/python -m tools.benchmarks.fleet [--boards 20] [--real 2] [--seconds 30] [--fps 60]

Each board has a mosquitto with ``config/fleet/board.conf``, whose bridges send over TLS to one with ``central.conf``.
The first boards run a daemon each, on painted frames in contact half of the time; the others repeat the first board's
messages under their own names: twenty daemons do not fit on a small machine, but their messages do. Every board also
publishes a numbered event a second. Then the central broker stalls, and is stopped and restarted. ``bridge prometheus``
reads the central broker all the time.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import cv2
from paho.mqtt.client import MQTTMessage

from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.bridge_process import BridgeProcess
from tools.testbed.daemon_rig import cpu_s
from tools.testbed.fleet import USER, WORD, CentralClient, ConfiguredBroker, board, central, people_port
from tools.testbed.mqtt_rig import Subscriber
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration
from tools.testbed.patience import wait_until

CUT_S = 5.0
UP = ("state", "instance", "info", "status/#", "event/#", "map/revision", "map/final", "health", "contact", "touch")


class Heard:
    """Counts of the messages that the central broker delivers."""

    def __init__(self) -> None:
        self.messages: Counter[str] = Counter()
        self.bytes: Counter[str] = Counter()
        self.numbers: dict[str, set[int]] = {}
        self.received_bytes = 0

    def __call__(self, message: MQTTMessage) -> None:
        """Count a message."""
        if message.topic.startswith("$SYS"):
            self.received_bytes = int(message.payload)
            return
        _, name, kind = message.topic.split("/", 2)
        self.messages[kind] += 1
        self.bytes[kind] += len(message.payload) + len(message.topic)
        if kind == "event/slip" and b'"number"' in message.payload:
            self.numbers.setdefault(name, set()).add(json.loads(message.payload)["number"])


class Streams:
    """Publishes every board's numbered events, and the first board's messages for the boards without a daemon."""

    def __init__(self, brokers: dict[str, ConfiguredBroker], real: int, stack: ExitStack) -> None:
        first = next(iter(brokers))
        self.at = {name: stack.enter_context(Subscriber(broker.port, "nothing")) for name, broker in brokers.items()}
        self.sent = 0
        self._stop = threading.Event()
        copies = list(self.at.items())[real:]

        def copy(message: MQTTMessage) -> None:
            kind = message.topic.split("/", 2)[2]
            for name, each in copies:
                each.publish(f"tacshade/{name}/{kind}", bytes(message.payload), message.qos, retain=message.retain)

        seen = stack.enter_context(Subscriber(brokers[first].port, "nothing"))
        seen.client.on_message = lambda _client, _data, message: copy(message)
        seen.client.subscribe([(f"tacshade/{first}/{kind}", 1) for kind in UP])
        thread = threading.Thread(target=self._number, name="numbers")
        thread.start()
        stack.callback(thread.join)
        stack.callback(self._stop.set)

    def _number(self) -> None:
        while not self._stop.wait(1.0):
            for name, each in self.at.items():
                each.publish(f"tacshade/{name}/event/slip", json.dumps({"number": self.sent}).encode())
            self.sent += 1


def daemon(folder: Path, name: str, port: int, fps: float, stack: ExitStack) -> int:
    """Start a daemon on painted frames; return its process id."""
    settings = folder / f"{name}.yaml"
    settings.write_text(
        f"sensor_id: {name}\nprofile: fast\ncalibration: c.npz\nmqtt: {{host: 127.0.0.1, port: {port}}}\n"
        f"source: {{kind: files, path: images, fps: {fps:g}, loop: true}}\n"
    )
    words = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(settings)]
    with (folder / f"{name}.log").open("w") as log:
        process = subprocess.Popen(words, stderr=log)
    stack.callback(process.wait)
    stack.callback(process.terminate)
    return process.pid


def rates(pids: dict[str, list[int]], heard: Heard, seconds: float, boards: int) -> None:
    """Print messages, bytes and processor time over some seconds."""
    begin, start_s = {kind: sum(map(cpu_s, some)) for kind, some in pids.items()}, time.monotonic()
    heard.messages.clear()
    heard.bytes.clear()
    received = heard.received_bytes
    time.sleep(seconds)
    took_s = time.monotonic() - start_s
    print(f"\n{'of one board':16}{'messages/s':>12}{'bytes/s':>10}")
    for kind, count in heard.messages.most_common():
        print(f"{kind:16}{count / took_s / boards:>12.2f}{heard.bytes[kind] / took_s / boards:>10.0f}")
    total, size = sum(heard.messages.values()), sum(heard.bytes.values())
    print(f"{'all':16}{total / took_s / boards:>12.2f}{size / took_s / boards:>10.0f}\n")
    print(
        f"central broker: {total / took_s:.0f} messages/s, {(heard.received_bytes - received) / took_s:.0f} bytes/s in"
    )
    for kind, some in pids.items():
        share = (sum(map(cpu_s, some)) - begin[kind]) / took_s
        print(f"{kind}: {share:.3f} of a core, {share / len(some):.4f} each")
    print(f"processor time of the central broker for a message: {1e6 * share / (total / took_s):.0f} us", flush=True)


def main() -> int:
    """Measure, then cut the links; return 1 if an event was lost or a sensor is not up."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--boards", type=int, default=20)
    parser.add_argument("--real", type=int, default=2, help="boards with a daemon of their own")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--fps", type=float, default=60.0, help="of the daemons")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary, ExitStack() as stack:
        folder, heard = Path(temporary), Heard()
        (folder / "images").mkdir()
        for k in range(64):
            cv2.imwrite(str(folder / "images" / f"{k:02}.png"), FREE if k < 32 else TOUCHED)
        calibration_file.save(folder / "c.npz", painted_calibration())
        middle = stack.enter_context(central(folder))
        names = [f"b{k:02d}" for k in range(args.boards)]
        brokers = {name: stack.enter_context(board(folder, name, middle.port)) for name in names}
        words = ("tacshade/#", "$SYS/broker/bytes/received")
        stack.enter_context(CentralClient(folder, people_port(folder), heard, None, *words))
        (folder / "word").write_text(WORD)
        login = ("--username", USER, "--password-file", str(folder / "word"), "--ca-file", str(folder / "ca.pem"))
        metrics = stack.enter_context(
            BridgeProcess("prometheus", people_port(folder), folder / "prometheus.log", *login)
        )
        streams = Streams(brokers, args.real, stack)
        daemons = [daemon(folder, name, brokers[name].port, args.fps, stack) for name in names[: args.real]]

        def up() -> int:
            return sum(x.startswith("tacshade_up{") and x.endswith(" 1.0") for x in metrics.page().splitlines())

        wait_until(lambda: up() == args.boards, 60, "every sensor is up")
        print(
            f"{args.boards} boards, {args.real} of them with a daemon at {args.fps:g} frames/s; Prometheus: {up()} up"
        )
        boards = [broker.pid for broker in brokers.values()]
        rates(
            {"daemons": daemons, "boards' brokers": boards, "central broker": [middle.pid]},
            heard,
            args.seconds,
            args.boards,
        )
        middle.stall()
        time.sleep(CUT_S)
        middle.resume()
        time.sleep(1)
        middle.stop()
        time.sleep(CUT_S)
        middle.start()
        cut = streams.sent
        time.sleep(1)
        wait_until(lambda: all(cut in found for found in heard.numbers.values()), 60, "events after the cuts")
        lost = sum(len(set(range(min(found), cut)) - found) for found in heard.numbers.values())
        wait_until(lambda: up() == args.boards, 60, "every sensor is up again")
        sent = cut * len(heard.numbers)
        print(f"after {CUT_S:g} s stalled and {CUT_S:g} s stopped: {lost} of {sent} events lost; Prometheus: {up()} up")
    return int(lost > 0)


if __name__ == "__main__":
    sys.exit(main())
