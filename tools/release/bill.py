#!/usr/bin/env python3
"""``make bill``: the bill of materials of the wheels for boards, ``dist/bill.cdx.json``.

::

    .venv/bin/python -m tools.release.bill [--out dist]

`systemd/requirements.lock` pins some packages differently for each Python. So this installs what it
pins for each supported one, lets ``cyclonedx-py``, which uv fetches, list each of these sets, and
joins the lists. It fails if a pinned package is missing.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

TREE = Path(__file__).resolve().parents[2]
LOCK = TREE / "systemd/requirements.lock"
NAME = "bill.cdx.json"
UV = (sys.executable, "-m", "uv")
CYCLONEDX = (*UV, "tool", "run", "--quiet", "--from", "cyclonedx-bom>=7", "cyclonedx-py")
_PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)", re.MULTILINE)
_CLASSIFIER = re.compile(r"Programming Language :: Python :: (3\.\d+)")


def pinned(lock: str) -> set[tuple[str, str]]:
    """Name and version of everything that a lock pins, for whichever Python."""
    return {(name, version) for name, version in _PIN.findall(lock)}


def pythons(tree: Path) -> list[str]:
    """The versions of Python that pyproject.toml supports."""
    project = tomllib.loads((tree / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [found[1] for line in project["classifiers"] if (found := _CLASSIFIER.fullmatch(line))]


def joined(bills: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """One bill of several of the same program: every component, and what each depends on."""
    first, *others = bills
    components = {each["bom-ref"]: each for each in first["components"]}
    needs = {each["ref"]: set(each.get("dependsOn", ())) for each in first["dependencies"]}
    for bill in others:
        components |= {each["bom-ref"]: each for each in bill["components"]}
        for each in bill["dependencies"]:
            needs.setdefault(each["ref"], set()).update(each.get("dependsOn", ()))
    return first | {
        "components": [components[ref] for ref in sorted(components)],
        "dependencies": [
            {"ref": ref} | ({"dependsOn": sorted(needs[ref])} if needs[ref] else {})
            for ref in sorted(needs)
        ],
    }


def missing(bill: dict[str, Any], lock: str) -> list[str]:
    """What a lock pins and a bill does not list."""
    listed = {(each["name"].lower(), each["version"]) for each in bill["components"]}
    return [f"{name} {version}" for name, version in sorted(pinned(lock) - listed)]


def bill_of(python: str, folder: Path) -> dict[str, Any]:
    """The bill of what the lock pins for one Python, which need not be installed."""
    environment, made = folder / python, folder / f"{python}.json"
    subprocess.run((*UV, "venv", "--quiet", str(environment)), check=True)
    (packages,) = environment.glob("lib/python*/site-packages")
    board = ("--python-platform", "x86_64-manylinux_2_28", "--python-version", python)
    words = ("--quiet", "--target", str(packages), "--require-hashes", "--no-deps", "-r", str(LOCK))
    subprocess.run((*UV, "pip", "install", *board, *words), check=True)
    project = ("--pyproject", str(TREE / "pyproject.toml"), str(environment))
    output = ("--output-reproducible", "--output-file", str(made))
    subprocess.run((*CYCLONEDX, "environment", *project, *output), check=True)
    found: dict[str, Any] = json.loads(made.read_text(encoding="utf-8"))
    return found


def main() -> int:
    """Write the bill."""
    parser = argparse.ArgumentParser(
        prog="bill.py", description="Write the bill of materials of the wheels for boards."
    )
    parser.add_argument("--out", type=Path, default=TREE / "dist", help="folder")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bill = joined(bill_of(python, Path(folder)) for python in pythons(TREE))
    if left_out := missing(bill, LOCK.read_text(encoding="utf-8")):
        print(f"bill: found no {', '.join(left_out)}, expected all of {LOCK}", file=sys.stderr)
        return 1
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / NAME).write_text(json.dumps(bill, indent=2) + "\n", encoding="utf-8")
    print(f"{args.out / NAME}: {len(bill['components'])} packages")
    return 0


if __name__ == "__main__":
    sys.exit(main())
