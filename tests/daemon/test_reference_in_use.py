"""The reference: collected on request, stored, and followed from frames of the resting sensor."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.painted_sensor import FREE, painted_calibration
from support.published_sensor import unmeasured
from support.resting_sensor import BATCH_S, Resting
from tacshade_edge.calibration.files.calibration_file import with_crc
from tacshade_edge.calibration.reference.references import bounds
from tacshade_edge.daemon import reference_in_use
from tacshade_edge.daemon.reference_in_use import REFERENCE_FRAMES, References
from tacshade_edge.daemon.reference_origin import requested, restored
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.contact.untouched import GAP_S, PERIOD_S, REST_S, UNTOUCHED_FRAMES
from tacshade_edge.types import Calibration, Frame, KnownObject, Need


@pytest.fixture
def resting(calibration: Calibration, tmp_path: Path) -> Resting:
    return Resting(calibration, tmp_path / "c.reference.npz")


def test_ten_frames_of_a_sensor_at_rest_once_a_minute(resting: Resting, pictures: Any) -> None:
    resting.show(pictures.free, REST_S)
    assert resting.taken() is None
    resting.show(pictures.free, BATCH_S + 0.2)
    assert resting.taken() == UNTOUCHED_FRAMES
    resting.show(pictures.free, PERIOD_S - 1)
    assert resting.taken() is None
    resting.show(pictures.free, BATCH_S + 1)
    assert resting.taken() == UNTOUCHED_FRAMES
    assert resting.references.frames.discarded == 0


@pytest.mark.parametrize("how", ["touched", "black"])
@pytest.mark.parametrize("glance", [False, True])
def test_a_touch_or_an_invalid_frame_ends_the_rest(
    resting: Resting, pictures: Any, how: str, glance: bool
) -> None:
    resting.show(pictures.free, REST_S + BATCH_S / 2)
    assert resting.references.frames.at_rest
    resting.show(getattr(pictures, how), 0.1, glance=glance)
    assert (resting.references.frames.at_rest, resting.references.frames.discarded) == (False, 1)
    resting.show(pictures.free, REST_S - 0.2)
    assert resting.taken() is None
    resting.show(pictures.free, BATCH_S + 0.4)
    assert resting.taken() == UNTOUCHED_FRAMES
    assert resting.references.frames.discarded == 1


def test_a_touch_of_unknown_depth_is_no_rest_and_no_new_zero(resting: Resting) -> None:
    frames, lost = resting.references.frames, unmeasured(0)
    frames.see(Frame(0, 0, 0, FREE), replace(lost, touched=False))
    frames.see(Frame(1, 1, 0, FREE), replace(lost, touched=False))
    assert frames.at_rest
    frames.see(Frame(2, 2, 0, FREE), lost)
    assert not frames.at_rest
    replies: list[Any] = []
    resting.references.handle(replies.append)
    resting.references.see(FrameResult(Frame(3, 3, 0, FREE), None, lost))
    resting.references.poll()
    (refused,) = replies
    assert refused.code is ReasonCode.FRAME_IN_CONTACT
    assert "a contact of unknown depth" in refused.text


def test_nobody_knows_what_touched_while_no_frame_came(resting: Resting, pictures: Any) -> None:
    resting.show(pictures.free, REST_S + BATCH_S / 2)
    resting.s += GAP_S + 1
    resting.show(pictures.free, REST_S)
    assert resting.taken() is None
    assert resting.references.frames.discarded == 1
    resting.s -= 500  # another clock
    resting.show(pictures.free, REST_S)
    assert resting.taken() is None


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "calibration.reference.npz"


def test_another_calibration_makes_it_void_and_says_so_once(
    calibration: Calibration, pictures: Any, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    requested(calibration, [pictures.free] * REFERENCE_FRAMES, path)
    newer = with_crc(replace(calibration, reference_grey=calibration.reference_grey // 2))
    void = restored(newer, path)
    assert void.calibration is newer
    assert void.reason is not None
    assert void.reason.code is ReasonCode.CALIBRATION_CHANGED
    assert restored(newer, path).reason is None
    (warning,) = caplog.records
    assert warning.getMessage().endswith(
        "belongs to another calibration; take a new reference; "
        "using the calibration's own reference"
    )
    assert not path.exists()


def test_a_folder_that_cannot_be_written_is_reported(
    calibration: Calibration, pictures: Any, tmp_path: Path
) -> None:
    taken = requested(
        calibration, [pictures.free] * REFERENCE_FRAMES, tmp_path / "gone" / "c.reference.npz"
    )
    assert taken.calibration.crc32 != 0
    assert taken.reason is not None
    assert taken.reason.code is ReasonCode.DISK
    assert taken.reason.text.endswith("this reference lasts only until the next start or reload")


def test_it_follows_from_where_it_began_and_reports_how_far(
    resting: Resting, calibration: Calibration, pictures: Any, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    assert not resting.poll()
    assert (resting.health["state"], resting.health["light"], resting.health["looks"]) == (
        "waiting",
        None,
        0,
    )
    assert resting.look(pictures.free)
    assert not resting.look(pictures.free)
    assert (resting.health["state"], resting.health["looks"], resting.health["renewals"]) == (
        "following",
        2,
        0,
    )
    assert resting.references.calibration is calibration
    for gain in (0.95, 0.9, 0.85):
        assert resting.look(camera_faults.gain(pictures.free, gain))
    assert resting.references.calibration.crc32 not in (0, calibration.crc32)
    assert resting.health["renewals"] == 3
    assert resting.health["light"] == pytest.approx(0.85, abs=0.02)
    info = resting.references.info()
    assert (info["origin"], info["calibration_crc32"]) == ("calibration", calibration.crc32)
    assert info["bounds"] == bounds(calibration.geometry.disc)
    # The next is beyond: it stays where it was, says so once, and goes on when the light is back.
    followed = resting.references.calibration
    assert resting.look(camera_faults.gain(pictures.free, 0.7))
    assert not resting.look(camera_faults.gain(pictures.free, 0.69))
    info = resting.references.info()
    assert (info["state"], info["stopped_code"]) == ("stopped", "light_drift")
    assert "0.69 times the light" in info["stopped"]
    assert resting.references.calibration is followed
    assert (resting.health["state"], resting.health["reason_code"]) == ("stopped", "light_drift")
    assert resting.look(pictures.free)
    assert (resting.health["state"], resting.health["reason"]) == ("following", "")
    texts = [record.getMessage() for record in caplog.records]
    assert [text.partition(":")[0] for text in texts] == [
        "reference following",
        "reference stopped",
        "reference following",
    ]
    assert "0.70 times the light" in texts[1]
    assert set(resting.health) >= set(info["bounds"]) - {"light_low", "light_high"}


def test_it_stays_while_it_is_held_and_amid_a_contact(resting: Resting, pictures: Any) -> None:
    darker = camera_faults.gain(pictures.free, 0.9)
    assert resting.look(darker, held=True)
    assert not resting.look(darker, held=True)
    assert resting.references.info()["calibration_crc32"] == resting.references.calibration.crc32
    assert (resting.health["state"], resting.health["looks"]) == ("held", 0)
    resting.show(darker, PERIOD_S + 2)
    resting.show(pictures.touched, 0.1)
    assert resting.poll()  # the state alone
    assert (resting.health["looks"], resting.health["renewals"]) == (1, 0)
    assert resting.look(darker)


def test_a_doubt_or_a_spot_stops_it_with_its_reason(
    resting: Resting, calibration: Calibration, pictures: Any
) -> None:
    doubt = Reason(ReasonCode.GLARE, "glare hides 3 % of the disc")
    assert resting.look(pictures.free, doubt=doubt)
    assert (resting.health["state"], resting.health["reason"]) == ("stopped", doubt.text)
    assert resting.health["looks"] == 1
    disc = calibration.geometry.disc
    assert resting.look(camera_faults.glare(pictures.free, disc.row_c, disc.col_c + 20, 2))
    assert (resting.health["state"], resting.health["reason_code"]) == ("stopped", "patch_changed")
    assert resting.references.calibration is calibration


def test_a_request_is_a_new_beginning_that_outlives_a_restart(
    resting: Resting, calibration: Calibration, pictures: Any, tmp_path: Path
) -> None:
    darker = camera_faults.gain(pictures.free, 0.7)
    taken = resting.take(darker)
    assert (taken.frames, taken.unstored) == (10, None)
    assert taken.calibration_crc32 == resting.references.calibration.crc32 != calibration.crc32
    assert resting.look(camera_faults.gain(pictures.free, 0.6))  # 0.86 of the beginning's
    assert resting.health["state"] == "following"
    resting.references.stop()
    again = References(calibration, tmp_path / "c.reference.npz", "left", lambda _: None)
    assert again.calibration.crc32 == taken.calibration_crc32
    assert again.info() == {**resting.references.info(), "state": "waiting"}
    again.reload(calibration, tmp_path / "another.reference.npz")
    assert again.calibration is calibration
    assert again.info()["origin"] == "calibration"


def test_the_stored_reference_has_one_owner(
    resting: Resting,
    calibration: Calibration,
    pictures: Any,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    taken = resting.take(pictures.free)
    stored = (tmp_path / "c.reference.npz").read_bytes()
    second = Resting(calibration, tmp_path / "c.reference.npz")
    other = second.references
    assert "c.reference.npz: in use by 'sensor left, process" in caplog.text
    assert (other.info() or {})["reason_code"] == "in_use"
    assert other.calibration.crc32 == taken.calibration_crc32, "it may be read"
    unstored = second.take(camera_faults.gain(pictures.free, 0.7)).unstored
    assert unstored is not None
    assert unstored.code is ReasonCode.IN_USE
    assert "this reference lasts only until the next start or reload" in unstored.text
    newer = with_crc(replace(calibration, reference_grey=calibration.reference_grey // 2))
    other.reload(newer, tmp_path / "c.reference.npz")
    assert (tmp_path / "c.reference.npz").read_bytes() == stored, "nor deleted"
    resting.references.stop()
    other.reload(calibration, tmp_path / "c.reference.npz")
    assert second.take(pictures.free).unstored is None
    other.stop()


def test_a_reference_is_taken_from_the_next_ten_frames_once(
    resting: Resting, pictures: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert resting.take(pictures.free, REFERENCE_FRAMES - 1) is None
    assert resting.references.need() == Need.DEPTH
    assert resting.take(pictures.free, 0).code is ReasonCode.BUSY
    monkeypatch.setattr(reference_in_use, "REFERENCE_TIMEOUT_S", 0.0)
    resting = Resting(painted_calibration(), resting.path)
    assert resting.take(pictures.free, 1).text == "received fewer than 10 frames within 0 s"
    assert resting.take(pictures.touched).code is ReasonCode.FRAME_IN_CONTACT
    assert resting.take(pictures.black).code is ReasonCode.FRAME_INVALID
    assert (resting.changes, resting.references.need()) == (0, Need.CONTACT)


def test_taught_objects_come_with_the_same_reference(tmp_path: Path) -> None:
    used: list[Calibration] = []
    calibration = painted_calibration()
    made = References(calibration, tmp_path / "cal.reference.npz", "left", used.append)
    known = {"fast": (KnownObject("nut", np.zeros((1, 3), np.float32)),)}
    made.know(known)
    (found,) = used
    assert found.known == known
    assert found.crc32 == calibration.crc32
    assert made.calibration is found
    made.stop()
    nothing = References(Reason(ReasonCode.NOT_CALIBRATED, ""), tmp_path, "left", used.append)
    nothing.know(known)
    assert len(used) == 1
