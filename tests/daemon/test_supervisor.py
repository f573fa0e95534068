"""Sensors, a hand and daemons as their users run them:
the command, a real broker, and what becomes of the others.
"""

from __future__ import annotations

import contextlib
import json
import os
import pty
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest

from support.mqtt_rig import Broker, Subscriber
from support.painted_sensor import FREE, TOUCHED, painted_calibration
from support.patience import patience, wait_until
from support.robot import PtyRobot
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import EXIT_CONFIG
from tacshade_edge.daemon.supervisor import STEADY_S, restart_wait_s
from tacshade_edge.doctor.broker_check import check_broker, judge_daemon
from tacshade_edge.doctor.machine import Process
from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.wire import binary
from tacshade_edge.wire.hand_topics import HandObjects
from tacshade_edge.wire.topics import decode_hand

pytestmark = [pytest.mark.broker, pytest.mark.slow]
HAND = "tacshade/hand/left"


class Command:
    """``tacshade-edge run``, its reports to a service manager, and its log."""

    def __init__(self, config: Path) -> None:
        self._manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._manager.bind(str(config.with_suffix(".notify")))
        self._manager.setblocking(False)
        self._notices: list[str] = []
        self._log = config.with_suffix(".log")
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                (sys.executable, "-m", "tacshade_edge", "run", "--config", str(config)),
                env={**os.environ, "NOTIFY_SOCKET": str(config.with_suffix(".notify"))},
                stderr=log,
                stdin=subprocess.DEVNULL,
            )

    def __enter__(self) -> Command:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self._manager.close()

    def notices(self) -> list[str]:
        """Every line to the service manager so far."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self._notices += self._manager.recv(65536).decode().split("\n")
        return self._notices

    def log(self) -> str:
        return self._log.read_text()

    def children(self) -> set[int]:
        found = subprocess.run(
            ("pgrep", "-P", str(self.process.pid)), capture_output=True, check=False
        )
        return {int(word) for word in found.stdout.split()}

    def stop(self) -> None:
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(patience(20)) == 0, self.log()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Calibrations of three sensors, the third damaged, and looped images of a press."""
    for name in ("thumb", "index"):
        calibration_file.save(tmp_path / f"{name}.npz", painted_calibration())
        (tmp_path / name).mkdir()
        for i, image in enumerate([FREE] * 3 + [TOUCHED] * 20):
            cv2.imwrite(str(tmp_path / name / f"{i:02d}.png"), image)
    (tmp_path / "ring.npz").write_bytes(b"no calibration")
    (tmp_path / "ring").symlink_to("index")
    return tmp_path


def run(folder: Path, port: int, *names: str, more: str = "", **places: str) -> Command:
    """With `places`, x, y, z and the unnormalised w and z of a turn about z,
    the sensors are the fingers of a hand.
    """
    lines = [
        f"mqtt: {{host: 127.0.0.1, port: {port}}}",
        "recorder: {folder: recs}",
        "stitching: {folder: maps}",
    ]
    lines += ["hand_id: left"] * bool(places) + [*([more] if more else []), "sensors:"]
    for name in names:
        place = f", hand_T_sensor: {at(places[name])}" if places else ""
        source = f"{{kind: files, path: {name}, fps: 25, loop: true}}"
        lines += [f"  {name}: {{calibration: {name}.npz, source: {source}{place}}}"]
    (folder / "hand.yaml").write_text("\n".join(lines) + "\n")
    return Command(folder / "hand.yaml")


def at(place: str) -> list[float]:
    *xyz, w, z = map(float, place.split())
    long = (w * w + z * z) ** 0.5
    return [*xyz, round(w / long, 6), 0.0, 0.0, round(z / long, 6)]


def last(seen: Subscriber, topic: str) -> Any:
    payloads = seen.of(topic)
    return json.loads(payloads[-1]) if payloads else {}


def health(seen: Subscriber, name: str) -> Any:
    return last(seen, f"tacshade/{name}/health")


def assert_accounted(frames: dict[str, int]) -> None:
    assert frames["captured"] == sum(n for key, n in frames.items() if key != "captured")


def test_fingers_whose_places_seem_to_be_in_centimetres_are_warned_of(
    folder: Path, broker: Broker
) -> None:
    with run(folder, broker.port, "thumb", "index", thumb="0 0 0 1 0", index="0 3 2 1 0") as hand:
        said = "sensors.index.hand_T_sensor: found 3.6 mm from thumb, expected sensors"
        wait_until(lambda: hand.log().count(said) == 2, 20, "each finger's process says so")
        assert "are they in cm?" in hand.log()


def test_one_that_dies_or_cannot_start_touches_no_other(
    folder: Path, broker: Broker, seen: Subscriber
) -> None:
    with run(folder, broker.port, "thumb", "index", "ring") as running:
        wait_until(lambda: "READY=1" in running.notices(), 20, "up with one that cannot start")
        wait_until(
            lambda: all(health(seen, name) for name in ("thumb", "index")), 20, "both publish"
        )
        first = running.children()
        assert len(first) == 2
        states = {name: len(seen.of(f"tacshade/{name}/state")) for name in ("thumb", "index")}
        victim = min(first)
        os.kill(victim, signal.SIGKILL)
        wait_until(lambda: len(running.children() - {victim}) == 2, 20, "started again")
        both = ("thumb: streaming", "index: streaming")
        wait_until(
            lambda: any(all(b in n for b in both) for n in running.notices()[-4:]),
            20,
            "both stream",
        )
        assert any("ring: bad settings" in line for line in running.notices())
        disturbed = [
            name for name in states if len(seen.of(f"tacshade/{name}/state")) > states[name]
        ]
        assert len(disturbed) == 1, "the other never left the broker"
        (other,) = set(states) - set(disturbed)
        assert_accounted(health(seen, other)["frames"])
        assert health(seen, other)["source_dropped"] == 0

        calibration_file.save(folder / "ring.npz", painted_calibration())
        running.process.send_signal(signal.SIGHUP)
        wait_until(lambda: bool(health(seen, "ring")), 20, "the fixed one runs after a reload")
        running.stop()
        seen.wait_for_last("tacshade/ring/state", b"stopped")
    text = running.log()
    assert "sensors.ring.calibration: " in text
    assert "its process exited with -9; restarting in 1 s" in text
    assert {"thumb", "index", "ring"} <= {
        line.split(": ")[1] for line in text.splitlines() if "INFO" in line
    }


def test_one_that_ends_at_once_waits_longer_each_time() -> None:
    waits = [0.0]
    for _ in range(8):
        waits.append(restart_wait_s(waits[-1], STEADY_S - 0.1))
    assert waits[1:] == [1, 2, 4, 8, 16, 32, 60, 60]
    assert restart_wait_s(60.0, STEADY_S) == 1


def states(pid: int) -> set[str]:
    """The states of a process's threads, none if it has ended."""
    found = set()
    with contextlib.suppress(OSError):  # a thread ended meanwhile
        for path in Path(f"/proc/{pid}/task").glob("*/stat"):
            found.add(path.read_text().rpartition(")")[2].split()[0])
    return found - {"Z"}


def suspend(pid: int) -> None:
    """Send SIGSTOP and wait until every thread has stopped:
    the kernel wakes a process whose stop is incomplete.
    """
    os.kill(pid, signal.SIGSTOP)
    wait_until(lambda: states(pid) == {"T"}, 20, "each thread stands")


def test_those_that_a_signal_stops_or_that_hang_are_started_again_and_end_with_their_supervisor(
    folder: Path, broker: Broker, seen: Subscriber
) -> None:
    parts = ("thumb", "index", "hand/left")
    with run(
        folder, broker.port, "thumb", "index", thumb="0 0 0 1 0", index="0 0 0 1 0"
    ) as running:
        wait_until(lambda: all(health(seen, name) for name in parts), 20, "all publish")
        victim = max(running.children())
        os.kill(victim, signal.SIGTERM)
        wait_until(lambda: len(running.children() - {victim}) == 3, 20, "started again")
        seen.messages.clear()
        wait_until(lambda: all(health(seen, name) for name in parts), 20, "all again")
        hung = min(running.children())
        os.kill(hung, signal.SIGSTOP)
        wait_until(lambda: hung not in running.children(), 40, "ended")
        wait_until(lambda: len(running.children()) == 3, 20, "started again")
        assert "ending the process, which has not responded for 10 s" in running.log()
        children = running.children()
        for child in children:
            suspend(child)
    try:
        wait_until(lambda: not any(map(states, children)), 20, "they end, stopped as they are")
    finally:
        for child in filter(states, children):
            os.kill(child, signal.SIGKILL)
    assert "a signal ended its process; restarting in 1 s" in running.log()


def test_one_robots_line_gives_poses_to_every_sensor(
    folder: Path, broker: Broker, seen: Subscriber
) -> None:
    link = Path(f"/dev/shm/tacshade-hand-{os.getpid()}")

    def posed(name: str) -> bool:
        return any(binary.decode(payload).pose for payload in seen.of(f"tacshade/{name}/height"))

    def shared() -> tuple[str, str]:
        serial = last(seen, "tacshade/index/status/serial")
        return serial["state"], serial["shared_by"]

    with (
        PtyRobot(link, rate_hz=100, binary=True),
        run(folder, broker.port, "thumb", "index", more=f"serial: {{device: {link}}}") as running,
    ):
        wait_until(lambda: posed("thumb") and posed("index"), 30, "both have poses")
        wait_until(lambda: shared() == ("connected", "thumb"), 10, "index says whose line it is")
        running.stop()


def test_no_settings_that_can_work_is_bad_configuration(folder: Path) -> None:
    with run(folder, 1, "ring") as running:
        assert running.process.wait(patience(20)) == EXIT_CONFIG
        assert (
            "found text that begins with 'no calibration'; expected a calibration" in running.log()
        )


# A hand.


def latest(seen: Subscriber) -> HandObjects | None:
    payloads = seen.of(f"{HAND}/objects")
    return decode_hand(payloads[-1]) if payloads else None


def both_touch(seen: Subscriber) -> bool:
    hand = latest(seen)
    return hand is not None and {finger.state for finger in hand.fingers.values()} == {"contact"}


def thumb_z_mm(seen: Subscriber) -> float | None:
    hand = latest(seen)
    objects = hand.fingers["thumb"].objects if hand else ()
    return objects[0].centroid_mm[2] if objects else None


def test_objects_of_both_fingers_come_in_the_hands_frame_and_no_part_needs_another(
    folder: Path, broker: Broker
) -> None:
    # Nobody listens to what a finger sees.
    with (
        run(
            folder, broker.port, "thumb", "index", thumb="100 0 0 1 0", index="0 0 0 1 1"
        ) as running,
        Subscriber(broker.port, "tacshade/+/health") as fingers,
    ):
        # Nobody listens to the hand yet: no depth is computed.
        wait_until(
            lambda: health(fingers, "thumb").get("frames", {}).get("unasked", 0) > 60,
            30,
            "unasked frames",
        )
        frames = health(fingers, "thumb")["frames"]
        assert frames["published"] < 0.2 * frames["unasked"]
        topics = [(f"tacshade/+/{topic}", 1) for topic in ("state", "info", "instance")]
        fingers.client.subscribe(topics)
        with Subscriber(broker.port, f"{HAND}/+") as seen:
            wait_until(lambda: both_touch(seen), 30, "both fingers touch")
            hand = latest(seen)
            assert hand is not None
            (thumb, *_), (index, *_) = (hand.fingers[name].objects for name in ("thumb", "index"))
            x_mm, y_mm, z_mm = thumb.centroid_mm
            assert index.centroid_mm == pytest.approx(
                (-y_mm, x_mm - 100, z_mm), abs=1e-3
            )  # a quarter turn
            assert index.depth_max_mm == thumb.depth_max_mm > 0
            assert all(
                finger.age_ms is not None and finger.age_ms < 1000
                for finger in hand.fingers.values()
            )
            wait_until(lambda: last(fingers, "tacshade/thumb/info"), 10, "where the thumb is")
            info = last(fingers, "tacshade/thumb/info")
            assert (info["hand_id"], info["hand_T_sensor"]) == (
                "left",
                [100.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            )

            # A reload moves the thumb, from the next frame on.
            config = folder / "hand.yaml"
            config.write_text(config.read_text().replace("[100.0, 0.0, 0.0,", "[100.0, 0.0, 50.0,"))
            running.process.send_signal(signal.SIGHUP)
            wait_until(
                lambda: last(fingers, "tacshade/thumb/info")["hand_T_sensor"][2] == 50,
                20,
                "its new place",
            )
            wait_until(
                lambda: thumb_z_mm(seen) == pytest.approx(z_mm + 50, abs=0.5), 20, "and used"
            )

            # The hand's own process ends: the sensors never leave the broker, and it comes back.
            left = {name: len(fingers.of(f"tacshade/{name}/state")) for name in ("thumb", "index")}
            first = last(seen, f"{HAND}/instance")
            os.kill(first["process"], signal.SIGKILL)
            wait_until(
                lambda: last(seen, f"{HAND}/instance")["id"] != first["id"], 20, "started again"
            )
            count = len(seen.of(f"{HAND}/objects"))
            wait_until(
                lambda: len(seen.of(f"{HAND}/objects")) > count and both_touch(seen),
                20,
                "both touch again",
            )
            assert {name: len(fingers.of(f"tacshade/{name}/state")) for name in left} == left

            # A sensor's process ends: the hand says so at once, the other finger goes on.
            count = len(seen.of(f"{HAND}/objects"))
            os.kill(last(fingers, "tacshade/thumb/instance")["process"], signal.SIGKILL)

            def away() -> bool:
                hands = map(decode_hand, seen.of(f"{HAND}/objects")[count:])
                return any(hand.fingers["thumb"].reason_code == "daemon_stopped" for hand in hands)

            wait_until(away, 10, "the hand says that a finger is away")
            wait_until(lambda: both_touch(seen), 20, "both touch again")
            assert len(fingers.of("tacshade/index/state")) == left["index"]
            assert_accounted(health(fingers, "index")["frames"])

            running.stop()
            seen.wait_for_last(f"{HAND}/state", b"stopped")
            assert last(seen, f"{HAND}/health")["undecodable"] == 0
            assert all(count > 0 for count in last(seen, f"{HAND}/health")["heard"].values())
    assert "Traceback" not in running.log()


# Two daemons that share what belongs to one: the second says who has it,
# and the first loses nothing.


@pytest.fixture
def device() -> Iterator[str]:
    """A serial port with nobody at its other end."""
    master, slave = pty.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_two_daemons(folder: Path, broker: Broker, seen: Subscriber, device: str) -> None:
    def daemon(name: str) -> Command:
        settings = folder / f"{name}.yaml"
        settings.write_text(
            "sensor_id: left\n"
            "calibration: thumb.npz\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
            "source: {kind: files, path: thumb, fps: 30, loop: true}\n"
            f"serial: {{device: {device}}}\n"
            "stitching: {folder: one}\n"
        )
        return Command(settings)

    def captured() -> int:
        return int(health(seen, "left").get("frames", {}).get("captured", 0))

    (folder / "one").mkdir()
    with daemon("first") as first:
        wait_until(lambda: captured() > 10, 30, "the first works")
        failed = health(seen, "left")["frames"]["failed"]  # before it was connected
        with daemon("second") as second:
            holder = f"process {first.process.pid}"
            place = f"on {socket.gethostname()}, {holder}"
            for text in (
                f"thumb.reference.npz: in use by 'sensor left, {holder}'",
                f"another daemon, {place}, is using tacshade/left",
                f"/one: in use by 'sensor left, {holder}'",
                f"serial {device}: in use by another program",
            ):
                wait_until(lambda text=text: text in second.log(), 30, text)
            address = BrokerAddress(
                host="127.0.0.1", port=broker.port, username=None, password=None, tls_ca=None
            )
            _, found = check_broker(address, "left")
            finding = judge_daemon(
                found, Process(first.process.pid, ("tacshade-edge", "run")), "left"
            )
            waiting = f"on {socket.gethostname()}, process {second.process.pid}"
            expected = (
                f"two daemons are using left: one is running {place}, "
                f"and the other is waiting {waiting}"
            )
            assert finding.found == expected
            before = captured()
            wait_until(lambda: captured() > before + 30, 30, "the first goes on")
            counts = health(seen, "left")
            assert (counts["mqtt"]["losses"], counts["frames"]["failed"]) == (0, failed)
            assert not [
                t
                for t in ("in use by", "another daemon, on", "connection lost")
                if t in first.log()
            ]
            second.stop()
        first.stop()
        assert set(seen.of("tacshade/left/state")) <= {b"online", b"stopped", b"degraded"}
