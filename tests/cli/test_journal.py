"""What the journal's socket gets from a process that logs by python3-systemd,
in a mount namespace of its own.
"""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache

import pytest

from support.patience import patience
from tacshade_edge import libsystemd

pytestmark = [
    pytest.mark.slow,
    # Not by find_spec("systemd"), which finds the repository's folder of that name.
    pytest.mark.skipif(
        libsystemd.module("journal") is None, reason="systemd-python is not installed"
    ),
]

LOGS = """
import json, logging, os, socket, sys, threading
os.makedirs("/run/systemd/journal")
journal = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
journal.bind("/run/systemd/journal/socket")
said = []
def read():
    while entry := journal.recv(1 << 16):
        said.append(entry.hex())
reader = threading.Thread(target=read)
reader.start()
found = os.fstat(2)
os.environ["JOURNAL_STREAM"] = f"{found.st_dev}:{found.st_ino}"
from tacshade_edge.cli.shared.logs import start_logging
start_logging(logging.INFO, "left", each_line=len(sys.argv) > 1)
log = logging.getLogger("test")
log.debug("nothing")
log.info("said %s", "a\\nPRIORITY=0")
try:
    raise ValueError("bad\\nMESSAGE=forged")
except ValueError:
    log.exception("failed")
for k in range(30):
    log.warning("again %d", k)
logging.shutdown()
with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
    end.sendto(b"", "/run/systemd/journal/socket")
reader.join()
print(json.dumps(said))
"""


def fields(message: bytes) -> dict[str, str]:
    """The fields of one entry in the journal's native protocol,
    whose long form has the value's size.
    """
    found = {}
    while message:
        line, _, message = message.partition(b"\n")
        name, short, value = line.partition(b"=")
        if not short:
            size = int.from_bytes(message[:8], "little")
            value, message = message[8 : 8 + size], message[9 + size :]
        found[name.decode()] = value.decode()
    return found


def in_namespace(program: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a Python program with a /run of its own, where it can be the journal."""
    script = 'mount -t tmpfs tmpfs /run && exec "$@"'
    command = ["unshare", "--mount", "--map-root-user", "sh", "-c", script, "sh"]
    probe = subprocess.run([*command, "true"], capture_output=True, text=True, check=False)
    if probe.returncode:
        pytest.skip(f"no mount namespace here: {probe.stderr.strip()}")
    return subprocess.run(
        [*command, sys.executable, "-c", program, *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=patience(20),
    )


@cache
def entries(*words: str) -> tuple[dict[str, str], ...]:
    """What the journal got; with a word, of a process for one of several sensors."""
    done = in_namespace(LOGS, *words)
    assert (done.returncode, done.stderr) == (0, "")
    return tuple(fields(bytes.fromhex(message)) for message in json.loads(done.stdout))


def test_each_message_is_one_entry_with_its_priority_place_and_sensor() -> None:
    said, failed, *again = entries()
    assert said["MESSAGE"] == r"INFO test: said a\nPRIORITY=0"
    assert said["PRIORITY"] == "6"
    assert failed["PRIORITY"] == "3"
    assert failed["MESSAGE"].startswith("ERROR test: failed\n    Traceback")
    assert failed["MESSAGE"].splitlines()[-1] == "    MESSAGE=forged"
    assert {entry["PRIORITY"] for entry in again} == {"4"}
    for entry in (said, failed, *again):
        assert (entry["SENSOR_ID"], entry["SYSLOG_IDENTIFIER"]) == ("left", "tacshade-edge")
        assert entry["LOGGER"] == "test"
        assert entry["CODE_LINE"].isdecimal()


def test_a_flood_is_limited_there_too() -> None:
    *_, last = entries()
    assert len(entries()) == 2 + 10 + 1
    assert last["MESSAGE"] == "WARNING test: left out 20 more lines like this: again #"


def test_of_several_sensors_each_line_names_its_own() -> None:
    assert entries("several")[0]["MESSAGE"] == r"INFO test: left: said a\nPRIORITY=0"


STALLED = """
import logging, os, socket
os.makedirs("/run/systemd/journal")
journal = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
journal.bind("/run/systemd/journal/socket")
with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as others:
    others.setblocking(False)
    try:
        while others.sendto(b"MESSAGE=full", "/run/systemd/journal/socket"):
            pass
    except BlockingIOError:
        pass
found = os.fstat(2)
os.environ["JOURNAL_STREAM"] = f"{found.st_dev}:{found.st_ino}"
from tacshade_edge.cli.shared.logs import start_logging
start_logging(logging.INFO)
logging.getLogger("test").warning("said")
"""


def test_a_journal_that_does_not_read_holds_nothing_up() -> None:
    done = in_namespace(STALLED)
    assert (done.returncode, done.stderr) == (0, "<4>WARNING test: said\n")
