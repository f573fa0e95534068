import json
import socket
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated, found_prints, simulated
from support.painted_sensor import FREE, HEIGHT, TOUCHED, WIDTH, painted_calibration
from support.progress_lines import only_progress, without_progress
from support.trade_points import row
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main
from tacshade_edge.cli.commands import tradeoff
from tacshade_edge.cli.commands.tradeoff import OwnTwin
from tacshade_edge.lab.demo import child
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.studies.tradeoff.judging import JudgedFrames, Setting
from tacshade_edge.lab.studies.tradeoff.measure import Offer, Promise
from tacshade_edge.lab.trial.trial import Wanted
from tacshade_edge.sensor.profiles import PROFILES


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A calibration, an image of a contact and one without, with their truth."""
    calibration_file.save(tmp_path / "cal.npz", painted_calibration())
    (tmp_path / "images").mkdir()
    rows, cols = np.ogrid[:HEIGHT, :WIDTH]
    coin = np.hypot(rows - 59.5, cols - 79.5) < 20
    for name, image, contact in (("coin", TOUCHED, coin), ("none", FREE, 0 * coin > 0)):
        cv2.imwrite(str(tmp_path / "images" / f"{name}.png"), image)
        np.savez(
            tmp_path / "images" / f"{name}.npz",
            height_mm=np.where(contact, 2.0, 0.0),
            contact=contact,
        )
    return tmp_path


def of_own(folder: Path, *more: str) -> list[str]:
    return [
        "tradeoff",
        "--calibration",
        str(folder / "cal.npz"),
        "--images",
        str(folder / "images"),
        *more,
    ]


@pytest.mark.slow  # it starts interpreters
@pytest.mark.broker
def test_own_images_the_files_and_the_settings(
    own: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tradeoff, "BUSY", 1e9)  # this machine may be
    monkeypatch.setattr(tradeoff, "TAIL_S", 0.3)
    words = of_own(
        own, "--profile", "fast", "--out", str(own / "out"), "--plot", "--budget-ms", "10000"
    )
    assert main(words) == 0
    printed = capsys.readouterr()
    assert only_progress(printed.err)
    *_, settings, daemon, control = printed.out.splitlines()
    assert settings.startswith(("profile: fast", "# calibrate again"))
    assert daemon.startswith(
        "# the daemon itself, here, through a private broker: decoded messages "
    )
    assert control.startswith("# control: plain work of ")
    written = ["tradeoff.csv", "tradeoff.json", "tradeoff.md", "tradeoff.png"]
    assert sorted(p.name for p in (own / "out").iterdir()) == written
    assert (own / "out" / "tradeoff.md").read_text() in printed.out
    rows = json.loads((own / "out" / "tradeoff.json").read_text())["rows"]
    assert {
        (each["scenes"], each["missed"], each["untouched"], each["phantoms"]) for each in rows
    } == {(1, 0, 1, 0)}
    (tried,) = [each for each in rows if each["daemon_p50_ms"] is not None]
    assert tried["outputs"] == "contact height cloud shear sigma"
    assert 0 < tried["daemon_p50_ms"] <= tried["daemon_p99_ms"]
    assert tried["daemon_control_p99_ms"] > 0
    assert [each["outputs"] for each in rows[::2]] == [
        "contact",
        "height",
        "cloud",
        "shear",
        "sigma",
        "contact height cloud shear sigma",
    ]


def judged_nothing(
    monkeypatch: pytest.MonkeyPatch, rows: Sequence[Offer], busy: float = 1.0
) -> list[Sequence[Setting]]:
    """Replace the work by these rows; return the settings asked for."""
    asked: list[Sequence[Setting]] = []
    touched = JudgedFrames("s", TOUCHED, True, np.ones(1, bool), np.zeros((1, 6)))

    def judge(settings: Sequence[Setting], *_: object) -> list[JudgedFrames]:
        asked.append(settings)
        return [touched]

    sensors = [SimpleNamespace(calibration=painted_calibration())]
    monkeypatch.setattr(tradeoff, "calibrate_sensors", lambda *_: sensors)
    monkeypatch.setattr(tradeoff, "simulated", judge)
    monkeypatch.setattr(tradeoff, "measure", lambda *_: (rows, busy))
    return asked


def test_a_need_that_nothing_holds_exits_1(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    judged_nothing(monkeypatch, [row("fast", 0.2, 1.0)], busy=3.0)
    words = [
        "tradeoff",
        "--outputs",
        "height",
        "--fps",
        "60",
        "--fingers",
        "100",
        "--json",
        "--sensors",
        "default",
    ]
    assert main(words) == 1
    printed = capsys.readouterr()
    busy, nothing = without_progress(printed.err)
    assert "the machine was busy: frames took 3.0" in busy
    assert "nothing holds height for 100 fingers" in nothing
    assert len(json.loads(printed.out)["rows"]) == 1


class Nothing:
    """A broker of no trial."""

    def __init__(self, *_: object) -> None:
        """Whatever the settings."""

    def __enter__(self) -> None:
        """Open."""

    def __exit__(self, *_: object) -> None:
        """Close."""


NEED = ["tradeoff", "--outputs", "height", "--fps", "60", "--budget-ms", "10"]
NEED += ["--sensors", "default"]


def tried(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, p99_ms: dict[str, float]
) -> tuple[int, str, str, list[str]]:
    """What the command says of settings whose daemon has these p99 (ms), and which it tried."""
    some = [
        row(name, error, 1.0) for name, error in zip(PROFILES, (0.4, 0.3, 0.2, 0.1), strict=True)
    ]
    judged_nothing(monkeypatch, some)
    asked: list[str] = []

    def try_daemon(wanted: Wanted, *_: object) -> Promise:
        asked.append(wanted.profile)
        return Promise(2.0, p99_ms[wanted.profile], 500, 0, "a broker", 1.0, 1.1)

    monkeypatch.setattr(tradeoff, "TrialBroker", Nothing)
    monkeypatch.setattr(tradeoff, "try_daemon", try_daemon)
    code = main(NEED)
    printed = capsys.readouterr()
    return code, printed.out, "".join(without_progress(printed.err)), asked


def test_what_the_daemon_itself_does_not_hold_is_not_recommended(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    *_, second, first = PROFILES
    found = tried(capsys, monkeypatch, dict.fromkeys(PROFILES, 9.0) | {first: 11.0})
    assert found[0] == 0
    assert found[3] == [first, second]
    assert f"\nprofile: {second}\n" in found[1]
    assert f"# given up: {first} at 640x480: off by 0.100 mm; p99 11.0 ms" in found[1]
    assert "(p50), 9.0 ms (p99); lost after the first second: 0 of 500 frames" in found[1]


def test_no_more_than_a_few_daemons_are_tried(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = tried(capsys, monkeypatch, dict.fromkeys(PROFILES, 11.0))
    assert found[0] == 1
    assert found[3] == list(PROFILES)[:0:-1]
    assert "nothing holds that the daemon was tried with" in found[2]


def test_without_a_broker_the_promise_ends_where_a_message_is_encoded(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    judged_nothing(monkeypatch, [row("fast", 0.2, 1.0)])
    monkeypatch.setattr(tradeoff, "TAIL_S", 0.1)
    monkeypatch.setattr(child.shutil, "which", lambda *_args, **_more: None)
    monkeypatch.setattr(child.importlib.util, "find_spec", lambda _name: None)
    assert main(NEED) == 0
    *_, last = capsys.readouterr().out.splitlines()
    assert last.startswith("# the daemon was not tried (found no broker, expected mosquitto")
    assert "so this ends when a message is encoded: plain work of " in last


def test_the_report_of_a_board_names_no_host(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = judged_nothing(
        monkeypatch, [row(name, 0.2, 1.0) for name in ("fast", "balanced", "accurate")]
    )
    assert main(["tradeoff", "--report"]) == 0
    assert {each.profile for each in asked[0]} == {"fast", "balanced", "accurate"}
    printed = capsys.readouterr().out
    assert "\n- board: " in printed
    assert socket.gethostname() not in printed


@pytest.mark.slow
def test_a_twin_looks_like_its_sensor() -> None:
    found = found_prints()[0]
    model, layout = found.at(found.values)
    twin = OwnTwin(model, found.kind, layout, found.light)
    press = Press(ball(6.0), 2.0, 0.0, 3.0)
    own, like = (sensor.frame((press,), 1) for sensor in (simulated(HALF), twin))
    assert like.image.shape[:2] == own.image.shape[:2] == (240, 320)
    assert like.truth().depth_max_mm == pytest.approx(own.truth().depth_max_mm, rel=0.1)
    assert calibrated().image_width_px == 320


@pytest.mark.parametrize(
    "words",
    [
        ["--plot"],
        ["--outputs", "smell"],
        ["--report", "--budget-ms", "3"],
        ["--calibration", "cal.npz", "--sensors", "default"],
        ["--images", "."],
    ],
)
def test_wrong_usage(words: list[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["tradeoff", *words])


@pytest.mark.slow
def test_what_is_not_there_is_one_line_before_the_work(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (own / "images").glob("coin.*"):
        path.unlink()
    assert main(of_own(own)) == 78
    assert "found no image of a contact to score" in capsys.readouterr().err
    assert main(["tradeoff", "--out", str(own / "cal.npz")]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "cal.npz: cannot write it" in error
