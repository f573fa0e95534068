"""A bridge as its users run it, with its memory and its time to stop."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from types import TracebackType

from tools.testbed.patience import patience


class BridgeProcess:
    """``tacshade-edge bridge KIND`` for a broker on this machine, on a free port, at the `url` that it prints."""

    def __init__(self, kind: str, broker_port: int, log: Path, *words: str) -> None:
        self._command = [sys.executable, "-m", "tacshade_edge", "bridge", kind, "--listen", "127.0.0.1:0"]
        self._command += ["--broker", f"127.0.0.1:{broker_port}", *words]
        self._log = log

    def __enter__(self) -> BridgeProcess:
        with self._log.open("w") as stream:
            self.process = subprocess.Popen(self._command, stdout=subprocess.PIPE, stderr=stream, text=True)
        assert self.process.stdout is not None
        found = re.search(r"\w+://\S+", self.process.stdout.readline())
        assert found, self.log()
        self.url = found[0]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.kill()
        self.process.communicate()

    @property
    def port(self) -> int:
        """The port that it listens on."""
        found = re.search(r":(\d+)", self.url)
        assert found
        return int(found[1])

    def log(self) -> str:
        return self._log.read_text(errors="replace")

    def page(self) -> str:
        """The page that Prometheus gets. Raises OSError if there is no answer."""
        with urllib.request.urlopen(self.url, timeout=patience(10)) as answer:
            text: str = answer.read().decode()
            return text

    def peak_mb(self) -> float:
        """Its peak memory in MB."""
        return self._status("VmHWM") / 1024

    def threads(self) -> int:
        return self._status("Threads")

    def stopped_s(self) -> float:
        """Send SIGTERM; return the seconds until it ends."""
        began_s = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(patience(30))
        assert code == 0, f"exit {code}: {self.log()}"
        return time.monotonic() - began_s

    def _status(self, name: str) -> int:
        found = re.search(rf"{name}:\s+(\d+)", Path(f"/proc/{self.process.pid}/status").read_text())
        assert found
        return int(found[1])
