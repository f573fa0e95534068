"""Points and triangles as PLY and STL files."""
