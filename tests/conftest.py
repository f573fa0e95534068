"""Hypothesis, for all tests: no time limit per example (machines are shared), and a failure can be repeated."""

from hypothesis import settings

settings.register_profile("tacshade", deadline=None, print_blob=True)
settings.load_profile("tacshade")
