"""The median of some thousand values, in a fifth of the time that NumPy's takes."""

from __future__ import annotations

from tacshade_edge.types import F32, F64


def median(values: F32 | F64) -> float:
    """Middle of at least one value, none of them NaN; of an even number of them the mean of the two."""
    low, high = (values.size - 1) // 2, values.size // 2
    ordered = values.copy()
    ordered.partition((low, high))  # np.partition does the same, and asks first what it was given
    return (float(ordered[low]) + float(ordered[high])) / 2
