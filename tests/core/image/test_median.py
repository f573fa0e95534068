from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tacshade_edge.core.image.median import median
from tacshade_edge.types import F32


@given(hnp.arrays(np.float32, st.integers(1, 50), elements=st.floats(-1e6, 1e6, width=32)))
def test_it_is_numpys(values: F32) -> None:
    assert median(values) == np.median(values.astype(np.float64))
