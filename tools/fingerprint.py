"""A fingerprint of what decides a page's figures:
networks, golden results, and the programs that measure.

Of Python files the syntax tree counts, without docstrings and imports, and not where a file lies:
neither formatting nor comments nor moves change a fingerprint, and every version of Python makes
the same.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
WEIGHTS = ROOT / "tacshade_edge/sensor/inference/weights"
GOLDEN = ROOT / "tests/golden"
NETWORKS = ("fast", "balanced", "accurate")
PARTS = ("networks", "golden results", "program")
"""What a fingerprint is made of, in this order."""
DIGITS = 5
FOLLOWED = (
    "support/",
    "tools/",
    "tacshade_edge/cli/commands/",
    "tacshade_edge/lab/fitting/",
    "tacshade_edge/lab/cluster",
    "tacshade_edge/lab/parallel",
    "tacshade_edge/lab/simulator/camera_faults",
    "tacshade_edge/lab/studies/",
)
"""A program's imports from here belong to it; what else it imports is pinned
by the golden results.
"""


def fingerprint(
    programs: Iterable[str], folders: Iterable[str] = (), profiles: Iterable[str] = NETWORKS
) -> str:
    """Fingerprint modules with what they import from `FOLLOWED`, whole folders of code,
    and profiles.
    """
    code = imported(programs)
    for folder in folders:
        code |= set((ROOT / folder).rglob("*.py"))
    golden = [GOLDEN / "replay.json"]
    golden += [GOLDEN / f"profiles/{name}.json" for name in ("simulator", *profiles)]
    parts = (
        _digest(f"{path.name} {_bytes_of(path)}" for path in WEIGHTS.iterdir()),
        _digest(f"{path.name} {_bytes_of(path)}" for path in golden),
        _digest(map(tree_of, code)),
    )
    return "-".join(parts)


def changed(one: str, other: str) -> str:
    """Name the parts in which two fingerprints differ."""
    pairs = zip(PARTS, one.split("-"), other.split("-"), strict=True)
    return ", ".join(name for name, ours, theirs in pairs if ours != theirs)


def imported(programs: Iterable[str]) -> set[Path]:
    """Find the files of modules, and of all that they import from `FOLLOWED`, directly or not,
    but for this one, which says where they lie.
    """
    found: set[Path] = set()
    waiting = [path for program in programs for path in _files_of(program)]
    while waiting:
        path = waiting.pop()
        if path not in found and path != Path(__file__):
            found.add(path)
            waiting += _imports_of(path.read_bytes())
    return found


def tree_of(path: Path) -> str:
    """Digest a file's syntax tree."""
    return _tree_of(path.read_bytes())


@cache
def _tree_of(source: bytes) -> str:
    return hashlib.sha256("".join(_words(ast.parse(source))).encode()).hexdigest()


def _bytes_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _digest(digests: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(sorted(digests)).encode()).hexdigest()[:DIGITS]


def _words(value: object) -> Iterator[str]:
    """Write a tree without what differs between versions of Python: empty fields and contexts."""
    if isinstance(value, ast.AST):
        yield f"({type(value).__name__}"
        for name, field in ast.iter_fields(value):
            if isinstance(field, list):
                field = [each for each in field if not _says_nothing(each, value)]
            if name not in ("ctx", "kind", "type_comment") and field != []:
                yield f" {name}"
                yield from _words(field)
        yield ")"
    elif isinstance(value, list):
        for each in value:
            yield from _words(each)
    else:
        yield f" {value!r}"


def _says_nothing(node: object, parent: ast.AST) -> bool:
    """Whether a node is an import, a docstring, or an empty piece of an f-string."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        return True
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    return isinstance(parent, ast.JoinedStr) and isinstance(node, ast.Constant) and node.value == ""


@cache
def _imports_of(source: bytes) -> tuple[Path, ...]:
    names: list[str] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return tuple(
        file
        for name in names
        for file in _files_of(name)
        if file.relative_to(ROOT).as_posix().startswith(FOLLOWED)
    )


def _files_of(module: str) -> list[Path]:
    path = ROOT.joinpath(*module.split("."))
    files = (path.with_suffix(".py"), path / "__init__.py", path / "__main__.py")
    return [file for file in files if file.is_file()]
