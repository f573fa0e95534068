"""A person at a terminal (a pty) who uses ``tacshade-edge capture``."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from support.patience import patience


class Person:
    """Types into a command on a pty and reads its output."""

    def __init__(self, words: list[str], python: str, folder: Path | None) -> None:
        self._leader, follower = pty.openpty()
        command = [python, "-m", "tacshade_edge", "capture", *words]
        self.process = subprocess.Popen(
            command,
            stdin=follower,
            stdout=follower,
            stderr=follower,
            start_new_session=True,
            cwd=folder,
        )
        os.close(follower)
        self.heard = self.before = ""

    def hears(self, *texts: str) -> str:
        """Wait for one of the texts in the output since the last wait; return the one that came."""
        end_s = time.monotonic() + patience(60)
        while not (found := [text for text in texts if text in self.heard]):
            assert time.monotonic() < end_s, (
                f"did not say {' or '.join(texts)!r} but {self.heard!r}"
            )
            if select.select([self._leader], [], [], 0.1)[0]:
                said = self._read()
                assert said, f"ended, and did not say {' or '.join(texts)!r} but {self.heard!r}"
                self.heard += said
        self.before, _, self.heard = self.heard.partition(found[0])
        return found[0]

    def types(self, line: str) -> None:
        os.write(self._leader, f"{line}\n".encode())

    def ends(self) -> int:
        """Wait until the command ends; return its exit code."""
        while data := self._read():
            self.heard += data
        return self.process.wait(patience(20))

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._leader)

    def _read(self) -> str:
        try:
            return os.read(self._leader, 65536).decode()
        except OSError:  # the follower's last descriptor was closed
            return ""


@contextlib.contextmanager
def person(
    *words: str, python: str = sys.executable, folder: Path | None = None
) -> Iterator[Person]:
    started = Person(list(words), python, folder)
    try:
        yield started
    finally:
        started.close()
