"""The command line's parser: argparse, with a suggestion for a mistyped word."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from tacshade_edge.quoting import did_you_mean


def _at_home(value: Any) -> Any:
    if isinstance(value, list):
        return [_at_home(each) for each in value]
    return Path(os.path.expanduser(value)) if isinstance(value, Path) else value


class Parser(argparse.ArgumentParser):
    """argparse's parser with suggestions; the parsers of its commands are also of this class."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._words: tuple[str, ...] = ()
        # The innermost parser sets this last: it is the one that knows the command's options.
        self.set_defaults(parser=self)

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Parse as argparse does, and keep the words for `error`."""
        self._words = tuple(args or ())
        found, rest = super().parse_known_args(args, namespace)
        for name, value in vars(found).items():  # a shell leaves the ~ of --out=~/map
            setattr(found, name, _at_home(value))
        return found, rest

    def error(self, message: str) -> NoReturn:
        """Print the usage, the message and the nearest valid word, if any; exit with 2."""
        if refused := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)$", message):
            meant = did_you_mean(refused[1], re.findall(r"[\w-]+", refused[2]))
        else:
            meant = next(filter(None, map(self._option_meant, self._words)), "")
        super().error(message + meant)

    def _option_meant(self, word: str) -> str:
        """Return a suggestion for a word that looks like an option but is none of this parser's, else ''."""
        options = re.findall(r"--[\w-]+", self.format_usage())
        name = word.partition("=")[0]
        is_known = any(option.startswith(name) for option in (*options, "--help"))
        return "" if is_known or not name.startswith("--") else did_you_mean(name, options)
