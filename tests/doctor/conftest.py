"""A machine below a folder: real directories, links and pipes in place of /dev, /proc and /sys."""

from __future__ import annotations

from pathlib import Path

import pytest

from tacshade_edge.doctor.machine import Machine


class Made(Machine):
    """A `Machine` that files can be put into."""

    __slots__ = ()

    def put(self, path: str, text: str = "") -> Path:
        target = self.at(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text)
        return target

    def link(self, path: str, to: str) -> None:
        target = self.at(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.symlink_to(to)

    def process(self, pid: int, *words: str, holds: str = "") -> None:
        self.put(f"/proc/{pid}/cmdline", "\0".join(words) + "\0")
        self.at(f"/proc/{pid}/fd").mkdir()
        if holds:
            self.link(f"/proc/{pid}/fd/3", str(self.at(holds)))


@pytest.fixture
def machine(tmp_path: Path) -> Made:
    return Made(tmp_path)
