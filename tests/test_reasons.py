"""Programs decide by a reason's code: with every text of the core worded otherwise, all but the texts is the same."""

from __future__ import annotations

import json
import sys
from functools import cache
from typing import Any

import numpy as np
import pytest
from support.calibrated_sensor import FULL, calibrated, pressed, unloaded

from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.doctor.calibration import check_images
from tacshade_edge.doctor.camera import check_picture
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.protocol import messages, wire
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.simulator import nuisance
from tacshade_edge.storage.runs.summary import summary
from tacshade_edge.types import U8, Frame
from tools.testbed.simulator import camera_faults

FLAGS_AT = 7  # in the wire's header
CODES = ("size", "black", "saturated", "no_contrast", "noise", "light", "torn", "surround", "camera_shift", "untrusted",
         "glare", "light_drift")  # fmt: skip


@cache
def images() -> dict[str, U8]:
    """At least one for each of `CODES`, and two good ones."""
    good, touched = unloaded(FULL), pressed("ball", 3.0, FULL).image
    skin = disc_mask(*good.shape[:2], calibrated(FULL, 0).geometry.disc)
    lost = good.copy()
    lost[200:328] = 128
    partly = touched.copy()
    low = skin & (np.arange(len(good)) > 0.82 * len(good))[:, None]
    partly[low] = touched[::-1][low]
    return {
        "good": good,
        "touched": touched,
        "another size": good[:-2],
        "black": good * 0,
        "white": good * 0 + 255,
        "plain": good * 0 + 90,
        "noise": camera_faults.noise(good, 30, 1),
        "dim": nuisance.gain(good, 0.35),
        "torn": camera_faults.torn(touched, good, 240, 20),
        "lost rows": lost,
        "lit surround": np.where(skin[..., None], good, 255).astype(np.uint8),
        "partly another": partly,
        "shifted": nuisance.shift(good, 4, 5),
        "glare": camera_faults.glare(touched, FULL.row_c + 90, FULL.col_c, 14),
        "blurred": camera_faults.defocus(good, 4.0),
    }


def outcomes() -> dict[str, tuple[Any, list[str]]]:
    """Of each image all that programs go by, and the texts."""
    made = make_reconstructor(calibrated(FULL, 0), PROFILES["accurate"])
    found = {}
    for k, (name, image) in enumerate(images().items()):
        result = made.step(Frame(k, k * 1_000_000_000, 0, image))
        record = summary(result)
        texts = [record.pop("reason"), record.pop("degraded")]
        findings = [*check_images(calibrated(FULL, 0), [image], live=True), check_picture(image)]
        found[name] = (
            (
                (result.valid, result.contact, wire.encode_height(result, calibration_crc32=1)[FLAGS_AT], record),
                json.loads(messages.encode_contact(result, fps=0.0)),
                [(finding.check, finding.state, finding.fix) for finding in findings],
            ),
            texts,
        )
    return found


@pytest.mark.slow
def test_rewording_every_text_of_the_core_changes_nothing_but_texts(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = outcomes()
    count = 0

    class Reworded(Reason):
        """A type as `Reason` is: the core asks for it."""

        def __init__(self, code: ReasonCode, text: str) -> None:
            nonlocal count
            count += 1
            super().__init__(code, f"zz {text[::-1]}")

    for name, module in list(sys.modules.items()):
        if name.startswith("tacshade_edge.core.") and hasattr(module, "Reason"):
            monkeypatch.setattr(module, "Reason", Reworded)
    other = outcomes()
    assert count > 0
    for name, (behaviour, texts) in plain.items():
        assert other[name][0] == behaviour, name
        for text, again in zip(texts, other[name][1], strict=True):
            assert again == (f"zz {text[::-1]}" if text else ""), name
    records = [behaviour[0][3] for behaviour, _ in plain.values()]
    codes = {record[key] for record in records for key in ("reason_code", "degraded_code")} - {""}
    assert codes == set(CODES)
