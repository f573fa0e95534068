"""The walk that finds a mistake agrees with msgspec, which finds that there is one."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tacshade_edge.calibration.files.indenter_file import IndenterEntry
from tacshade_edge.calibration.files.sensor_file import DomeFile, PadFile
from tacshade_edge.errors import ConfigError
from tacshade_edge.settings import Settings, strict_yaml
from tacshade_edge.settings.conversion import convert, first_misfit, schema_of

SCHEMAS = {kind: schema_of(kind) for kind in (Settings, DomeFile, PadFile, IndenterEntry)}
KEYS = sorted(
    {
        name
        for schema in SCHEMAS.values()
        for each in schema["$defs"].values()
        for name in each["properties"]
    }
)
WORDS = "v4l2 rpicam files simulated auto fast dome bright ball otsu /dev/video0 640:480 MJPG"
SCALARS = (
    st.none()
    | st.booleans()
    | st.sampled_from([0, 1, 63, 64, 128, 2**63, 2**64, -(2**63) - 1, 10**400])
    | st.sampled_from([0.5, 5.0, 20.0, 1e300])
    | st.sampled_from(["", "a", "a b", *WORDS.split()])
)
VALUES = st.recursive(
    SCALARS | st.lists(st.sampled_from([0, 1, 1.5, 10**400, "x"]), min_size=6, max_size=8),
    lambda inner: (
        st.dictionaries(st.sampled_from([*KEYS, "other"]), inner, max_size=3)
        | st.lists(inner, max_size=2)
    ),
    max_leaves=6,
)
SOURCE = {"kind": "rpicam", "width_px": 128, "sensor_mode": "640:480"}


@example(kind=Settings, value={"source": SOURCE})
@example(kind=Settings, value={"source": SOURCE | {"width_px": 100}})
@example(kind=Settings, value={"source": SOURCE | {"gain": 1}, "hand_T_sensor": [0] * 7})
@example(kind=Settings, value={"hand_T_sensor": [10**400] * 7})
@example(kind=Settings, value={"latency_budget_ms": 0})
@example(kind=DomeFile, value={"skin_radius_mm": 20, "visible_circle": {"row_px": 1}})
@given(st.sampled_from(list(SCHEMAS)), st.dictionaries(st.sampled_from([*KEYS, "other"]), VALUES))
def test_the_walk_finds_a_misfit_exactly_if_msgspec_refuses(
    kind: type, value: dict[str, Any]
) -> None:
    misfit = first_misfit(value, SCHEMAS[kind])
    refusal = nullcontext() if misfit is None else pytest.raises(msgspec.ValidationError)
    with refusal:
        msgspec.convert(value, kind)


class Ordered(msgspec.Struct):
    """What no schema can state."""

    first: int
    last: int

    def __post_init__(self) -> None:
        if self.last < self.first:
            raise ValueError(f"found last {self.last},\nexpected it after {self.first}")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: {first: 2, last: 1}", r"s.yaml:1: a: found last 1,\nexpected it after 2"),
        ("a: {first: 2, lst: 1}", "s.yaml:1: a.lst: found an unknown key, expected one of first"),
        ("a: {first: 2}", "s.yaml: a.last: found nothing, expected an integer"),
        ("a: {first: 2, last: {}}", "s.yaml:1: a.last: found a mapping, expected an integer"),
        ("a: [1]", "s.yaml:1: a: found a list, expected a mapping of settings"),
    ],
)
def test_a_part_of_a_file_is_converted_or_refused_in_one_line(text: str, said: str) -> None:
    file = strict_yaml.parse(Path("s.yaml"), text.encode())
    with pytest.raises(ConfigError) as refused:
        convert(file, Ordered, at=("a",))
    assert str(refused.value).startswith(said)
