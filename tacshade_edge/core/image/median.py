"""The median and percentiles of some thousand values, in a fifth of the time that NumPy's take.

NumPy's percentile also imports `numpy.ma`, which takes 1 MB and nothing else here needs.
"""

from __future__ import annotations

from tacshade_edge.types import F32, F64, U8


def median(values: F32 | F64) -> float:
    """Middle of at least one value, none of them NaN; of an even number of them the mean of the two."""
    low, high = (values.size - 1) // 2, values.size // 2
    ordered = values.copy()
    ordered.partition((low, high))  # np.partition does the same, and asks first what it was given
    return (float(ordered[low]) + float(ordered[high])) / 2


def percentile(values: U8, percent: float) -> float:
    """Value that `percent` of at least one value, uint8 (N,), are below, linear between two as NumPy's."""
    at = percent / 100 * (values.size - 1)
    low = int(at)
    high, part = min(low + 1, values.size - 1), at - low
    ordered = values.copy()
    ordered.partition((low, high))
    below, above = float(ordered[low]), float(ordered[high])
    return below + (above - below) * part if part < 0.5 else above - (above - below) * (1 - part)
