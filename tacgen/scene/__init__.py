"""A resolved scene as numbers: the path of the indenter and the mesh of the gel."""
