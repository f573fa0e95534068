"""docs/how-to/doctor.md names every check that there is, and no other."""

from __future__ import annotations

import re
from pathlib import Path

import tacshade_edge.doctor

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs/how-to/doctor.md").read_text()


def test_every_check_has_its_row() -> None:
    rows = set(re.findall(r"^\| `([a-z ]+)` \|", TEXT, re.MULTILINE))
    sources = Path(tacshade_edge.doctor.__file__).parent.glob("*.py")
    code = "".join(path.read_text() for path in sources)
    made = set(re.findall(r'\b(?:ok|warning|fault|_failed)\(\s*"([a-z ]+)"', code)) | {"settings", "source", "picture"}
    assert rows == made
