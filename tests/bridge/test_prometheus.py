"""The metrics as Prometheus reads them: its own parser, a real broker, a hand that falls silent."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from support.mqtt_rig import MOSQUITTO, Broker
from support.patience import patience, wait_until
from support.published_hand import PublishedHand
from support.published_health import health

parser = pytest.importorskip("prometheus_client.parser", reason="the extra prometheus is not installed")

Series = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def series(text: str) -> Series:
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in parser.text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_what_is_told_of_a_hand() -> None:
    from prometheus_client import CollectorRegistry, generate_latest

    from tacshade_edge.bridge.prometheus import Hands

    hands = Hands([])
    registry = CollectorRegistry()
    registry.register(hands)
    payload = health()

    def told() -> dict[str, float]:
        found = series(generate_latest(registry).decode())
        return {
            f"{name} {' '.join(v for k, v in labels if k != 'sensor')}".strip(): x
            for (name, labels), x in found.items()
        }

    hands.hear("tacshade/left/state", b"online", True)
    hands.hear("tacshade/left/health", payload, True)  # retained: of another time
    assert told()["tacshade_up"] == 0
    assert "tacshade_uptime_seconds" not in told()
    for damaged in (b"{", b"[]", b"\xff", b"[" * 100_000, b'{"uptime_s": "a"}'):
        hands.hear("tacshade/left/health", damaged, False)
    hands.hear("tacshade/left/health", payload, False)
    got = told()
    said = json.loads(payload)
    assert got["tacshade_up"] == got["tacshade_state online"] == 1
    assert got["tacshade_state offline"] == 0
    outcomes = {k: v for k, v in got.items() if k.startswith("tacshade_frames_total ")}
    assert sum(outcomes.values()) + got["tacshade_frames_pending"] == said["frames"]["captured"] == 3
    assert outcomes["tacshade_frames_total invalid"] == 1
    assert got["tacshade_source_dropped_total"] == 4
    assert got["tacshade_latency_seconds 99"] == pytest.approx(said["latency_ms"]["p99"] / 1000)
    assert got["tacshade_reason invalid torn"] == 1
    assert got["tacshade_mqtt_total published"] == 9
    assert got["tacshade_recorder_frames_total written"] == 5
    hands.hear("tacshade/left/state", b"offline", False)
    assert {name.split()[0] for name in told()} == {"tacshade_up", "tacshade_state"}
    assert told()["tacshade_up"] == 0


def test_a_silent_hand_tells_no_numbers() -> None:
    from tacshade_edge.bridge import prometheus

    now_s = 100.0
    hands = prometheus.Hands([], lambda: now_s)
    hands.hear("tacshade/left/state", b"online", True)
    hands.hear("tacshade/left/health", health(), False)
    names = {sample.name for family in hands.collect() for sample in family.samples}
    assert "tacshade_capture_fps" in names
    now_s += prometheus.FRESH_S + 0.1
    samples = [sample for family in hands.collect() for sample in family.samples]
    assert {sample.name for sample in samples} == {"tacshade_up", "tacshade_state"}
    assert samples[0].value == 0


@pytest.mark.broker
@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_prometheus_reads_it(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, PublishedHand(broker.port) as hand:
        command = [sys.executable, "-m", "tacshade_edge", "bridge", "prometheus", "--listen", "127.0.0.1:0"]
        child = subprocess.Popen([*command, "--broker", f"127.0.0.1:{broker.port}"], stdout=subprocess.PIPE, text=True)
        try:
            assert child.stdout is not None
            found = re.search(r"http://\S+", child.stdout.readline())
            assert found
            url = found[0]

            def is_up() -> bool:
                hand.tell("health", health())
                with urllib.request.urlopen(url, timeout=patience(10)) as answer:
                    assert answer.headers.get_content_type() == "text/plain"
                    return series(answer.read().decode()).get(("tacshade_up", (("sensor", "drawn"),))) == 1

            wait_until(is_up, 20, "the hand is up")
            child.send_signal(signal.SIGTERM)
            assert child.wait(patience(10)) == 0
        finally:
            child.kill()
            child.communicate()
