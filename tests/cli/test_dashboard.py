from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.patience import patience, stretched

from tacshade_edge import cli

COMMAND = [sys.executable, "-m", "tacshade_edge", "dashboard"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_tells_its_address_and_stops_on_a_signal(number: signal.Signals) -> None:
    child = subprocess.Popen(
        [*COMMAND, "--broker", "[::1]:1883", "--http", "0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    line = child.stdout.readline()
    assert line.startswith("dashboard: http://127.0.0.1:")
    assert "[::1]:1883" in line
    port = int(line.split("/")[2].rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port)):  # one that says nothing
        began = time.monotonic()
        child.send_signal(number)
        out, errors = child.communicate(timeout=patience(20))
    assert time.monotonic() - began < stretched(3)  # it is 0.8 s
    assert (child.returncode, out, errors) == (0, "", "")


def test_a_port_in_use_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert cli.main(["dashboard", "--http", str(port)]) == 1
    out, errors = capsys.readouterr()
    assert out == ""
    assert errors == (
        f"tacshade-edge: port {port} of 127.0.0.1: Address already in use, expected a free port of this machine\n"
    )


def test_an_address_of_another_machine_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["dashboard", "--http", "0", "--host", "192.0.2.1"]) == 1
    assert "port 0 of 192.0.2.1: Cannot assign requested address" in capsys.readouterr().err


@pytest.mark.parametrize(
    "address", ["localhost", "localhost:", ":1883", "localhost:70000", "mqtt://h:1", "a@h:1", "h:0"]
)
def test_a_bad_broker_address_is_a_usage_error(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["dashboard", "--broker", address])
    assert ended.value.code == 2
    assert f"found {address!r}, expected HOST:PORT" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["--http", "65536"], ["--http", "-1"], ["--origin", "hand.example"], ["--origin", "https://h/path"]]
)
def test_other_bad_arguments_are_usage_errors(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["dashboard", *words])
    assert ended.value.code == 2
    assert "expected" in capsys.readouterr().err


def test_a_bad_authority_file_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "ca.pem").write_text("no certificate")
    for name in ("ca.pem", "none.pem"):
        assert cli.main(["dashboard", "--ca-file", str(tmp_path / name)]) == 78
        errors = capsys.readouterr().err
        assert f"--ca-file {tmp_path / name}: " in errors
        assert errors.count("\n") == 1


def test_without_its_library_it_says_how_to_get_it() -> None:
    code = (
        "import sys; sys.modules['websockets'] = None; from tacshade_edge import cli; sys.exit(cli.main(['dashboard']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=patience(20), check=False
    )
    assert done.returncode == 78
    assert "pip install 'tacshade-edge[dashboard]'" in done.stderr
    assert done.stderr.count("\n") == 1
