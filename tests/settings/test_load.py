"""Settings files that must be refused, each with its one line, and the default file."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.errors import ConfigError
from tacshade_edge.settings import (
    Files,
    Rpicam,
    Serial,
    Settings,
    Simulated,
    V4l2,
    digest,
    file_schema,
    json_schema,
    load,
    to_yaml,
)

DEFAULT = Path(__file__).parents[2] / "config" / "default.yaml"


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "s.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("mqtt:\n  prot: 1\n", ":2: mqtt.prot: found an unknown key"),
        ("mqtt:\n  port: abc\n", ":2: mqtt.port: found abc"),
        ("mqtt:\n  port: 70000\n", ":2: mqtt.port: found 70000"),
        ("mqtt:\n  port: 1.5\n", ":2: mqtt.port: found 1.5"),
        ("mqtt:\n  port: yes\n", ":2: mqtt.port: found yes"),
        ("mqtt:\n  port: 99999999999999999999999\n", ":2: mqtt.port: found 999"),
        ("mqtt:\n  username: 7\n", ":2: mqtt.username: found 7"),
        ("mqtt:\n  host: bad host\n", ":2: mqtt.host: found bad host"),
        ("mqtt:\n  host: mqtt://a:1883\n", ":2: mqtt.host: found mqtt://a:1883"),
        ('mqtt:\n  host: "h\\0"\n', r':2: mqtt.host: found "h\0"'),
        (f"mqtt:\n  host: {'a.' * 130}\n", ":2: mqtt.host: found 'a.a."),
        ("mqtt: 3\n", ":1: mqtt: found 3"),
        ("mqtt:\n", ":1: mqtt: found nothing"),
        ("\nsensor_id: a b\n", ":2: sensor_id: found a b"),
        ("sensor_id: hand\n", ":1: sensor_id: found hand"),
        ("sensor_id: 007\n", ":1: sensor_id: found 007, which YAML reads as 7"),
        ("profile: slow\n", ":1: profile: found slow"),
        ("profile: 1\n", ":1: profile: found 1"),
        ("source:\n  kind: usb\n", ":2: source.kind: found usb"),
        ("source:\n  kind: 3\n", ":2: source.kind: found 3"),
        ("source:\n  device: /dev/video1\n", ": source.kind: found nothing"),
        ("source: v4l2\n", ":1: source: found v4l2"),
        ("source:\n  kind: files\n", ": source.path: found nothing"),
        ("source:\n  kind: files\n  path: a\n  fps: .nan\n", ":4: source.fps: found .nan"),
        ("source:\n  kind: v4l2\n  fps: 1e9\n", ":3: source.fps: found 1e9"),
        ("source:\n  kind: v4l2\n  device: video0\n", ":3: source.device: found video0"),
        ("source:\n  kind: v4l2\n  fourcc: H264\n", ":3: source.fourcc: found H264"),
        ("profile: auto\n", ": latency_budget_ms: found nothing with profile auto"),
        (
            "profile: auto\nlatency_budget_ms: null\n",
            ":2: latency_budget_ms: found nothing with profile auto",
        ),
        ("profile: auto\nlatency_budget_ms: 0\n", ":2: latency_budget_ms: found 0"),
        (
            "profile: fast\nlatency_budget_ms: 20\n",
            ":2: latency_budget_ms: found 20 with profile fast",
        ),
        ("serial:\n  baud: 9600\n", ": serial.device: found nothing"),
        ("serial:\n  device: ttyACM0\n", ":2: serial.device: found ttyACM0"),
        ("mqtt:\n  port: 1\n  port: 2\n", ":3: mqtt.port: found again"),
        ('"a\\nb": 1\n', ":1: 'a\\nb': found an unknown key"),
        ("1: a\n", ":1: the file: found a key that is not text"),
        ("? [a]\n: b\n", ":1: the file: found a key that is not text"),
        ("profile: 2026-13-45\n", ":1: profile: found 2026-13-45"),
        ("mqtt:\n  port: 0b_\n", ":2: mqtt.port: found 0b_"),
        ("profile: !!python/name:os.system\n", ":1: profile: found !!python/name"),
        ("a: &x 1\n", ":1: not valid YAML here: an anchor or alias, expected a plain value"),
        ("mqtt:\n  host: [\n", ":3: not valid YAML here"),
        ("a: 1\n---\nb: 2\n", ":2: not valid YAML here"),
        ("profile: a\x00b\n", ": not valid YAML: "),
        (b"profile: fast\nsensor_id: \xff\n", ":2: found byte 0xff"),
        ("", ":1: found nothing"),
        ("\n- a\n", ":2: found a list"),
        ("a: " + "[" * 500, ": found YAML that is nested too deeply"),
        (
            "[" + "0," * 100_000 + "0]",
            ":1: not valid YAML here: more than 10000 values, expected a settings file",
        ),
        ("#" * (1 << 20) + "\n", ": found more than 1048576 bytes"),
    ],
)
def test_a_mistake_is_one_line_with_its_place(tmp_path: Path, text: str | bytes, line: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}{line}")
    assert "\n" not in str(caught.value)


@given(
    st.dictionaries(
        st.text("ab.[]`$0", max_size=4),
        st.recursive(
            st.integers(-1, 1) | st.text("a`", max_size=2),
            lambda inner: (
                st.lists(inner, max_size=2)
                | st.dictionaries(st.sampled_from(["kind", "path", "a`.b"]), inner)
            ),
        ),
        max_size=3,
    ).map(lambda more: {"source": more, "mqtt": more, **more})
)
def test_the_mistake_of_any_mapping_is_a_single_line(
    tmp_path_factory: pytest.TempPathFactory, document: dict[str, Any]
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_text(yaml.safe_dump(document))
    said = str(path)
    try:
        load(path)
    except ConfigError as error:
        said = str(error)
    assert said.startswith(f"{path}")
    assert "\n" not in said


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError,
        match=r"none\.yaml: No such file or directory, expected a settings file; tacshade-edge "
        r"capture FOLDER writes FOLDER/config\.yaml for a new sensor$",
    ):
        load(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match=r"Is a directory, expected a settings file$"):
        load(tmp_path)


def uncommented(kind: str) -> str:
    """The commented source block of one kind in the default file, as YAML."""
    text = DEFAULT.read_text()
    blocks = re.findall(r"(?m)^# source:\n(?:#   .*\n)+", text)
    (block,) = (b for b in blocks if f"kind: {kind}\n" in b)
    return re.sub(r"(?m)^# ", "", block)


def test_the_default_file_is_the_defaults_and_names_every_key() -> None:
    document = load(DEFAULT)
    assert document.settings == Settings()
    written = yaml.safe_load(DEFAULT.read_text())
    assert written == msgspec.to_builtins(
        Settings()
    )  # a key that the file leaves out would differ here
    assert list(written) == list(msgspec.to_builtins(Settings()))


@pytest.mark.parametrize(
    ("kind", "defaults"),
    [("rpicam", Rpicam()), ("files", Files(path="presses/")), ("simulated", Simulated())],
    ids=["rpicam", "files", "simulated"],
)
def test_the_commented_sources_of_the_default_file_are_their_defaults(
    tmp_path: Path, kind: str, defaults: Rpicam | Files | Simulated
) -> None:
    path = write(tmp_path, uncommented(kind))
    assert yaml.safe_load(path.read_text())["source"] == msgspec.to_builtins(defaults)
    assert load(path).settings.source.__class__ is defaults.__class__


def test_the_commented_robot_of_the_default_file_is_its_defaults(tmp_path: Path) -> None:
    block = re.search(r"(?m)^# serial:\n(?:#   .*\n)+", DEFAULT.read_text())
    assert block
    path = write(tmp_path, re.sub(r"(?m)^# ", "", block[0]))
    assert load(path).settings.serial == Serial(device="/dev/ttyACM0")
    assert set(yaml.safe_load(path.read_text())["serial"]) == set(Serial.__struct_fields__)


def test_a_relative_path_counts_from_the_files_folder(tmp_path: Path) -> None:
    text = (
        "calibration: c.npz\n"
        "source: {kind: files, path: x}\n"
        "mqtt: {password_file: p, ca_file: /abs/ca}\n"
    )
    text += "recorder: {folder: r}\nstitching: {folder: s}\n"
    settings = load(write(tmp_path, text)).settings
    assert settings.calibration == str(tmp_path / "c.npz")
    assert settings.source == Files(path=str(tmp_path / "x"))
    assert (settings.mqtt.password_file, settings.mqtt.ca_file) == (str(tmp_path / "p"), "/abs/ca")
    assert (settings.recorder.folder, settings.stitching.folder) == (
        str(tmp_path / "r"),
        str(tmp_path / "s"),
    )


def test_where_names_the_line_of_a_key_or_only_the_file(tmp_path: Path) -> None:
    document = load(write(tmp_path, "\nmqtt:\n  port: 1\n"))
    assert document.where("mqtt", "port") == f"{document.path}:3: mqtt.port"
    assert document.where("calibration") == f"{document.path}: calibration"


def test_the_digest_distinguishes_settings() -> None:
    assert digest(Settings()) == digest(Settings(source=V4l2()))
    assert digest(Settings()) != digest(Settings(sensor_id="b"))
    assert re.fullmatch("[0-9a-f]{12}", digest(Settings()))


def schema_errors(schema: dict[str, Any], value: Any, root: dict[str, Any]) -> list[str]:
    """Where `value` breaks `schema`, by the keywords that our schema uses."""
    types: dict[str, tuple[type, ...]] = {
        "object": (dict,),
        "string": (str,),
        "integer": (int,),
        "null": (type(None),),
    }
    types |= {"number": (int, float), "boolean": (bool,), "array": (list,)}
    errors = []
    if "$ref" in schema:
        errors += schema_errors(root["$defs"][schema["$ref"].rpartition("/")[2]], value, root)
    if "if" in schema:
        branch = "else" if schema_errors(schema["if"], value, root) else "then"
        errors += schema_errors(schema[branch], value, root)
    if "anyOf" in schema and all(schema_errors(option, value, root) for option in schema["anyOf"]):
        errors.append("no option")
    if "type" in schema and not isinstance(value, types[schema["type"]]):
        return ["type"]
    within = (
        schema.get("minimum", value) <= value <= schema.get("maximum", value)
        if "maximum" in schema
        else True
    )
    length = (
        schema.get("minItems", schema.get("minProperties", 0)) <= len(value)
        if hasattr(value, "__len__")
        else True
    )
    if (
        not within
        or not length
        or value not in schema.get("enum", [value])
        or value == schema.get("exclusiveMinimum", ...)
    ):
        errors.append("value")
    if not re.search(schema.get("pattern", ""), str(value)):
        errors.append("pattern")
    if isinstance(value, dict):
        errors += [f"no {k}" for k in schema.get("required", ()) if k not in value]
        rest = (
            {"not": {}}
            if schema.get("additionalProperties") is False
            else schema.get("additionalProperties", {})
        )
        for k, v in value.items():
            of_key = schema.get("properties", {}).get(k, rest)
            errors += [f"unknown {k}"] if "not" in of_key else schema_errors(of_key, v, root)
            errors += schema_errors(schema.get("propertyNames", {}), k, root)
    return errors


def test_the_json_schema_accepts_the_default_file_and_refuses_mistakes() -> None:
    schema = json_schema()
    good = yaml.safe_load(DEFAULT.read_text())
    assert schema_errors(schema, good, schema) == []
    assert schema_errors(schema, yaml.safe_load(uncommented("files")), schema) == []
    assert (
        schema_errors(schema, good | {"profile": "auto", "latency_budget_ms": 20.5}, schema) == []
    )
    assert schema_errors(schema, yaml.safe_load(uncommented("rpicam")), schema) == []
    for wrong in (
        {"x": 1},
        {"mqtt": {"port": 0}},
        {"profile": "slow"},
        {"source": {"kind": "usb"}},
        {"mqtt": None},
        {"profile": "auto"},
        {"latency_budget_ms": 20},
        {"profile": "auto", "latency_budget_ms": 0},
    ):
        assert schema_errors(schema, good | wrong, schema), wrong


def test_the_schema_of_files_takes_one_sensor_and_several() -> None:
    schema, sensor = file_schema(), {"calibration": "c.npz", "source": {"kind": "simulated"}}
    finger = sensor | {"hand_T_sensor": [0, 0, 0, 1, 0, 0, 0]}
    assert schema_errors(schema, {"hand_id": "left", "sensors": {"a": finger}}, schema) == []
    assert schema_errors(schema, yaml.safe_load(DEFAULT.read_text()), schema) == []
    assert (
        schema_errors(schema, {"sensors": {"a": sensor, "b": sensor | {"profile": "fast"}}}, schema)
        == []
    )
    for wrong in (
        {"sensors": {}},
        {"sensors": {"a b": sensor}},
        {"sensors": {"a": {"source": {"kind": "simulated"}}}},
        {"sensors": {"a": sensor}, "source": None},
        {"sensors": {"a": sensor | {"sensor_id": "b"}}},
        {"x": 1},
        {"hand_id": "left"},
        {"hand_T_sensor": finger["hand_T_sensor"]},
        {"sensors": {"a": finger}},
        {"hand_id": "left", "sensors": {"a": sensor}},
        {"hand_id": "a b", "sensors": {"a": finger}},
        {"hand_id": "left", "sensors": {"a": finger | {"hand_T_sensor": [0, 0, 0]}}},
    ):
        assert schema_errors(schema, wrong, schema), wrong


def test_auto_is_loaded_with_its_budget(tmp_path: Path) -> None:
    settings = load(write(tmp_path, "profile: auto\nlatency_budget_ms: 20\n")).settings
    assert (settings.profile, settings.latency_budget_ms) == ("auto", 20.0)
    assert load(write(tmp_path, to_yaml(settings))).settings == settings


def test_a_pipe_as_settings_does_not_hang(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "s.yaml")
    with pytest.raises(ConfigError, match=r"s\.yaml: found no regular file"):
        load(tmp_path / "s.yaml")


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("kind: rpicam, fps: 60, exposure_us: 16666", ""),
        ("kind: rpicam, fps: 60, exposure_us: 16667", ":1: source.exposure_us: found 16667"),
        ("kind: rpicam, fps: 240", ": source.exposure_us: found 10000"),
        ("kind: v4l2, fps: 30, exposure: 333", ""),
        ("kind: v4l2, fps: 30, exposure: 334", ":1: source.exposure: found 334"),
    ],
)
def test_an_exposure_that_is_longer_than_a_frame_is_refused(
    tmp_path: Path, source: str, said: str
) -> None:
    path = write(tmp_path, f"source: {{{source}}}\n")
    if not said:
        load(path)
        return
    with pytest.raises(ConfigError) as refused:
        load(path)
    assert f"{path}{said}" in str(refused.value)
