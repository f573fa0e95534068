"""From an image to the white ratio and its maps: binarisation, integral images, denoising."""
