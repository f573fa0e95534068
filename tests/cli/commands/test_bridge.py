"""``tacshade-edge bridge``: what it refuses, in one line."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import pytest

from tacshade_edge.cli import EXIT_CONFIG, main

KINDS = {"foxglove": "foxglove", "prometheus": "prometheus_client"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_missing_package_names_its_extra(
    kind: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, KINDS[kind], None)
    assert main(["bridge", kind]) == EXIT_CONFIG
    assert capsys.readouterr().err.endswith(f"to install it: pip install '.[{kind}]' in the clone\n")


@pytest.mark.parametrize("kind", KINDS)
def test_an_address_in_use(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip(KINDS[kind], reason=f"the extra {kind} is not installed")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        assert main(["bridge", kind, "--listen", where]) == EXIT_CONFIG
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(f"tacshade-edge: --listen {where}: ")
    assert "Address already in use" in error


def test_a_password_needs_a_name_and_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bridge", "prometheus", "--password-file", str(tmp_path / "password")]
    assert main(words) == EXIT_CONFIG
    assert "--password-file: found no --username" in capsys.readouterr().err
    assert main([*words, "--username", "dashboard"]) == EXIT_CONFIG
    assert f"--password-file: {tmp_path}/password: No such file or directory" in capsys.readouterr().err
