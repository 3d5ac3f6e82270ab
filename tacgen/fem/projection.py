"""Tangents that are exact, or positive semi-definite."""

from enum import IntEnum


class Projection(IntEnum):
    """Whether tangents are projected to be positive semi-definite, per element or per contact point."""

    NONE = 0  # the exact second derivative
    STRAINED = 1  # only where the material is strained: near rest the exact tangent is positive definite
    FULL = 2  # everywhere
