"""What long commands say on stderr where it is no terminal: a line every 10 s, on slow machines."""

import re

_LINE = re.compile(r"[a-z ]+: \d+/\d+(, [0-9a-z ]+ left)?")


def without_progress(err: str) -> list[str]:
    """The lines of anything else."""
    return [line for line in err.splitlines() if not _LINE.fullmatch(line)]


def only_progress(err: str) -> bool:
    """Whether nothing else was said."""
    return not without_progress(err)
