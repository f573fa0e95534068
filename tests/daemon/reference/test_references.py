from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.core.calibration.reference.following import bounds
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.daemon.references import PERIOD_S, REST_S, UNTOUCHED_FRAMES, References
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.simulator import camera_faults, nuisance
from tacshade_edge.storage.calibration.calibration_file import with_crc
from tacshade_edge.types import U8, Calibration, Frame

FPS = 10


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
        assert resting.look(nuisance.gain(pictures.free, gain))
    assert resting.references.calibration.crc32 not in (0, calibration.crc32)
    assert resting.health["renewals"] == 3
    assert resting.health["light"] == pytest.approx(0.85, abs=0.02)
    info = resting.references.info()
    assert (info["origin"], info["calibration_crc32"]) == ("calibration", calibration.crc32)
    assert info["bounds"] == bounds(calibration.geometry.disc)
    # The next is beyond: it stays where it was, says so once, and goes on when the light is back.
    followed = resting.references.calibration
    assert resting.look(nuisance.gain(pictures.free, 0.7))
    assert not resting.look(nuisance.gain(pictures.free, 0.69))
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
    darker = nuisance.gain(pictures.free, 0.9)
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
    darker = nuisance.gain(pictures.free, 0.7)
    taken = resting.references.take([darker] * 10)
    assert (taken.frames, taken.unstored) == (10, None)
    assert taken.calibration_crc32 == resting.references.calibration.crc32 != calibration.crc32
    assert resting.look(nuisance.gain(pictures.free, 0.6))  # 0.86 of the beginning's
    assert resting.health["state"] == "following"
    resting.references.close()
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
    unstored = other.take([nuisance.gain(pictures.free, 0.7)] * 10).unstored
    assert unstored is not None
    assert unstored.code is ReasonCode.IN_USE
    assert "this reference lasts only until the next start or reload" in unstored.text
    newer = with_crc(replace(calibration, reference_grey=calibration.reference_grey // 2))
    other.reload(newer, tmp_path / "c.reference.npz")
    assert (tmp_path / "c.reference.npz").read_bytes() == stored, "nor deleted"
    resting.references.close()
    assert other.take([pictures.free // 2 + 20] * 10).unstored is None
    other.close()
