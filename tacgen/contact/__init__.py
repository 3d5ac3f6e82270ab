"""Contact of the gel's face with an indenter: barrier, friction, and detection of tunnelling."""
