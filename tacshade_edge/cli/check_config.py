"""``tacshade-edge check-config``: is a settings file right, as far as can be told without hardware?"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from tacshade_edge.devices import registry
from tacshade_edge.reasons import Reason
from tacshade_edge.settings import json_schema, load

DEFAULT_CONFIG = Path("/etc/tacshade-edge/config.yaml")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "file", nargs="?", type=Path, default=DEFAULT_CONFIG, metavar="FILE", help="default: %(default)s"
    )
    parser.add_argument("--schema", action="store_true", help="print the JSON Schema of a settings file instead")


def run(args: argparse.Namespace) -> int:
    """Print ``FILE: ok``, or raise the ConfigError that says what is wrong."""
    if args.schema:
        print(json.dumps(json_schema(), indent=2))
        return 0
    document = load(args.file)
    registry.check_files(document)
    calibration = registry.find_calibration(document)
    # What `run` makes, made and not started: a wrong certificate is found here.
    registry.make_source(document.settings.source)
    registry.make_link(document, on_request=lambda _: None, on_outcome=lambda *_: None)
    print(f"{args.file}: ok")
    if isinstance(calibration, Reason):
        print(f"{document.where('calibration')}: warning: {calibration}")
    return 0
