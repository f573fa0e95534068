"""How depth and shear are found when objects are dragged, twisted and tilted."""
