"""How an extra is installed: from a clone, but not into Debian's package."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tacshade_edge import version


def test_debians_package_takes_no_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert version.how_to_install("demo") == "pip install '.[demo]' in the clone"
    monkeypatch.setattr(sys, "prefix", version.PACKAGED)
    monkeypatch.setattr(version, "DPKG_LIST", tmp_path / "tacshade-edge.list")
    assert "in the clone" in version.how_to_install("demo")  # install.sh, which has a clone
    (tmp_path / "tacshade-edge.list").touch()
    assert version.how_to_install("fit") == (
        "use a PC whose installation has the extra fit (README.md, Get it), as the Debian package "
        "takes none"
    )
