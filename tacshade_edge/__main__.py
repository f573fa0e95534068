"""``python -m tacshade_edge``: the same as the console script."""

from tacshade_edge.cli.entry import entry

entry()
