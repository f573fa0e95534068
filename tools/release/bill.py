"""A bill of materials (CycloneDX 1.6) of installed wheels: packages and the third-party libraries that they bundle."""

from __future__ import annotations

import email
import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from email.message import Message
from pathlib import Path
from typing import Any

# Libraries in a wheel's folder NAME.libs, by the start of their names: project and licence (SPDX).
BUNDLED = {
    "libaom": ("AOM AV1", "BSD-2-Clause"),
    "libavif": ("libavif", "BSD-2-Clause"),
    "libavcodec": ("FFmpeg", "LGPL-2.1-or-later"),
    "libavformat": ("FFmpeg", "LGPL-2.1-or-later"),
    "libavutil": ("FFmpeg", "LGPL-2.1-or-later"),
    "libswresample": ("FFmpeg", "LGPL-2.1-or-later"),
    "libswscale": ("FFmpeg", "LGPL-2.1-or-later"),
    "libcrypto": ("OpenSSL", "OpenSSL"),
    "libssl": ("OpenSSL", "OpenSSL"),
    "libdrm": ("libdrm", "MIT"),
    "libgfortran": ("GCC runtime", "GPL-3.0-or-later WITH GCC-exception-3.1"),
    "libquadmath": ("GCC runtime", "LGPL-2.1-or-later"),
    "libopenblasp": ("OpenBLAS and LAPACK", "BSD-3-Clause"),
    "libscipy_openblas": ("OpenBLAS and LAPACK", "BSD-3-Clause"),
    "libpng16": ("libpng", "libpng-2.0"),
    "libvpx": ("libvpx", "BSD-3-Clause"),
}

# SPDX expressions of older metadata's free texts.
SPDX = {
    "3-Clause BSD License": "BSD-3-Clause",
    "Apache 2.0": "Apache-2.0",
    "BSD": "BSD-3-Clause",
    "MIT License": "MIT",
    "License :: OSI Approved :: Apache Software License": "Apache-2.0",
    "License :: OSI Approved :: BSD License": "BSD-3-Clause",
    "License :: OSI Approved :: MIT License": "MIT",
    "License :: OSI Approved :: Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
}
_LICENCE_FILE = re.compile(r"licen[cs]e|copying|notice", re.IGNORECASE)
_VENDORED = re.compile(r"^\| \S+ \| (\w+): .*?\| ([\d.]+) \|", re.MULTILINE)


def bill(found: Mapping[str, Path], root: Path) -> str:
    """The bill as JSON; the same for the same wheels.

    Parameters
    ----------
    found : mapping
        Folders that wheels were installed into, by the machine and Python they are for.
    root : Path
        This project's.

    Raises
    ------
    KeyError
        A licence or a bundled library that the tables above do not have.
    """
    packages: dict[tuple[str, str], dict[str, Any]] = {}
    for where, folder in sorted(found.items()):
        for about in sorted(folder.glob("*.dist-info")):
            metadata = email.message_from_string((about / "METADATA").read_text(encoding="utf-8"))
            name, version = metadata["Name"].lower(), metadata["Version"]
            package = packages.setdefault((name, version), {**component(name, version, licence(metadata)), "for": []})
            package["purl"] = package["bom-ref"] = f"pkg:pypi/{name}@{version}"
            package["for"].append(where)
            files = sorted(licence_files(about))
            package["licence files"] = sorted({*package.get("licence files", []), *files})
            for part in bundled(about):
                parts = package.setdefault("components", [])
                if part not in parts:
                    parts.append(part)
    components = [finished(package) for _, package in sorted(packages.items())]
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    document = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": {"type": "application", **named(project["name"], "", project["license"])}},
        "components": components + vendored(root),
    }
    return json.dumps(document, indent=1) + "\n"


def named(name: str, version: str, spdx: str) -> dict[str, Any]:
    """The fields of every component."""
    told = {"version": version} if version else {}
    return {"name": name, **told, "licenses": [{"expression": spdx}]}


def component(name: str, version: str, spdx: str) -> dict[str, Any]:
    """A library's component."""
    return {"type": "library", **named(name, version, spdx)}


def licence(metadata: Message) -> str:
    """The SPDX expression of a package's metadata. Raises KeyError if the licence is unknown."""
    if expression := metadata["License-Expression"]:
        return str(expression)
    classifiers = [value for value in metadata.get_all("Classifier", []) if value.startswith("License ::")]
    said = [metadata["License"] or "", *classifiers]
    known = [SPDX.get(text, text) for text in said if text in SPDX or text in SPDX.values()]
    if not known:
        raise KeyError(f"{metadata['Name']}: the licence {said}")
    return known[0]


def licence_files(about: Path) -> Iterator[str]:
    """Paths of a package's licence texts, in a folder of installed wheels."""
    for line in (about / "RECORD").read_text(encoding="utf-8").splitlines():
        path = line.rsplit(",", 2)[0].strip('"')
        if _LICENCE_FILE.search(path.rpartition("/")[2]) and not path.endswith((".py", ".pyc", ".pyi")):
            yield path


def bundled(about: Path) -> Iterator[dict[str, Any]]:
    """The third-party shared libraries that a package bundles. Raises KeyError for an unknown one."""
    folder = about.with_name(f"{about.name.partition('-')[0]}.libs")
    for path in sorted(folder.glob("*.so*")):
        known = [name for name in BUNDLED if path.name.startswith(name)]
        if not known:
            raise KeyError(f"{about.name}: the library {path.name}")
        whose, spdx = BUNDLED[known[0]]
        version = path.name.partition(".so.")[2]
        yield {**component(known[0], version, spdx), "group": whose}


def finished(package: dict[str, Any]) -> dict[str, Any]:
    """A package with what CycloneDX has no field for as properties."""
    notes = {"machines": ", ".join(package.pop("for")), "licence files": ", ".join(package.pop("licence files"))}
    properties = [{"name": f"tacshade:{key}", "value": value} for key, value in notes.items() if value]
    return {**package, "properties": properties}


def vendored(root: Path) -> list[dict[str, Any]]:
    """The page's libraries."""
    text = (root / "tacshade_edge/dashboard/static/vendor/vendored.md").read_text()
    packages = set(_VENDORED.findall(text))
    return [
        {**component(name, version, "MIT"), "purl": f"pkg:npm/{name}@{version}"} for name, version in sorted(packages)
    ]
