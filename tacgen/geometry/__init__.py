"""Shapes: gels and indenters, from numbers or mesh files, and the tets that fill a gel."""
