import numpy as np

from tacshade_edge.core.touch_map import Raster
from tacshade_edge.studies.stitch.picture import comparison


def test_the_error_is_where_it_is() -> None:
    known = Raster(np.zeros((20, 30), np.float32), 0.0, 0.0, 0.25)
    z = known.z_mm.copy()
    z[2:6, 3:7] = 0.5  # at small x and y: bottom left of a picture from above
    z[10:, 20:] = np.nan
    picture = comparison(known, Raster(z, 0.0, 0.0, 0.25), known).astype(int)
    height, width = picture.shape[0] // 2, picture.shape[1] // 2
    error = picture[height + 22 : height + 22 + 40, width : width + 60]
    red = (error[..., 2] == 255) & (error[..., 0] == 0)
    rows, cols = np.nonzero(red)
    assert rows.min() >= 40 - 2 * 6 - 1
    assert rows.max() <= 40 - 2 * 2
    assert cols.min() >= 2 * 3 - 1
    assert cols.max() <= 2 * 7
    grey = (error == 225).all(axis=2)
    assert grey[:20, 40:].all()
    assert np.count_nonzero(grey) == 400
