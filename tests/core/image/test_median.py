from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tacshade_edge.core.image.median import median, percentile
from tacshade_edge.types import F32, U8


@given(hnp.arrays(np.float32, st.integers(1, 50), elements=st.floats(-1e6, 1e6, width=32)))
def test_the_median_is_numpys(values: F32) -> None:
    assert median(values) == np.median(values.astype(np.float64))


@given(hnp.arrays(np.uint8, st.integers(1, 200)), st.floats(0, 100))
def test_a_percentile_is_numpys(values: U8, percent: float) -> None:
    found = np.percentile(values, percent)
    assert abs(percentile(values, percent) - found) <= 1e-12 * found
