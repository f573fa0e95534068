"""Whether the packages that this one requires are those that Python finds: another program's
installation, or a folder in PYTHONPATH, may have put others in their place.

It imports nothing outside the standard library, so that it can say why an import fails.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from importlib import metadata
from typing import Final

_REQUIREMENT: Final = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^]]*\])?\s*\(?([^;()]*)\)?\s*(;.*)?")
_BOUND: Final = re.compile(r"(<=|>=|==|!=|<|>|~=)\s*([0-9][0-9.]*)")
_MODULES: Final = {
    "opencv-contrib-python-headless": "cv2",
    "pyserial": "serial",
    "paho-mqtt": "paho.mqtt",
    "pyyaml": "yaml",
    "scikit-image": "skimage",
    "protobuf": "google.protobuf",
}
"""Packages whose module has another name."""
PACKAGES_FIX: Final = (
    "install the program into an environment of its own (docs/tutorials/install.md), and unset "
    "PYTHONPATH"
)


def missing_requirements(package: str = "tacshade-edge") -> tuple[str, ...]:
    """What is wrong with the packages that a package requires, and with theirs, a line for each."""
    try:
        return tuple(dict.fromkeys(_problems(package, direct=True)))
    except metadata.PackageNotFoundError:
        # A source tree that was not installed states nothing.
        return ()


def _problems(package: str, *, direct: bool) -> Iterator[str]:
    for requirement in metadata.requires(package) or ():
        parsed = _REQUIREMENT.fullmatch(requirement)
        # What a marker asks for is needed here or not; pip knows.
        if parsed is None or parsed[3]:
            continue
        name, bounds = parsed[1], parsed[2].strip()
        found = _problem(name, bounds, direct=direct)
        if found:
            yield found
        elif direct:
            yield from _problems(name, direct=False)


def _problem(name: str, bounds: str, *, direct: bool) -> str:
    """What is wrong with one package; empty if nothing is."""
    expected = f"expected {bounds or 'any version'}"
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return f"{name}: found no such package, {expected}"
    where = metadata.distribution(name).locate_file("")
    if not _is_within(version, bounds):
        return f"{name}: found {version} in {where}, {expected}"
    if not direct:
        return ""
    # The metadata may be right and the module another's: several packages bring `cv2`.
    module = _MODULES.get(name.lower(), name.replace("-", "_"))
    try:
        imported = importlib.import_module(module)
    except Exception as error:  # noqa: BLE001 (whatever the start of another package raises)
        reason = str(error).strip().partition("\n")[0]
        return f"{name}: cannot import {module}: {type(error).__name__}: {reason}"
    own = getattr(imported, "__version__", version)
    if isinstance(own, str) and not _is_within(own, bounds):
        return f"{name}: found {module} {own} at {imported.__file__}, {expected}"
    return ""


def _is_within(version: str, bounds: str) -> bool:
    have = _numbers(version)
    if not have:
        return True
    for sign, bound in _BOUND.findall(bounds):
        most = _numbers(bound)
        # 2.1 and 2.1.0 are one version.
        size = max(len(have), len(most))
        a, b = ((*each, *[0] * (size - len(each))) for each in (have, most))
        kept = {
            "<": a < b,
            "<=": a <= b,
            ">": a > b,
            ">=": a >= b,
            "==": a == b,
            "!=": a != b,
            "~=": a >= b and a[: len(most) - 1] == b[: len(most) - 1],
        }
        # "==1.*" leaves the dot at the end.
        if sign in ("==", "!=") and bound.endswith("."):
            same = a[: len(most)] == most
            kept[sign] = same if sign == "==" else not same
        if not kept[sign]:
            return False
    return True


def _numbers(version: str) -> tuple[int, ...]:
    begin = re.match(r"\d+(\.\d+)*", version)
    return tuple(map(int, begin[0].split("."))) if begin else ()
