"""``tacshade-edge dashboard`` and ``bridge``:
what they print, and what they refuse, in one line.
"""

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

from support.mqtt_rig import certificate
from support.patience import patience, stretched
from tacshade_edge.cli import EXIT_CONFIG, main


@contextmanager
def started(*words: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The command's first line."""
    command = [sys.executable, "-m", "tacshade_edge", "dashboard", "--http", "0", *words]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout is not None
    try:
        yield child.stdout.readline(), child
    finally:
        child.kill()
        child.communicate()


@pytest.mark.slow
def test_it_prints_its_address_and_stops_on_a_signal() -> None:
    with started("--broker", "[::1]:1883") as (line, child):
        found = re.match(r"dashboard: http://127\.0\.0\.1:(\d+)/ for the broker \[::1\]:1883", line)
        assert found, line
        with socket.create_connection(("127.0.0.1", int(found[1]))):  # one that says nothing
            began = time.monotonic()
            child.send_signal(signal.SIGINT)
            out, errors = child.communicate(timeout=patience(20))
        assert time.monotonic() - began < stretched(3)  # it is 0.8 s
        assert (child.returncode, out, errors) == (0, "", "")


@pytest.mark.slow
def test_the_folder_of_the_recordings_is_made(tmp_path: Path) -> None:
    folder = tmp_path / "var" / "recordings"
    with started("--recordings", str(folder)) as (line, _):
        assert line.startswith("dashboard: http"), line
        assert folder.is_dir()


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["--http", "TAKEN"], 1),
        (["--recordings", "text"], 78),
        (["--recordings", "text/none"], 78),
        (["--host", "192.0.2.1"], 1),
        (["--ca-file", "none.pem"], 78),
        (["--ca-file", "text"], 78),
        *(
            (["--token-file", name], 78)
            for name in (".", "none/token", "empty", "short", "text", "long", "lines")
        ),
        (["--certificate", "none.pem"], 78),
        (["--certificate", "empty", "--key", "key.pem"], 78),
        (["--certificate", "cert.pem"], 78),
        (["--certificate", "cert.pem", "--key", "locked.pem"], 78),
        (["--certificate", "cert.pem", "--key", "cert.pem"], 78),
        (["--key", "key.pem"], 78),
    ],
)
def test_what_cannot_be_used_is_one_line(
    words: list[str],
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    texts = {"empty": "", "short": "short", "text": "a token of several words", "long": "x" * 129}
    for name, text in (texts | {"lines": "a" * 20 + "\n" + "b" * 20}).items():
        (tmp_path / name).write_text(text)
    for name, path in zip(("cert.pem", "key.pem"), certificate(tmp_path), strict=True):
        path.rename(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    command = [
        "openssl",
        "ec",
        "-in",
        "key.pem",
        "-aes256",
        "-passout",
        "pass:word",
        "-out",
        "locked.pem",
    ]
    subprocess.run(command, check=True, capture_output=True)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        words = [word.replace("TAKEN", port) for word in words]
        assert main(["dashboard", *(() if "--http" in words else ("--http", "0")), *words]) == code
    out, errors = capsys.readouterr()
    assert (out, errors.count("\n")) == ("", 1)
    assert errors.startswith("tacshade-edge: ")
    assert words[1] in errors
    assert "expected " in errors


@pytest.mark.slow
def test_a_token_is_printed_once_and_kept(tmp_path: Path) -> None:
    cert, key = certificate(tmp_path)
    words = [
        "--host",
        "0.0.0.0",
        "--token-file",
        str(tmp_path / "t"),
        "--certificate",
        str(cert),
        "--key",
        str(key),
    ]
    with started(*words) as (line, _):
        assert f"/login#{(tmp_path / 't').read_text().strip()} for the broker" in line
        assert f", read-only, token in {tmp_path / 't'}; press Ctrl-C to stop" in line
    assert (tmp_path / "t").stat().st_mode & 0o777 == 0o600
    with started(*words, "--allow-control") as (line, child):
        assert line.startswith("dashboard: https://")
        assert "#" not in line
        assert "read-only" not in line
        child.send_signal(signal.SIGTERM)
        assert child.communicate(timeout=patience(20))[1] == ""


KINDS = {"foxglove": "foxglove", "prometheus": "prometheus_client"}


@pytest.mark.parametrize(
    ("words", "package"),
    [
        ("dashboard", "websockets"),
        ("bridge foxglove", "foxglove"),
        ("bridge prometheus", "prometheus_client"),
        ("bridge ros2", "zenoh"),
    ],
)
def test_a_missing_package_names_its_extra(
    words: str, package: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    assert main(words.split()) == EXIT_CONFIG
    assert capsys.readouterr().err.endswith(f"pip install '.[{words.split()[-1]}]' in the clone\n")


@pytest.mark.parametrize("kind", KINDS)
def test_an_address_in_use(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip(KINDS[kind], reason=f"the extra {kind} is not installed")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        assert main(["bridge", kind, "--listen", where]) == EXIT_CONFIG
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(f"tacshade-edge: --listen {where}: ")
    assert "Address already in use" in error


def test_a_password_needs_a_name_and_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["bridge", "prometheus", "--password-file", str(tmp_path / "password")]
    assert main(words) == EXIT_CONFIG
    assert "--password-file: found no --username" in capsys.readouterr().err
    assert main([*words, "--username", "dashboard"]) == EXIT_CONFIG
    assert (
        f"--password-file: {tmp_path}/password: No such file or directory"
        in capsys.readouterr().err
    )
