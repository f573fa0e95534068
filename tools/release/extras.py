#!/usr/bin/env python3
"""What the plain installation and each extra bring, for every distribution here: packages, sizes of wheels, licences.

::

    .venv/bin/python -m tools.release.extras

uv resolves each pyproject.toml by the index as it is today, for Python 3.13 on both machines, and installs nothing.
Licences are those that the packages in this environment state, and for what it has not, of `STATED`.
"""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from email.message import Message
from pathlib import Path
from typing import Any, cast

from packaging.markers import Marker
from packaging.tags import Tag, compatible_tags, cpython_tags
from packaging.utils import canonicalize_name, parse_wheel_filename

from tacshade_edge.studies.tables import markdown
from tools.release.bill import licence
from tools.release.distributions import TREE, UV, projects

MACHINES = {"x86_64": "x86-64", "aarch64": "arm64"}
PYTHON = (3, 13)
NOT_FOR_USERS = ("dev", "docs")
NVIDIA = "NVIDIA's own"
STATED = {
    "cloudpickle": "BSD-3-Clause", "dask": "BSD-3-Clause", "distributed": "BSD-3-Clause", "filelock": "MIT",
    "fsspec": "BSD-3-Clause", "importlib-metadata": "Apache-2.0", "jinja2": "BSD-3-Clause",
    "lazy-importer": "Apache-2.0", "locket": "BSD-2-Clause", "markupsafe": "BSD-3-Clause",
    "matplotlib": "matplotlib's own (like PSF-2.0)", "mpmath": "BSD-3-Clause", "msgpack": "Apache-2.0",
    "networkx": "BSD-3-Clause", "partd": "BSD-3-Clause", "psutil": "BSD-3-Clause", "pyarrow": "Apache-2.0",
    "setuptools": "MIT", "sortedcontainers": "Apache-2.0", "sympy": "BSD-3-Clause", "tblib": "BSD-2-Clause",
    "toolz": "BSD-3-Clause", "torch": "BSD-3-Clause", "tornado": "Apache-2.0", "triton": "MIT",
    "typing-extensions": "PSF-2.0", "zict": "BSD-3-Clause", "zipp": "MIT",
}  # fmt: skip
"""Licences of packages that `make check` does not need, and of one whose metadata hold its whole text."""


@dataclass(frozen=True, slots=True, eq=False)
class Locked:
    """A package of a uv.lock: its wheels' names and bytes, and its dependencies' entries."""

    name: str
    version: str
    wheels: Mapping[str, int] = field(default_factory=dict)
    dependencies: tuple[dict[str, Any], ...] = ()
    extras: Mapping[str, tuple[dict[str, Any], ...]] = field(default_factory=dict)


def lock(tree: Path, project: Path) -> list[Locked]:
    """Resolve a project of a tree with all its extras, in a clone of the last commit. Raises CalledProcessError."""
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder, "clone")
        subprocess.run(("git", "clone", "--quiet", "--depth", "1", f"file://{tree}", str(clone)), check=True)
        there = clone / project.relative_to(tree)
        # No index has the others of this repository before they are published.
        others = {name: clone / path.relative_to(tree) for name, path in ours(tree).items() if path != project}
        sources = (f'{name} = {{ path = "{path}" }}' for name, path in others.items())
        with (there / "pyproject.toml").open("a", encoding="utf-8") as about:
            about.write("\n".join(("\n[tool.uv.sources]", *sources, "")))
        told = os.environ | {"TACSHADE_EDGE_VERSION": "1.0.0"}
        subprocess.run((*UV, "lock", "--quiet", "--project", str(there)), check=True, env=told)
        return parse(tomllib.loads((there / "uv.lock").read_text(encoding="utf-8")))


def ours(tree: Path) -> dict[str, Path]:
    """The distributions of a tree by their names."""
    abouts = {project: tomllib.loads((project / "pyproject.toml").read_text("utf-8")) for project in projects(tree)}
    return {str(canonicalize_name(about["project"]["name"])): project for project, about in abouts.items()}


def parse(document: Mapping[str, Any]) -> list[Locked]:
    """The packages of a uv.lock."""
    return [
        Locked(
            each["name"],
            each.get("version", ""),
            {wheel["url"].rpartition("/")[2]: wheel["size"] for wheel in each.get("wheels", ()) if "size" in wheel},
            tuple(each.get("dependencies", ())),
            {name: tuple(words) for name, words in each.get("optional-dependencies", {}).items()},
        )
        for each in document["package"]
    ]


def needed(packages: Iterable[Locked], name: str, extras: Iterable[str], machine: str) -> set[Locked]:
    """The packages that an installation with some extras brings on a machine, without the package itself."""
    by_name: dict[str, list[Locked]] = {}
    for each in packages:
        by_name.setdefault(each.name, []).append(each)
    told = {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix", "platform_machine": machine}
    told |= {"python_version": "3.13", "python_full_version": "3.13.0", "implementation_name": "cpython"}
    told |= {"platform_python_implementation": "CPython", "extra": ""}
    seen: set[tuple[str, str]] = set()
    found: dict[str, Locked] = {}
    todo = [(name, "", extra) for extra in ("", *extras)]
    while todo:
        one, version, extra = todo.pop()
        (package,) = (p for p in by_name[one] if version in ("", p.version))
        if (one, extra) in seen:
            continue
        seen.add((one, extra))
        found[one] = package
        for entry in package.extras.get(extra, ()) if extra else package.dependencies:
            if "marker" not in entry or Marker(entry["marker"]).evaluate(told):
                todo += [(entry["name"], entry.get("version", ""), more) for more in ("", *entry.get("extra", ()))]
    del found[name]
    return {*found.values()}


def size_mb(packages: Iterable[Locked], machine: str) -> float:
    """Megabytes of the wheels that pip would take on a machine. Raises ValueError if a package has none for it."""
    order = {tag: rank for rank, tag in enumerate(tags(machine))}
    total = 0
    for package in packages:
        ranked = [
            (min(order[tag] for tag in parse_wheel_filename(name)[3] if tag in order), size)
            for name, size in package.wheels.items()
            if any(tag in order for tag in parse_wheel_filename(name)[3])
        ]
        if not ranked:
            raise ValueError(f"{package.name} {package.version}: found no wheel for {machine}")
        total += min(ranked)[1]
    return total / 1e6


def tags(machine: str) -> list[Tag]:
    """Tags of the wheels that Debian 13's Python accepts on a machine, the best first."""
    platforms = [f"manylinux_2_{minor}_{machine}" for minor in range(41, 4, -1)]
    platforms += [f"{name}_{machine}" for name in ("manylinux2014", "manylinux2010", "manylinux1")]
    return [*cpython_tags(PYTHON, platforms=platforms), *compatible_tags(PYTHON, "cp313", platforms)]


def licences(packages: Iterable[Locked]) -> list[str]:
    """The packages' licences, each once. Raises KeyError for a package that nobody has checked."""
    return sorted({stated(package.name) for package in packages})


def stated(name: str) -> str:
    """The licence of a package."""
    if name in STATED:
        return STATED[name]
    if name.startswith(("nvidia-", "cuda-")):
        return NVIDIA
    found = importlib.metadata.distribution(name).metadata
    return licence(cast(Message, found))


def report(tree: Path) -> str:
    """The table, one line for each distribution and extra; what is ours has no wheel there yet, and is not counted."""
    lines, own = [], ours(tree)
    for name, project in own.items():
        about = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        packages = lock(tree, project)
        extras = [extra for extra in about.get("optional-dependencies", {}) if extra not in NOT_FOR_USERS]
        for extra in ("", *extras):
            added = {}
            for machine in MACHINES:
                plain = needed(packages, name, (), machine)
                brought = needed(packages, name, (extra,), machine) - plain if extra else plain
                added[machine] = {package for package in brought if package.name not in own}
            names = sorted({package.name for some in added.values() for package in some})
            sizes = [f"{size_mb(some, machine):.1f}" for machine, some in added.items()]
            what = f"{about['name']}[{extra}]" if extra else about["name"]
            all_of_them = {package for some in added.values() for package in some}
            lines.append([what, *sizes, str(len(names)), ", ".join(licences(all_of_them))])
    header = ["what", *(f"{name}, MB" for name in MACHINES.values()), "packages", "licences"]
    return markdown(header, lines)


if __name__ == "__main__":
    print(report(TREE))
    sys.exit()
