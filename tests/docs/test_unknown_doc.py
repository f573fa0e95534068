"""docs/reference/mqtt/unknown.md: what each consumer gets in each state, by the real encoders."""

from __future__ import annotations

import csv
import json
import math
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.published_sensor import CRC, bump, calibration, unmeasured
from tacshade_edge.daemon.hand_process import FingerReporter, Lines
from tacshade_edge.hand.fingers import STALLED_NS, HandAggregator
from tacshade_edge.library.frame_assembler import FrameAssembler
from tacshade_edge.library.result import Result
from tacshade_edge.mqtt.home_assistant import encode_discovery
from tacshade_edge.mqtt.publishing import Publisher
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.recording.exports.table_export import csv_export
from tacshade_edge.recording.recording import RecordedFrame
from tacshade_edge.recording.runs import summary
from tacshade_edge.rigid import from_seven
from tacshade_edge.robot.touch_events import TouchEvents
from tacshade_edge.robot.verbs import TouchAsked
from tacshade_edge.types import Frame, Reconstruction, Touch
from tacshade_edge.wire import messages
from tacshade_edge.wire.hand_messages import encode_hand

PAGE: Final = Path(__file__).parents[2] / "docs/reference/mqtt/unknown.md"
HEAD, _, *ROWS = (
    [re.sub(r"\[(.*?)\]\(.*?\)", r"\1", cell.strip()) for cell in line.strip("|").split("|")]
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if line.startswith("|")
)
TABLE: Final = {row[0]: dict(zip(HEAD[1:], row[1:], strict=True)) for row in ROWS}
"""The expected words by state and consumer."""
S: Final = 1_000_000_000
AWAY: Final = ("camera away", "stopped", "died")
ALIVE: Final = tuple(state for state in TABLE if state not in AWAY)


def made(state: str, seq: int, t_ns: int) -> Reconstruction:
    """The result of a frame in a state that has frames."""
    if state == "something touches":
        touch = Touch({"depth_mm": 1.26}, {"depth_mm": 0.1})
        found = replace(bump(seq, 1.26, 240, 328, 8), touch=touch)
    else:
        found = unmeasured(seq, 8) if "unknown" in state else bump(seq, 0.0, 0, 0, 8)
    code = {"unusable frames": ReasonCode.TORN, "not calibrated": ReasonCode.NOT_CALIBRATED}
    if state in code:
        found = replace(found, valid=False, reason=Reason(code[state], state))
    return replace(found, t_ns=t_ns, wall_ns=t_ns)


@dataclass
class Played:
    """What a daemon has published: a contact before, then three seconds of the state."""

    state: str

    def __post_init__(self) -> None:
        self.heard: dict[str, list[bytes]] = {}
        self.results = [made("something touches", 0, S)]
        if self.state in ALIVE:
            self.results += [made(self.state, k, S + k * S // 10) for k in range(1, 31)]
        publisher = Publisher(
            lambda stream, payload, _: self.heard.setdefault(stream, []).append(payload),
            lambda *_: None,
            lambda *_: None,
        )
        for result in self.results:
            publisher.see(seen(result))
        if "state" not in self.heard:
            words = {"stopped": "stopped", "died": "offline", "camera away": "degraded"}
            self.retained = {
                "state": words.get(self.state, "online"),
                "status/camera": "away" if self.state == "camera away" else "streaming",
            }

    @property
    def silent(self) -> bool:
        return self.state in AWAY

    def last(self, stream: str) -> Any:
        return json.loads(self.heard[stream][-1])


def seen(result: Reconstruction) -> FrameResult:
    image = np.zeros((8, 8), np.uint8)
    return FrameResult(Frame(result.seq, result.t_ns, 0, image), calibration(), result)


def word(value: Any, unknown: str) -> str:
    return unknown if value is None or value == "" or value != value else str(value)


def contact(played: Played, _: Path) -> str:
    if played.silent:
        return "silence"
    last = played.last("contact")
    assert len({last[k] is None for k in ("contact", "touched", "objects")}) == 1
    assert len({last[k] is None for k in ("depth_max_mm", "area_mm2", "volume_mm3")}) == 1
    return f"{word(last['contact'], 'null')}, {word(last['depth_max_mm'], 'null')}"


def home_assistant(played: Played, _: Path) -> str:
    jinja2 = pytest.importorskip("jinja2")
    announced = encode_discovery("x", version="1", profiles=("fast",))
    entities = {topic.split("/")[3]: json.loads(p) for topic, p in announced.items()}
    shown = []
    for name in ("contact", "depth"):
        entity = entities[name]
        assert entity["availability_mode"] == "all"
        online = all(
            jinja2.Template(one["value_template"]).render(
                value=(value := played.retained[one["topic"].removeprefix("tacshade/x/")]),
                value_json={"state": value},
            )
            == "online"
            for one in entity["availability"]
        )
        assert 1 < entity["expire_after"] <= 10
        template = jinja2.Template(entity["value_template"])
        value = template.render(value_json=played.last("contact"))
        known = {"None": "unknown", "ON": "on", "OFF": "off"}.get(value, value)
        shown.append(known if online else "unavailable")
    return ", ".join(shown)


def touch(played: Played, _: Path) -> str:
    if played.silent:
        return "silence"
    last = played.last("touch")
    if last["touch"] is None:
        return f"null: {last['reason_code']}".removesuffix(": ")
    return str(last["touch"]["depth_mm"])


def hand(played: Played, _: Path) -> str:
    lines = Lines(["x"])
    lines.want(wanted=True)
    reporter = FingerReporter(lines.fingers["x"], from_seven((0, 0, 0, 1, 0, 0, 0)))
    together = HandAggregator(["x"])
    together.listen(S, listened=True)
    for result in played.results:
        reporter.see(seen(result))
        while (finger := lines.take("x")) is not None:
            together.hear("x", finger, result.t_ns)
    now_ns = played.results[-1].t_ns + (played.silent and STALLED_NS) + 1
    if played.state in ("stopped", "died"):
        lines.end("x")
        while (finger := lines.take("x")) is not None:
            together.hear("x", finger, now_ns)
    finger = json.loads(encode_hand(together.message(now_ns, 0)))["fingers"]["x"]
    for sock in (*lines.hand.values(), *(line.sock for line in lines.fingers.values())):
        sock.close()
    reason = f": {finger['reason_code']}" if finger["state"] == "away" else ""
    return f"{finger['state']}{reason}{', touched' if finger['touched'] else ''}"


def spoken(events: TouchEvents) -> str:
    return " ".join(event.text() for event in iter(events.take, None))


def serial_line(played: Played, _: Path) -> str:
    if played.state in ("stopped", "died"):
        return "silence"
    events = TouchEvents(115200, lambda: None)
    events.switch(TouchAsked(("depth_mm",), 60))
    said = ""
    for result in played.results:
        events.observe(result)
        said = spoken(events) or said
    if played.state == "camera away":
        events.lost()
        said = spoken(events)
        events.lost()
        assert spoken(events) == ""
    value = said.split()[3]
    assert value.startswith("depth_mm") or said.endswith("depth_mm=-")
    return value


def table(played: Played, folder: Path) -> str:
    if played.silent:
        return "no row"
    result, path = played.results[-1], folder / "x.csv"
    frame = seen(result).frame
    with csv_export(path, ["depth_mm"]) as add:
        add(RecordedFrame("x.png", frame, result.wall_ns), result)
    (row,) = csv.DictReader(path.read_text().splitlines())
    told = summary(result)
    assert (told["contact"] is None, told["depth_max_mm"] is None) == (
        row["contact"] == "",
        row["depth_max_mm"] == "",
    )
    return f"{word(row['contact'], 'empty')}, {word(row['depth_max_mm'], 'empty')}"


def library(played: Played, _: Path) -> str:
    if played.silent:
        return "error"  # tests/library/test_subscriber.py: `listen` raises DeviceError
    known = played.state != "not calibrated"
    assembler = FrameAssembler()
    geometry = calibration() if known else Reason(ReasonCode.NOT_CALIBRATED, "none")
    assembler.add("info", messages.encode_info(calibration=geometry, profile="fast"))
    for topic in ("height", "cloud", "contact"):
        assembler.add(topic, played.heard[topic][-1])
    result: Result | None = assembler.take()
    if result is None:
        return "none"
    what = "contact" if result.in_contact else "touched" if result.touched else "free"
    depth_mm = result.depth_max_mm
    assert math.isnan(result.volume_mm3) == math.isnan(depth_mm)
    # The drawn heights and points are not quite of one skin.
    shown = "1.26" if abs(depth_mm - 1.26) < 0.1 else f"{depth_mm:g}".replace("nan", "NaN")
    return f"{what if result.valid else 'invalid'}, {shown}"


def lerobot(played: Played, _: Path) -> str:
    if played.silent:
        return "none"
    sys.path.insert(0, str(Path(__file__).parents[1] / "client_lerobot"))
    import test_pictures

    sys.path.pop(0)
    made = test_pictures.pictures.Pictures(56)
    made.add(test_pictures.INFO)
    last = played.results[-1].seq
    if played.state == "something touches":
        height = test_pictures.binary.encode_height(
            played.results[-1], calibration_crc32=CRC, pose=None, pose_error_us=0
        )
        made.add(test_pictures.message("height", height))
    assert played.last("contact")["seq"] == last
    if made.add(test_pictures.message("contact", played.heard["contact"][-1])) is None:
        return "none"
    numbers = dict(zip(test_pictures.pictures.TACTILE, made.tactile.tolist(), strict=True))
    depth = numbers["depth_max_mm"]
    return f"{numbers['contact']:g}, {'NaN' if math.isnan(depth) else f'{depth:g}'}"


def scraped(played: Played) -> dict[str, float]:
    """The latest values by name, after ten seconds of the state."""
    pytest.importorskip("prometheus_client", reason="the extra prometheus is not installed")
    from support.published_sensor import health
    from tacshade_edge.bridge.prometheus import FRESH_S, SensorMetrics

    clock = iter(range(2000))
    metrics = SensorMetrics([], clock_s=lambda: next(clock) / 10, contact=True)
    report = json.loads(health())
    frames = 0 if played.silent else 1
    for second in range(100):
        report["frames"]["captured"] += frames
        payload = json.dumps(report).encode()
        metrics.hear("tacshade/x/health", payload, False)
        metrics.hear("tacshade/x/state", b"online", False)
        if frames or second == 0:
            metrics.hear("tacshade/x/contact", played.heard["contact"][-1], False)
    assert next(clock) > 10 * FRESH_S
    metrics.hear("tacshade/x/state", played.retained["state"].encode(), False)
    return {sample.name: sample.value for metric in metrics.collect() for sample in metric.samples}


def prometheus(played: Played, _: Path) -> str:
    found = scraped(played)
    up = {None: "absent", 0.0: "down", 1.0: "up"}[found.get("tacshade_up")]
    return up + (", latency" if "tacshade_latency_seconds" in found else "")


def prometheus_contact(played: Played, _: Path) -> str:
    found = scraped(played)
    contact, depth_m = (found.get(f"tacshade_contact{what}") for what in ("", "_depth_meters"))
    depth = "absent" if depth_m is None else f"{depth_m:g}"
    return f"{'absent' if contact is None else f'{contact:g}'}, {depth}"


CONSUMERS: Final[dict[str, Callable[[Played, Path], str]]] = {
    "`contact`": contact,
    "Home Assistant: *Contact*, *Depth*": home_assistant,
    "`touch`": touch,
    "hand": hand,
    "serial line": serial_line,
    "CSV": table,
    "library": library,
    "LeRobot": lerobot,
    "Prometheus": prometheus,
    "Prometheus with `--contact`": prometheus_contact,
}


def test_the_table_has_every_consumer() -> None:
    # The page is shown in a browser: tests/dashboard/test_page_trouble.py.
    assert HEAD[1:] == [*CONSUMERS, "page"]


@pytest.mark.parametrize("consumer", CONSUMERS)
@pytest.mark.parametrize("state", TABLE)
def test_a_consumer_gets_what_the_table_says(state: str, consumer: str, tmp_path: Path) -> None:
    assert CONSUMERS[consumer](Played(state), tmp_path) == TABLE[state][consumer]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from([*ALIVE, "camera away"]), min_size=1, max_size=12))
def test_the_last_touch_event_is_true_after_any_sequence_of_states(states: list[str]) -> None:
    events, last = TouchEvents(115200, lambda: None), " contact=0"
    events.switch(TouchAsked(("depth_mm",), 60))
    for k, state in enumerate(states):
        if state == "camera away":
            events.lost()
        else:
            events.observe(made(state, 2 * k, k * S))
            events.observe(made(state, 2 * k + 1, k * S + S // 5))
        last = spoken(events) or last
        if state == "camera away" and all(one == state for one in states[: k + 1]):
            continue  # no frame yet, to which an event could belong
        assert TABLE[state]["serial line"] in last


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(ALIVE), min_size=1, max_size=12), st.integers(1, S))
def test_the_last_contact_is_known_exactly_if_the_last_frame_was_usable(
    states: list[str], period_ns: int
) -> None:
    heard: list[bytes] = []
    publisher = Publisher(
        lambda stream, payload, _: heard.append(payload) if stream == "contact" else None,
        lambda *_: None,
        lambda *_: None,
    )
    for k, state in enumerate(states):
        publisher.see(seen(made(state, k, k * period_ns)))
        last = json.loads(heard[-1])
        usable = state not in ("unusable frames", "not calibrated")
        assert (last["contact"] is not None) == usable == (last["reason_code"] == "")
