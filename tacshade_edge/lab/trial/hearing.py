"""A subscriber in a process of its own: how old each message is when it is decoded, and what the
daemon says of its frames.

::

    python -m tacshade_edge.lab.trial.hearing < LISTENING.json
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np
from paho.mqtt.reasoncodes import ReasonCode as MqttCode

from tacshade_edge.errors import DeviceError
from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.mqtt.follower import Follower
from tacshade_edge.reasons import Reason
from tacshade_edge.wire.topics import OF_SENSORS, decode_hand

SETTLED_NS: Final = 2_000_000_000
"""Ages count from this long after the first: before, caches and the processor's clock are cold."""
FIRST_NS: Final = 1_000_000_000
"""Frames lost within this time after the first are those of a start."""
START_S: Final = 60.0
"""A hand on a small board may take so long until each of its sensors is heard."""
_READY, _HEARS, _SILENT = "ready", "hears all", "silent"


@dataclass(frozen=True, slots=True, kw_only=True)
class Listening:
    """What to listen to: the topics below each sensor whose messages are decoded and timed, those
    that are only received, and the hand's objects.
    """

    broker: BrokerAddress
    sensors: Sequence[str]
    decoded: Sequence[str]
    received: Sequence[str] = ()
    hand_id: str = ""

    def topics(self) -> list[str]:
        """All topics to subscribe to."""
        parts = ("state", "health", *self.decoded, *self.received)
        # A broker may send what two subscriptions match twice.
        parts = ("#",) if "#" in self.received else parts
        found = [f"tacshade/{name}/{part}" for name in self.sensors for part in parts]
        return [*found, *([f"tacshade/hand/{self.hand_id}/objects"] if self.hand_id else [])]


@dataclass(frozen=True, slots=True)
class Heard:
    """What was heard, times on CLOCK_MONOTONIC: of each sensor its decoded messages (topic, number
    and time of the frame, time of the decode) and its ``health`` with their times; of the hand its
    messages with the time, finger and number of each touching finger's frame.
    """

    messages: Mapping[str, Sequence[tuple[str, int, int, int]]] = field(default_factory=dict)
    health: Mapping[str, Sequence[tuple[int, dict[str, Any]]]] = field(default_factory=dict)
    hand: Sequence[tuple[int, Sequence[tuple[int, str, int | None]]]] = ()

    def ages_ms(self) -> list[float]:
        """The ages of all messages, sorted, without those of the start."""
        found = []
        for messages in self.messages.values():
            from_ns = min((at_ns for *_, at_ns in messages), default=0) + SETTLED_NS
            found += [(at - t) / 1e6 for _, _, t, at in messages if at >= from_ns]
        return sorted(found)

    def percentile_ms(self, part: float) -> float:
        """The age that this part (0 to 1) of the messages does not exceed; NaN without any."""
        ages_ms = self.ages_ms()
        return float(np.quantile(ages_ms, part)) if ages_ms else math.nan

    def rate(self) -> float:
        """Decoded messages of a sensor per second, averaged over the sensors."""
        times_ns = [at_ns for some in self.messages.values() for *_, at_ns in some]
        return 1e9 * len(times_ns) / (max(times_ns) - min(times_ns)) / len(self.messages)

    def frames(self) -> tuple[int, int]:
        """How many frames the cameras took after the first second, and how many of them were lost:
        replaced by newer ones, failed, or dropped by the camera.
        """
        captured = lost = 0
        for told in self.health.values():
            begun = [(at_ns, each) for at_ns, each in told if each["frames"]["captured"]]
            later = [each for at_ns, each in begun if at_ns >= begun[0][0] + FIRST_NS]
            if later:
                captured += _captured(later[-1]) - _captured(later[0])
                lost += _lost(later[-1]) - _lost(later[0])
        return captured, lost


def _captured(health: Mapping[str, Any]) -> int:
    return int(health["frames"]["captured"]) + int(health.get("source_dropped", 0))


def _lost(health: Mapping[str, Any]) -> int:
    frames = health["frames"]
    return int(frames["superseded"] + frames["failed"] + health.get("source_dropped", 0))


class HearingProcess:
    """The process. Raises DeviceError if the broker rejects it or does not answer."""

    def __init__(self, listening: Listening) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdin is not None
        # Not as an argument: the broker's password would be in the list of processes.
        self._process.stdin.write(json.dumps(asdict(listening)) + "\n")
        self._process.stdin.flush()
        if (line := self._line()) != _READY:
            self.stop()
            broker = listening.broker
            raise DeviceError(f"{broker['host']}:{broker['port']}: {line or 'no answer'}")

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().rstrip("\n")

    def wait_until_all_are_heard(self) -> bool:
        """Wait for a decoded message of each sensor, for `START_S` at most; whether all came."""
        return self._line() == _HEARS

    def heard(self) -> Heard:
        """What was heard, once all sensors have stopped."""
        assert self._process.stdout is not None
        last = self._process.stdout.read().splitlines()[-1]
        self._process.wait()
        found = json.loads(last)
        return Heard(
            {name: [tuple(each) for each in some] for name, some in found["messages"].items()},
            {name: [tuple(each) for each in some] for name, some in found["health"].items()},
            found["hand"],
        )

    def stop(self) -> None:
        """End the process, whatever it has heard."""
        self._process.kill()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        self._process.wait()


class _Ears(Follower):
    """The subscriber; all but its making runs in paho's thread."""

    def __init__(self, listening: Listening) -> None:
        super().__init__(listening.broker, self._hear, name="trial")
        self._decoded = frozenset(listening.decoded)
        self._left, self._silent = set(listening.sensors), set(listening.sensors)
        self._messages: dict[str, list[tuple[str, int, int, int]]] = {
            name: [] for name in listening.sensors
        }
        self._health: dict[str, list[tuple[int, Any]]] = {name: [] for name in listening.sensors}
        self._hand: list[tuple[int, list[tuple[int, str, int | None]]]] = []
        self.all_heard, self.done = threading.Event(), threading.Event()
        self.follow(listening.topics())

    def document(self) -> dict[str, Any]:
        """All that was heard, for JSON."""
        return {"messages": self._messages, "health": self._health, "hand": self._hand}

    def _hear(self, topic: str, payload: bytes, retained: object) -> None:
        # What is retained is of an earlier run.
        if retained:
            return
        _, name, part = topic.split("/", 2)
        if part in self._decoded:
            self._take(name, part, payload)
        elif part == "health":
            self._health[name].append((time.monotonic_ns(), json.loads(payload)))
        elif part == "state" and payload in (b"stopped", b"offline"):
            self._left.discard(name)
            if not self._left:
                self.done.set()
        elif name == "hand":
            hand = decode_hand(payload)
            touching = [
                (f.t_ns, finger, f.seq)
                for finger, f in hand.fingers.items()
                if f.state == "contact" and f.t_ns
            ]
            self._hand.append((time.monotonic_ns(), touching))

    def _take(self, name: str, part: str, payload: bytes) -> None:
        message = OF_SENSORS[part].decode(part, payload)
        self._messages[name].append((part, message.seq, message.t_ns, time.monotonic_ns()))
        self._silent.discard(name)
        if not self._silent:
            self.all_heard.set()

    def _on_subscribed(self, codes: list[MqttCode]) -> None:
        super()._on_subscribed(codes)
        print(_READY, flush=True)

    def _report(self, reason: Reason | None, fix: str = "") -> None:
        if reason is not None and not any(self._messages.values()):
            print(reason, flush=True)
            self.done.set()


def main() -> None:
    """Listen until all sensors have stopped; print what was heard."""
    ears = _Ears(Listening(**json.loads(sys.stdin.readline())))
    ears.start()
    print(_HEARS if ears.all_heard.wait(START_S) else _SILENT, flush=True)
    ears.done.wait()
    ears.stop()
    print(json.dumps(ears.document()))


if __name__ == "__main__":
    main()
