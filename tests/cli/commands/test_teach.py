"""`teach` and `recognise`, with the images of a simulated sensor, and `teach --live` with its
camera.
"""

from __future__ import annotations

import itertools
import json
import threading
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from support.calibrated_sensor import calibrated, pressed, unloaded
from support.mqtt_rig import Broker
from support.patience import wait_until
from support.progress_lines import without_progress
from support.published_sensor import DISC, PublishedSensor, bump, unmeasured
from tacshade_edge.calibration.files import calibration_file, objects_file
from tacshade_edge.cli import EXIT_CONFIG, main
from tacshade_edge.cli.commands.teach import deepest_of_each
from tacshade_edge.library.result import Result, result_of
from tacshade_edge.types import Geometry

PROFILES = ("accurate", "balanced", "fast")


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("touches")
    for name in ("ball", "cube"):
        (folder / name).mkdir()
        for k, depth_mm in enumerate((2.5, 3.5)):
            cv2.imwrite(str(folder / name / f"{k}.png"), pressed(name, depth_mm).image)
        cv2.imwrite(str(folder / f"{name}.png"), pressed(name, 3.0).image)
    cv2.imwrite(str(folder / "bar.png"), pressed("bar", 3.0).image)
    cv2.imwrite(str(folder / "free.png"), unloaded())
    cv2.imwrite(str(folder / "black.png"), unloaded() * 0)
    return folder


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    path = tmp_path / "cal.npz"
    calibration_file.save(path, calibrated())
    return path


def taught(calibration: Path) -> dict[str, dict[str, int]]:
    known = objects_file.load(objects_file.path_beside(calibration))
    return {p: {o.name: len(o.touches) for o in objects} for p, objects in known.items()}


def teach(calibration: Path, *words: object) -> int:
    return main(["teach", *map(str, words), "--calibration", str(calibration)])


def recognise(calibration: Path, *words: object) -> int:
    return main(["recognise", "--calibration", str(calibration), *map(str, words)])


@pytest.mark.slow
def test_taught_objects_are_recognised(
    calibration: Path, images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert teach(calibration, "ball", images / "ball") == 0
    assert teach(calibration, "cube", images / "cube" / "0.png") == 0
    assert teach(calibration, "cube", images / "cube" / "1.png") == 0
    assert taught(calibration) == {profile: {"ball": 2, "cube": 2} for profile in PROFILES}
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].endswith("taught cube by 1 touch; 2 objects known: ball, cube")

    shown = [images / f"{name}.png" for name in ("ball", "cube", "bar", "free")]
    assert recognise(calibration, *shown) == 0
    found = [line.rpartition(": ")[2] for line in capsys.readouterr().out.splitlines()]
    assert [text.partition(" (")[0] for text in found] == ["ball", "cube", "unknown", "no contact"]

    assert recognise(calibration, "--json", "--same-object", *shown[:1], images / "ball") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["same_object"]["touches"] == 3
    assert answer["same_object"]["name"] == "ball"
    single = answer["images"][0]["objects"][0]
    assert single["name"] == "ball"
    assert answer["same_object"]["probability"] >= single["probability"] > 0.5

    assert main(words_of_reconstruct(calibration, images / "ball.png")) == 0
    record = json.loads((calibration.parent / "out" / "summary.json").read_text())[0]
    assert record["objects"][0]["name"] == "ball"
    assert record["objects"][0]["probability"] == single["probability"]

    assert teach(calibration, "ball", "--forget") == 0
    assert taught(calibration) == {profile: {"cube": 2} for profile in PROFILES}
    assert teach(calibration, "cube", "--forget") == 0
    assert not objects_file.path_beside(calibration).exists()


def words_of_reconstruct(calibration: Path, image: Path) -> list[str]:
    out = str(calibration.parent / "out")
    return ["reconstruct", "--calibration", str(calibration), "--out", out, str(image)]


@pytest.mark.slow
def test_images_without_a_firm_touch_are_named_and_the_others_used(
    calibration: Path, images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = [images / f"{name}.png" for name in ("free", "ball", "black")]
    assert teach(calibration, "ball", *shown, "--profile", "fast") == 1
    assert taught(calibration) == {"fast": {"ball": 1}}
    captured = capsys.readouterr()
    lines = without_progress(captured.err)
    assert any("free.png: found no touch that is firm enough" in line for line in lines)
    assert any("black.png: invalid: " in line for line in lines)
    assert "Traceback" not in captured.err

    assert teach(calibration, "nothing", shown[0]) == EXIT_CONFIG
    assert taught(calibration) == {"fast": {"ball": 1}}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a b", "x.png"], "name: found a b, expected 1 to 64 letters"),
        (["nut"], "IMG: found no image, expected at least one"),
        (["nut", "x.png", "--forget"], "IMG: found images, expected none"),
        (["nut", "--forget"], "found no object nut, expected one of 0 objects known"),
    ],
)
def test_mistakes_are_one_line(
    calibration: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    assert teach(calibration, *words) == EXIT_CONFIG
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


def test_one_place_of_touches_is_expected(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["teach", "nut", "x.png"]) == EXIT_CONFIG
    assert "--calibration, --live: found neither, expected one" in capsys.readouterr().err


def test_recognise_says_where_nothing_is_taught(
    calibration: Path, images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert recognise(calibration, images / "ball.png") == EXIT_CONFIG
    (line,) = capsys.readouterr().err.splitlines()
    assert "cal.objects.npz: found no object that balanced was taught" in line


def test_a_damaged_file_of_objects_is_one_line(
    calibration: Path, images: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    objects_file.path_beside(calibration).write_bytes(b"PK")
    assert recognise(calibration, images / "ball.png") == EXIT_CONFIG
    (line,) = capsys.readouterr().err.splitlines()
    assert "cal.objects.npz: found text that begins with 'PK'; expected a file of objects" in line


def test_the_deepest_frame_of_each_contact_is_taken() -> None:
    geometry = Geometry(20.0, 14.0, 50.0, calibrated().geometry.disc)

    def result(seq: int, depth_mm: float, *, valid: bool = True) -> Result:
        made = replace(bump(seq, depth_mm, 100, 100), valid=valid)
        return result_of(made, geometry, None, None)

    depths_mm = (0, 1.0, 2.5, 2.0, 0, 0, 1.5, 0, 3.0)
    results = [result(seq, depth_mm) for seq, depth_mm in enumerate(depths_mm)]
    results.insert(3, result(99, 9.0, valid=False))
    results.insert(3, result_of(unmeasured(98), geometry, None, None))
    assert [each.seq for each in deepest_of_each(results)] == [2, 6, 8]
    assert list(deepest_of_each([])) == []


@pytest.mark.slow
def test_live_touches_of_the_camera(
    calibration: Path, images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "seen").mkdir()
    for k, name in enumerate(("free", "ball", "free", "ball/0")):
        (tmp_path / "seen" / f"{k}.png").write_bytes((images / f"{name}.png").read_bytes())
    config = tmp_path / "config.yaml"
    config.write_text(
        f"calibration: {calibration}\nsource: {{kind: files, path: seen, fps: 4, loop: true}}\n"
        "mqtt: {host: 127.0.0.1, port: 1}\n"
    )
    assert main(["teach", "ball", "--live", "--touches", "2", "--config", str(config)]) == 0
    assert taught(calibration) == {"balanced": {"ball": 2}}
    captured = capsys.readouterr()
    assert "touch 2 of 2: " in captured.out
    assert "no daemon is heard, so the camera is opened" in captured.err


@pytest.mark.slow
@pytest.mark.broker
def test_live_touches_of_the_running_daemon(
    calibration: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "config.yaml"
    ended: list[int] = []
    with Broker(tmp_path) as broker, PublishedSensor(broker.port, "drawn") as sensor:
        config.write_text(
            f"sensor_id: drawn\ncalibration: {calibration}\nsource: {{kind: simulated}}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
        )
        words = ["teach", "nut", "--live", "--touches", "2", "--config", str(config)]
        thread = threading.Thread(target=lambda: ended.append(main(words)))
        thread.start()
        seq = itertools.count()

        def pressed_again() -> bool:
            for depth_mm in (0.0, 1.5, 2.5, 0.0):
                sensor.show(bump(next(seq), depth_mm, DISC.row_c, DISC.col_c, 4))
            return bool(ended)

        wait_until(pressed_again, 20, "two touches")
        thread.join()
    assert ended == [0]
    assert taught(calibration) == {"fast": {"nut": 2}}
    assert "touch 2 of 2: " in capsys.readouterr().out
