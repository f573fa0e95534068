#!/usr/bin/env python3
"""``make deb``: Debian packages of the service, ready to run and complete,
for boards without a clone and a network.

::

    python3 -m tools.release.package_debian [--machine x86_64 aarch64] [--python 3.11 3.13]
        [--out dist] [--level 9]

One for each machine and Debian release, whose Python it is for (3.11: Debian 12, 3.13: Debian 13).
In it: an environment as systemd/environment.sh makes it, of the wheels of systemd/requirements.lock
and the program's own; the files that systemd/install.sh lays; the scripts of systemd/debian. No
root, no program of the other machine. Needs uv, hatchling and Debian's dpkg-deb. Equal commits give
equal packages.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from tools.release.version import version

TREE = Path(__file__).resolve().parents[2]
APP = "opt/tacshade-edge"
ARCHITECTURES = {"x86_64": "amd64", "aarch64": "arm64"}
RELEASES = {"3.11": 12, "3.13": 13}
"""Debian's, whose python3 it is; Raspberry Pi OS has the same."""
ELF_MACHINES = {"x86_64": 62, "aarch64": 183}
UV = (sys.executable, "-m", "uv")
LOCK = TREE / "systemd/requirements.lock"
CONFFILES = (
    "etc/tacshade-edge/config.yaml",
    "etc/mosquitto/conf.d/tacshade.conf",
    "etc/mosquitto/tacshade.acl",
)
OURS = ("refresh.sh", "hand.conf", "rpicam.conf", "serial.conf")
"""Files that the scripts run, and files that a person installs as needed."""
SCRIPTS = ("preinst", "postinst", "prerm", "postrm")
CONTROL = """\
Package: tacshade-edge
Version: {version}
Architecture: {architecture}
Maintainer: tacshade-edge <root@localhost>
Section: science
Priority: optional
Installed-Size: {size_kib}
Depends: python3 (>= {python}~), python3 (<< {next}~), python3-systemd, systemd, \
libc6 (>= 2.28), libstdc++6, libgcc-s1, zlib1g
Recommends: mosquitto
Description: tactile sensor TacShade: camera to height maps over MQTT
 A daemon that turns the camera images of a TacShade, a soft optical tactile
 fingertip, into height maps and object clouds, with its service, its commands
 and all Python packages that it needs.
"""
COPYRIGHT = """\
tacshade-edge is under the licence below. The packages of others beside it in
/opt/tacshade-edge/lib, unchanged as on the Python Package Index, have their licences in their
folders *.dist-info, cv2 and onnxruntime there; the release's bill.cdx.json lists them.

"""


def main() -> int:
    """Make the packages that the command line requests."""
    parser = argparse.ArgumentParser(
        prog="package_debian.py", description="Make Debian packages of the service."
    )
    parser.add_argument("--machine", nargs="+", choices=ARCHITECTURES, default=list(ARCHITECTURES))
    parser.add_argument("--python", nargs="+", choices=RELEASES, default=list(RELEASES))
    parser.add_argument("--out", type=Path, default=TREE / "dist", help="folder")
    parser.add_argument("--level", type=int, default=9, help="zstd's: 1 (fast) to 19 (small)")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        words = ("build", "--quiet", "--wheel", "--no-build-isolation", "--out-dir", folder)
        subprocess.run((*UV, *words, str(TREE)), check=True)
        (wheel,) = Path(folder).glob("*.whl")
        for machine in args.machine:
            for python in args.python:
                made = args.out / file_name(version(), python, machine)
                with tempfile.TemporaryDirectory(dir=args.out) as root:
                    stage(Path(root), wheel, machine, python, debian_version(version(), python))
                    pack(Path(root), made, args.level)
                print(f"{made}: {made.stat().st_size / 1e6:.0f} MB")
    return 0


def debian_version(version: str, python: str) -> str:
    """The package's version: a development version lies below its release, as in Python."""
    return f"{version.replace('.dev', '~dev')}+deb{RELEASES[python]}"


def file_name(version: str, python: str, machine: str) -> str:
    """The package's file, of a program of this version."""
    return f"tacshade-edge_{debian_version(version, python)}_{ARCHITECTURES[machine]}.deb"


def stage(root: Path, wheel: Path, machine: str, python: str, version: str) -> None:
    """Lay out all files of a package of this version below `root`."""
    root.chmod(0o755)
    environment(root / APP, wheel, machine, python)
    below = os.environ | {"DESTDIR": str(root), "LIB": "/usr/lib"}
    subprocess.run((TREE / "systemd/install.sh",), env=below, check=True)
    (root / APP / "systemd").mkdir()
    for name in OURS:
        shutil.copy(TREE / "systemd" / name, root / APP / "systemd")
    (root / "usr/bin").mkdir(parents=True)
    (root / "usr/bin/tacshade-edge").symlink_to(f"/{APP}/bin/tacshade-edge")
    completion(root / "usr/share/bash-completion/completions")
    about = root / "usr/share/doc/tacshade-edge"
    about.mkdir(parents=True)
    (about / "copyright").write_text(COPYRIGHT + (TREE / "LICENSE").read_text())
    shutil.copy(TREE / "CHANGELOG.md", about)
    # What a person copies to other programs: a board may have no clone.
    shutil.copytree(TREE / "config/integrations", about / "examples")
    check_machine(root, machine)
    # Before anything in DEBIAN, which is not installed.
    files = [path for path in sorted(root.rglob("*")) if path.is_file() and not path.is_symlink()]
    sums = [
        f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(root)}\n"
        for path in files
    ]
    about_it = {
        "version": version,
        "architecture": ARCHITECTURES[machine],
        "size_kib": sum(path.stat().st_size for path in files) // 1024,
        "python": python,
        "next": f"3.{int(python.partition('.')[2]) + 1}",
    }
    (root / "DEBIAN").mkdir()
    (root / "DEBIAN/md5sums").write_text("".join(sums))
    (root / "DEBIAN/control").write_text(CONTROL.format(**about_it))
    (root / "DEBIAN/conffiles").write_text("".join(f"/{name}\n" for name in CONFFILES))
    for name in SCRIPTS:
        shutil.copy(TREE / "systemd/debian" / name, root / "DEBIAN")


def completion(folder: Path) -> None:
    """Bash's completion of the commands and their options, which a board cannot make itself."""
    folder.mkdir(parents=True)
    words = (sys.executable, "-m", "tacshade_edge", "completion", "bash")
    made = subprocess.run(words, cwd=TREE, capture_output=True, check=True)
    (folder / "tacshade-edge").write_bytes(made.stdout)


def environment(app: Path, wheel: Path, machine: str, python: str) -> None:
    """A virtual environment of Debian's Python, which takes no more than this,
    filled for another machine.
    """
    packages = app / "lib" / f"python{python}" / "site-packages"
    board = (
        "--python-platform",
        f"{machine}-manylinux_2_28",
        "--python-version",
        python,
        "--target",
        str(packages),
    )
    words = (
        "install",
        "--quiet",
        *board,
        "--no-deps",
        "--require-hashes",
        "--link-mode",
        "copy",
        "-r",
        str(LOCK),
    )
    subprocess.run((*UV, "pip", *words), check=True)
    zipfile.ZipFile(wheel).extractall(packages)  # an installer would note where and when
    (packages / ".lock").unlink(missing_ok=True)
    shutil.rmtree(packages / "bin", ignore_errors=True)
    # Of the environment's Python too, which sees no other package of Debian's.
    (packages / "systemd").symlink_to("/usr/lib/python3/dist-packages/systemd")
    (app / "bin").mkdir()
    (app / "bin/python3").symlink_to("/usr/bin/python3")
    (app / "bin/python").symlink_to("python3")
    (app / "pyvenv.cfg").write_text("home = /usr/bin\ninclude-system-site-packages = false\n")
    command = app / "bin/tacshade-edge"
    command.write_text(
        f"#!/{APP}/bin/python3\nfrom tacshade_edge.__main__ import entry\n\nentry()\n"
    )
    command.chmod(0o755)


def check_machine(root: Path, machine: str) -> None:
    """Raise ValueError for a library or program that was compiled for another machine."""
    for path in root.rglob("*"):
        if path.is_file() and not path.is_symlink():
            with path.open("rb") as file:
                head = file.read(20)
            if (
                head[:4] == b"\x7fELF"
                and int.from_bytes(head[18:20], "little") != ELF_MACHINES[machine]
            ):
                raise ValueError(f"{path.relative_to(root)}: expected a file for {machine}")


def pack(root: Path, file: Path, level: int) -> None:
    """Pack the files below `root` into the package."""
    subprocess.run(("chmod", "-R", "u=rwX,go=rX", str(root)), check=True)
    (root / "etc/tacshade-edge").chmod(0o750)
    command = ("git", "-C", str(TREE), "log", "-1", "--format=%ct")
    commit_s = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    environment = os.environ | ({"SOURCE_DATE_EPOCH": commit_s} if commit_s else {})
    words = ("--root-owner-group", "-Zzstd", f"-z{level}", "--build", str(root), str(file))
    subprocess.run(("dpkg-deb", *words), env=environment, check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    sys.exit(main())
