"""``python -m tacshade_edge``: the same as the console script."""

import sys

from tacshade_edge.cli import main

sys.exit(main())
