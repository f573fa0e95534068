"""Hypothesis, for all tests: no time limit per example (machines are shared), and a failure can be repeated.

Where CI is set, the examples are the same in every run: one there judges the change, one at the desk looks for news.
"""

import os

from hypothesis import settings

settings.register_profile("tacshade", deadline=None, print_blob=True, derandomize="CI" in os.environ)
settings.load_profile("tacshade")
