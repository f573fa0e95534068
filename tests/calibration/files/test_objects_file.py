from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacshade_edge.calibration.files import objects_file
from tacshade_edge.calibration.files.objects_file import (
    OBJECTS_MAX,
    TOUCHES_MAX,
    check_name,
    load,
    path_beside,
    save,
    taught,
    without,
)
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files.npz import Content
from tacshade_edge.types import F32


def touches(count: int, first: float = 0.0) -> F32:
    return first + np.arange(count * 5, dtype=np.float32).reshape(count, 5)


def known() -> objects_file.Known:
    made = taught({}, "balanced", "nut_m8", touches(3))
    made = taught(made, "balanced", "key", touches(1, 50))
    return taught(made, "fast", "nut_m8", touches(2, 9))


def shown(known: objects_file.Known) -> dict[str, list[tuple[str, list[list[float]]]]]:
    return {p: [(o.name, o.touches.tolist()) for o in objects] for p, objects in known.items()}


def test_what_is_stored_comes_back(tmp_path: Path) -> None:
    path = path_beside(tmp_path / "left.npz")
    assert path.name == "left.objects.npz"
    assert load(path) == {}
    save(path, known())
    assert shown(load(path)) == shown(known())
    assert [each.name for each in tmp_path.iterdir()] == [path.name]
    save(path, {})
    assert list(tmp_path.iterdir()) == []


def test_teaching_adds_touches_and_forgetting_removes_the_object() -> None:
    more = taught(known(), "balanced", "nut_m8", touches(2, 100))
    assert [(o.name, len(o.touches)) for o in more["balanced"]] == [("nut_m8", 5), ("key", 1)]
    np.testing.assert_array_equal(more["balanced"][0].touches[3:], touches(2, 100))
    left = without(more, "nut_m8")
    assert shown(left) == {"balanced": [("key", touches(1, 50).tolist())]}


@pytest.mark.parametrize("name", ["", "a b", "-x", "ü", "a/b", "x" * 65, "a\n", "None "])
def test_names_that_the_wire_cannot_carry_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=r"^name: found .*, expected 1 to 64 letters"):
        check_name(name)


def test_names_that_it_can_carry() -> None:
    for name in ("a", "nut_m8", "0.5-inch.bolt", "x" * 64):
        assert check_name(name) == name


def test_no_more_than_a_file_may_hold(tmp_path: Path) -> None:
    full = taught({}, "fast", "nut", touches(TOUCHES_MAX))
    with pytest.raises(ConfigError, match="nut: found 65 touches, expected at most 64"):
        taught(full, "fast", "nut", touches(1))
    many: objects_file.Known = {}
    for k in range(OBJECTS_MAX):
        many = taught(many, "fast", f"{k}", touches(1))
    with pytest.raises(ConfigError, match="one_more: found 256 objects"):
        taught(many, "fast", "one_more", touches(1))
    save(tmp_path / "most.npz", many)
    assert len(load(tmp_path / "most.npz")["fast"]) == OBJECTS_MAX


GOOD = {"version": objects_file.VERSION, "touches": {"fast": [["nut", 2], ["key", 1]]}}


@pytest.mark.parametrize(
    ("meta", "arrays", "message"),
    [
        ({**GOOD, "version": 99}, {"fast": touches(3)}, "found version 99 of the objects"),
        ({"version": objects_file.VERSION}, {"fast": touches(3)}, "Expected"),
        (GOOD, {"fast": touches(2)}, "descriptions of 3 touches"),
        (GOOD, {"fast": touches(3).astype(np.float64)}, "descriptions of 3 touches"),
        (GOOD, {"fast": touches(3) * np.nan}, "finite numbers"),
        (GOOD, {"fast": touches(3)[:, :0]}, "finite numbers"),
        (GOOD, {"slow": touches(3)}, "other arrays"),
        ({**GOOD, "touches": {"fast": [["a b", 3]]}}, {"fast": touches(3)}, "the name a b"),
        ({**GOOD, "touches": {"fast": [["a", 0]]}}, {"fast": touches(0)}, ">= 1"),
        ({**GOOD, "touches": {"fast": []}}, {"fast": touches(0)}, "1 to 256 objects"),
        ({**GOOD, "touches": {"fast": [["a", 1], ["a", 2]]}}, {"fast": touches(3)}, "different"),
    ],
)
def test_other_content_is_refused_in_one_line(
    tmp_path: Path, meta: dict[str, Any], arrays: dict[str, Any], message: str
) -> None:
    path = tmp_path / "cal.objects.npz"
    path.write_bytes(Content(meta, arrays).packed())
    with pytest.raises(ConfigError, match=message) as error:
        load(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "teach again" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cal.objects.npz"
    save(path, known())
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(ConfigError, match="damaged"):
        load(path)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="cannot write it"):
        save(tmp_path / "away" / "cal.objects.npz", known())
