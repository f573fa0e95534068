"""Control loops that follow a surface or an edge by touch."""
