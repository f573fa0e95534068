"""docs/how-to/integrations.md: the files that it gives for other programs ask for what we publish.

The programs themselves have loaded the files once, as the page says; they are too heavy for a
suite.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import pytest
import yaml

from support.published_sensor import bump, health
from tacshade_edge.mqtt.home_assistant import encode_discovery
from tacshade_edge.wire import messages
from tacshade_edge.wire.health_topics import Health
from tacshade_edge.wire.sensor_topics import OF_JSON, Contact
from tacshade_edge.wire.topics import OF_SENSORS, STATES

ROOT: Final = Path(__file__).parents[2]
FILES: Final = ROOT / "config/integrations"
FLOW: Final = json.loads((FILES / "node-red-flow.json").read_text(encoding="utf-8"))
BOARD: Final = json.loads((FILES / "grafana-board.json").read_text(encoding="utf-8"))
LAYOUT: Final = json.loads((FILES / "foxglove-layout.json").read_text(encoding="utf-8"))
BLUEPRINT: Final = FILES / "home-assistant-blueprint.yaml"


def test_the_page_names_every_file() -> None:
    page = (ROOT / "docs/how-to/integrations.md").read_text(encoding="utf-8")
    named = re.findall(r"\.\./\.\./config/integrations/([\w.-]+)\)", page)
    assert sorted(set(named)) == sorted(path.name for path in FILES.iterdir())


# -- Node-RED ------------------------------------------------------------------------------------


def downstream(node: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The nodes that a node's messages reach."""
    for wire in (name for output in node["wires"] for name in output):
        (after,) = (one for one in FLOW if one["id"] == wire)
        yield after
        yield from downstream(after)


def test_the_flow_reads_what_a_sensor_publishes() -> None:
    sources = [node for node in FLOW if node["type"] == "mqtt in"]
    assert len(sources) == 3
    for node in sources:
        topic = node["topic"].removeprefix("tacshade/+/")
        assert topic in OF_SENSORS
        text = json.dumps(list(downstream(node)))
        read = set(re.findall(r"payload\.(\w+)", text))
        if topic == "state":
            values = {r["v"] for n in downstream(node) for r in n.get("rules", ())}
            assert values < set(STATES)
            assert (read, node["datatype"]) == (set(), "utf8")
        else:
            assert read
            assert read <= {field.name for field in fields(OF_JSON[topic])}
            assert node["datatype"] == "json"


def test_the_flow_holds_together() -> None:
    names = {node["id"] for node in FLOW}
    assert len(names) == len(FLOW)
    reached = {one["id"] for node in FLOW if "wires" in node for one in downstream(node)}
    kinds = {node["id"]: node["type"] for node in FLOW}
    assert names - reached == {
        name for name, kind in kinds.items() if kind in ("tab", "mqtt-broker", "mqtt in")
    }
    (broker,) = (node for node in FLOW if node["type"] == "mqtt-broker")
    assert all(node["broker"] == broker["id"] for node in FLOW if node["type"] == "mqtt in")


# -- Grafana ---------------------------------------------------------------------------------------


def served() -> dict[str, dict[str, set[str]]]:
    """The labels and their values by metric, of a sensor that is touched."""
    pytest.importorskip("prometheus_client", reason="the extra prometheus is not installed")
    from tacshade_edge.bridge.prometheus import SensorMetrics

    metrics = SensorMetrics([], contact=True)
    metrics.hear("tacshade/x/state", b"online", False)
    metrics.hear("tacshade/x/health", health(), False)
    contact = messages.encode_contact(bump(1, 1.0, 240, 328, 8), fps=30.0)
    metrics.hear("tacshade/x/contact", contact, False)
    found: dict[str, dict[str, set[str]]] = {}
    for family in metrics.collect():
        for sample in family.samples:
            labels = found.setdefault(sample.name, {})
            for label, value in sample.labels.items():
                labels.setdefault(label, set()).add(value)
    return found


TARGETS: Final = [
    pytest.param(target, id=f"{panel['title']} {target['refId']}")
    for panel in BOARD["panels"]
    for target in panel["targets"]
]


@pytest.mark.parametrize("target", TARGETS)
def test_the_board_asks_for_metrics_that_are_served(target: dict[str, Any]) -> None:
    metrics = served()
    asked = re.findall(r"(tacshade_\w+)(?:\{(.*?)\})?", target["expr"])
    assert len(asked) == 1
    ((name, matchers),) = asked
    assert name in metrics
    for label, _, values in re.findall(r'(\w+)(=~?)"([^"]*)"', matchers):
        if values == "$sensor":
            assert label == "sensor"
        else:
            known = (
                {"dropped"} if name == "tacshade_recorder_frames_total" else metrics[name][label]
            )
            assert set(values.split("|")) <= known
    assert set(re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])) <= metrics[name].keys()
    is_counter = name.endswith("_total")
    assert is_counter == ("rate(" in target["expr"])


def test_the_board_shows_every_sensor_and_metric_of_interest() -> None:
    (variable,) = (one for one in BOARD["templating"]["list"] if one["type"] == "query")
    found = re.fullmatch(r"label_values\((\w+), (\w+)\)", variable["query"]["query"])
    assert found
    assert found[2] in served()[found[1]]
    left_out = {
        "tacshade_uptime_seconds",
        "tacshade_touched_frames_total",
        "tacshade_frames_pending",
    }
    assert (
        set(re.findall(r"tacshade_\w+", json.dumps(BOARD["panels"]))) == served().keys() - left_out
    )


# -- Foxglove --------------------------------------------------------------------------------------


def shown(value: Any) -> set[str]:
    """The topics of a sensor in a panel's configuration."""
    return set(re.findall(r'/tacshade/demo/([a-z]+)[".]', json.dumps(value)))


def test_the_layout_shows_topics_that_the_bridge_has() -> None:
    bridge = pytest.importorskip("tacshade_edge.bridge.foxglove")
    schemas = {
        "3D": {"SceneUpdate", "PointCloud"},
        "Image": {"RawImage", "CompressedImage"},
        "RosOut": {"Log"},
    }
    everything = set()
    for panel, config in LAYOUT["configById"].items():
        kind = panel.partition("!")[0]
        topics = shown(config)
        assert topics, panel
        everything |= topics
        for topic in topics:
            schema, _ = bridge.CHANNELS[topic]
            assert isinstance(schema, dict) == (kind == "Plot")
            if kind != "Plot":
                assert schema.name.removeprefix("foxglove.") in schemas[kind]
    assert everything == bridge.CHANNELS.keys() - {"touch", "tf"}


def test_the_layout_plots_numbers_that_are_published() -> None:
    kinds = {"contact": Contact, "health": Health}
    for topic, key in re.findall(r"/tacshade/demo/(\w+)\.(\w+)", json.dumps(LAYOUT["configById"])):
        assert key in {field.name for field in fields(kinds[topic])}


def keys(kind: type[Any]) -> set[str]:
    """What a class of Foxglove's layouts has in JSON."""
    words = (field.name.split("_") for field in fields(kind))
    return {first + "".join(word.capitalize() for word in rest) for first, *rest in words}


def test_the_layout_has_keys_that_foxglove_knows() -> None:
    layouts = pytest.importorskip("foxglove.layouts", reason="the extra foxglove is not installed")
    kinds = {
        "3D": layouts.ThreeDeeConfig,
        "Image": layouts.ImageConfig,
        "Plot": layouts.PlotConfig,
        "RosOut": layouts.LogConfig,
    }
    for panel, config in LAYOUT["configById"].items():
        assert config.keys() <= keys(kinds[panel.partition("!")[0]])
        assert config.get("imageMode", {}).keys() <= keys(layouts.ImageModeConfig)
        assert config.get("cameraState", {}).keys() <= keys(layouts.ThreeDeeCameraState)
        for path in config.get("paths", ()):
            assert path.keys() <= keys(layouts.PlotSeries)
    places = re.findall(r'"(?:first|second)": "([^"]+)"', json.dumps(LAYOUT["layout"]))
    assert sorted(places) == sorted(LAYOUT["configById"])


# -- Home Assistant --------------------------------------------------------------------------------


class Loader(yaml.SafeLoader):
    """Reads `!input NAME` as ``Input("NAME")``."""


class Input(str):
    __slots__ = ()


Loader.add_constructor("!input", lambda loader, node: Input(loader.construct_scalar(node)))


def inputs(value: Any) -> Iterator[str]:
    if isinstance(value, Input):
        yield str(value)
    elif isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            yield from inputs(one)


def test_the_blueprint_is_for_the_entity_that_is_announced() -> None:
    document = yaml.load(BLUEPRINT.read_text(encoding="utf-8"), Loader)
    about = document.pop("blueprint")
    assert set(inputs(document)) == about["input"].keys()
    announced = encode_discovery("x", version="1", profiles=("fast",))
    domains = {topic.split("/")[1]: json.loads(payload) for topic, payload in announced.items()}
    (wanted,) = about["input"]["contact"]["selector"]["entity"]["filter"]
    assert wanted["integration"] == "mqtt"
    assert domains[wanted["domain"]]["name"] == about["input"]["contact"]["name"] == "Contact"
    # A missing value is unknown, a silent or stopped sensor unavailable: see unknown.md.
    assert [one["to"] for one in document["trigger"]] == ["on", ["unknown", "unavailable"]]
    ids = {one["id"] for one in document["trigger"]}
    assert document["action"][0]["choose"][0]["conditions"][0]["id"] in ids
