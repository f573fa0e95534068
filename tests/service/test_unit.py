"""The unit and its installation as systemd judges them,
and what the daemon takes of a small board's memory.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tacshade_edge.settings import load

FILES = Path(__file__).parents[2] / "systemd"
EXPOSURE_MAX = 1.5
PROGRAM = "/opt/tacshade-edge/bin/tacshade-edge"
ANALYZE = shutil.which("systemd-analyze")
needs_analyze = pytest.mark.skipif(ANALYZE is None, reason="systemd is not installed")


def analyze(*words: str | Path) -> str:
    assert ANALYZE is not None
    done = subprocess.run([ANALYZE, *words], capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def unit(
    folder: Path,
    old: str = PROGRAM,
    new: str = sys.executable,
    name: str = "tacshade-edge.service",
) -> Path:
    """The unit with a program that exists here."""
    text = (FILES / name).read_text().replace(PROGRAM, sys.executable)
    path = folder / name
    path.write_text(text.replace(old, new))
    return path


@needs_analyze
def test_systemd_finds_nothing_to_say_of_the_unit(tmp_path: Path) -> None:
    """Its exit code is 0 whatever it finds, so only silence counts."""
    assert "Unknown key" in analyze("verify", unit(tmp_path, "MemoryMax", "MemoryMaximum"))
    assert analyze("verify", unit(tmp_path)) == ""


@needs_analyze
@pytest.mark.parametrize("name", ["serial.conf", "rpicam.conf", "hand.conf"])
def test_nor_of_what_lets_it_use_other_devices(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "tacshade-edge.service.d"
    folder.mkdir()
    text = (FILES / name).read_text()
    (folder / name).write_text(text)
    assert analyze("verify", unit(tmp_path)) == ""
    (folder / name).write_text(text.replace("MemoryMax", "MemoryMost"))
    assert "Unknown key" in analyze("verify", unit(tmp_path))


@needs_analyze
def test_nor_of_the_dashboards(tmp_path: Path) -> None:
    assert analyze("verify", unit(tmp_path, name="tacshade-dashboard.service")) == ""


@needs_analyze
@pytest.mark.parametrize("name", ["tacshade-edge.service", "tacshade-dashboard.service"])
def test_its_exposure_is_at_most_the_promised(tmp_path: Path, name: str) -> None:
    report = analyze("security", "--offline=true", "--no-pager", unit(tmp_path, name=name))
    (exposure,) = re.findall(r"exposure level for \S+: ([\d.]+)", report)
    assert 0.1 < float(exposure) <= EXPOSURE_MAX


@pytest.mark.parametrize("name", ["tacshade-edge.service", "tacshade-dashboard.service"])
def test_a_minimal_debian_has_every_program_of_the_units(name: str) -> None:
    text = (FILES / name).read_text()
    programs = re.findall(r"^Exec\w+=[-@:+!]*(\S+)", text, re.MULTILINE)
    assert PROGRAM in programs
    assert set(programs) <= {PROGRAM, "/bin/sh"}


def install(root: Path, *words: str, **environment: str) -> str:
    environ = {"DESTDIR": str(root), "PATH": "/usr/bin:/bin", **environment}
    done = subprocess.run(
        [FILES / "install.sh", *words], env=environ, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout


def tree(root: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()
    }


def test_install_twice_and_uninstall(tmp_path: Path) -> None:
    assert install(tmp_path) == ""
    first = tree(tmp_path)
    assert set(first) == {
        "usr/local/lib/systemd/system/tacshade-edge.service",
        "usr/local/lib/systemd/system/tacshade-dashboard.service",
        "usr/local/lib/sysusers.d/tacshade-edge.conf",
        "etc/udev/rules.d/99-tacshade.rules",
        "etc/tacshade-edge/config.yaml",
        "etc/mosquitto/conf.d/tacshade.conf",
        "etc/mosquitto/tacshade.acl",
    }
    load(tmp_path / "etc/tacshade-edge/config.yaml")
    # Where sudo looks.
    command = tmp_path / "usr/local/bin/tacshade-edge"
    assert command.readlink() == Path("/opt/tacshade-edge/bin/tacshade-edge")
    assert install(tmp_path) == ""
    assert tree(tmp_path) == first
    assert install(tmp_path, "--uninstall") == ""
    assert tree(tmp_path) == {}
    assert not command.is_symlink()
    assert install(tmp_path, "--uninstall") == ""


def test_a_packages_files_lie_where_those_of_packages_do(tmp_path: Path) -> None:
    install(tmp_path, LIB="/usr/lib")
    assert not (tmp_path / "usr/local").exists()
    assert {name for name in tree(tmp_path) if not name.startswith("etc/")} == {
        "usr/lib/systemd/system/tacshade-edge.service",
        "usr/lib/systemd/system/tacshade-dashboard.service",
        "usr/lib/sysusers.d/tacshade-edge.conf",
        "usr/lib/udev/rules.d/99-tacshade.rules",
    }
    assert install(tmp_path, "--uninstall", LIB="/usr/lib") == ""
    assert tree(tmp_path) == {}


def test_a_command_of_another_installation_is_kept(tmp_path: Path) -> None:
    command = tmp_path / "usr/local/bin/tacshade-edge"
    command.parent.mkdir(parents=True)
    command.write_text("of pipx\n")
    install(tmp_path)
    install(tmp_path, "--uninstall")
    assert command.read_text() == "of pipx\n"


def test_what_a_person_edited_is_kept(tmp_path: Path) -> None:
    install(tmp_path)
    config = tmp_path / "etc/tacshade-edge/config.yaml"
    config.write_text("profile: paper\n")
    assert install(tmp_path) == "kept: /etc/tacshade-edge/config.yaml\n"
    assert config.read_text() == "profile: paper\n"
    assert install(tmp_path, "--uninstall") == "kept: /etc/tacshade-edge/config.yaml (edited)\n"
    assert tree(tmp_path) == {"etc/tacshade-edge/config.yaml": b"profile: paper\n"}


FRAMES, FPS = (
    1_500,
    150,
)  # as fast as a busy machine of two cores reads them; what comes too fast is superseded
# Measured with ONNX Runtime 1.32, which takes 8 MB more than 1.28: 120.6 MB after a tenth, 120.8 at
# the end and at the peak of 5000 frames. A kilobyte forgotten with each frame of these: 1.3 MB.
RESIDENT_MAX_MB, GROWTH_MAX_MB = 128.0, 1.2


@pytest.mark.slow
@pytest.mark.broker
def test_it_stays_small_and_does_not_grow(tmp_path: Path) -> None:
    figures = tmp_path / "memory.json"
    words = f"-m tools.benchmarks.memory --frames {FRAMES} --fps {FPS} --json {figures}"
    command = [sys.executable, *words.split()]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    read = json.loads(figures.read_text())
    assert read["frames"]["published"] >= FRAMES / 2
    begin, _, whole = read["after"].values()
    assert 0 < whole["peak"] < RESIDENT_MAX_MB
    assert whole["resident"] - begin["resident"] < GROWTH_MAX_MB
    print(done.stdout)
