"""Contact of the gel's face with an indenter: barrier, friction, and what keeps one from passing through."""
