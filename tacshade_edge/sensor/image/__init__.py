"""Compute the white ratio and its maps from an image: binarisation, integral images, denoising."""
