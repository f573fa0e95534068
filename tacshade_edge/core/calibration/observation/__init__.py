"""Presses as their images show them and as a machine places them."""
