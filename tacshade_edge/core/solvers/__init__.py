"""Depth solvers behind one protocol; the registry is one dict."""
