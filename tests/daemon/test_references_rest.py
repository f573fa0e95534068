"""Where a touch begins, learnt from the frames that the reference follows."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from support.resting_sensor import BATCH_S, Resting
from tacshade_edge.calibration.files.calibration_file import with_crc
from tacshade_edge.daemon.reference_in_use import References
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.contact import untouched
from tacshade_edge.sensor.contact.rest import Evidence
from tacshade_edge.sensor.contact.untouched import FACTOR, PERIOD_S, REST_S
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration, RestLimits


class Finding:
    """In place of the running reconstructor: it finds what the test states."""

    profile = PROFILES["fast"]

    def __init__(self) -> None:
        self.found: Evidence | Reason = Evidence(0.02, 0.004, 0.01)

    def evidence(self, image: U8) -> Evidence | Reason:
        return self.found


class Learning(Resting):
    """A sensor at rest whose evidence the test states."""

    def __init__(self, calibration: Calibration, path: Path) -> None:
        super().__init__(calibration, path)
        self.references.stop()
        self.running = Finding()
        self.references = References(
            calibration,
            path,
            "left",
            lambda _: self._changed(),
            self._changed,
            held=lambda: self.held,
            running=lambda: cast(Reconstructor, self.running),
        )

    def rest(self, image: U8, batches: int = 2, held: bool = False) -> None:
        """So many batches that nothing touches before or after; two are enough here."""
        for _ in range(batches):
            self.look(image, held)
            self.show(image, REST_S)
            self.poll(held)

    @property
    def limits(self) -> RestLimits | None:
        known = self.references.calibration
        assert not isinstance(known, Reason)
        return known.rest.get("fast")


@pytest.fixture
def learning(calibration: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Learning:
    monkeypatch.setattr(untouched, "ENOUGH_FRAMES", 10)
    return Learning(calibration, tmp_path / "c.reference.npz")


def test_untouched_frames_show_where_a_touch_begins_and_a_restart_knows(
    learning: Learning, calibration: Calibration, pictures: Any, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    learning.rest(pictures.free, 1)
    assert (learning.limits, learning.health["rest_frames"]) == (None, 5)
    learning.rest(pictures.free, 1)
    first = learning.limits
    assert first is not None
    assert (first.frames, first.height_mm, first.false_contacts) == (10, 0.04, 1e-4)
    assert learning.health["rest_frames"] == 10
    text = (
        "fast now reports a touch from 0.04 mm of its own heights on, as 10 untouched frames show"
    )
    assert text in caplog.messages
    learning.running.found = Evidence(0.9, 0.004, 0.01)
    learning.rest(pictures.free, 4)
    wider = learning.limits
    assert wider is not None
    assert wider.height_mm == pytest.approx(FACTOR * first.height_mm)
    learning.references.stop()
    again = Learning(calibration, learning.path)
    assert again.limits == wider
    assert again.references.info() == {**learning.references.info(), "state": "waiting"}
    again.running.found = Evidence(0.9, 0.9, 0.01)
    again.rest(pictures.free, 3)
    assert again.limits is not None
    assert again.limits.height_mm == wider.height_mm, "no restart widens them further"
    taken = again.take(camera_faults.gain(pictures.free, 0.9))
    assert taken.calibration_crc32 == again.references.calibration.crc32
    assert again.limits is not None
    assert again.limits.height_mm == wider.height_mm, "another reference keeps them"
    again.references.stop()
    assert Learning(calibration, learning.path).limits == again.limits


def test_nothing_is_learnt_while_it_touches_is_held_or_stopped(
    learning: Learning, calibration: Calibration, pictures: Any
) -> None:
    learning.rest(pictures.free, 4, held=True)
    learning.held = False
    for _ in range(4):
        learning.show(pictures.touched, PERIOD_S)
        learning.show(pictures.free, REST_S + BATCH_S + 0.2)
        learning.show(pictures.touched, 0.2)
        learning.poll()
    assert learning.health["looks"] == 4
    disc = calibration.geometry.disc
    learning.rest(camera_faults.glare(pictures.free, disc.row_c, disc.col_c + 20, 2), 4)
    assert learning.health["reason_code"] == "patch_changed"
    learning.running.found = Reason(ReasonCode.GLARE, "glare")
    learning.rest(pictures.free, 4)
    learning.running.profile = PROFILES["paper"]
    learning.rest(pictures.free, 4)
    assert learning.limits is None
    assert not learning.path.exists()


def test_limits_near_the_calibrations_own_are_kept_and_not_stored(
    calibration: Calibration, pictures: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(untouched, "ENOUGH_FRAMES", 10)
    own = RestLimits(60, 1e-3, height_mm=0.042, local_change=0.004, changed_part=0.3)
    calibration = with_crc(replace(calibration, rest={"fast": own}))
    learning = Learning(calibration, tmp_path / "c.reference.npz")
    learning.rest(pictures.free, 4)
    assert learning.references.calibration is calibration
    assert not learning.path.exists()
    learning.running.found = Evidence(0.9, 0.004, 0.01)
    learning.rest(pictures.free, 4)
    assert learning.limits is not None
    assert learning.limits.height_mm == pytest.approx(2 * own.height_mm)
    assert learning.limits.false_contacts == own.false_contacts


def test_limits_that_cannot_be_stored_are_used_and_the_log_says_so(
    calibration: Calibration,
    pictures: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(untouched, "ENOUGH_FRAMES", 10)
    learning = Learning(calibration, tmp_path / "gone" / "c.reference.npz")
    learning.rest(pictures.free)
    assert learning.limits is not None
    assert "where touches begin is known until the next start or reload" in caplog.text
