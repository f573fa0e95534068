"""The metrics as Prometheus reads them: its own parser, a real broker,
a sensor that falls silent.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from support.mqtt_rig import BridgeProcess, Broker
from support.patience import patience, wait_until
from support.published_sensor import PublishedSensor, bump, health, unmeasured
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Reconstruction
from tacshade_edge.wire import messages

parser = pytest.importorskip(
    "prometheus_client.parser", reason="the extra prometheus is not installed"
)

prometheus = pytest.importorskip("tacshade_edge.bridge.prometheus")

Series = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def series(text: str) -> Series:
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in parser.text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_what_is_exposed_of_a_sensor() -> None:
    from prometheus_client import CollectorRegistry, generate_latest

    sensors = prometheus.SensorMetrics([])
    registry = CollectorRegistry()
    registry.register(sensors)
    payload = health()

    def exposed() -> dict[str, float]:
        found = series(generate_latest(registry).decode())
        return {
            f"{name} {' '.join(v for k, v in labels if k != 'sensor')}".strip(): x
            for (name, labels), x in found.items()
        }

    sensors.hear("tacshade/left/state", b"online", True)
    sensors.hear("tacshade/left/health", payload, True)  # retained: of another time
    assert exposed()["tacshade_up"] == 0
    assert "tacshade_uptime_seconds" not in exposed()
    for damaged in (b"{", b"[]", b"\xff", b"[" * 100_000, b'{"uptime_s": "a"}'):
        sensors.hear("tacshade/left/health", damaged, False)
    sensors.hear("tacshade/left/health", payload, False)
    got = exposed()
    said = json.loads(payload)
    assert got["tacshade_up"] == got["tacshade_state online"] == 1
    assert got["tacshade_state offline"] == 0
    outcomes = {k: v for k, v in got.items() if k.startswith("tacshade_frames_total ")}
    assert (
        sum(outcomes.values()) + got["tacshade_frames_pending"] == said["frames"]["captured"] == 3
    )
    assert outcomes["tacshade_frames_total invalid"] == 1
    assert got["tacshade_source_dropped_total"] == 4
    assert got["tacshade_latency_seconds 99"] == pytest.approx(said["latency_ms"]["p99"] / 1000)
    assert got["tacshade_reason invalid torn"] == 1
    assert got["tacshade_touched_frames_total"] == said["touched_frames"] == 0
    assert got["tacshade_mqtt_total published"] == 9
    assert got["tacshade_recorder_frames_total written"] == 5
    sensors.hear("tacshade/left/state", b"offline", False)
    assert {name.split()[0] for name in exposed()} == {
        "tacshade_up",
        "tacshade_state",
        "tacshade_bridge_refused_total",
    }
    assert exposed()["tacshade_up"] == 0


def test_a_silent_sensor_reports_no_numbers() -> None:
    now_s = 100.0
    sensors = prometheus.SensorMetrics([], lambda: now_s)
    sensors.hear("tacshade/left/health", health(), False)
    assert "tacshade_capture_fps" in {
        sample.name for family in sensors.collect() for sample in family.samples
    }
    now_s += prometheus.FRESH_S + 0.1
    assert up_of(sensors) == {"left": 0}
    assert "tacshade_capture_fps" not in {
        sample.name for family in sensors.collect() for sample in family.samples
    }


def up_of(sensors: Any) -> dict[str, float]:
    (family,) = (family for family in sensors.collect() if family.name == "tacshade_up")
    return {sample.labels["sensor"]: sample.value for sample in family.samples}


def test_what_never_reported_a_health_or_stopped_is_not_down() -> None:
    sensors = prometheus.SensorMetrics([])
    sensors.hear("tacshade/replay/state", b"online", False)
    for name, state in (("ended", b"stopped"), ("died", b"offline"), ("hangs", b"online")):
        sensors.hear(f"tacshade/{name}/state", state, True)
        sensors.hear(f"tacshade/{name}/health", health(), True)
    assert up_of(sensors) == {"died": 0, "hangs": 0}
    sensors.hear("tacshade/ended/state", b"online", False)
    sensors.hear("tacshade/ended/health", health(), False)
    assert up_of(sensors) == {"died": 0, "hangs": 0, "ended": 1}
    sensors.hear("tacshade/died/state", b"", False)  # dismissed
    assert up_of(sensors) == {"hangs": 0, "ended": 1}


def test_real_hands_come_before_invented_ones() -> None:
    sensors = prometheus.SensorMetrics([])
    for number in range(2 * prometheus.SENSORS_MAX):
        sensors.hear(f"tacshade/a{number}/state", b"online", True)
    sensors.hear("tacshade/real/health", health(), True)
    assert up_of(sensors) == {"real": 0}
    sensors.hear("tacshade/other/health", health(), False)
    assert up_of(sensors) == {"other": 1, "real": 0}
    refused = {
        s.labels["why"]: s.value
        for f in sensors.collect()
        for s in f.samples
        if "refused" in f.name
    }
    assert refused == {"undecodable": 0, "no_room": prometheus.SENSORS_MAX, "unknown_topic": 0}


def contact_of(sensors: Any) -> dict[str, float]:
    return {
        sample.name: sample.value
        for family in sensors.collect()
        for sample in family.samples
        if "contact" in sample.name
    }


def begun(type_: str) -> bytes:
    values = {"t_ns": 1, "start_ns": 1, "end_ns": None, "depth_max_mm": None, "volume_mm3": None}
    return json.dumps(
        {"type": type_, "id": 1, **values, "shear_mm": None, "slip": None, "objects": None}
    ).encode()


def test_contacts_are_served_on_request_and_absent_while_unknown() -> None:
    now_s = 100.0
    sensors = prometheus.SensorMetrics(["left"], lambda: now_s, contact=True)
    assert prometheus.SensorMetrics(["left"]).topics == {
        f"tacshade/left/{name}" for name in ("state", "health")
    }
    assert sensors.topics == {
        f"tacshade/left/{name}" for name in ("state", "health", "contact", "event/contact")
    }

    def show(result: Reconstruction) -> dict[str, float]:
        sensors.hear("tacshade/left/contact", messages.encode_contact(result, fps=30.0), False)
        return contact_of(sensors)

    press = bump(1, 1.25, 240, 328, 8)
    assert show(press) == {}, "of a sensor that has not reported its health"
    sensors.hear("tacshade/left/health", health(), False)
    assert contact_of(sensors) == {"tacshade_contacts_total": 0}
    for type_ in ("new", "update", "end", "new"):
        sensors.hear("tacshade/left/event/contact", begun(type_), False)
    count = {"tacshade_contacts_total": 2}
    depth = "tacshade_contact_depth_meters"
    assert show(press) == count | {"tacshade_contact": 1, depth: 0.00125}
    assert show(bump(2, 0.0, 0, 0, 8)) == count | {"tacshade_contact": 0, depth: 0}
    assert show(unmeasured(3)) == count | {"tacshade_contact": 1}
    unusable = replace(press, valid=False, reason=Reason(ReasonCode.TORN, "torn"))
    assert show(unusable) == count
    assert len(show(press)) == 3
    now_s += prometheus.FRESH_S + 0.1  # as when the camera is away
    sensors.hear("tacshade/left/health", health(), False)
    assert contact_of(sensors) == count
    show(press)
    sensors.hear("tacshade/left/state", b"stopped", False)
    assert contact_of(sensors) == {}


def hostile_healths() -> Iterator[bytes]:
    """Numbers, names and amounts that no daemon reports."""
    reported = json.loads(health())
    for key in ("uptime_s", "capture_fps", "source_dropped"):
        for number in ("-1", "1e308", "1e999", "1" + "0" * 400, "null", '"x"', "[]"):
            yield json.dumps({**reported, key: "?"}).replace('"?"', number).encode()
    yield json.dumps({**reported, "frames": {'a"} 1\nforged{x="': 1}}).encode()
    yield json.dumps(
        {**reported, "frames": {f"k{number}": number for number in range(100_000)}}
    ).encode()
    yield from (b"{", b"[]", b"\xff", b"[" * 60_000, b"{}", b"0")


def test_what_no_daemon_reports_is_refused() -> None:
    sensors = prometheus.SensorMetrics([])
    sensors.hear("tacshade/real/health", health(), False)
    for number, payload in enumerate(hostile_healths()):
        sensors.hear(f"tacshade/bad{number}/health", payload, False)
    assert up_of(sensors) == {"real": 1}


@pytest.mark.broker
def test_prometheus_reads_it(tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        PublishedSensor(broker.port) as sensor,
        BridgeProcess("prometheus", broker.port, tmp_path / "log") as bridge,
    ):

        def is_up() -> bool:
            sensor.publish("health", health())
            with contextlib.suppress(OSError):
                return series(bridge.page()).get(("tacshade_up", (("sensor", "drawn"),))) == 1
            return False

        wait_until(is_up, 20, "the sensor is up")
        with contextlib.ExitStack() as idle:
            for _ in range(3 * prometheus.CONNECTIONS_MAX):
                idle.enter_context(socket.create_connection(("127.0.0.1", bridge.port), 5))
            assert bridge.threads() <= prometheus.CONNECTIONS_MAX + 8
            assert bridge.stopped_s() < patience(3)


def test_the_sensors_that_are_there_are_named_beside_one_that_is_not(tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        PublishedSensor(broker.port),
        BridgeProcess("prometheus", broker.port, tmp_path / "log", "--sensor", "drawm") as bridge,
    ):
        named = "no sensor drawm so far; there are drawn\n"
        wait_until(lambda: named in bridge.log(), 20, "the name of the sensor that is there")
