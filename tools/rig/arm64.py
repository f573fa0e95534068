#!/usr/bin/env python3
"""Run a command as root in an arm64 user space: Debian's,
on QEMU's model of a Pi 5's processor (Cortex-A76).

::

    python3 -m tools.rig.arm64 [--python 3.11|3.13] COMMAND [ARGUMENT...]
    python3 -m tools.rig.arm64 [--processor cortex-a53] --count -m MODULE [ARGUMENT...]

With ``--count`` it prints the instructions that Python executes until each mark
(tools/ci/arm_frames.py) and until its end, there or on an older board's processor, whose libraries
take other ways: without dot products of integers, for one.
The tree (Debian bookworm for Python 3.11, trixie for 3.13) is made once below ``.rig/``: Debian's
packages unpacked, the wheels of ``systemd/requirements.lock`` installed, checked by their hashes,
and the tests' other dependencies. COMMAND runs in it with this tree at ``/src``, its folder, on the
machine's network. Needs root, and the Debian packages debootstrap, qemu-user-static, and for
--count qemu-user and gcc. Exit status 77 means that it cannot run here.

The processor is emulated instruction by instruction: its speed says nothing of a board's, the count
does. The kernel's files that state what processor there is (/proc/cpuinfo, /sys) are those of a Pi
5, since libraries choose their code by them; /sys has nothing else.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
TREE = HERE.parents[1]
CACHE = TREE / ".rig"
SUITES = {"3.11": "bookworm", "3.13": "trixie"}
PROCESSORS = {
    "cortex-a53": ("0xd03", "fp asimd evtstrm crc32 cpuid"),
    "cortex-a72": ("0xd08", "fp asimd evtstrm crc32 cpuid"),
    "cortex-a76": (
        "0xd0b",
        "fp asimd evtstrm aes pmull sha1 sha2 crc32 atomics fphp asimdhp cpuid asimdrdm lrcpc "
        "dcpop asimddp",
    ),
}
"""By QEMU's name: the kernel's number of the part, and its features, on a Pi Zero 2 W, 4 and 5."""
PROCESSOR = "cortex-a76"
PROGRAMS = {
    "debootstrap": "debootstrap",
    "qemu-aarch64-static": "qemu-user-static",
    "dpkg-deb": "dpkg",
}
COUNT_PROGRAMS = {"qemu-aarch64": "qemu-user", "cc": "gcc"}
EXIT_CANNOT = 77
UV = (sys.executable, "-m", "uv", "pip", "--quiet")
PACKAGES = "python3,libgomp1,libstdc++6,ca-certificates,procps"
BINFMT = Path("/proc/sys/fs/binfmt_misc")
ENVIRONMENT = {
    "HOME": "/root",
    "PATH": "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin",
    "LANG": "C.UTF-8",
    "QEMU_CPU": PROCESSOR,
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}
ENTER = """\
set -e
mount --bind "$2" "$1/src"
mount -t proc proc "$1/proc"
mount --bind "$1/opt/cpuinfo" "$1/proc/cpuinfo"
mount --rbind /dev "$1/dev"
mount -t tmpfs tmpfs "$1/tmp"
exec chroot "$1" /bin/bash -c "cd /src && exec $3"
"""


def cpuinfo(processor: str) -> str:
    """The kernel's /proc/cpuinfo of a board with four of these,
    by which libraries choose their code.
    """
    part, features = PROCESSORS[processor]
    return "".join(
        f"processor\t: {core}\nBogoMIPS\t: 108.00\nFeatures\t: {features}\n"
        "CPU implementer\t: 0x41\nCPU architecture: 8\nCPU variant\t: 0x4\n"
        f"CPU part\t: {part}\nCPU revision\t: 1\n\n"
        for core in range(4)
    )


class CannotRunError(Exception):
    """The command cannot run on this machine; one line says why."""


def check(programs: dict[str, str]) -> None:
    """Raise CannotRunError if a requirement is missing."""
    if os.geteuid():
        raise CannotRunError("expected root (to mount, and to enter another user space)")
    missing = sorted(
        {package for program, package in programs.items() if not shutil.which(program)}
    )
    if missing:
        raise CannotRunError(f"missing Debian packages: {' '.join(missing)}")


def emulator() -> None:
    """Make the kernel run arm64 programs with QEMU, including those that programs start."""
    if not (BINFMT / "register").exists():
        _run("mount", "-t", "binfmt_misc", "binfmt_misc", str(BINFMT))
    if not (BINFMT / "qemu-aarch64").exists():
        (BINFMT / "register").write_bytes(
            Path("/usr/lib/binfmt.d/qemu-aarch64.conf").read_bytes().strip()
        )


def user_space(python: str) -> Path:
    """Make the tree for a Python once; return its folder."""
    final = CACHE / f"arm64-{python}"
    if final.exists():
        return final
    CACHE.mkdir(exist_ok=True)
    root = CACHE / f"arm64-{python}.part"
    shutil.rmtree(root, ignore_errors=True)
    print(
        f"arm64: unpacking Debian {SUITES[python]} and the wheels of the lock (900 MB, once)",
        file=sys.stderr,
    )
    words = ("--arch=arm64", "--foreign", "--variant=minbase", f"--include={PACKAGES}")
    _run("debootstrap", *words, SUITES[python], str(root))
    for package in sorted((root / "var/cache/apt/archives").glob("*.deb")):
        _run(
            "dpkg-deb", "-x", str(package), str(root)
        )  # unpacked, not configured: no program of it has run
        package.unlink()
    (root / "etc/passwd").write_text(
        "root:x:0:0:root:/root:/bin/bash\nnobody:x:65534:65534::/:/bin/false\n"
    )
    (root / "etc/group").write_text("root:x:0:\ndialout:x:20:\nvideo:x:44:\nnogroup:x:65534:\n")
    (root / "etc/hosts").write_text("127.0.0.1 localhost\n")
    for name in ("src", "opt"):
        (root / name).mkdir(exist_ok=True)
    (root / "opt/cpuinfo").write_text(cpuinfo(PROCESSOR))
    for name in ("possible", "present"):
        file = root / "sys/devices/system/cpu" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("0-3\n")
    install(python, root)
    root.rename(final)
    return final


def install(python: str, root: Path) -> None:
    """The lock's wheels, as systemd/environment.sh does, into ``/opt/lock``;
    what tests need into ``/opt/dev``.
    """
    board = (
        "--python-platform",
        "aarch64-manylinux_2_28",
        "--python-version",
        python,
        "--only-binary",
        ":all:",
    )
    lock = str(TREE / "systemd/requirements.lock")
    _run(
        *UV,
        "install",
        *board,
        "--target",
        str(root / "opt/lock"),
        "--require-hashes",
        "--no-deps",
        "-r",
        lock,
    )
    dev = ("--target", str(root / "opt/dev"))
    tests = str(TREE / "tools/ci/requirements.lock")
    _run(*UV, "install", *board, *dev, "--require-hashes", "--no-deps", "-r", tests)
    # What the package says of itself; its code is this tree's.
    _run(*UV, "install", *board[:-2], *dev, "--no-deps", str(TREE))
    shutil.rmtree(root / "opt/dev/tacshade_edge")


def enter(python: str, command: list[str]) -> None:
    """Become the command in the tree: its signals and its exit status are ours."""
    check(PROGRAMS)
    emulator()
    root = user_space(python)
    environment = ENVIRONMENT | {"PYTHONPATH": "/src:/opt/lock:/opt/dev"}
    words = (
        "unshare",
        "--mount",
        "--propagation",
        "private",
        "bash",
        "-c",
        ENTER,
        "arm64",
        str(root),
        str(TREE),
    )
    os.execvpe(words[0], (*words, shlex.join(command)), environment)


def counted(script: list[str], processor: str) -> int:
    """Print the instructions that Python 3.11 executes for a script, or -m and a module, until
    each mark and its end; return its exit status.
    """
    check(PROGRAMS | COUNT_PROGRAMS)
    root = user_space("3.11")
    plugin = CACHE / "count_instructions.so"
    _run("cc", "-shared", "-fPIC", "-O2", "-o", str(plugin), str(HERE / "count_instructions.c"))
    (root / "proc/cpuinfo").write_text(cpuinfo(processor))
    paths = (TREE, root / "opt/lock", root / "opt/dev")
    # Without a fixed seed Python's start varies by a million instructions between runs.
    ours = {
        "PYTHONPATH": ":".join(map(str, paths)),
        "PATH": os.environ["PATH"],
        "PYTHONHASHSEED": "0",
        "QEMU_CPU": processor,
    }
    environment = os.environ | ENVIRONMENT | ours
    words = (
        "qemu-aarch64",
        "-plugin",
        str(plugin),
        "-L",
        str(root),
        str(root / "usr/bin/python3.11"),
        "-B",
    )
    done = subprocess.run(
        (*words, *script), env=environment, stderr=subprocess.PIPE, text=True, check=False
    )
    print(done.stderr, end="", file=sys.stderr)
    print("\n".join(re.findall(r"^instructions: (\d+)$", done.stderr, re.MULTILINE)))
    return done.returncode


def instructions_between(script: list[str], processor: str = PROCESSOR) -> list[int]:
    """Instructions of a script between its first and second mark, its third and fourth, and so
    on.
    """
    words = ("--processor", processor, "--count", *script)
    command = (sys.executable, "-m", "tools.rig.arm64", *words)
    done = subprocess.run(command, cwd=TREE, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{shlex.join(script)}: {done.stderr.strip()}")
    *marks, _end = map(int, done.stdout.split())
    return [after - before for before, after in zip(marks[::2], marks[1::2], strict=True)]


def _run(*command: str) -> None:
    done = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    if done.returncode:
        last = (done.stdout.strip().splitlines() or ["no message"])[-1]
        raise CannotRunError(f"{shlex.join(command[:4])} ...: {last}")


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(
        prog="arm64.py", description="Run COMMAND in an emulated arm64 user space."
    )
    parser.add_argument("--python", choices=list(SUITES), default="3.11")
    parser.add_argument(
        "--processor", choices=list(PROCESSORS), default=PROCESSOR, help="whose code is counted"
    )
    # With all that follows: words that begin with a dash are no COMMAND to argparse.
    parser.add_argument(
        "--count",
        nargs=argparse.REMAINDER,
        metavar="SCRIPT",
        help="a Python script, or -m and a module, with its arguments; print its instructions "
        "until each mark and until its end",
    )
    parser.add_argument(
        "command", nargs=argparse.REMAINDER, metavar="COMMAND", help="with its arguments"
    )
    args = parser.parse_args()
    if not (args.count or args.command):
        parser.error("COMMAND is missing")
    try:
        if args.count:
            return counted(args.count, args.processor)
        enter(args.python, args.command)
    except CannotRunError as error:
        print(f"arm64: {error}", file=sys.stderr)
    return EXIT_CANNOT


if __name__ == "__main__":
    sys.exit(main())
