"""Exports of a reconstructed recording to other programs' formats."""
