"""What the commands share: options, the values that argparse reads, lines on stderr,
missing packages.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, get_args
from urllib.parse import urlsplit

from tacshade_edge.cli.shared.journal import WARNING, complain
from tacshade_edge.errors import ConfigError
from tacshade_edge.sensor.profiles import AUTO, DEFAULT, NETWORK, PROFILES, Outline
from tacshade_edge.version import how_to_install

DEFAULT_CONFIG = Path("/etc/tacshade-edge/config.yaml")


def warn(line: object) -> None:
    complain(f"tacshade-edge: {line}", WARNING)


NEXT_FIT = (
    "next (--fit needs the `fit` extra and takes minutes; without it, "
    "the networks stay as shipped):"
)


def need(what: str, extra: str, *packages: str) -> None:
    """Raise a ConfigError that names the extra if one of these packages is missing;
    imports none of them.
    """
    for package in packages:
        # Only looks for the package: to import PyTorch takes seconds.
        if importlib.util.find_spec(package) is None:
            raise ConfigError(
                f"{what}: the package {package} is not installed; to install it: "
                f"{how_to_install(extra)}"
            )


def path(text: str) -> Path:
    """Read a path; a shell leaves the ~ of --out=~/map."""
    return Path(text).expanduser()


def add_option(
    to: Any, name: str, metavar: str, text: str, kind: Callable[[str], Any] = path, **more: Any
) -> None:
    """Declare an option of a parser or a group of options;
    its value is a path unless `kind` reads another.
    """
    to.add_argument(name, type=kind, metavar=metavar, help=text, **more)


def add_flag(to: Any, name: str, text: str) -> None:
    to.add_argument(name, action="store_true", help=text)


def add_cluster(to: Any) -> None:
    """Declare ``--cluster``, for `parallel.workers`."""
    text = "run the jobs on a Dask cluster, such as tcp://HOST:8786 (extra `cluster`)"
    add_option(to, "--cluster", "ADDRESS", text, str)


def add_config(parser: argparse.ArgumentParser, text: str = "settings file") -> None:
    add_option(parser, "--config", "FILE", f"{text} (default: %(default)s)", default=DEFAULT_CONFIG)


def add_sensor(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--sensor", metavar="ID", help="sensor to use, if the settings list several"
    )


def sensor_id(text: str) -> str:
    """Read the name of a sensor that a command makes."""
    # `tacshade/hand/...` are the topics of hands.
    if not re.fullmatch(r"(?!hand$)[A-Za-z0-9_-]{1,64}", text):
        raise argparse.ArgumentTypeError(
            f"found {text}, expected letters, digits, - and _, but not the word hand"
        )
    return text


def add_profile(parser: argparse.ArgumentParser, default: str = DEFAULT) -> None:
    """Declare ``--profile`` of commands whose results must not depend on the machine's speed."""
    text = f"speed against accuracy (default: {default})"
    parser.add_argument(
        "--profile", type=_fixed, choices=sorted(PROFILES), default=default, help=text
    )


def add_outline(parser: argparse.ArgumentParser) -> None:
    text = (
        "what separates the contact from the other skin: the network, or two means of the heights "
        f"as in the paper, which `paper` always uses (default: {NETWORK})"
    )
    parser.add_argument("--outline", choices=get_args(Outline), default=NETWORK, help=text)


def _fixed(text: str) -> str:
    if text == AUTO:
        found = f"found {AUTO}, which adapts to the clock, so no two runs would be the same"
        raise argparse.ArgumentTypeError(f"{found}; expected one of {', '.join(sorted(PROFILES))}")
    return text


def number(
    expected: str, low: float, high: float, kind: type[int] | type[float] = float
) -> Callable[[str], Any]:
    """Return an argparse type that reads a number from `low` to `high`,
    which `expected` describes.
    """

    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            # In no range, so that both mistakes give the same line.
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"found {text!r}, expected {expected}")
        return value

    return read


FINITE = number("a finite number", -sys.float_info.max, sys.float_info.max)
POSITIVE = number("a number above 0 and at most a million", sys.float_info.min, 1e6)
RATE = number("a number from 0.001 to a million", 1e-3, 1e6)
COUNT = number("a whole number from 0", 0, 2**31 - 1, int)
PORT = number("a port from 0 to 65535", 0, 65535, int)


def address(default_port: int | None = None) -> Callable[[str], tuple[str, int]]:
    """Return an argparse type that reads HOST:PORT;
    with a default port, it also accepts HOST alone and port 0.
    """

    def read(text: str) -> tuple[str, int]:
        with suppress(ValueError):
            parts = urlsplit(f"//{text}")
            host, port = parts.hostname, parts.port
            # urlsplit also takes apart what is no address: a path, a user, a port that is missing
            # after its colon.
            if host and parts.netloc == text and parts.username is None and not text.endswith(":"):
                if default_port is not None:
                    return host, default_port if port is None else port
                if port:
                    return host, port
        expected = "HOST:PORT" if default_port is None else "HOST or HOST:PORT"
        raise argparse.ArgumentTypeError(
            f"found {text!r}, expected {expected} such as localhost:{default_port or 1883}"
        )

    return read
