from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support import bad_pictures
from support.calibrated_sensor import HALF, calibrated, pressed
from support.networks import saying
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.reasons import code_of, text_of
from tacshade_edge.sensor.depth.learned import fold
from tacshade_edge.sensor.frame_check import first_reason
from tacshade_edge.sensor.frame_check.foreign_skin import (
    UNTRUSTED_SURE,
    PlainSkinJudge,
    untrusted_part,
    untrusted_rows_part,
)
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F32, U8, Bool, Disc, Frame, Reconstruction

ROW, COL = np.mgrid[: disc_map.CELLS, : disc_map.CELLS] - (disc_map.CELLS - 1) / 2
TOUCHED = np.hypot(ROW, COL) < 20


def judged(
    untrusted_rows: slice, image: U8, logit: float = 4.0
) -> tuple[Reconstructor, Reconstruction]:
    """A contact in the middle, of whose picture some rows of 28 are untrusted."""
    untrusted = np.full((28, 28), -1, np.float32)
    untrusted[untrusted_rows] = logit
    maps = np.stack((TOUCHED.astype(np.float32), np.where(TOUCHED, np.float32(3), np.float32(-3))))
    calibration = replace(calibrated(HALF, 0), factors={})
    made = Reconstructor(calibration, PROFILES["balanced"], saying(fold(maps, 4), untrusted))
    return made, made.step(Frame(0, 0, 0, image))


def test_a_few_untrusted_cells_are_no_contact_and_a_doubt() -> None:
    made, result = judged(slice(13, 14), pressed("ball", 3.0).image)
    assert result.valid
    assert result.degraded is not None
    percent = float(result.degraded.text.split(" %")[0])
    rows = np.zeros_like(TOUCHED)
    rows[52:56] = True
    assert percent == pytest.approx(
        100 * (rows & made.rays.inside).sum() / made.rays.inside.sum(), abs=0.06
    )
    np.testing.assert_array_equal(result.untrusted, rows & made.rays.inside)
    np.testing.assert_array_equal(result.height.contact, TOUCHED & ~rows)


@pytest.mark.parametrize(
    ("rows", "logit", "code", "degraded"),
    [
        (slice(0, 0), 4.0, "", ""),
        (slice(10, 28), 4.0, "torn", ""),
        (slice(10, 28), 2.0, "", "untrusted"),
    ],
    ids=["this skin", "another picture", "a skin that the network does not know"],
)
def test_a_picture_of_something_else_is_refused(
    rows: slice, logit: float, code: str, degraded: str
) -> None:
    _, result = judged(rows, pressed("ball", 3.0).image, logit=logit)
    assert (code_of(result.reason), code_of(result.degraded)) == (code, degraded)
    assert result.contact == (code == "")
    assert (result.untrusted is None) == (degraded == "")


def logits(untrusted: Bool, logit: float = 4.0) -> F32:
    """Of 28x28 cells."""
    return np.where(untrusted[2::4, 2::4], np.float32(logit), np.float32(-4))


def test_untrusted_patches_are_no_torn_rows() -> None:
    """A skin that the network does not know is untrusted in patches, however large;
    a torn picture across the disc.
    """
    inside = np.hypot(ROW, COL) < 54
    patch, rows = COL > 0, ROW > 24
    assert untrusted_part(patch & inside, inside) > 0.4
    assert untrusted_rows_part(logits(patch), inside) == 0.0
    assert untrusted_rows_part(logits(rows), inside) == pytest.approx(
        untrusted_part(rows, inside), abs=0.02
    )
    assert untrusted_rows_part(logits(rows, 2.0), inside) > 0.1
    assert untrusted_rows_part(logits(rows, 2.0), inside, UNTRUSTED_SURE) == 0.0
    assert untrusted_rows_part(logits(np.ones_like(inside)), inside) > 0.97
    assert untrusted_rows_part(logits(np.zeros_like(inside)), inside) == 0.0


def test_nothing_of_a_disc_without_cells_is_untrusted() -> None:
    nothing = np.zeros((112, 112), dtype=bool)
    assert untrusted_part(nothing, nothing) == untrusted_rows_part(logits(~nothing), nothing) == 0.0


DISC = Disc(50.0, 60.0, 40.0)
# A tear by half a stripe changes every pixel of a row,
# and nothing else differs from row to row but the noise.
STRIPES = camera_faults.noise(
    np.tile(np.uint8(60) + np.uint8(120) * (np.arange(120) % 16 < 8), (100, 1)), 2, 1
)


def torn_text(grey: U8, reference: U8 = STRIPES, unloaded: bool = True) -> str:
    judge = PlainSkinJudge(reference, disc_mask(100, 120, DISC), DISC, 12.0, 1, unloaded=unloaded)
    return text_of(first_reason(judge.measured(grey)))


@pytest.mark.parametrize("row", [30, 75])
def test_it_names_the_row_above_the_tear(row: int) -> None:
    torn = bad_pictures.torn(STRIPES, STRIPES, row, 8)
    assert torn_text(torn).startswith(f"torn: row {row - 1} ")
    assert torn_text(torn, unloaded=False) == "", "a pressed pattern may look so"


def test_an_untorn_frame_has_none_nor_one_whose_reference_looks_the_same() -> None:
    torn = bad_pictures.torn(STRIPES, STRIPES, 50, 8)
    assert torn_text(camera_faults.noise(STRIPES, 2, 2)) == torn_text(torn, torn) == ""


def test_an_edge_across_a_part_of_the_disc_is_none() -> None:
    """As of a contact, which may follow a row."""
    image = STRIPES.copy()
    image[50:, 20:60] = 255 - image[50:, 20:60]
    assert torn_text(image) == ""


@pytest.mark.parametrize(("first", "last", "torn"), [(36, 60, True), (36, 48, False)])
def test_two_rows_of_squares_without_a_marker_are_torn(first: int, last: int, torn: bool) -> None:
    image = STRIPES.copy()
    image[first:last] = 128
    assert (torn_text(image, unloaded=False) != "") == torn
