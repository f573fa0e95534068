"""What the fence finds, and how its baseline shrinks."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from tools.ci import fence

LONG = "def long() -> None:\n" + "    print()\n" * 50
SHORT = "def short() -> None:\n" + "    print()\n" * 49


def violations(text: str) -> list[tuple[str, int, int]]:
    return [(each.rule, each.line, each.times) for each in fence.in_file("a.py", text)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (SHORT, []),
        (f"{SHORT}\n\n{SHORT}", []),
        (LONG, [("long-function", 1, 1)]),
        ("import os\n\n\n@cache\nasync " + LONG, [("long-function", 5, 1)]),
        (
            "class A:\n" + "".join(f"    {line}\n" for line in LONG.split("\n")),
            [("long-function", 2, 1)],
        ),
        (f"{SHORT}    def inner() -> None:\n" + "        print()\n" * 2, [("long-function", 1, 1)]),
        (
            "def long(\n    a: int,\n) -> None:\n" + "    print(a)\n" * 100,
            [("long-function", 1, 2)],
        ),
        ("x = 0\n" * 400, []),
        ("x = 0\n" * 401, [("long-file", 1, 1)]),
        ("x = 0\n" * 801, [("long-file", 1, 2)]),
        ("x = 0\ny = (1,2)  # fmt:" + " skip\n", [("fmt-skip", 2, 1)]),
    ],
)
def test_long_functions_and_files(text: str, expected: list[tuple[str, int, int]]) -> None:
    assert violations(text) == expected


def test_ruff_counts_what_a_link_leads_to_once(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("def f(x: object) -> object:\n    return x._private\n")
    (tmp_path / "b.py").symlink_to("a.py")
    (found,) = fence.of_ruff(tmp_path)
    assert (found.file, found.line, found.rule) == ("a.py", 2, "SLF001")


def test_a_new_violation_and_one_that_is_gone_are_mistakes() -> None:
    found = [fence.Violation("a.py", 3, "C901", "`f` is too complex (13 > 12)")]
    known = fence.counted(found)
    assert fence.differences(found, known) == []
    assert fence.differences(found, Counter()) == [
        "a.py:3: C901 `f` is too complex (13 > 12)",
        "a.py: C901 found 1, 1 more than before",
    ]
    assert fence.differences([], known) == [
        "a.py: C901 found 0, fewer now",
        "to shrink tools/ci/lint_baseline.json: .venv/bin/python -m tools.ci.fence --write",
    ]


def test_a_renamed_file_keeps_its_count_and_no_rule_grows() -> None:
    known = Counter({("a.py", "C901"): 2, ("a.py", "FBT001"): 1})
    assert fence.grown(Counter({("b.py", "C901"): 2}), known) == []
    assert fence.grown(Counter({("b.py", "C901"): 2, ("a.py", "C901"): 1}), known) == [
        "C901: found 3 in all files, expected at most 2"
    ]


def test_a_baseline_is_read_as_it_was_written(tmp_path: Path) -> None:
    known = Counter({("b.py", "C901"): 2, ("a.py", "FBT001"): 1, ("b.py", "SLF001"): 3})
    fence.write(tmp_path / "baseline.json", known)
    assert fence.read(tmp_path / "baseline.json") == known
    assert (tmp_path / "baseline.json").read_text() == (
        '{\n"a.py": {"FBT001": 1},\n"b.py": {"C901": 2, "SLF001": 3}\n}\n'
    )
