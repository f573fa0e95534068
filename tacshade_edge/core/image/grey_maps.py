"""Compute the maps of sections IV-A and IV-B for shape from shading."""

from __future__ import annotations

import numpy as np

from tacshade_edge.core.image import greyscale
from tacshade_edge.core.image.greyscale import Denoiser
from tacshade_edge.core.image.preprocess import Preprocessed, Preprocessor
from tacshade_edge.core.image.total_variation import chambolle
from tacshade_edge.types import F32, Bool, frozen


@frozen
class GreyMaps:
    """The maps of one image on one grid.

    Attributes
    ----------
    g, g0 : float32 (rows, cols), 0 to 255
        White ratio of the image and of the unloaded skin, denoised.
    g_d : float32 (rows, cols)
        Eq. 9, positive in contact.
    inside : bool (rows, cols)
    """

    g: F32
    g0: F32
    g_d: F32
    inside: Bool


class GreyMapper:
    """Denoises white ratios, then applies eq. 9 without the common change of light.

    Parameters
    ----------
    preprocessor : Preprocessor
        Provides the reference; its profile sets the weight of the denoising.
    denoise : callable
        The total-variation denoising.
    """

    def __init__(self, preprocessor: Preprocessor, denoise: Denoiser = chambolle) -> None:
        self._inside, self._sign = preprocessor.rays.inside, preprocessor.sign
        self._weight, self._denoise = preprocessor.profile.tv_weight, denoise
        self._g0 = self._smooth(preprocessor.reference_g)

    def maps(self, preprocessed: Preprocessed) -> GreyMaps:
        """The maps of an image."""
        g = self._smooth(preprocessed.g - np.float32(self._sign * preprocessed.drift_grey))
        g_d = greyscale.grey_difference(g, self._g0, self._inside, self._sign)
        return GreyMaps(g=g, g0=self._g0, g_d=g_d, inside=self._inside)

    def _smooth(self, g: F32) -> F32:
        return greyscale.denoise_tv(g, self._inside, self._weight, self._denoise)
