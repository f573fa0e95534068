"""One daemon process, and a broker that is absent, comes, goes, returns and hangs."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.calibrated_sensor import FULL, calibrated

from tacshade_edge.protocol import wire
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import patience, promised, stretched, wait_until

BASE = "tacshade/tacshade"
BACK_S = 3.0
AWAY_S = 1.0
STALL_S = 10.0
STOP_S = 2.0
# Measured: 0.8 MB; with every payload of the stall kept it is 10 MB.
GROWTH_MAX_MB = 5.0
STATE_CHANGE = re.compile(
    r"\S+ (INFO|WARNING) tacshade_edge\.(daemon\.app: (source|stopped)|devices\.mqtt\.link: [\d.]+:\d+: )"
)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    """Not started."""
    made = Broker(tmp_path)
    yield made
    made.stop()


@pytest.fixture
def daemon(tmp_path: Path, broker: Broker) -> Iterator[subprocess.Popen[str]]:
    calibration_file.save(tmp_path / "c.npz", calibrated(FULL))
    settings = tmp_path / "settings.yaml"
    settings.write_text(
        f"calibration: c.npz\nsource: {{kind: simulated}}\nmqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
    )
    with (tmp_path / "stderr").open("w") as errors:
        command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(settings)]
        child = subprocess.Popen(command, stderr=errors, stdout=subprocess.DEVNULL, text=True)
    yield child
    child.kill()
    child.wait()


def memory_mb(child: subprocess.Popen[str], name: str) -> float:
    """VmRSS, what a process holds now, or VmHWM, the most it ever held."""
    status = Path(f"/proc/{child.pid}/status").read_text()
    return int(re.search(rf"^{name}:\s+(\d+) kB$", status, re.MULTILINE)[1]) / 1024  # type: ignore[index]


def heights(seen: Subscriber) -> list[wire.HeightMessage]:
    decoded = [wire.decode(payload) for payload in seen.of(f"{BASE}/height")]
    return [message for message in decoded if isinstance(message, wire.HeightMessage)]


def stream_is_back(seen: Subscriber, since_ns: int) -> None:
    """Wait for a height map of a frame captured after `since_ns`, within 3 s of it."""
    left_s = BACK_S - (time.monotonic_ns() - since_ns) / 1e9
    promised(lambda: any(h.t_ns > since_ns for h in heights(seen)), left_s, "the stream is back")


def health(seen: Subscriber) -> dict[str, Any]:
    latest: dict[str, Any] = json.loads(seen.wait_for(f"{BASE}/health")[-1])
    return latest


def assert_accounted(frames: dict[str, int]) -> None:
    assert frames["captured"] == sum(count for name, count in frames.items() if name != "captured")


@pytest.mark.slow
@pytest.mark.broker
@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_broker_absent_stopped_restarted_and_stalled(
    tmp_path: Path, broker: Broker, daemon: subprocess.Popen[str]
) -> None:
    log = tmp_path / "stderr"
    wait_until(lambda: "Connection refused" in log.read_text(), 20, "it waits for the broker")
    wait_until(lambda: "source streaming" in log.read_text(), 20, "and works meanwhile")

    for _ in range(2):
        broker.start()
        since_ns = time.monotonic_ns()
        with Subscriber(broker.port) as seen:
            stream_is_back(seen, since_ns)
            seen.wait_for_last(f"{BASE}/state", b"online")
        broker.stop()
        promised(lambda: "Connection refused" in log.read_text().splitlines()[-1], BACK_S, "the loss is logged")
        threading.Event().wait(AWAY_S)

    broker.start()
    with Subscriber(broker.port) as seen:
        seen.wait_for(f"{BASE}/height", 30, 20)  # streams in full
    rss_mb, peak_mb = memory_mb(daemon, "VmRSS"), memory_mb(daemon, "VmHWM")
    with Subscriber(broker.port) as seen:
        published_before = health(seen)["frames"]["published"]
    broker.stall()
    deadline_s = time.monotonic() + STALL_S
    while (left_s := deadline_s - time.monotonic()) > 0:
        threading.Event().wait(min(left_s, 2.5))
        assert memory_mb(daemon, "VmRSS") - rss_mb < GROWTH_MAX_MB
    broker.resume()
    since_ns = time.monotonic_ns()
    with Subscriber(broker.port) as seen:
        stream_is_back(seen, since_ns)
        promised(lambda: seen.of(f"{BASE}/state")[-1:] == [b"online"], BACK_S, "online again")
        seen.wait_for(f"{BASE}/height", 30, 20)
        growth_mb = memory_mb(daemon, "VmRSS") - rss_mb, memory_mb(daemon, "VmHWM") - peak_mb
        assert max(growth_mb) < GROWTH_MAX_MB
        assert_accounted(health(seen)["frames"])

        began_s = time.monotonic()
        daemon.terminate()
        assert daemon.wait(patience(20)) == 0
        assert time.monotonic() - began_s < stretched(STOP_S)
        promised(lambda: seen.of(f"{BASE}/state")[-1:] == [b"stopped"], BACK_S, "stopped")
        last = health(seen)
        assert_accounted(last["frames"])
        assert last["frames"]["pending"] == 0
        assert last["mqtt"]["connects"] >= 4
        received = [h.seq for h in heights(seen)]
        assert received == sorted(set(received))
        assert len(received) <= last["frames"]["published"] - published_before
    lines = log.read_text().splitlines()
    assert [line for line in lines if not STATE_CHANGE.match(line)] == []
    assert len(lines) < 30
