"""What a package must not be made of; tests/service/test_package.py lives with a whole one."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tools.release import package_debian

SCRIPTS = Path(__file__).parents[3] / "systemd/debian"


def elf(machine: int) -> bytes:
    """The head of a library for a machine, by its number."""
    return b"\x7fELF\2\1\1".ljust(18, b"\0") + machine.to_bytes(2, "little")


@pytest.mark.parametrize(("machine", "other"), [("x86_64", "aarch64"), ("aarch64", "x86_64")])
def test_a_library_for_another_machine_is_refused(tmp_path: Path, machine: str, other: str) -> None:
    (tmp_path / "ours.so").write_bytes(elf(package_debian.ELF_MACHINES[machine]))
    (tmp_path / "text").write_text("no library")
    package_debian.check_machine(tmp_path, machine)
    (tmp_path / "theirs.so").write_bytes(elf(package_debian.ELF_MACHINES[other]))
    with pytest.raises(ValueError, match=rf"theirs\.so: expected a file for {machine}"):
        package_debian.check_machine(tmp_path, machine)


@pytest.mark.parametrize("name", package_debian.SCRIPTS)
def test_its_scripts_are_in_the_language_of_every_debian(name: str) -> None:
    script = SCRIPTS / name
    assert script.read_text().startswith("#!/bin/sh\nset -e\n")
    assert script.stat().st_mode & 0o111
    assert subprocess.run(["sh", "-n", script], check=False).returncode == 0
