"""The client in a checkout, where tacshade_edge has its files; the wheel has the files themselves.

See client/hatch_build.py.
"""

from tacshade_edge.thin_client import *  # noqa: F403
from tacshade_edge.thin_client import __all__ as __all__
