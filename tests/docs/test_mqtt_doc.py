"""docs/reference/mqtt/: its decoders run, its vector is one of ours, its table is the header."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.patience import patience
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.stitching.session import MapPublisher, MapRevision
from tacshade_edge.stitching.stitcher import Raster
from tacshade_edge.wire import binary
from tacshade_edge.wire.topics import OF_SENSORS

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs/reference/mqtt"
WIRE_JS = ROOT / "tacshade_edge" / "dashboard" / "static" / "wire.js"
VECTORS = json.loads((ROOT / "tests" / "wire" / "vectors" / "wire.json").read_text())
HAND_VECTORS = json.loads((ROOT / "tests" / "wire" / "vectors" / "hand.json").read_text())
TOUCH_VECTORS = json.loads((ROOT / "tests" / "wire" / "vectors" / "touch.json").read_text())
NODE = shutil.which("node")
FLAGS = {1: "contact", 2: "invalid", 4: "saturated", 8: "degraded", 32: "touched"}

# Reads lines of hex; each is decoded from a view at an odd offset of a larger buffer,
# as mqtt.js delivers it.
HARNESS = """
const plain = (k, v) =>
  typeof v === "bigint" ? v.toString() : ArrayBuffer.isView(v) ? Array.from(v) : v;
for (const line of require("fs").readFileSync(0, "latin1").trimEnd().split("\\n")) {
  const bytes = Buffer.from(line.slice(1), "hex"), big = Buffer.alloc(bytes.length + 7);
  bytes.copy(big, 3);
  let answer;
  try { answer = NAME(big.subarray(3, 3 + bytes.length)); }
  catch (e) { answer = { error: e.message }; }
  console.log(JSON.stringify(answer, plain));
}
"""


def code(language: str, page: str = "frames") -> str:
    (found,) = re.findall(
        rf"```{language}\n(.*?)```", (PAGES / f"{page}.md").read_text(), re.DOTALL
    )
    return str(found)


def decoded(name: str, payloads: list[bytes]) -> list[Any]:
    """What a function of the dashboard's decoders, which the pages name, answers."""
    assert NODE is not None
    script, exported = WIRE_JS.read_text().split("\nexport ")
    assert name in re.findall(r"\w+", exported)
    command = [NODE, "-e", script + HARNESS.replace("NAME", name)]
    lines = "".join(f"x{payload.hex()}\n" for payload in payloads)
    done = subprocess.run(
        command, input=lines, capture_output=True, text=True, timeout=patience(60), check=True
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


needs_node = pytest.mark.skipif(NODE is None, reason="Node.js is not installed")


def values(sequence: Any) -> Any:
    """As float64 with null for NaN: JSON has none."""
    return np.array([np.nan if v is None else v for v in sequence], np.float64)


@pytest.mark.node
@needs_node
def test_the_decoder_understands_every_sound_vector_and_refuses_the_damaged() -> None:
    sound, damaged = ([v for v in VECTORS if key in v] for key in ("expect", "error"))
    answers = decoded("decode", [bytes.fromhex(v["hex"]) for v in sound])
    assert len(answers) == len(sound) >= 6
    for answer, expect in zip(answers, (v["expect"] for v in sound), strict=True):
        assert [answer["seq"], *map(int, (answer["t_ns"], answer["wall_ns"]))] == [
            expect[key] for key in ("seq", "t_ns", "wall_ns")
        ]
        assert answer["flags"] & sum(FLAGS) == sum(
            bit for bit, name in FLAGS.items() if expect[name]
        )
        assert (answer["pose"] and list(answer["pose"])) == expect["pose"]
        if expect["kind"] in ("height", "shear", "sigma"):
            name = f"{expect['kind']}_mm"
            np.testing.assert_allclose(values(answer[name]), values(expect[name]), rtol=1e-6)
            assert [answer[k] for k in ("row0", "col0", "step_px")] == [
                expect[k] for k in ("row0", "col0", "step_px")
            ]
        else:
            assert (answer["points_mm"], answer["labels"]) == (
                expect["points_mm"],
                expect["labels"],
            )
    answers = decoded("decode", [bytes.fromhex(v["hex"]) for v in damaged])
    assert len(answers) == len(damaged) >= 10
    assert [v["name"] for v, a in zip(damaged, answers, strict=True) if "error" not in a] == []


@pytest.mark.node
@needs_node
def test_the_decoder_of_a_hand_understands_and_refuses_every_vector() -> None:
    answers = decoded("decodeHand", [v["payload"].encode() for v in HAND_VECTORS])
    assert [
        v["name"]
        for v, a in zip(HAND_VECTORS, answers, strict=True)
        if ("error" in a) != ("error" in v)
    ] == []
    for vector, answer in zip(HAND_VECTORS, answers, strict=True):
        if "expect" in vector:
            expect, fingers = vector["expect"], answer["fingers"]
            assert {name: finger["state"] for name, finger in fingers.items()} == expect["states"]
            assert [o["centroid_mm"] for f in fingers.values() for o in f["objects"]] == expect[
                "centroids_mm"
            ]
            assert [finger["age_ms"] for finger in fingers.values()] == expect["ages_ms"]


def test_what_is_reported_of_a_map_is_what_the_text_shows() -> None:
    z = np.array([[np.nan, 1.25, 1.5], [-0.5, np.nan, 0.75]], np.float32)
    revision = MapRevision("pad-1", 5, 4, 4, 1, "/s/pad-1", lambda: Raster(z, 120.0, -3.5, 0.25))
    reported: dict[str, bytes] = {}
    MapPublisher(reported.__setitem__).publish(revision)
    assert json.loads(reported["map/final"]) == json.loads(code("json", "map"))
    vector = next(v["expect"] for v in VECTORS if v["name"] == "map cloud")
    cloud = binary.decode(reported["map/cloud"])
    assert isinstance(cloud, binary.CloudMessage)
    assert (cloud.points_mm.ravel().tolist(), cloud.labels.tolist()) == (
        vector["points_mm"],
        vector["labels"],
    )
    assert (cloud.seq, cloud.contact) == (vector["seq"], vector["contact"])


def test_the_touch_in_the_text_is_the_first_of_its_vectors() -> None:
    assert json.loads(code("json")) == json.loads(TOUCH_VECTORS[0]["payload"])


def test_vector_in_the_text_is_one_of_the_file() -> None:
    assert "".join(code("text").split()) == VECTORS[0]["hex"]


def test_every_reason_has_its_row() -> None:
    """Each code of the enumeration once, and no other."""
    rows = re.findall(r"^- `([a-z_]+)`", (PAGES / "reasons.md").read_text(), re.MULTILINE)
    codes = [code.value for code in ReasonCode]
    assert sorted(set(codes) - set(rows)) == [], "reasons without a row"
    assert sorted(rows) == sorted(codes)


def test_every_topic_has_its_row() -> None:
    table = (
        (PAGES.parent / "mqtt.md").read_text().partition("## Topics")[2].partition("\n\nIn a")[0]
    )
    rows = set(
        re.findall(r"`([a-z/<>]+)`", "".join(re.findall(r"^\|([^|]+)", table, re.MULTILINE)))
    )
    assert {re.sub("<.*", "", name) for name in rows} == {*OF_SENSORS, "req/", "doctor"}


def test_header_table_is_without_a_gap() -> None:
    """Every byte of the header is in the table once; N and the size share theirs."""
    sizes = {
        "4 bytes": 4,
        "u8": 1,
        "u32": 4,
        "u64": 8,
        "u16, u16": 4,
        "f32": 4,
        "3 × f32": 12,
        "7 × f32": 28,
    }
    rows = re.findall(r"^\| (\d+) \| ([^|]+) \|", (PAGES / "frames.md").read_text(), re.MULTILINE)
    position = 0
    for offset, kind in rows:
        if (offset, kind) == ("32", "u32"):
            continue
        assert int(offset) == position
        position += sizes[kind]
    assert position == binary.HEADER_BYTES
