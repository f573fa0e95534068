"""``tacshade-edge backup``: one file with a board's settings, calibrations, objects and maps,
and back.
"""

from __future__ import annotations

import argparse

from tacshade_edge.cli import EXIT_OK
from tacshade_edge.cli.shared.options import add_config, add_flag, add_option
from tacshade_edge.daemon.board_backup import REPLACED, back_up, restore
from tacshade_edge.quoting import counted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_config(parser)
    text = f"put back FILE; what differs is kept as NAME{REPLACED}"
    add_flag(parser, "--restore", text)
    add_option(parser, "file", "FILE", "zip file to write, or with --restore to read")


def run(args: argparse.Namespace) -> int:
    if args.restore:
        written = restore(args.file, args.config)
        for path in written:
            print(path)
        print(
            f"{counted(len(written), 'file')} restored; next: sudo systemctl restart tacshade-edge"
        )
        return EXIT_OK
    names = back_up(args.config, args.file)
    print(f"{args.file}: {counted(len(names), 'file')}; passwords and certificates are not in it")
    return EXIT_OK
