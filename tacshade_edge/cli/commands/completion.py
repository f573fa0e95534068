"""``tacshade-edge completion``: prints a script for bash, zsh or tcsh; pressing TAB then runs none of our code."""

from __future__ import annotations

import argparse

from tacshade_edge.cli import command_line
from tacshade_edge.errors import ConfigError
from tacshade_edge.version import how_to_install

SHELLS = ("bash", "zsh", "tcsh")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.epilog = (
        "For bash, run: tacshade-edge completion bash > ~/.local/share/bash-completion/completions/tacshade-edge; for "
        "zsh, run: tacshade-edge completion zsh > DIR/_tacshade-edge, where DIR is in $fpath. Then open a new shell."
    )
    parser.add_argument("shell", choices=SHELLS)


def run(args: argparse.Namespace) -> int:
    """Print the shell's completion script."""
    try:
        import shtab
    except ImportError:
        found = "completion: the package shtab is not installed"
        raise ConfigError(f"{found}; to install it: {how_to_install('completion')}") from None
    parser, _ = command_line(lambda _: True)
    print(shtab.complete(parser, args.shell))
    return 0
