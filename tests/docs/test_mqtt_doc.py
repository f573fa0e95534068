"""docs/reference/mqtt/: its decoders run, its vector is one of ours, its table is the header."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tacshade_client
from paho.mqtt.client import topic_matches_sub

from tacshade_edge.core.stitching.surface_map import Raster
from tacshade_edge.daemon.session import MapPublisher, MapRevision
from tacshade_edge.protocol import wire
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import HeightMap, ObjectCloud, Pose, Reconstruction
from tools.testbed.patience import patience

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs/reference/mqtt"
WIRE_JS = ROOT / "tacshade_edge" / "dashboard" / "static" / "wire.js"
VECTORS = json.loads((ROOT / "tests" / "protocol" / "vectors" / "wire.json").read_text())
HAND_VECTORS = json.loads((ROOT / "tests" / "protocol" / "vectors" / "hand.json").read_text())
TOUCH_VECTORS = json.loads((ROOT / "tests" / "protocol" / "vectors" / "touch.json").read_text())
NODE = shutil.which("node")

# Reads lines of hex; each is decoded from a view at an odd offset of a larger buffer, as mqtt.js delivers it.
HARNESS = """
const plain = (k, v) => typeof v === "bigint" ? v.toString() : ArrayBuffer.isView(v) ? Array.from(v) : v;
for (const line of require("fs").readFileSync(0, "latin1").trimEnd().split("\\n")) {
  const bytes = Buffer.from(line.slice(1), "hex"), big = Buffer.alloc(bytes.length + 7);
  bytes.copy(big, 3);
  let answer;
  try { answer = decode(big.subarray(3, 3 + bytes.length)); } catch (e) { answer = { error: e.message }; }
  console.log(JSON.stringify(answer, plain));
}
"""


def code(language: str, page: str = "frames") -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", (PAGES / f"{page}.md").read_text(), re.DOTALL)
    return str(found)


def javascript(page: str, name: str) -> str:
    """The dashboard's decoders, which the page names, as a script."""
    text = (PAGES / f"{page}.md").read_text()
    assert f"](../../../{WIRE_JS.relative_to(ROOT)})" in text
    assert f"`{name}`" in text or page == "frames"
    script, exported = WIRE_JS.read_text().split("\nexport ")
    assert name in re.findall(r"\w+", exported)
    return script


def by_python(payloads: list[bytes]) -> list[dict[str, Any]]:
    """The client's answers, in the words of the other decoder."""
    assert "](../client.md)" in (PAGES / "frames.md").read_text()
    answers: list[dict[str, Any]] = []
    for payload in payloads:
        try:
            message = tacshade_client.decode(payload)
        except tacshade_client.DecodeError as error:
            answers.append({"error": str(error)})
            continue
        fields = {name: getattr(message, name) for name in message.__dataclass_fields__}
        flags = sum(bit for bit, name in enumerate_flags() if fields[name])
        pose = message.pose and dataclasses.astuple(message.pose)[1:]
        raveled = {name: value.ravel() for name, value in fields.items() if isinstance(value, np.ndarray)}
        answers.append(fields | raveled | {"flags": flags, "pose": pose})
    return answers


def by_javascript(payloads: list[bytes]) -> list[dict[str, Any]]:
    assert NODE is not None
    lines = "".join(f"x{p.hex()}\n" for p in payloads)
    done = subprocess.run(
        [NODE, "-e", javascript("frames", "decode") + HARNESS],
        input=lines,
        capture_output=True,
        text=True,
        timeout=patience(60),
        check=True,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    for answer in answers:
        for key in ("t_ns", "wall_ns"):
            if key in answer:
                answer[key] = int(answer[key])
    return answers


Decoder = Callable[[list[bytes]], list[dict[str, Any]]]
both = pytest.mark.parametrize(
    "decode",
    [
        by_python,
        pytest.param(
            by_javascript,
            marks=[pytest.mark.node, pytest.mark.skipif(NODE is None, reason="Node.js is not installed")],
        ),
    ],
)


def values(sequence: Any) -> Any:
    """As float64 with null for NaN: JSON has none."""
    return np.array([np.nan if v is None else v for v in sequence], np.float64)


@both
def test_decoder_understands_every_sound_vector(decode: Decoder) -> None:
    sound = [v for v in VECTORS if "expect" in v]
    answers = decode([bytes.fromhex(v["hex"]) for v in sound])
    assert len(answers) == len(sound) >= 6
    for answer, expect in zip(answers, (v["expect"] for v in sound), strict=True):
        assert [answer[k] for k in ("seq", "t_ns", "wall_ns")] == [expect[k] for k in ("seq", "t_ns", "wall_ns")]
        flags = sum(bit for bit, name in enumerate_flags() if expect[name])
        assert answer["flags"] & 15 == flags
        assert (answer["pose"] and list(answer["pose"])) == expect["pose"]
        if expect["kind"] in ("height", "shear", "sigma"):
            name = f"{expect['kind']}_mm"
            np.testing.assert_allclose(values(answer[name]), values(expect[name]), rtol=1e-6)
            assert [answer[k] for k in ("row0", "col0", "step_px")] == [expect[k] for k in ("row0", "col0", "step_px")]
        else:
            assert list(answer["points_mm"]) == expect["points_mm"]
            assert list(answer["labels"]) == expect["labels"]


def enumerate_flags() -> list[tuple[int, str]]:
    return [(1, "contact"), (2, "invalid"), (4, "saturated"), (8, "degraded")]


@both
def test_decoder_refuses_every_damaged_vector(decode: Decoder) -> None:
    damaged = [v for v in VECTORS if "error" in v]
    answers = decode([bytes.fromhex(v["hex"]) for v in damaged])
    assert len(answers) == len(damaged) >= 10
    assert [v["name"] for v, a in zip(damaged, answers, strict=True) if "error" not in a] == []


@both
def test_decoder_understands_what_the_encoder_writes_now(decode: Decoder) -> None:
    rng = np.random.default_rng(1)
    height = rng.normal(0, 10, (37, 53)).astype(np.float32)
    height[rng.random(height.shape) < 0.2] = np.nan
    cloud = ObjectCloud(rng.normal(0, 20, (999, 3)).astype(np.float32), rng.integers(1, 2**16, 999, np.uint16))
    grid = HeightMap(height, np.zeros(height.shape, np.bool_), 1.5, 2.5, 4.0)
    glare = Reason(ReasonCode.GLARE, "glare")
    result = Reconstruction(77, 2**60, 5, "fast", True, None, True, True, glare, grid, cloud)
    pose = Pose(2**60, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)
    decoded = decode(
        [
            wire.encode_height(result, calibration_crc32=1, pose=pose, pose_error_us=5),
            wire.encode_cloud(result, calibration_crc32=1),
        ]
    )
    assert [d["seq"] for d in decoded] == [77, 77]
    assert [d["t_ns"] for d in decoded] == [2**60, 2**60]
    assert list(decoded[0]["pose"]) == [1, 2, 3, 1, 0, 0, 0]
    expected = np.clip(height, -32.767, 32.767).ravel()
    np.testing.assert_allclose(values(decoded[0]["height_mm"]), expected, atol=0.000505)
    np.testing.assert_array_equal(values(decoded[1]["points_mm"]), cloud.points_mm.ravel().astype(np.float64))
    np.testing.assert_array_equal(decoded[1]["labels"], cloud.labels)


def hand_by_javascript(payloads: list[bytes]) -> list[Any]:
    assert NODE is not None
    harness = (
        javascript("hand", "decodeHand")
        + """
for (const line of require("fs").readFileSync(0, "latin1").trimEnd().split("\\n")) {
  let answer = null;
  try { answer = decodeHand(Buffer.from(line.slice(1), "hex")); } catch { /* refused */ }
  console.log(JSON.stringify(answer));
}
"""
    )
    lines = "".join(f"x{p.hex()}\n" for p in payloads)
    command = [NODE, "-e", harness]
    done = subprocess.run(command, input=lines, capture_output=True, text=True, timeout=patience(60), check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.node
@pytest.mark.skipif(NODE is None, reason="Node.js is not installed")
def test_the_decoder_of_a_hand_understands_and_refuses_every_vector() -> None:
    answers = hand_by_javascript([v["payload"].encode() for v in HAND_VECTORS])
    assert [v["name"] for v, a in zip(HAND_VECTORS, answers, strict=True) if (a is None) != ("error" in v)] == []
    for vector, answer in zip(HAND_VECTORS, answers, strict=True):
        if "expect" in vector:
            expect, fingers = vector["expect"], answer["fingers"]
            assert {name: finger["state"] for name, finger in fingers.items()} == expect["states"]
            assert [o["centroid_mm"] for f in fingers.values() for o in f["objects"]] == expect["centroids_mm"]
            assert [finger["age_ms"] for finger in fingers.values()] == expect["ages_ms"]


def test_what_is_told_of_a_map_is_what_the_text_shows() -> None:
    z = np.array([[np.nan, 1.25, 1.5], [-0.5, np.nan, 0.75]], np.float32)
    revision = MapRevision("pad-1", 5, 4, 4, 1, "/s/pad-1", lambda: Raster(z, 120.0, -3.5, 0.25))
    told: dict[str, bytes] = {}
    MapPublisher(told.__setitem__).publish(revision)
    assert json.loads(told["map/final"]) == json.loads(code("json", "map"))
    vector = next(v["expect"] for v in VECTORS if v["name"] == "map cloud")
    cloud = wire.decode(told["map/cloud"])
    assert isinstance(cloud, wire.CloudMessage)
    assert (cloud.points_mm.ravel().tolist(), cloud.labels.tolist()) == (vector["points_mm"], vector["labels"])
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


def test_header_table_is_without_a_gap() -> None:
    """Every byte of the header is in the table once; N and the size share theirs."""
    sizes = {"4 bytes": 4, "u8": 1, "u32": 4, "u64": 8, "u16, u16": 4, "f32": 4, "3 × f32": 12, "7 × f32": 28}
    rows = re.findall(r"^\| (\d+) \| ([^|]+) \|", (PAGES / "frames.md").read_text(), re.MULTILINE)
    position = 0
    for offset, kind in rows:
        if (offset, kind) == ("32", "u32"):
            continue
        assert int(offset) == position
        position += sizes[kind]
    assert position == wire.HEADER_BYTES


@pytest.mark.parametrize(
    "path", [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))], ids=lambda path: path.name
)
def test_an_example_does_not_flood_a_terminal(path: Path) -> None:
    """Where `mosquitto_sub` gets a stream, it ends after a count, and it prints nothing binary."""
    text = {"tacshade/left-index/contact", "tacshade/left-index/touch", "tacshade/hand/left/objects"}
    streams = text | {f"tacshade/left-index/{name}" for name in ("height", "cloud", "shear", "sigma", "preview")}
    binary = streams - text | {"tacshade/left-index/map/cloud"}
    for line in re.findall(r"^    (?:.*\s)?mosquitto_sub\s.*$", path.read_text(), re.MULTILINE):
        words = shlex.split(line, comments=True)
        patterns = [word for flag, word in itertools.pairwise(words) if flag == "-t"]
        got = {topic for topic in streams | binary for pattern in patterns if topic_matches_sub(pattern, topic)}
        assert {"-C", "|"} & set(words) or not got & streams, line
        assert "-F" in words or not got & binary, line
