#!/usr/bin/env python3
"""Draw sentences with a fixed seed, for a reader to judge the English of the documents, the help and the messages.

::

    python -m tools.release.sentences [--seed 1] [--count 40] [--all] [--source docs help messages]

Prints numbered sentences, each with its file and line, in equal parts of

- docs: prose of README, CONTRIBUTING, CHANGELOG and docs/ without its results: no code, no heading, and of tables only
  cells of five words or more;
- help: what ``--help`` prints of every command;
- messages: errors, reasons, log lines and the doctor's findings, with ``...`` for each value.

The rubric. The reader knows the field and the glossary, but not the page or the code around the sentence. A sentence is
to be rewritten if a native engineer must read it twice, or if it

1. drops a noun, article or verb that English needs. Help and messages may be phrases: "no frame within 2 s" is fine;
2. inverts the usual order of words;
3. hides who acts, where the reader needs to know;
4. strings nouns together with "of" where a verb would do;
5. uses a word in a sense that English does not give it;
6. or reads as translated in any other way.

The bar: at most 3 of 40.
"""

from __future__ import annotations

import argparse
import ast
import functools
import random
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.cli import command_line

TREE = Path(__file__).resolve().parents[2]
SOURCES = ("docs", "help", "messages")

_CALLS = {"ConfigError", "DeviceError", "DecodeError", "RefusedError", "SafetyStop", "Reason", "fault", "warning", "ok"}
_LOG_CALLS = {"info", "warning", "error", "debug", "exception"}
_WORDS_MIN = 3
_CELL_WORDS_MIN = 5
_WORD = re.compile(r"[A-Za-z][a-z'-]+\b")
_CODE = re.compile(r"`[^`]*`")
_LIST_ITEM = re.compile(r"\s*(?:[-*]|\d+\.)\s+")
_NO_PROSE = re.compile(r"\s*(?:#|<|!\[|\[\w[^]]*\]:|:::|---)")
_SENTENCE_END = re.compile(r"(?<=[.!?])(?<!e\.g\.)(?<!i\.e\.)(?:\*\*|\)|\")?\s+(?=[A-Z`\[*\"(])")


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence and where it stands: ``file:line``, or the command whose help it is."""

    where: str
    text: str


def draw(seed: int, count: int, sources: Iterable[str] = SOURCES) -> list[Sentence]:
    """`count` sentences, in equal parts of each source; the same for the same tree and seed."""
    chance = random.Random(seed)
    names = list(sources)
    drawn = []
    for i, name in enumerate(names):
        drawn += chance.sample(collect(name), (count + i) // len(names))
    return drawn


@functools.cache
def collect(source: str) -> tuple[Sentence, ...]:
    """All sentences of one of `SOURCES`, each text once."""
    found = {"docs": _of_docs, "help": _of_help, "messages": _of_messages}[source]()
    unique: dict[str, Sentence] = {}
    for sentence in found:
        if _words(sentence.text) >= _WORDS_MIN:
            unique.setdefault(sentence.text, sentence)
    return tuple(unique.values())


def _words(text: str) -> int:
    """The number of words in a text, without code."""
    return len(_WORD.findall(_CODE.sub("", text)))


def _of_docs() -> Iterator[Sentence]:
    pages = [TREE / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    pages += sorted(path for path in (TREE / "docs").rglob("*.md") if path.parent.name != "results")
    for page in pages:
        for line, text in prose(page.read_text(encoding="utf-8")):
            for sentence in _SENTENCE_END.split(text):
                yield Sentence(f"{page.relative_to(TREE)}:{line}", sentence.strip())


def prose(markdown: str) -> Iterator[tuple[int, str]]:
    """Paragraphs, list items and long cells, each on one line with the number of its first line."""
    begin, block, is_code = 0, "", False
    for number, line in enumerate([*markdown.splitlines(), ""], start=1):
        is_fence = line.lstrip().startswith(("```", "~~~"))
        is_cells = line.lstrip().startswith("|")
        item = _LIST_ITEM.match(line)
        is_indented = line.startswith("    ") and not (block or item)
        is_no_text = is_code or is_fence or is_cells or is_indented or _NO_PROSE.match(line)
        is_text = bool(line.strip()) and not is_no_text
        if block and (not is_text or item):
            yield begin, block
            block = ""
        if is_text:
            begin = begin if block else number
            block = f"{block} {line[item.end() if item else 0 :].strip()}".strip()
        elif is_cells and not is_code:
            cells = (cell.strip() for cell in line.strip().strip("|").split("|"))
            yield from ((number, cell) for cell in cells if _words(cell) >= _CELL_WORDS_MIN)
        is_code ^= is_fence


def _of_help() -> Iterator[Sentence]:
    parser, _ = command_line(lambda _name: True)
    yield from _of_parser(parser)


def _of_parser(parser: argparse.ArgumentParser) -> Iterator[Sentence]:
    for text in (parser.description, parser.epilog):
        if text:
            yield from (Sentence(parser.prog, part) for part in _SENTENCE_END.split(text))
    for group in parser._action_groups:  # argparse offers no other way to walk them
        if group.description:
            yield Sentence(parser.prog, group.description)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for child in dict.fromkeys(action.choices.values()):
                yield from _of_parser(child)
        elif action.help and action.help != argparse.SUPPRESS:
            name = action.option_strings[-1] if action.option_strings else action.metavar or action.dest
            yield Sentence(f"{parser.prog} {name}", action.help.replace("%(default)s", str(action.default)))


def _of_messages() -> Iterator[Sentence]:
    for path in sorted((TREE / "tacshade_edge").rglob("*.py")):
        for line, text in messages(path.read_text(encoding="utf-8")):
            yield Sentence(f"{path.relative_to(TREE)}:{line}", text)


def messages(source: str) -> Iterator[tuple[int, str]]:
    """The strings that a module gives to errors, reasons, log lines and findings, straight or by a name of its own."""
    tree = ast.parse(source)
    named: dict[str, list[ast.expr]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            named.setdefault(node.targets[0].id, []).append(node.value)
    seen: set[ast.expr] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and _is_message(node.func):
            for argument in node.args:
                yield from _strings(argument, named, seen)
        elif isinstance(node, ast.FunctionDef) and node.name.endswith(("_fix", "_unreached")):
            for inner in ast.walk(node):
                if isinstance(inner, ast.Return) and inner.value is not None:
                    yield from _strings(inner.value, named, seen)


def _is_message(called: ast.expr) -> bool:
    if isinstance(called, ast.Attribute):
        return called.attr in _LOG_CALLS and isinstance(called.value, ast.Name) and "log" in called.value.id
    return isinstance(called, ast.Name) and called.id in _CALLS


def _strings(node: ast.expr, named: dict[str, list[ast.expr]], seen: set[ast.expr]) -> Iterator[tuple[int, str]]:
    if node in seen:
        return
    seen.add(node)
    match node:
        case ast.Constant(value=str(text)):
            yield node.lineno, re.sub(r"%[-\d.]*[a-z]|\{[^{}]*\}", "...", text)
        case ast.JoinedStr(values=parts):
            yield (
                node.lineno,
                "".join(str(part.value) if isinstance(part, ast.Constant) else "..." for part in parts),
            )
            for part in parts:
                if isinstance(part, ast.FormattedValue):
                    yield from _strings(part.value, named, seen)
        case ast.Name(id=name):
            for value in named.get(name, []):
                yield from _strings(value, named, seen)
        case ast.IfExp(body=body, orelse=orelse):
            yield from _strings(body, named, seen)
            yield from _strings(orelse, named, seen)
        case ast.BinOp(left=left, right=right):
            yield from _strings(left, named, seen)
            yield from _strings(right, named, seen)
        case ast.Call(func=ast.Attribute(value=value)):
            yield from _strings(value, named, seen)


def main() -> None:
    """Print a draw, or everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--all", action="store_true", help="print every sentence instead of a draw")
    parser.add_argument("--source", nargs="+", choices=SOURCES, default=SOURCES)
    args = parser.parse_args()
    every = [sentence for source in args.source for sentence in collect(source)] if args.all else None
    for number, sentence in enumerate(every or draw(args.seed, args.count, args.source), start=1):
        print(f"{number}. {sentence.text}  [{sentence.where}]")


if __name__ == "__main__":
    main()
