"""From pose to pose: where the indenter goes, and the gel's way to equilibrium under it."""
