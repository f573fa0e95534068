"""``tacshade-edge completion``: prints a script for bash, zsh or tcsh;
pressing TAB then runs none of our code.
"""

from __future__ import annotations

import argparse

from tacshade_edge.cli import command_line
from tacshade_edge.cli.shared.options import need


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "For bash, run: tacshade-edge completion bash > "
        "~/.local/share/bash-completion/completions/tacshade-edge; for zsh, run: tacshade-edge "
        "completion zsh > DIR/_tacshade-edge, where DIR is in $fpath. Then open a new shell."
    )
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"))


def run(args: argparse.Namespace) -> int:
    need("completion", "completion", "shtab")
    import shtab

    # A script holds every command's options, so here all modules are imported.
    parser, _ = command_line(lambda _: True)
    print(shtab.complete(parser, args.shell))
    return 0
