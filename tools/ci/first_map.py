#!/usr/bin/env python3
"""From a bare Debian to a published height map, by ``apt install`` and by ``pip install``, in a fresh guest.

::

    sudo .venv/bin/python -m tools.ci.first_map apt pip [--number 1.0.0] [--native]

The guest (tools/rig) boots a new Debian 12 with systemd and Python, and nothing else. What would be released of the
last commit lies in an apt repository and a package index that this machine serves; everything else apt fetches from
Debian. Then, as a person would: install, simulate a calibration set, calibrate, start, listen. The seconds are printed;
the processor is emulated, some twenty times slower than this machine. With --native it is this machine's, in a
container that boots systemd on this machine's network, where port 1883 must be free. Needs root, debootstrap, GnuPG.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from tools.release import apt_repository, index, rehearsal
from tools.release.package_debian import TREE
from tools.rig import guest

SUITE, PYTHON = "bookworm", "3.11"
BASE = ("systemd-sysv", "udev", "dbus", "ca-certificates", "python3-venv")
KEY = "first-map@localhost"
HOST, NATIVE_HOST = "10.0.2.2", "127.0.0.1"
"""This machine's loopback, in a guest and in a container."""
NATIVE_S = 900
SILENT_S = 120.0
SCRIPT = Path(__file__).with_name("first_map.sh")
WAYS = ("apt", "pip")


def base() -> Path:
    """The root of a bare Debian, made once."""
    made = guest.CACHE / f"bare-{SUITE}"
    if not made.exists():
        guest.CACHE.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=guest.CACHE) as folder:
            root = Path(folder, "root")
            command = ("debootstrap", "--variant=minbase", f"--include={','.join(BASE)}", SUITE, str(root))
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            root.rename(made)
    return made


def serve(folder: Path) -> ThreadingHTTPServer:
    """Serve a folder's files on a free port of the loopback."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            """Log nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


def fill(folder: Path, ways: list[str], number: str) -> None:
    """Make the release `number`: a package index, and an apt repository with a temporary key."""
    if "pip" in ways:
        rehearsal.rehearse(TREE, number, folder / "files")
        index.fetch_locked(folder / "files", PYTHON)
        index.lay_out(sorted((folder / "files").iterdir()), folder)
    if "apt" in ways:
        debs, home = folder / "debs", folder / "gnupg"
        home.mkdir(mode=0o700)
        os.environ["GNUPGHOME"] = str(home)
        words = ("-m", "tools.release.package_debian", "--machine", "x86_64", "--python", PYTHON, "--level", "1")
        environment = os.environ | {"TACSHADE_EDGE_VERSION": number}
        subprocess.run((sys.executable, *words, "--out", str(debs)), cwd=TREE, env=environment, check=True)
        words = ("--batch", "--passphrase", "", "--quick-generate-key", KEY, "ed25519", "sign", "never")
        subprocess.run(("gpg", *words), check=True, capture_output=True)
        apt_repository.lay_out(sorted(debs.glob("*.deb")), folder / "apt", KEY)
        shutil.rmtree(debs)
        shutil.rmtree(home)


def boot(way: str, port: int, number: str, out: Path, native: bool) -> int:
    """Run the script in a fresh guest or container; return its exit status."""
    shutil.copy(SCRIPT, out)
    words = [way, f"http://{NATIVE_HOST if native else HOST}:{port}", SUITE, number]
    if not native:
        return guest.run(["bash", f"/out/{SCRIPT.name}", *words], out.resolve(), SILENT_S, True, base())
    (out / "scenario").write_text(f"#!/bin/bash\nexec bash /payload/{SCRIPT.name} {' '.join(words)}\n")
    (out / "scenario").chmod(0o755)
    environment = os.environ | {"FRESH": str(base()), "LIMIT_S": str(NATIVE_S)}
    return subprocess.run((TREE / "tools/rig/boot_systemd.sh", out.resolve()), env=environment, check=False).returncode


def main() -> int:
    """Try each way in its own guest."""
    parser = argparse.ArgumentParser(prog="first_map.py", description="From a bare guest to a published height map.")
    parser.add_argument("ways", nargs="+", choices=WAYS)
    parser.add_argument("--number", default="1.0.0", help="the version that is rehearsed (1.0.0)")
    parser.add_argument("--native", action="store_true", help="a container at this machine's speed, no guest")
    parser.add_argument("--out", type=Path, help="folder that keeps the guests' consoles and reports")
    args = parser.parse_args()
    try:
        guest.check(True)
    except guest.CannotRunError as error:
        print(f"first_map: {error}", file=sys.stderr)
        return guest.EXIT_CANNOT
    with tempfile.TemporaryDirectory(prefix="first-map-") as scratch:
        served = Path(scratch, "served")
        served.mkdir()
        fill(served, args.ways, args.number)
        server = serve(served)
        for way in args.ways:
            out = (args.out or Path(scratch)) / way
            out.mkdir(parents=True, exist_ok=True)
            print(f"--- {way} install, in a bare {SUITE}", flush=True)
            if code := boot(way, server.server_port, args.number, out, args.native):
                return code
        server.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
