from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tacshade_edge import cli
from tools.testbed.certificate import certificate
from tools.testbed.patience import patience, stretched

COMMAND = [sys.executable, "-m", "tacshade_edge", "dashboard"]


@pytest.mark.slow
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
        f"tacshade-edge: cannot listen on port {port} of 127.0.0.1: Address already in use; "
        "expected a free port of this machine\n"
    )


@pytest.mark.parametrize(
    "words",
    [
        *(
            ["--broker", a]
            for a in ("localhost", "localhost:", ":1883", "localhost:70000", "mqtt://h:1", "a@h:1", "h:0")
        ),
        *(["--http", port] for port in ("65536", "-1")),
        *(["--origin", origin] for origin in ("hand.example", "https://h/path")),
    ],
)
def test_bad_arguments_are_usage_errors(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["dashboard", *words])
    assert ended.value.code == 2
    assert f"argument {words[0]}: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["--recordings", "none"], 78),
        (["--host", "192.0.2.1"], 1),
        (["--ca-file", "none.pem"], 78),
        (["--ca-file", "text"], 78),
        *(
            (["--token-file", name], 78)
            for name in (".", "none/token", "empty", "short", "text", "long", "bytes", "lines")
        ),
    ],
)
def test_what_cannot_be_used_is_one_line(
    words: list[str], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    texts = {"empty": "", "short": "short", "text": "a token of several words", "long": "x" * 129}
    texts |= {"bytes": "\x80" * 20, "lines": "a" * 20 + "\n" + "b" * 20}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["dashboard", "--http", "0", *words]) == code
    out, errors = capsys.readouterr()
    assert out == ""
    assert errors.startswith("tacshade-edge: ")
    assert words[1] in errors
    assert errors.count("\n") == 1


def test_without_its_library_it_says_how_to_get_it() -> None:
    code = (
        "import sys; sys.modules['websockets'] = None; from tacshade_edge import cli; sys.exit(cli.main(['dashboard']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=patience(20), check=False
    )
    assert done.returncode == 78
    assert "pip install '.[dashboard]' in the clone" in done.stderr
    assert done.stderr.count("\n") == 1


@contextmanager
def started(*words: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The command's first line."""
    child = subprocess.Popen(
        [*COMMAND, "--http", "0", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    try:
        yield child.stdout.readline(), child
    finally:
        child.kill()
        child.communicate()


def test_opened_to_a_network_it_wants_a_token_and_is_read_only() -> None:
    with started("--host", "0.0.0.0") as (line, child):
        found = re.match(rf"dashboard: http://{re.escape(socket.gethostname())}:\d+/login#([\w-]{{32}}) for", line)
        assert found, line
        assert ", read-only; press Ctrl-C to stop" in line
        child.send_signal(signal.SIGTERM)
        assert "no encryption" in child.communicate(timeout=patience(20))[1]


@pytest.mark.slow
def test_a_token_is_told_once_and_kept(tmp_path: Path) -> None:
    cert, key = certificate(tmp_path)
    words = ["--host", "0.0.0.0", "--token-file", str(tmp_path / "t"), "--certificate", str(cert), "--key", str(key)]
    with started(*words) as (line, _):
        assert f"/login#{(tmp_path / 't').read_text().strip()} for the broker" in line
        assert f", read-only, token in {tmp_path / 't'}; press Ctrl-C to stop" in line
    with started(*words, "--allow-control") as (line, child):
        assert line.startswith("dashboard: https://")
        assert "#" not in line
        assert "read-only" not in line
        child.send_signal(signal.SIGTERM)
        assert child.communicate(timeout=patience(20))[1] == ""


def test_what_is_no_certificate_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cert, key = certificate(tmp_path)
    (tmp_path / "empty.pem").write_text("")
    locked = tmp_path / "locked.pem"
    command = ["openssl", "ec", "-in", key, "-aes256", "-passout", "pass:word", "-out", locked]
    subprocess.run(command, check=True, capture_output=True)
    for words in (
        ["--certificate", str(tmp_path / "none.pem")],
        ["--certificate", str(tmp_path / "empty.pem"), "--key", str(key)],
        ["--certificate", str(cert)],
        ["--certificate", str(cert), "--key", str(locked)],
        ["--certificate", str(cert), "--key", str(cert)],
        ["--key", str(key)],
    ):
        assert cli.main(["dashboard", "--http", "0", *words]) == 78
        errors = capsys.readouterr().err
        assert errors.startswith(f"tacshade-edge: {' '.join(words)}: ")
        assert ", expected " in errors
        assert errors.count("\n") == 1
