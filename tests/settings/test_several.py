"""A file of several sensors, and numbers as a person reads them in every file that we read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.calibration.files.indenter_file import read_indenters_file
from tacshade_edge.calibration.files.sensor_file import read_sensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.settings import Rpicam, Serial, Simulated, load, load_all, load_hand, strict_yaml

TWO = """\
profile: fast
mqtt: {host: board, username: hand}
recorder: {folder: recs}
sensors:
  thumb: {calibration: t.npz, source: {kind: simulated, fps: 20}}
  index:
    calibration: i.npz
    source: {kind: rpicam, camera: 1}
    profile: accurate
    mqtt: {username: index}
    stitching: {folder: maps}
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "s.yaml"
    path.write_text(text)
    return path


def test_what_all_have_with_what_each_has_over_it(tmp_path: Path) -> None:
    thumb, index = (document.settings for document in load_all(write(tmp_path, TWO)))
    assert (thumb.sensor_id, thumb.profile, thumb.source) == ("thumb", "fast", Simulated(fps=20))
    assert (index.sensor_id, index.profile, index.source) == ("index", "accurate", Rpicam(camera=1))
    assert [(s.mqtt.host, s.mqtt.username) for s in (thumb, index)] == [
        ("board", "hand"),
        ("board", "index"),
    ]
    assert (thumb.calibration, index.calibration) == (
        str(tmp_path / "t.npz"),
        str(tmp_path / "i.npz"),
    )


def test_folders_of_all_have_one_below_for_each_and_its_own_are_as_they_are(tmp_path: Path) -> None:
    thumb, index = (document.settings for document in load_all(write(tmp_path, TWO)))
    assert (thumb.recorder.folder, index.recorder.folder) == (
        f"{tmp_path}/recs/thumb",
        f"{tmp_path}/recs/index",
    )
    assert thumb.stitching.folder == "/var/lib/tacshade-edge/sessions/thumb"
    assert index.stitching.folder == f"{tmp_path}/maps"


def test_one_of_them_is_taken_by_its_id(tmp_path: Path) -> None:
    path = write(tmp_path, TWO)
    assert load(path, "index").settings.sensor_id == "index"
    assert load(path, "index").where("source", "camera") == f"{path}:8: sensors.index.source.camera"
    assert load(path, "thumb").where("mqtt", "host") == f"{path}:2: mqtt.host"
    with pytest.raises(
        ConfigError,
        match="found several sensors but no --sensor, expected --sensor with one of thumb, index",
    ):
        load(path)
    with pytest.raises(ConfigError, match=r"--sensor: found ring"):
        load(path, "ring")


GOOD_SENSOR = "{calibration: t.npz, source: {kind: v4l2, device: /dev/video0}}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sensors:\n", "1: sensors: found nothing"),
        ("sensors: {}\n", "1: sensors: found 0"),
        ("sensors: [a]\n", "1: sensors: found a list"),
        ("calibration: c.npz\nsensors: {a: {}}\n", "1: calibration: found beside sensors"),
        (f"mqtt: {{port: 0}}\nsensors:\n  a: {GOOD_SENSOR}\n", "1: mqtt.port: found 0"),
        (
            f"sensors:\n  a: {GOOD_SENSOR}\n  b: {GOOD_SENSOR}\n",
            "3: sensors.b.calibration: found the same as in ",
        ),
        (
            f"sensors:\n  a: {GOOD_SENSOR}\n  b: {GOOD_SENSOR.replace('t.npz', 'b.npz')}\n",
            "3: sensors.b.source: found the same as in sensors.a.source",
        ),
        (f"sensors:\n  a b: {GOOD_SENSOR}\n", "2: sensors.a b.sensor_id: found a b"),
        ("sensors:\n  a: {sensor_id: b}\n", "2: sensors.a.sensor_id: found a second id"),
        ("sensors:\n  a: {source: {kind: simulated}}\n", " sensors.a.calibration: found nothing"),
        ("sensors:\n  a:\n", "2: sensors.a: found nothing"),
        (
            f"sensors:\n  a: {GOOD_SENSOR.replace('}}', '}, profile: slow}')}\n",
            "2: sensors.a.profile: found slow",
        ),
    ],
)
def test_a_mistake_among_several_has_its_line(tmp_path: Path, text: str, said: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_all(path)
    assert str(caught.value).removeprefix(f"{path}:").startswith(said)


HAND = """\
hand_id: left
mqtt: {host: board, username: left, password_file: left.password}
sensors:
  thumb: {calibration: t.npz, source: {kind: simulated}, hand_T_sensor: [1, 2.5, -3, 1, 0, 0, 0]}
  index:
    calibration: i.npz
    source: {kind: simulated}
    mqtt: {username: index}
    hand_T_sensor: [0, 0, 90, 0.6, 0, 0.8, 0]
"""


def test_a_hand_has_its_own_broker_settings_and_each_finger_its_place(tmp_path: Path) -> None:
    path = write(tmp_path, HAND)
    thumb, index = (document.settings for document in load_all(path))
    assert (thumb.hand_id, thumb.hand_T_sensor) == ("left", [1, 2.5, -3, 1, 0, 0, 0])
    assert (index.hand_id, index.mqtt.username) == ("left", "index")
    hand = load_hand(path)
    assert hand is not None
    assert (hand.hand_id, hand.fingers) == ("left", ("thumb", "index"))
    mqtt = hand.common.settings.mqtt
    assert (mqtt.host, mqtt.username, mqtt.password_file) == (
        "board",
        "left",
        str(tmp_path / "left.password"),
    )
    assert hand.common.where("mqtt", "username") == f"{path}:2: mqtt.username"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            ", hand_T_sensor: [1, 2.5, -3, 1, 0, 0, 0]",
            "",
            " sensors.thumb.hand_T_sensor: found nothing",
        ),
        ("[1, 2.5, -3, 1, 0, 0, 0]", "null", "4: sensors.thumb.hand_T_sensor: found nothing"),
        ("-3, 1, 0, 0, 0]", "1, 0, 0, 0]", "4: sensors.thumb.hand_T_sensor: found a list of 6"),
        (
            "-3, 1, 0, 0, 0]",
            "-3, 2, 0, 0, 0]",
            "4: sensors.thumb.hand_T_sensor: found a quaternion of length 2, ex",
        ),
        (
            "[0, 0, 90,",
            "[0, 0, 9.0e+7,",
            "9: sensors.index.hand_T_sensor: found a place 9e+07 mm away",
        ),
        ("[0, 0, 90,", "[0, 0, up,", "9: sensors.index.hand_T_sensor.2: found up"),
        (
            "[0, 0, 90,",
            "[1.03, 2.5, -2.91,",
            "9: sensors.index.hand_T_sensor: found 0.095 mm from thumb, expected sensors that do "
            "not overlap, with x, y, z in mm: are they in m?",
        ),
        ("hand_id: left\n", "", "3: sensors.thumb.hand_T_sensor: found it without hand_id"),
        ("hand_id: left\n", "hand_id: my hand\n", "1: hand_id: found my hand"),
        (
            "    mqtt: {",
            "    hand_id: right\n    mqtt: {",
            "8: sensors.index.hand_id: found in a sensor",
        ),
        (
            "sensors:\n",
            "hand_T_sensor: [0, 0, 0, 1, 0, 0, 0]\nsensors:\n",
            "3: hand_T_sensor: found beside sensors",
        ),
    ],
)
def test_what_is_wrong_with_a_hand_has_its_line(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    assert old in HAND
    path = write(tmp_path, HAND.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        load_all(path)
    assert str(caught.value).removeprefix(f"{path}:").startswith(said)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hand_id: left\n", "hand_id: found left"),
        ("hand_T_sensor: [0, 0, 0, 1, 0, 0, 0]\n", "hand_T_sensor: found it without hand_id"),
    ],
)
def test_one_sensor_is_no_hand(tmp_path: Path, text: str, said: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=rf"^{path}:1: {said}"):
        load_all(path)


def test_a_robots_line_is_shared_and_one_may_have_its_own_or_none(tmp_path: Path) -> None:
    path = write(
        tmp_path, f"serial: {{device: /dev/ttyACM0, baud: 460800}}\n{TWO}    serial: null\n"
    )
    thumb, index = (document.settings for document in load_all(path))
    assert thumb.serial == Serial(device="/dev/ttyACM0", baud=460800)
    assert index.serial is None
    path = write(
        tmp_path, f"serial: {{device: /dev/ttyACM0}}\n{TWO}    serial: {{device: /dev/ttyACM1}}\n"
    )
    assert [document.settings.serial for document in load_all(path)] == [
        Serial(device="/dev/ttyACM0"),
        Serial(device="/dev/ttyACM1"),
    ]
    path = write(tmp_path, f"serial: {{device: /dev/ttyACM0}}\n{TWO}    serial: {{baud: 9600}}\n")
    said = "13: sensors.index.serial: found a different baud"
    with pytest.raises(ConfigError, match=said):
        load_all(path)


SENSOR = "skin_radius_mm: {}\nvisible_half_angle_deg: 50\npolarity: bright\n"
FILES: list[tuple[str, Callable[[Path], object]]] = [
    ("source: {{kind: simulated}}\nserial: {{device: /dev/ttyUSB0, baud: {}}}\n", load),
    ("source: {{kind: v4l2, width: {}}}\n", load),
    (SENSOR, read_sensor),
    ("flange_T_sensor: [{}, 0, 0, 1, 0, 0, 0]\n" + SENSOR.format(20), read_sensor),
    ("pin: {{shape: ball, radius_mm: {}}}\n", read_indenters_file),
]


@pytest.mark.parametrize(("text", "read"), FILES)
@pytest.mark.parametrize(
    ("number", "meant"),
    [
        ("0115200", 39552),
        ("-017", -15),
        ("020.5", 20.5),
        ("1_000", 1000),
        ("0x28", 40),
        ("1:30", 90),
    ],
)
def test_a_number_that_yaml_reads_in_its_own_way_is_refused(
    tmp_path: Path, text: str, read: Callable[[Path], object], number: str, meant: float
) -> None:
    path = tmp_path / "any.yaml"
    path.write_text(text.format(number))
    expected = (
        f"found {number}, which YAML reads as {meant}, expected a plain decimal number, "
        "or quotes around text"
    )
    with pytest.raises(ConfigError) as refused:
        read(path)
    assert expected in str(refused.value)
    assert str(refused.value).startswith(f"{path}:")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("3e1", 30),
        ("3E+1", 30),
        ("2.5e1", 25),
        ("-.5", -0.5),
        ("1.", 1),
        ("+7", 7),
        ("0", 0),
        ("-0.0", 0),
        ("1e-3", 0.001),
        ("1.0e-05", 1e-5),
        ("0.5", 0.5),
        ("'3e1'", "3e1"),
        ("'040'", "040"),
        ("080", "080"),
        ("1e", "1e"),
        ("e1", "e1"),
        ("٣", "٣"),
    ],
)
def test_plain_decimals_are_numbers_and_quoted_ones_are_text(
    tmp_path: Path, text: str, value: object
) -> None:
    path = tmp_path / "any.yaml"
    path.write_text(f"a: {text}\n", encoding="utf-8")
    found = strict_yaml.read(path).value
    assert found == {"a": value}
    assert type(found["a"]) in ((str,) if isinstance(value, str) else (int, float))


@given(st.one_of(st.integers(), st.floats(allow_nan=False, allow_infinity=False)))
def test_every_number_that_python_writes_comes_back(
    tmp_path_factory: pytest.TempPathFactory, number: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_text(f"a: {number!r}\n")
    assert strict_yaml.read(path).value == {"a": number}
