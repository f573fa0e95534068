"""How depth and displacement are found when objects are dragged, twisted and tilted."""
