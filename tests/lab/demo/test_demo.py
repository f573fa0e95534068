from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from support.mqtt_rig import MOSQUITTO, Subscriber
from support.patience import wait_until
from tacshade_edge.errors import DeviceError
from tacshade_edge.lab.demo.child import Child, broker_command, free_port, wait_for_port

FULL_SIZE = 640 * 480 * 2 + 96


@pytest.mark.parametrize("kind", ["mosquitto", "embedded"])
def test_the_broker_carries_full_size_maps_and_keeps_retained_ones(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "embedded":
        pytest.importorskip("iotcore")
        monkeypatch.setattr(shutil, "which", lambda *_, **__: None)
    elif MOSQUITTO is None:
        pytest.skip("mosquitto is not installed")
    port = free_port()
    child = Child("broker", broker_command(tmp_path, port), tmp_path)
    try:
        wait_for_port(child, port, 20)
        with Subscriber(port, "tacshade/#", v5=True) as early:
            early.publish("tacshade/demo/state", b"online", retain=True)
            early.wait_for("tacshade/demo/state")
            for number in range(5):
                early.publish("tacshade/demo/height", bytes([number]) * FULL_SIZE, qos=0)
            maps = early.wait_for("tacshade/demo/height", 5)
            assert [(m[0], len(m)) for m in maps] == [(number, FULL_SIZE) for number in range(5)]
            with Subscriber(port, "tacshade/#", v5=True) as late:
                assert late.wait_for("tacshade/demo/state") == [b"online"]
        child.check()
    finally:
        child.stop()
    assert child.output.count("\n") < 30  # not a line for every message


def test_mosquitto_is_set_as_a_users_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda *_, **__: "mosquitto")
    broker_command(tmp_path, 1883)
    settings = (tmp_path / "mosquitto.conf").read_text().splitlines()
    drop_in = Path("systemd/mosquitto-tacshade.conf").read_text().splitlines()
    for line in filter(None, drop_in):
        assert line.startswith("#") or line in settings


def test_without_any_broker_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda *_, **__: None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(
        DeviceError,
        match=r"expected mosquitto or the `demo` extra's broker: pip install '\.\[demo\]'",
    ):
        broker_command(tmp_path, 1883)


def gone(pid: int) -> bool:
    """Dead, or dead and not yet collected by whoever inherited it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_a_child_that_ends_is_reported_with_its_last_line(tmp_path: Path) -> None:
    child = Child(
        "broker", ["sh", "-c", "echo first; echo; echo no room >&2; echo; exit 3"], tmp_path
    )
    with pytest.raises(DeviceError, match=r"^demo: the broker exited with status 3: no room$"):
        wait_for_port(child, free_port(), 20)
    child.stop()
    assert "first" in child.output


def test_a_child_that_does_not_listen_is_reported(tmp_path: Path) -> None:
    child, port = Child("daemon", ["sleep", "60"], tmp_path), free_port()
    with pytest.raises(
        DeviceError, match=rf"^demo: the daemon did not listen on port {port} within 0 s$"
    ):
        wait_for_port(child, port, 0.0)
    child.stop()
    with pytest.raises(DeviceError, match="exited with status -15: no output"):
        child.check()


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's death signal is Linux's")
def test_a_killed_demo_leaves_no_child(tmp_path: Path) -> None:
    program = f"""
from pathlib import Path
from tacshade_edge.lab.demo.child import Child
child = Child("daemon", ["sh", "-c", "echo $$; exec sleep 60"], Path({str(tmp_path)!r}))
while not child.output.strip():
    pass
print(child.output, flush=True)
input()
"""
    parent = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert not gone(pid)
    os.kill(parent.pid, signal.SIGKILL)
    wait_until(lambda: gone(pid), 10, "the child is gone")
    parent.communicate()
