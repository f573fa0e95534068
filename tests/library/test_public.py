"""The public surface: what is listed, and that nothing is paid for before it is used."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import tacshade_edge as ts

ROOT = Path(__file__).parents[2]


def test_everything_that_is_listed_is_there_and_on_the_page() -> None:
    page = (ROOT / "docs/reference/api.md").read_text()
    (members,) = re.findall(r"members: \[(.+?)\]", page, re.DOTALL)
    assert {name.strip() for name in members.split(",")} == set(ts.__all__) - {"__version__"}
    for name in ts.__all__:
        assert getattr(ts, name) is not None
    assert set(ts.__all__) <= set(dir(ts))
    assert not hasattr(ts, "anything")


def test_the_import_brings_nothing_and_starts_nothing() -> None:
    code = "import sys, threading; before = set(sys.modules); import tacshade_edge; "
    code += (
        "print(sorted(m for m in set(sys.modules) - before if 'numpy' in m or 'cv2' in m or "
        "m.startswith('tacsh')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['tacshade_edge']"
