"""Impossible numbers behind a right checksum: a stored file is used or refused in one line."""

from __future__ import annotations

import contextlib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.examples import at_most
from support.impossible_values import EXTREMES, changed, kinds, places
from support.networks import shared_networks  # noqa: F401  a fixture
from tacshade_edge.calibration.files import objects_file
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import KnownObject

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", ["c.npz", "c.reference.npz", "c.objects.npz"])
@settings(max_examples=at_most(200), deadline=None)
@given(data=st.data())
def test_an_impossible_number_is_stepped_with_or_refused(name: str, data: st.DataObject) -> None:
    kind = kinds()[name]
    floats = [key for key, array in kind.content.arrays.items() if array.dtype.kind == "f"]
    part = data.draw(st.sampled_from(["", "", *floats]))
    numbers = [(k,) for k in range(kind.content.arrays[part].size)] if part else None
    place = data.draw(st.sampled_from(numbers or sorted(places(kind.content.meta), key=str)))
    with TemporaryDirectory(dir="/dev/shm") as folder:
        path = Path(folder) / name
        path.write_bytes(changed(kind.content, part, place, data.draw(st.sampled_from(EXTREMES))))
        with contextlib.suppress(ConfigError):
            kind.used(path)


def test_objects_described_by_other_numbers_are_refused(tmp_path: Path) -> None:
    few = {"fast": (KnownObject("cup", np.zeros((3, 24), np.float32)),)}
    objects_file.save(tmp_path / "c.objects.npz", few)
    with pytest.raises(ConfigError, match="cup: found 24 numbers in a description, expected 272"):
        kinds()["c.objects.npz"].used(tmp_path / "c.objects.npz")


@pytest.mark.parametrize(
    ("name", "place", "extreme"),
    [("c.reference.npz", ("wall_ns",), 10**30), ("c.npz", ("touch", "fast", "width"), 1e-300)],
)
def test_a_number_that_ended_the_daemon_is_refused(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    name: str,
    place: tuple[str, ...],
    extreme: float,
) -> None:
    kind = kinds()[name]
    path = tmp_path / name
    path.write_bytes(changed(kind.content, "", place, extreme))
    if name == "c.npz":
        with pytest.raises(ConfigError, match="width"):
            kind.used(path)
    else:
        assert kind.used(path).valid
        assert "not a reference file" in caplog.text
