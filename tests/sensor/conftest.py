"""Every test here may make a reconstructor."""

from support.networks import shared_networks

__all__ = ["shared_networks"]
