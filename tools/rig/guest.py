#!/usr/bin/env python3
"""Run a command as root under Debian's kernel, in a software-emulated guest
with this machine's root file system.

::

    python3 -m tools.rig.guest [--out DIR] [--silent SECONDS] COMMAND [ARGUMENT...]

The guest sees this machine's files at the same paths, read-only (9p). Its writes go to memory and
are lost, except below ``/out``, which is DIR on this machine. COMMAND runs in the tree's folder
once systemd and udev have started, and this program passes on its output and exit status. Exit
status 77 means that the guest cannot run here (one line says why). 125 means that it did not finish
in two attempts (the emulator itself hangs now and then): it gave no sign of life for --silent
seconds (normally one each second), or ended without an exit status. This program uses only the
standard library, so that it can report what is missing.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import lzma
import mmap
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
TREE = HERE.parents[1]
CACHE = TREE / ".rig"
BOOT_MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay", "virtio_console")
PROGRAMS = {  # each program that we call, and its Debian package
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "cpio": "cpio",
    "modprobe": "kmod",
    "depmod": "kmod",
    "v4l2-ctl": "v4l-utils",
    "apt-get": "apt",
    "dpkg": "dpkg",
    "/lib/systemd/systemd": "systemd",
    "udevadm": "udev",
    "dbus-daemon": "dbus",
}
EXIT_CANNOT, EXIT_UNFINISHED = 77, 125
ATTEMPTS = 2


class CannotRunError(Exception):
    """The guest cannot run on this machine; the message's one line says why."""


def check() -> None:
    """Raise CannotRunError if a program that the guest needs is missing."""
    if platform.machine() != "x86_64":
        raise CannotRunError(f"the guest needs an x86-64 machine, this one is {platform.machine()}")
    os.environ["PATH"] += ":/usr/sbin:/sbin"  # for kmod's programs, if the user is not root
    missing = sorted(
        {package for program, package in PROGRAMS.items() if not shutil.which(program)}
    )
    if missing:
        raise CannotRunError(
            f"missing Debian packages: {' '.join(missing)} (tools/ci/install_debian.sh installs "
            "them)"
        )


def kernel() -> tuple[Path, str]:
    """Unpack Debian's standard kernel once; return its folder and its version."""
    ready = sorted(CACHE.glob("kernel-*"), key=lambda path: path.stat().st_mtime)
    if ready:
        return ready[-1], ready[-1].name.removeprefix("kernel-")
    depends = _output("apt-cache", "depends", "linux-image-amd64")
    found = re.search(r"Depends: linux-image-(\S+)", depends)
    if not found:
        raise CannotRunError(
            "apt knows no linux-image-amd64 (the guest boots Debian's kernel; try apt-get update)"
        )
    version = found[1]
    CACHE.mkdir(exist_ok=True)
    print(f"guest: downloading Debian's kernel {version} (70 MB, once)", file=sys.stderr)
    with tempfile.TemporaryDirectory(dir=CACHE) as scratch:
        root = Path(scratch, "root")
        _output("apt-get", "download", "-q", f"linux-image-{version}", cwd=scratch)
        _output("dpkg", "-x", str(next(Path(scratch).glob("*.deb"))), str(root))
        _output("depmod", "-b", str(root), version)
        final = CACHE / f"kernel-{version}"
        try:
            root.rename(final)
        except OSError:
            if not final.exists():  # another run was faster
                raise
    return final, version


def initramfs(out: Path, root: Path, version: str) -> None:
    """Write ``out/.initrd``: busybox and the modules that reach the 9p root."""
    with tempfile.TemporaryDirectory() as scratch:
        top = Path(scratch)
        for name in ("bin", "dev", "proc", "sys", "ro", "rw", "new", "modules"):
            (top / name).mkdir()
        shutil.copy(shutil.which("busybox") or "", top / "bin/busybox")
        for number, module in enumerate(_modules(root, version)):
            content = module.read_bytes()
            if module.suffix == ".xz":
                content = lzma.decompress(content)
            (top / "modules" / f"{number:02}-{module.name.removesuffix('.xz')}").write_bytes(
                content
            )
        shutil.copy(HERE / "systemd_root.sh", top)
        text = (HERE / "init.sh").read_text()
        (top / "init").write_text(text.replace("@MODULES@", f"{root}/lib/modules/{version}"))
        (top / "init").chmod(0o755)
        names = "\n".join(str(path.relative_to(top)) for path in sorted(top.rglob("*")))
        with (out / ".initrd").open("wb") as archive:
            subprocess.run(
                ["cpio", "-o", "-H", "newc", "--quiet"],
                cwd=top,
                input=names.encode(),
                stdout=archive,
                check=True,
            )


def _modules(root: Path, version: str) -> list[Path]:
    """List the files of the boot modules and of their dependencies, in loading order."""
    files: dict[Path, None] = {}
    for module in BOOT_MODULES:
        for line in _output(
            "modprobe", "-d", str(root), "-S", version, "--show-depends", module
        ).splitlines():
            if line.startswith("insmod "):
                files[Path(line.split()[1])] = None
    return list(files)


def run(command: list[str], out: Path, silent_s: float) -> int:
    """Boot the guest, run the command, and return its exit status."""
    root, version = kernel()
    initramfs(out, root, version)
    (out / ".command").write_text(f"cd {shlex.quote(str(TREE))} && exec {shlex.join(command)}\n")
    status = out / ".status"
    status.unlink(missing_ok=True)
    alive, console, began_s = out / ".alive", out / ".console", time.time()
    for sign in (alive, console):
        sign.unlink(missing_ok=True)
    with subprocess.Popen(_qemu(root, version, out), stdin=subprocess.DEVNULL) as emulator:
        while emulator.poll() is None:
            # A kernel whose processors hang complains on the console for ever: after its boot, only
            # what a program writes counts.
            sign = alive if alive.exists() else console
            latest_s = max(began_s, sign.stat().st_mtime if sign.exists() else 0)
            if time.time() - latest_s > silent_s:
                emulator.kill()
                print(f"guest: no sign of life for {silent_s:.0f} s", file=sys.stderr)
                return EXIT_UNFINISHED
            with contextlib.suppress(subprocess.TimeoutExpired):
                emulator.wait(1)
    if not status.exists():
        print(
            f"guest: did not reach its end; the console's last lines, from {out}/.console:",
            file=sys.stderr,
        )
        print(
            *(out / ".console").read_text(errors="replace").splitlines()[-20:],
            sep="\n",
            file=sys.stderr,
        )
        return EXIT_UNFINISHED
    return int(status.read_text())


def _qemu(root: Path, version: str, out: Path) -> list[str]:
    """Make QEMU's command, without hardware virtualisation:
    not every machine has it, and it changes the timing.
    """
    systemd = "systemd.unit=scenario.target systemd.show_status=0"
    share = "security_model=none,multidevs=remap"
    kernel = f"console=ttyS0 quiet panic=-1 mitigations=off nokaslr audit=0 {_clock()} {systemd}"
    command = ["qemu-system-x86_64", "-M", "q35,usb=off", "-accel", "tcg,thread=multi"]
    command += ["-cpu", "max,-avx,-avx2,-fma"]  # emulating these takes ten times as long
    command += ["-smp", "2", "-m", "1536", "-nodefaults", "-no-user-config"]
    command += ["-display", "none", "-no-reboot", "-nic", "none"]
    command += ["-kernel", f"{root}/boot/vmlinuz-{version}", "-initrd", f"{out}/.initrd"]
    command += ["-append", kernel]
    command += ["-chardev", f"file,id=console,path={out}/.console", "-serial", "chardev:console"]
    command += ["-device", "virtio-serial-pci", "-chardev", "stdio,id=out,signal=off"]
    command += ["-device", "virtconsole,chardev=out", "-device", "virtio-rng-pci"]
    command += ["-fsdev", f"local,id=root,path=/,readonly=on,{share}"]
    command += ["-device", "virtio-9p-pci,fsdev=root,mount_tag=root"]
    command += ["-fsdev", f"local,id=out,path={out},{share}"]
    command += ["-device", "virtio-9p-pci,fsdev=out,mount_tag=out"]
    return command


def _clock() -> str:
    """Measure the rate of the guest's time stamp counter, which is this machine's.

    If the kernel measured the rate while the emulator is not scheduled, the result would be wrong
    by a large factor, and the guest's seconds would be too short for any work.
    """
    read = mmap.mmap(-1, mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
    read.write(bytes.fromhex("0f31 48c1e220 4809d0 c3"))  # rdtsc; shl rdx, 32; or rax, rdx; ret
    counter = ctypes.CFUNCTYPE(ctypes.c_uint64)(ctypes.addressof(ctypes.c_char.from_buffer(read)))
    began, began_ns = counter(), time.monotonic_ns()
    time.sleep(0.2)
    return (
        "tsc=reliable "
        f"tsc_early_khz={(counter() - began) * 1_000_000 // (time.monotonic_ns() - began_ns)}"
    )


def _output(*command: str, cwd: str | None = None) -> str:
    try:
        return subprocess.run(command, check=True, capture_output=True, text=True, cwd=cwd).stdout
    except subprocess.CalledProcessError as error:
        reason = (error.stderr.strip().splitlines() or ["no message"])[-1]
        raise CannotRunError(f"{shlex.join(command)}: {reason}") from None


def main() -> int:
    """Parse the command line and run the guest."""
    parser = argparse.ArgumentParser(
        prog="guest.py", description="Run COMMAND under a real kernel in a guest."
    )
    parser.add_argument(
        "--out", type=Path, help="folder that is /out in the guest (default: a new one, printed)"
    )
    parser.add_argument(
        "--silent",
        type=float,
        default=120.0,
        metavar="SECONDS",
        help="give up after no sign of life for so long (120)",
    )
    parser.add_argument(
        "command", nargs=argparse.REMAINDER, metavar="COMMAND", help="with its arguments"
    )
    args = parser.parse_args()
    try:
        check()
        if not args.command:
            parser.error("COMMAND is missing")
        if args.out is None:
            args.out = Path(tempfile.mkdtemp(prefix="guest-out."))
            print(f"guest: /out is {args.out}", file=sys.stderr)
        args.out.mkdir(parents=True, exist_ok=True)
        status = EXIT_UNFINISHED
        for _ in range(ATTEMPTS):
            if status == EXIT_UNFINISHED:
                status = run(args.command, args.out.resolve(), args.silent)
        return status
    except CannotRunError as error:
        print(f"guest: {error}", file=sys.stderr)
        return EXIT_CANNOT


if __name__ == "__main__":
    sys.exit(main())
