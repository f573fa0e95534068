"""Rows of outputs, their errors, times and memory;
tables, plots, and the settings for what a user needs.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from support.calibrated_sensor import HALF, calibrated, pressed, reconstructor, simulated, step
from support.painted_sensor import painted_calibration
from support.trade_points import row
from tacshade_edge.cli import main
from tacshade_edge.doctor.tail import Tail
from tacshade_edge.lab.parallel import ThisProcess
from tacshade_edge.lab.studies.evaluate.score import KnownTruth
from tacshade_edge.lab.studies.tradeoff import judging, measure, timing, tradeoff_report
from tacshade_edge.lab.studies.tradeoff.judging import (
    OUTPUTS,
    Setting,
    Simulation,
    errors,
    settings,
)
from tacshade_edge.lab.studies.tradeoff.measure import Estimate, Offer, Promise
from tacshade_edge.lab.studies.tradeoff.tradeoff_report import Wish, choose, tail_line
from tacshade_edge.sensor.image.white import halved
from tacshade_edge.types import Frame

NAN = Estimate(math.nan, math.nan, math.nan)


def quiet(what: str, done: int, total: int | None) -> None:
    assert total is None or 0 <= done <= total


def test_settings_are_profile_size_and_networks() -> None:
    fitted = replace(painted_calibration(), fitted={"fast": object()})  # type: ignore[dict-item]
    assert settings(("fast", "accurate"), fitted) == (
        Setting("fast", half=False, fitted=True),
        Setting("fast", half=False, fitted=False),
        Setting("fast", half=True, fitted=True),
        Setting("fast", half=True, fitted=False),
        Setting("accurate", half=False, fitted=False),
        Setting("accurate", half=True, fitted=False),
    )
    assert Setting("paper", half=False, fitted=False).outputs(fitted) == (
        "contact",
        "height",
        "cloud",
    )
    assert "touch" not in Setting("fast", half=False, fitted=True).outputs(fitted)


def known_ball() -> KnownTruth:
    frame = pressed("ball", 3.0)
    truth = frame.truth()
    shear_mm = np.zeros((*truth.contact.shape, 2), np.float32)
    return replace(KnownTruth.of(truth), height_mm=truth.height_mm, shear_mm=shear_mm)


@pytest.mark.slow
def test_errors_are_in_the_units_of_the_outputs() -> None:
    result = step("fast", pressed("ball", 3.0).image)
    found = errors(result, known_ball())
    assert set(found) == {*OUTPUTS} - {"touch"}
    assert all(0 <= found[name] < 0.6 for name in ("contact", "height", "cloud"))
    assert result.shear_mm is not None
    touched = known_ball().contact_on(result.height)
    assert found["shear"] == pytest.approx(
        np.linalg.norm(result.shear_mm[touched], axis=-1).mean(), rel=1e-5
    )
    assert 0 <= found["sigma"] <= 90


def test_a_missed_contact_counts_as_undeformed_skin() -> None:
    truth = known_ball()
    assert truth.height_mm is not None
    assert truth.contact is not None
    found = errors(
        reconstructor("fast").step(Frame(0, 0, 0, np.zeros_like(pressed("ball", 3.0).image))), truth
    )
    assert found["contact"] == found["cloud"] == truth.depth_max_mm
    assert found["height"] == pytest.approx(truth.height_mm[truth.contact].mean(), rel=0.05)
    assert found["shear"] == 0


def test_half_the_size_has_the_same_truth() -> None:
    setting = Setting("fast", half=True, fitted=False)
    image, truth = pressed("ball", 3.0).image, known_ball()
    result = setting.make(calibrated()).step(Frame(0, 0, 0, setting.image(image)))
    assert result.contact
    np.testing.assert_array_equal(setting.image(image), halved(image))
    assert errors(result, truth.halved())["height"] < 0.3
    assert errors(result, truth)["height"] > 0.5


@pytest.mark.slow  # it renders and starts interpreters
def test_all_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "SLICE_MS", 5.0)
    monkeypatch.setattr(measure, "ROUNDS", 3)
    one = Simulation("half", None, lambda: simulated(HALF), calibrated())
    some = settings(("fast",), one.calibration)
    judged = judging.simulated(some, [one], ["ball"], ThisProcess(), quiet)
    assert [each.touched for each in judged] == [True] * 3 + [False] * judging.NULL_FRAMES
    threads = cv2.getNumThreads()
    rows, busy = measure.measure(
        some, [("height",), ("height", "shear", "sigma")], one.calibration, judged, quiet
    )
    assert cv2.getNumThreads() == threads
    assert busy > 0.9
    assert [(each.outputs, each.image) for each in rows[::2]] == [
        (("height",), "320x240"),
        (("height", "shear", "sigma"), "320x240"),
    ]
    for each in rows:
        error, times = each.errors["height"], each.times
        assert 0 < error.low <= error.value <= error.high < 0.6
        assert times.idle_ms > 0
        assert 0 < times.p50_ms <= times.p99_ms
        assert 0 < each.peak_mib < 300
        assert (each.scenes, each.missed, each.untouched, each.phantoms) == (
            3,
            0,
            judging.NULL_FRAMES,
            0,
        )
    assert rows[2].errors["height"] == rows[0].errors["height"]


def test_the_rate_keeps_a_fifth_of_the_processor_free() -> None:
    one = row("fast", 0.2, 4.0)
    assert [one.fps(*each) for each in ((1, 1), (1, 4), (4, 4), (4, 1))] == [200, 200, 200, 50]


ALL = ("height", "shear")
ROWS = [
    row("fast", 0.3, 1.0, outputs=ALL),
    row("fast", 0.35, 0.5, outputs=ALL, half=True),
    row("accurate", 0.1, 3.0, outputs=ALL),
    row("accurate", 0.15, 2.0, outputs=ALL, half=True),
]


def block(rows: Sequence[Offer], wish: Wish) -> str:
    offer, text = choose(rows, wish)
    assert offer
    return text


@pytest.mark.parametrize(
    ("wish", "expected"),
    [
        (Wish(None, None, 1, 4), {"profile": "accurate"}),
        (Wish(6.0, None, 4, 1), {"profile": "accurate"}),
        (Wish(2.0, None, 1, 1), {"profile": "fast"}),
        (Wish(None, 60, 1, 1), {"profile": "accurate", "source": {"kind": "v4l2", "fps": 60}}),
        (
            Wish(5.9, None, 1, 4),
            {"profile": "accurate", "source": {"kind": "v4l2", "width_px": 320, "height_px": 240}},
        ),
        (Wish(None, 90, 4, 2), {"profile": "accurate"}),
        (Wish(None, 250, 4, 4), {"profile": "accurate"}),
        (Wish(None, 500, 4, 4), {"profile": "fast"}),
    ],
)
def test_the_most_accurate_that_holds_as_yaml(
    wish: Wish, expected: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = block(ROWS, wish)
    assert yaml.safe_load(text) == expected
    (tmp_path / "config.yaml").write_text(f"calibration: cal.npz\n{text}\n")
    assert main(["check-config", str(tmp_path / "config.yaml")]) in (
        0,
        1,
    )  # there is no calibration
    assert "config.yaml" in capsys.readouterr().out


def test_what_is_given_up_and_what_holds_nothing() -> None:
    given_up = (
        "# given up: accurate at 640x480: off by 0.100 mm, 0.100 mm; p99 of processor time 6.00 ms"
    )
    assert given_up in block(ROWS, Wish(2.0, None, 1, 4))
    assert "given up: nothing" in block(ROWS, Wish(None, None, 1, 4))
    assert "# source of each sensor: width_px: 320, height_px: 240, fps: 300" in block(
        ROWS, Wish(None, 300, 4, 4)
    )
    offer, text = choose(ROWS, Wish(0.5, 60, 4, 2))
    assert offer is None
    assert text.startswith(
        "nothing holds height, shear for 4 fingers on 2 cores, 60 frames/s, 0.5 ms (p99)"
    )
    assert "the fastest is fast at 320x240" in text
    assert not choose([row("fast", math.nan, math.nan)], Wish(None, None, 1, 1))[0]


def test_without_a_daemon_a_promise_is_made_with_the_machines_own_tail() -> None:
    offer, _ = choose(ROWS, Wish(None, None, 1, 4))
    assert offer
    tail = Tail(
        pieces=300,
        p50_ms=3.1,
        p99_ms=9.0,
        worst_ms=20.0,
        processor_p50_ms=3.0,
        processor_p99_ms=3.1,
    )
    line = tail_line(offer, tail, "no broker")
    assert "(no broker), so this ends when a message is encoded" in line
    assert "plain work of 3.0 ms ends within 9.0 ms in 99 % (3.0 times)" in line
    assert line.endswith(f"expect {3 * offer.times.p99_ms:.1f} ms")


@pytest.mark.parametrize(
    ("p99_ms", "lost", "control_p99_ms", "holds"),
    [
        (6.9, 0, 1.1, True),
        (6.9, 5, 1.1, True),
        (6.9, 6, 1.1, False),
        (7.1, 0, 1.1, False),
        # The machine let plain work wait as well: the settings are not to blame.
        (50.0, 90, 2.1, True),
    ],
)
def test_what_the_daemon_did_decides(
    p99_ms: float, lost: int, control_p99_ms: float, holds: bool
) -> None:
    promise = Promise(2.0, p99_ms, 500, lost, "a broker", 1.0, control_p99_ms)
    tried = replace(row("fast", 0.3, 1.0), promise=promise)
    offer, text = choose([tried], Wish(7.0, 60, 1, 1))
    assert (offer is tried) is holds
    assert ("other programs disturbed both" in text) is promise.is_disturbed
    record = tradeoff_report.record(tried)
    assert (record["daemon_p99_ms"], record["daemon_lost"]) == (p99_ms, lost)


def test_fitted_networks_run_where_there_are_some() -> None:
    better = row("fast", 0.05, 1.0, outputs=ALL)
    assert yaml.safe_load(block([*ROWS, better], Wish(None, None, 1, 4))) == {"profile": "fast"}
    fitted = row("fast", 0.2, 1.0, outputs=ALL, fitted=True)
    assert yaml.safe_load(block([*ROWS, better, fitted], Wish(None, None, 1, 4))) == {
        "profile": "accurate"
    }


def test_an_unknown_error_is_left_out() -> None:
    unknown = [replace(each, errors={"touch": NAN}) for each in ROWS]
    assert (
        yaml.safe_load(block(unknown, Wish(None, None, 1, 4)))["profile"] == "fast"
    )  # the fastest
    lines = list(csv.DictReader(io.StringIO(tradeoff_report.csv_text([*ROWS, unknown[0]]))))
    assert [
        (line["profile"], line["image"], line["height_error"], line["p99_ms"]) for line in lines[1:]
    ] == [
        ("fast", "320x240", "0.35", "1"),
        ("accurate", "640x480", "0.1", "6"),
        ("accurate", "320x240", "0.15", "4"),
        ("fast", "640x480", "", "2"),
    ]
    assert tradeoff_report.table(unknown).count("\n") == 5
    assert tradeoff_report.document(unknown, 1.0)["rows"][0]["touch_error"] is None


@pytest.mark.slow  # it imports matplotlib
@pytest.mark.parametrize("outputs", [("height",), ("height", "cloud"), ("touch",)])
def test_rows_are_drawn(outputs: tuple[str, ...]) -> None:
    rows = [
        row("fast", 0.2, 1.0, outputs=outputs, front=True),
        row("accurate", 0.1, 3.0, outputs=outputs, half=True),
    ]
    if outputs == ("touch",):
        rows = [replace(each, errors={"touch": NAN}) for each in rows]
    image = cv2.imdecode(np.frombuffer(tradeoff_report.draw(rows, 3.0), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
