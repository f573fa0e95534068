"""docs/reference/serial.md: typed lines get the answers shown, its C and Python run,
its events are vectors.
"""

from __future__ import annotations

import json
import os
import pty
import re
import select
import shutil
import subprocess
import threading
import time
import tty
from dataclasses import fields
from pathlib import Path

import pytest

from support.patience import patience
from tacshade_edge.robot.framing import LinkCounts
from tacshade_edge.robot.port import SerialPort
from tacshade_edge.robot.robot import Robot
from tacshade_edge.robot.serial_link import SerialLink
from tacshade_edge.robot.touch_events import TouchEvents
from tacshade_edge.robot.verbs import USAGE
from tacshade_edge.types import QUANTITIES
from tools.examples.serial.host import Daemon

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/reference/serial.md").read_text()
VECTORS = json.loads((ROOT / "tests" / "wire" / "vectors" / "serial.json").read_text())
ROBOT_H = ROOT / "tools/examples/serial/robot.h"
GCC = shutil.which("gcc")

# Reads a word and its text a line, and prints what the functions make of it.
HARNESS = r"""
static void hex(const uint8_t *p, size_t n) { while (n--) printf("%02x", *p++); puts(""); }

int main(void) {
  static char line[1024], sealed[300];
  static uint8_t out[300];
  while (fgets(line, sizeof line, stdin)) {
    line[strcspn(line, "\n")] = 0;
    char *text = line + 5;
    if (!strncmp(line, "seal ", 5)) { seal(sealed, text); fputs(sealed, stdout); }
    if (!strncmp(line, "open ", 5)) { int whole = unseal(text); printf("%d %s\n", whole, text); }
    if (!strncmp(line, "line ", 5)) {
      strcat(text, "\n");
      hex(out, line_frame(out, text, strlen(text)));
    }
    if (!strncmp(line, "pose ", 5)) {
      float p[7];
      char *at;
      unsigned long seq = strtoul(text, &at, 10);
      unsigned long long t_ns = strtoull(at, &at, 10);
      for (int i = 0; i < 7; i++) p[i] = strtof(at, &at);
      hex(out, pose_frame(out, (uint16_t)seq, t_ns, p));
    }
  }
  return 0;
}
"""


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def test_what_is_typed_by_hand_is_answered_so() -> None:
    link = SerialLink()
    steps = [line for line in blocks("text")[0].splitlines() if line]
    now_ns = 0
    for step, following in zip(steps, [*steps[1:], ""], strict=True):
        if step.startswith("> "):
            now_ns += 2 * 10**9
            link.receive(step[2:].encode() + b"\n", now_ns)
            said = link.take_output().decode().splitlines()
            assert said == ([following[2:]] if following.startswith("< ") else [])


def test_every_verb_and_every_counter_has_its_row() -> None:
    verbs = re.findall(r"^\| `([A-Z]+)[^|]*` \|", TEXT.replace("\\|", "/"), re.MULTILINE)
    assert set(verbs) >= set(USAGE)
    for name in (
        *(each.name for each in fields(LinkCounts)),
        *TouchEvents(0, lambda: None).as_dict(),
        *QUANTITIES,
    ):
        assert re.search(rf"[` \n]{name}[` \n]", TEXT), name


@pytest.mark.skipif(GCC is None, reason="gcc is not installed")
def test_the_microcontrollers_code_makes_the_vectors(tmp_path: Path) -> None:
    assert GCC is not None
    source, program = tmp_path / "robot.c", tmp_path / "robot"
    source.write_text(ROBOT_H.read_text() + HARNESS)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-fsanitize=undefined"]
    subprocess.run([GCC, *flags, "-o", program, source], check=True, timeout=patience(60))
    asked, expected = [], []
    for vector in VECTORS["crc"]:
        asked.append(f"seal {vector['text']}")
        expected.append(f"{vector['text']}*{vector['crc']}")
    for vector in VECTORS["lines"]:
        asked.append(f"open {vector['raw']}")
        expected.append(f"1 {vector['raw'][:-5]}" if vector["checked"] else f"0 {vector['raw']}")
    for vector in VECTORS["bad_lines"][:4]:
        asked.append(f"open {vector['raw']}")
        expected.append(f"0 {vector['raw']}")
    for vector in VECTORS["poses"]:
        asked.append(
            f"pose {vector['seq']} {vector['t_ns']} {' '.join(map(str, vector['values']))}"
        )
        expected.append(vector["frame"])
    for vector in (*VECTORS["line_frames"], *VECTORS["touches"]):
        asked.append(f"line {vector['line']}")
        expected.append(vector["frame"])
    done = subprocess.run(
        [program],
        input="\n".join(asked) + "\n",
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert done.stdout.splitlines() == expected


class Wire:
    """The robot's end of a pty, with what the host's code wants of a port."""

    def __init__(self) -> None:
        self.fd, slave = pty.openpty()
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        self._slave = slave
        self._buffer = b""

    def write(self, data: bytes) -> None:
        os.write(self.fd, data)

    def read_until(self, end: bytes) -> bytes:
        deadline_s = time.monotonic() + 0.1
        while end not in self._buffer and time.monotonic() < deadline_s:
            if select.select([self.fd], [], [], 0.02)[0]:
                self._buffer += os.read(self.fd, 4096)
        line, found, rest = self._buffer.partition(end)
        if not found:
            return b""
        self._buffer = rest
        return line + found

    def close(self) -> None:
        os.close(self.fd)
        os.close(self._slave)


def test_the_hosts_code_talks_to_the_daemon() -> None:
    wire = Wire()
    state = {"source": "streaming", "health": {"delivered_fps": 30.0}}
    robot = Robot(
        SerialPort(wire.name, 115200),
        lambda *_: None,
        lambda: state,
        lambda _: None,
        lambda: None,
        tuple,
    )
    robot.start()
    try:
        host = Daemon(wire, "a1")
        pause = threading.Event()
        for _ in range(3):
            host.sync()
            for _ in range(10):
                host.pose(time.monotonic_ns(), 1, 2, 3, 1, 0, 0, 0)
                pause.wait(0.005)
        assert "sync=two-way" in host.command("STATUS")
        with pytest.raises(RuntimeError, match="UNAVAILABLE"):
            host.command("STITCH BEGIN pad")
        found = robot.motion.at(time.monotonic_ns() - 20_000_000)
        assert found is None or (found[0].x_mm, found[0].y_mm, found[0].z_mm) == (1, 2, 3)
        assert robot.health()["poses"] == 30
        sync = robot.motion.state()
        assert abs(sync.offset_ns) <= 1000 * (sync.error_us + 1)  # one clock: the truth is 0
    finally:
        robot.stop(5)
        wire.close()


def test_the_events_in_the_text_are_vectors() -> None:
    events = [line[2:] for line in blocks("text")[1].splitlines() if "EVT" in line]
    assert events == [each["line"] for each in VECTORS["touches"]]
