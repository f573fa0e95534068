import numpy as np

from tacshade_edge.core.stitching.surface_map import Raster
from tacshade_edge.studies.stitch.picture import comparison


def test_the_error_is_where_it_is() -> None:
    known = Raster(np.zeros((20, 30), np.float32), 0.0, 0.0, 0.25)
    z = known.z_mm.copy()
    z[2:6, 3:7] = 0.5  # at small x and y: bottom left of a picture from above
    z[10:, 20:] = np.nan
    picture = comparison(known, Raster(z, 0.0, 0.0, 0.25), known).astype(int)
    height, width = picture.shape[0] // 2, picture.shape[1] // 2
    zoom = 600 // 30
    error = picture[height + 22 : height + 22 + 20 * zoom, width : width + 30 * zoom][
        zoom // 2 :: zoom, zoom // 2 :: zoom
    ]
    red = (error[..., 2] == 255) & (error[..., 0] == 0)
    expected = np.zeros((20, 30), bool)
    expected[20 - 6 : 20 - 2, 3:7] = True
    np.testing.assert_array_equal(red, expected)
    grey = np.zeros((20, 30), bool)
    grey[:10, 20:] = True
    np.testing.assert_array_equal((error == 225).all(axis=2), grey)
