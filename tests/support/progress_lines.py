"""What long commands say on stderr where it is no terminal: a line every 10 s, on slow machines."""

import re

_LINE = re.compile(r"[a-z ]+: \d+/\d+(, [0-9a-z ]+ left)?")


def only_progress(err: str) -> bool:
    """Whether nothing else was said."""
    return all(_LINE.fullmatch(line) for line in err.splitlines())
