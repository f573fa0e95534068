#!/usr/bin/env python3
"""Show the rooms of the package: how large each is, what it offers, and whom it knows.

::

    .venv/bin/python -m tools.ci.house

A room is a folder or module directly below the package, but for `cli`, `lab` and `sensor`, whose
folders count apart. "In" counts other rooms that import it, "out" those that it
imports.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "tacshade_edge"
FLOORS = ("cli", "lab", "sensor")
"""Rooms whose folders count apart."""
USED = "Other rooms use:"
"""Begins the list of modules in the docstring of a room's `__init__`."""
COMMANDS = ("cli", "commands")
"""Modules that have the names of commands, as others may too."""
TOOLS_TESTS = "tools"
"""The folder of tests that test tools, any of them."""
TESTED = ("tools.examples", "tools.release", "tools.results", "tools.testbed.simulator")
"""What other tests try too: what users copy, install and read, and the sensors of the studies."""
COLUMNS = ("room", "lines", "nodes", "public names", "in", "out", "longest function", "comments %")


@dataclass(slots=True)
class Room:
    """What is counted of a room."""

    lines: int = 0
    nodes: int = 0
    public: int = 0
    comments: int = 0
    longest: int = 0
    out: set[str] = field(default_factory=set)


def room_of(module: tuple[str, ...]) -> str:
    """The room of a module, by its names below the package."""
    floor, *rooms_and_modules = module
    deep = floor in FLOORS and len(rooms_and_modules) > 1
    return ".".join(module[:2] if deep else module[:1])


def modules_of(tree: ast.AST) -> Iterator[tuple[str, ...]]:
    """The package's modules that a tree imports, by their names below the package."""
    for name in _imported(tree):
        package, *module = name.split(".")
        if package == PACKAGE and module:
            yield tuple(module)


def _imported(tree: ast.AST) -> Iterator[str]:
    """The dotted names that a tree imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def rooms(root: Path = ROOT) -> dict[str, Room]:
    """Every room of a tree by its name."""
    made: dict[str, Room] = defaultdict(Room)
    for path in sorted((root / PACKAGE).rglob("*.py")):
        relative = path.relative_to(root / PACKAGE).with_suffix("")
        name, source = room_of(relative.parts), path.read_text(encoding="utf-8")
        tree, room = ast.parse(source), made[name]
        room.lines += source.count("\n")
        room.comments += sum(line.lstrip().startswith("#") for line in source.splitlines())
        room.public += sum(
            isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_")
            for node in tree.body
        )
        for node in ast.walk(tree):
            room.nodes += 1
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                room.longest = max(room.longest, (node.end_lineno or 0) - node.lineno + 1)
        room.out |= {room_of(module) for module in modules_of(tree)} - {name}
    return dict(made)


def strangers(root: Path = ROOT) -> list[str]:
    """What rooms import of others without a mention in their `__init__`s, and mentions in vain."""
    modules = {_module_of(path, root): path for path in (root / PACKAGE).rglob("*.py")}
    used: dict[str, set[str]] = defaultdict(set)
    for module, path in modules.items():
        for imported in modules_of(ast.parse(path.read_text(encoding="utf-8"))):
            names = imported
            while names not in modules:
                names = names[:-1]
            if len(names) > 1 and names[:1] != module[:1]:
                used[names[0]].add(".".join(names[1:]))
    found = []
    for room in {module[0] for module in modules if len(module) > 1}:
        text = ast.get_docstring(ast.parse(modules[(room,)].read_text(encoding="utf-8"))) or ""
        named = set(re.findall(r"`([\w.]+)`", text.partition(USED)[2]))
        found += [f"{room}.{name}: not in the docstring of {room}" for name in used[room] - named]
        found += [f"{room}.{name}: no other room uses it" for name in named - used[room]]
    return sorted(found)


def homeless_helpers(root: Path = ROOT) -> list[str]:
    """What tests import of each other, or of tools that they do not test: helpers belong in
    `support`.
    """
    found = []
    for path in sorted((root / "tests").rglob("*.py")):
        of_tools = path.relative_to(root / "tests").parts[0] == TOOLS_TESTS
        for name in _imported(ast.parse(path.read_text(encoding="utf-8"))):
            folder = name.partition(".")[0]
            tested = of_tools or f"{name}.".startswith(tuple(f"{each}." for each in TESTED))
            if folder == "tests" or (folder == "tools" and not tested):
                found.append(f"{path.relative_to(root)}: {name}")
    return found


def names_twice(root: Path = ROOT) -> list[str]:
    """Modules and public classes of one name."""
    places: dict[str, list[str]] = defaultdict(list)
    for path in sorted((root / PACKAGE).rglob("*.py")):
        module = _module_of(path, root)
        if path.stem not in ("__init__", "__main__") and module[:2] != COMMANDS:
            places[f"module {path.stem}"].append(".".join(module))
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[f"class {node.name}"].append(".".join(module))
    return [f"{name}: {', '.join(each)}" for name, each in places.items() if len(each) > 1]


def _module_of(path: Path, root: Path) -> tuple[str, ...]:
    names = path.relative_to(root / PACKAGE).with_suffix("").parts
    return names[:-1] if names[-1] == "__init__" else names


def table(made: dict[str, Room]) -> str:
    """The rooms as a table of Markdown."""
    rows = [COLUMNS, tuple("---" for _ in COLUMNS)]
    for name, room in sorted(made.items()):
        known_by = sum(name in other.out for other in made.values())
        share = f"{100 * room.comments / max(room.lines, 1):.1f}"
        numbers = (room.lines, room.nodes, room.public, known_by, len(room.out), room.longest)
        rows.append((f"`{name}`", *map(str, numbers), share))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


if __name__ == "__main__":
    print(table(rooms()))
