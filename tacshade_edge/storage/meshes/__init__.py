"""Points and triangles: PLY, STL."""
