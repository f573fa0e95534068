"""Reduce a touch to the few numbers that a controller needs,
by a model learnt from labelled frames.
"""
