"""The reference: collected on request, stored, and followed from frames of the resting sensor."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.core.calibration.reference.references import bounds
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.daemon.references import (
    GAP_S,
    PERIOD_S,
    REFERENCE_FRAMES,
    REST_S,
    UNTOUCHED_FRAMES,
    ReferenceCollector,
    References,
    UntouchedFrames,
    requested,
    restored,
)
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.simulator import camera_faults
from tacshade_edge.storage.calibration.calibration_file import with_crc
from tacshade_edge.types import U8, Calibration, Frame, Need


def collected(calibration: Calibration, images: list[Any]) -> list[U8] | Reason | None:
    collector = ReferenceCollector()
    reconstructor = make_reconstructor(calibration, PROFILES["fast"])
    for seq, image in enumerate(images):
        frame = Frame(seq, 0, 0, image)
        collector.see(frame, reconstructor.step(frame))
    return collector.outcome


def test_exactly_the_next_frames_are_taken_once(calibration: Calibration, pictures: Any) -> None:
    assert collected(calibration, [pictures.free] * (REFERENCE_FRAMES - 1)) is None
    taken = collected(calibration, [pictures.free] * (2 * REFERENCE_FRAMES + 3))
    assert isinstance(taken, list)
    assert len(taken) == REFERENCE_FRAMES


@pytest.mark.parametrize(
    ("bad", "code"), [("touched", ReasonCode.FRAME_IN_CONTACT), ("black", ReasonCode.FRAME_INVALID)]
)
def test_a_touched_or_invalid_frame_ends_them(
    calibration: Calibration, pictures: Any, bad: str, code: ReasonCode
) -> None:
    taken = collected(calibration, [pictures.free] * 4 + [getattr(pictures, bad)] + [pictures.free] * 20)
    assert isinstance(taken, Reason)
    assert taken.code is code
    assert taken.text.startswith("frame 4: found ")


FPS = 10

DOUBT = Reason(ReasonCode.GLARE, "glare hides 3 % of the disc")


class Stream:
    """Frames at 10 per second of a clock that the test turns."""

    def __init__(self, reconstructor: Reconstructor) -> None:
        self.frames = UntouchedFrames()
        self.s = 1000.0
        self._reconstructor = reconstructor

    def show(self, image: U8, seconds: float, doubt: Reason | None = None, glance: bool = False) -> None:
        need = Need.CONTACT if glance else Need.SHEAR
        for _ in range(round(seconds * FPS)):
            self.s += 1 / FPS
            frame = Frame(0, round(self.s * 1e9), 0, image)
            result = self._reconstructor.step(frame, need=need)
            self.frames.see(frame, replace(result, degraded=doubt) if result and doubt else result)

    def taken(self) -> int | Reason | None:
        """The number of images, or the doubt."""
        taken = self.frames.take()
        return len(taken) if isinstance(taken, list) else taken


@pytest.fixture
def stream(calibration: Calibration) -> Stream:
    return Stream(make_reconstructor(calibration, PROFILES["fast"]))


BATCH_S = UNTOUCHED_FRAMES / FPS


def test_ten_frames_of_a_sensor_at_rest_once_a_minute(stream: Stream, pictures: Any) -> None:
    stream.show(pictures.free, REST_S)
    assert stream.taken() is None
    stream.show(pictures.free, BATCH_S + 0.2)
    assert stream.taken() == UNTOUCHED_FRAMES
    stream.show(pictures.free, PERIOD_S - 1)
    assert stream.taken() is None
    stream.show(pictures.free, BATCH_S + 1)
    assert stream.taken() == UNTOUCHED_FRAMES
    assert stream.frames.discarded == 0


@pytest.mark.parametrize("how", ["touched", "black"])
@pytest.mark.parametrize("glance", [False, True])
def test_a_touch_or_an_invalid_frame_ends_the_rest(stream: Stream, pictures: Any, how: str, glance: bool) -> None:
    stream.show(pictures.free, REST_S + BATCH_S / 2)
    assert stream.frames.at_rest
    stream.show(getattr(pictures, how), 0.1, glance=glance)
    assert (stream.frames.at_rest, stream.frames.discarded) == (False, 1)
    stream.show(pictures.free, REST_S - 0.2)
    assert stream.taken() is None
    stream.show(pictures.free, BATCH_S + 0.4)
    assert stream.taken() == UNTOUCHED_FRAMES
    assert stream.frames.discarded == 1


def test_nobody_knows_what_touched_while_no_frame_came(stream: Stream, pictures: Any) -> None:
    stream.show(pictures.free, REST_S + BATCH_S / 2)
    stream.s += GAP_S + 1
    stream.show(pictures.free, REST_S)
    assert stream.taken() is None
    assert stream.frames.discarded == 1
    stream.s -= 500  # another clock
    stream.show(pictures.free, REST_S)
    assert stream.taken() is None


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "calibration.reference.npz"


def test_what_was_requested_is_restored(
    calibration: Calibration, pictures: Any, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    before_ns = time.time_ns()
    taken = requested(calibration, [pictures.free // 2 + 20] * REFERENCE_FRAMES, path)
    assert taken.reason is None
    assert taken.calibration.crc32 not in (0, calibration.crc32)
    again = restored(calibration, path)
    assert again.as_dict() == taken.as_dict()
    assert again.as_dict()["origin"] == "request"
    assert again.wall_ns is not None
    assert before_ns <= again.wall_ns <= time.time_ns()
    assert again.calibrated is calibration
    assert [record.levelname for record in caplog.records] == ["INFO", "INFO"]


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
        "belongs to another calibration; take a new reference; using the calibration's own reference"
    )
    assert not path.exists()


def test_a_damaged_one_is_told_and_left_alone(
    calibration: Calibration, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path.write_bytes(b"not of ours")
    for _ in range(2):
        origin = restored(calibration, path)
        assert origin.calibration is calibration
        assert origin.reason is not None
        assert origin.reason.code is ReasonCode.CONFIG
    assert path.read_bytes() == b"not of ours"
    assert [record.levelname for record in caplog.records] == ["WARNING", "WARNING"]


def test_a_folder_that_cannot_be_written_is_told(calibration: Calibration, pictures: Any, tmp_path: Path) -> None:
    taken = requested(calibration, [pictures.free] * REFERENCE_FRAMES, tmp_path / "gone" / "c.reference.npz")
    assert taken.calibration.crc32 != 0
    assert taken.reason is not None
    assert taken.reason.code is ReasonCode.DISK
    assert taken.reason.text.endswith("this reference lasts only until the next start or reload")


class Resting:
    """`References` and a stream of frames on the test's clock."""

    def __init__(self, calibration: Calibration, path: Path) -> None:
        self.references = References(calibration, path, "left")
        self._reconstructor = make_reconstructor(calibration, PROFILES["fast"])
        self._s = 0.0

    def show(self, image: U8, seconds: float, doubt: Reason | None = None) -> None:
        for _ in range(round(seconds * FPS)):
            self._s += 1 / FPS
            frame = Frame(0, round(self._s * 1e9), 0, image)
            result = self._reconstructor.step(frame)
            self.references.frames.see(frame, replace(result, degraded=doubt or result.degraded))

    def look(self, image: U8, held: bool = False, doubt: Reason | None = None) -> bool:
        """As long as it takes to the next look, and whether there is something to tell."""
        self.show(image, max(REST_S, PERIOD_S) + UNTOUCHED_FRAMES / FPS + 0.2, doubt)
        return self.references.follow(held)

    @property
    def health(self) -> dict[str, Any]:
        return self.references.health()


@pytest.fixture
def resting(calibration: Calibration, tmp_path: Path) -> Resting:
    return Resting(calibration, tmp_path / "c.reference.npz")


@pytest.mark.slow
def test_it_follows_from_where_it_began_and_tells_how_far(
    resting: Resting, calibration: Calibration, pictures: Any, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    assert not resting.references.follow(held=False)
    assert (resting.health["state"], resting.health["light"], resting.health["looks"]) == ("waiting", None, 0)
    assert resting.look(pictures.free)
    assert not resting.look(pictures.free)
    assert (resting.health["state"], resting.health["looks"], resting.health["renewals"]) == ("following", 2, 0)
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
        *("reference following", "reference stopped", "reference following")
    ]
    assert "0.70 times the light" in texts[1]
    assert set(resting.health) >= set(info["bounds"]) - {"light_low", "light_high"}


@pytest.mark.slow
def test_it_stays_while_it_is_held_and_amid_a_contact(resting: Resting, pictures: Any) -> None:
    darker = camera_faults.gain(pictures.free, 0.9)
    assert resting.look(darker, held=True)
    assert not resting.look(darker, held=True)
    assert resting.references.info()["calibration_crc32"] == resting.references.calibration.crc32
    assert (resting.health["state"], resting.health["looks"]) == ("held", 0)
    resting.show(darker, PERIOD_S + 2)
    resting.show(pictures.touched, 0.1)
    assert resting.references.follow(held=False)  # the state alone
    assert (resting.health["looks"], resting.health["renewals"]) == (1, 0)
    assert resting.look(darker)


@pytest.mark.slow
def test_a_doubt_or_a_spot_stops_it_with_its_reason(resting: Resting, calibration: Calibration, pictures: Any) -> None:
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
    taken = resting.references.take([darker] * 10)
    assert (taken.frames, taken.unstored) == (10, None)
    assert taken.calibration_crc32 == resting.references.calibration.crc32 != calibration.crc32
    assert resting.look(camera_faults.gain(pictures.free, 0.6))  # 0.86 of the beginning's
    assert resting.health["state"] == "following"
    resting.references.stop()
    again = References(calibration, tmp_path / "c.reference.npz", "left")
    assert again.calibration.crc32 == taken.calibration_crc32
    assert again.info() == {**resting.references.info(), "state": "waiting"}
    again.reload(calibration, tmp_path / "another.reference.npz")
    assert again.calibration is calibration
    assert again.info()["origin"] == "calibration"


def test_the_stored_reference_has_one_owner(
    resting: Resting, calibration: Calibration, pictures: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    taken = resting.references.take([pictures.free] * 10)
    stored = (tmp_path / "c.reference.npz").read_bytes()
    other = References(calibration, tmp_path / "c.reference.npz", "right")
    assert "c.reference.npz: in use by 'sensor left, process" in caplog.text
    assert (other.info() or {})["reason_code"] == "in_use"
    assert other.calibration.crc32 == taken.calibration_crc32, "it may be read"
    unstored = other.take([camera_faults.gain(pictures.free, 0.7)] * 10).unstored
    assert unstored is not None
    assert unstored.code is ReasonCode.IN_USE
    assert "this reference lasts only until the next start or reload" in unstored.text
    newer = with_crc(replace(calibration, reference_grey=calibration.reference_grey // 2))
    other.reload(newer, tmp_path / "c.reference.npz")
    assert (tmp_path / "c.reference.npz").read_bytes() == stored, "nor deleted"
    resting.references.stop()
    assert other.take([pictures.free // 2 + 20] * 10).unstored is None
    other.stop()
