from __future__ import annotations

import json
from pathlib import Path

import pytest

from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.recording.recording_content import content_of, events_in, wall_minus_t_ns


@pytest.mark.parametrize("number", ["Infinity", "NaN", "1e308", "1" + "0" * 400, "-5", "true", "null", '"7"', "[]"])
def test_times_are_whole_numbers_within_bounds(tmp_path: Path, number: str) -> None:
    (tmp_path / "recording.json").write_text(f'{{"first_wall_ns": {number}, "first_t_ns": 5}}')
    assert wall_minus_t_ns(tmp_path) == 0
    (tmp_path / "events.jsonl").write_text(
        f'{{"t_ns": {number}, "kind": "start", "data": {{"wall_ns": 9}}}}\n'
        f'{{"t_ns": 5, "kind": "start", "data": {{"wall_ns": {number}}}}}\n'
        '{"t_ns": 5, "kind": "start", "data": {"wall_ns": 105}}\n'
    )
    assert wall_minus_t_ns(tmp_path) == 100
    assert [event.data["wall_ns"] for event in events_in(content_of(tmp_path))][-1] == 105


def test_a_line_that_is_too_long_is_no_event(tmp_path: Path) -> None:
    lines = [json.dumps({"t_ns": 1, "kind": kind, "data": {}}) for kind in ("a", "b" * 70_000, "c")]
    assert [event.kind for event in events_in({"events.jsonl": "\n".join(lines).encode()})] == ["a", "c"]


def test_what_is_too_large_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "events.jsonl").open("wb") as stream:
        stream.truncate((8 << 20) + 1)
    with pytest.raises(ConfigError, match=r"events\.jsonl: found more than 8388608 bytes"):
        content_of(tmp_path)
