"""Rigid transforms: `tacshade_edge.rigid` in a checkout, that file itself in the wheel."""

from tacshade_edge.rigid import *  # noqa: F403
