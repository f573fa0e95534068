"""The shipped files: what systemd and mosquitto themselves say of them, and what install.sh does with them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from mqtt_rig import MOSQUITTO, free_port, wait_until
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from tacshade_edge.settings import load

FILES = Path(__file__).parents[2] / "systemd"
EXPOSURE_MAX = 1.5
PROGRAM = "/opt/tacshade-edge/bin/tacshade-edge"
ANALYZE = shutil.which("systemd-analyze")
needs_analyze = pytest.mark.skipif(ANALYZE is None, reason="systemd is not installed")
needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


def analyze(*words: str | Path) -> str:
    assert ANALYZE is not None
    done = subprocess.run([ANALYZE, *words], capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def unit(folder: Path, old: str = PROGRAM, new: str = sys.executable) -> Path:
    """The unit with a program that exists here."""
    text = (FILES / "tacshade-edge.service").read_text().replace(PROGRAM, sys.executable)
    path = folder / "tacshade-edge.service"
    path.write_text(text.replace(old, new))
    return path


@needs_analyze
def test_systemd_finds_nothing_to_say_of_the_unit(tmp_path: Path) -> None:
    """Its exit code is 0 whatever it finds, so only silence counts."""
    assert "Unknown key" in analyze("verify", unit(tmp_path, "MemoryMax", "MemoryMaximum"))
    assert analyze("verify", unit(tmp_path)) == ""


@needs_analyze
def test_its_exposure_is_at_most_the_promised(tmp_path: Path) -> None:
    told = analyze("security", "--offline=true", "--no-pager", unit(tmp_path))
    assert 0.1 < float(re.search(r"exposure level for \S+: ([\d.]+)", told)[1]) <= EXPOSURE_MAX  # type: ignore[index]


def install(root: Path, *words: str) -> str:
    command = [FILES / "install.sh", *words]
    done = subprocess.run(
        command, env={"DESTDIR": str(root), "PATH": "/usr/bin:/bin"}, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout


def tree(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def test_install_twice_and_uninstall(tmp_path: Path) -> None:
    assert install(tmp_path) == ""
    first = tree(tmp_path)
    assert set(first) == {
        "usr/local/lib/systemd/system/tacshade-edge.service",
        "usr/local/lib/sysusers.d/tacshade-edge.conf",
        "etc/udev/rules.d/99-tacshade.rules",
        "etc/tacshade-edge/config.yaml",
        "etc/mosquitto/conf.d/tacshade.conf",
        "etc/mosquitto/tacshade.acl",
    }
    load(tmp_path / "etc/tacshade-edge/config.yaml")
    assert install(tmp_path) == ""
    assert tree(tmp_path) == first
    assert install(tmp_path, "--uninstall") == ""
    assert tree(tmp_path) == {}
    assert install(tmp_path, "--uninstall") == ""


def test_what_a_person_edited_is_kept(tmp_path: Path) -> None:
    install(tmp_path)
    config = tmp_path / "etc/tacshade-edge/config.yaml"
    config.write_text("profile: paper\n")
    assert install(tmp_path) == "kept: /etc/tacshade-edge/config.yaml\n"
    assert config.read_text() == "profile: paper\n"
    assert install(tmp_path, "--uninstall") == "kept: /etc/tacshade-edge/config.yaml (edited)\n"
    assert tree(tmp_path) == {"etc/tacshade-edge/config.yaml": b"profile: paper\n"}


def test_a_wrong_option_is_one_line(tmp_path: Path) -> None:
    command = [FILES / "install.sh", "--remove"]
    done = subprocess.run(command, env={"DESTDIR": str(tmp_path)}, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "install.sh: found --remove, expected --uninstall or nothing\n")


def start_broker(folder: Path, text: str) -> subprocess.Popen[str]:
    path = folder / "mosquitto.conf"
    path.write_text(f"user root\n{text}\n")
    return subprocess.Popen([str(MOSQUITTO), "-c", str(path)], stderr=subprocess.PIPE, text=True)


def answer(port: int, ca: Path | None, user: str | None) -> str:
    """What the broker says to a connection."""
    told: list[str] = []
    client = Client(CallbackAPIVersion.VERSION2)
    client.on_connect = lambda _c, _d, _f, reason, _p: told.append(str(reason))
    if ca is not None:
        client.tls_set(str(ca))
    if user is not None:
        client.username_pw_set(user, "secret")
    client.connect("127.0.0.1", port)
    client.loop_start()
    try:
        wait_until(lambda: told, 5, "an answer to CONNECT")
    finally:
        client.disconnect()
        client.loop_stop()
    return told[0]


def accepts(port: int, ca: Path | None, user: str | None) -> bool:
    try:
        return answer(port, ca, user) == "Success"
    except OSError:
        return False


@pytest.mark.broker
@needs_broker
def test_mosquitto_takes_the_drop_in_as_shipped(tmp_path: Path) -> None:
    port = free_port()
    broker = start_broker(
        tmp_path, f"port {port}\nallow_anonymous true\n{(FILES / 'mosquitto-tacshade.conf').read_text()}"
    )
    try:
        wait_until(lambda: accepts(port, None, None), 10, "a connection")
    finally:
        broker.terminate()
        _, errors = broker.communicate(timeout=10)
    assert "Error" not in errors


@pytest.mark.broker
@needs_broker
def test_mosquitto_takes_the_drop_in_filled_in(tmp_path: Path) -> None:
    port = free_port()
    key, certificate, passwords = tmp_path / "server.key", tmp_path / "server.crt", tmp_path / "passwd"
    options = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=localhost"
    names = ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(certificate)]
    subprocess.run(["openssl", *options.split(), *names], check=True, capture_output=True)
    passwords.touch(0o600)
    subprocess.run(["mosquitto_passwd", "-b", passwords, "tacshade", "secret"], check=True, capture_output=True)
    text = (FILES / "mosquitto-tacshade.conf").read_text().replace("#: ", "")
    for old, new in (
        ("/etc/mosquitto/tacshade.passwd", passwords),
        ("/etc/mosquitto/tacshade.acl", FILES / "mosquitto-tacshade.acl"),
        ("/etc/mosquitto/certs/server.crt", certificate),
        ("/etc/mosquitto/certs/server.key", key),
        ("listener 8883", f"listener {port}"),
    ):
        assert old in text
        text = text.replace(old, str(new))
    broker = start_broker(tmp_path, text)
    try:
        wait_until(lambda: accepts(port, certificate, "tacshade"), 10, "a connection with a password over TLS")
        assert answer(port, certificate, None) == "Not authorized"
    finally:
        broker.terminate()
        _, errors = broker.communicate(timeout=10)
    assert "Error" not in errors
