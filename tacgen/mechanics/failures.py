"""How a solve fails: one enum, whose values are the sentences for users."""

from enum import StrEnum
from typing import Any

MAX_REPORTED_J = 0.2  # J below which the message of a failure reports it [-]
RETRY_HINT = "try less depth, less friction or a finer mesh"


class Failure(StrEnum):
    """Why a frame has no solution. A value is the message, a format string of the failure's data."""

    newton = f"Newton did not converge in {{steps}} steps; {RETRY_HINT}"
    squeezed = (
        f"Newton did not converge in {{steps}} steps, the gel squeezed to {{least_J:.1%}} of its volume; {RETRY_HINT}"
    )
    # the budget of Newton steps is spent; shorter load steps would need more
    effort = f"Newton did not converge in {{steps}} steps, shorter load steps included; {RETRY_HINT}"
    # the indenter might tunnel through the gel; a shorter load step may converge
    too_far = "the gel cannot follow the indenter that far at once"
    # the gel tunnelled while it folded; a shorter load step would fail in the same way
    snaps = f"the gel folds, and snaps past a thin part of the indenter; {RETRY_HINT}"
    unbalanced = (
        "residual {residual:.1e} and balance {balance:.1e} of the contact force, smallest gap {least_gap:.1e} mm"
    )
    inverted = f"an element is turned inside out, to {{least_J:.2g}} of its volume; {RETRY_HINT}"
    inside = (
        "the indenter, {width:.3g} mm thin, penetrates the gel by {depth:.3g} mm between contact points of a mesh of"
        " edge {edge:g} mm: a finer one or less depth is needed"
    )
    # no depth gives the force; `index` of the frame
    too_much = "{asked:g} N asked for, and {part:.0%} of the gel's thickness gives {most:.3g} N"
    hopeless = "{why}, as a coarse mesh has it"
    force_effort = "{asked:g} N asked for: {why}, of which the best gives {most:.3g} N"
    force = "{asked:g} N asked for, and as far as the gel could be solved it gives {most:.3g} N: {why}"
    deeper = "{asked:g} N asked for: the indenter sinks {depth:.3g} mm below the fine part of the mesh"
    folds = "the gel folds, wrinkles or slips suddenly, and forces would depend on the step size"
    singular = "no sensitivity: the tangent is singular"
    grasp = (
        "the object's balance was not found in {trials} trials; try more frames for this movement, more grip force or"
        " a finer mesh"
    )
    grasp_loose = "the fingers, {width:.4g} mm apart, do not touch the object; first touch is at {opening:.4g} mm"
    coarser_mesh = "on the coarser mesh that uncertainty asks for: {why}"


class NotConverged(ArithmeticError):
    """A frame has no solution that meets the tolerances: the `failure` and its `data`, by name."""

    def __init__(self, failure: Failure, **data: Any) -> None:
        super().__init__(failure.format(**data))
        self.failure, self.data = failure, data


def no_equilibrium(least_J: float, steps: int) -> NotConverged:
    """The failure to find one in so many steps, which ended at this smallest J."""
    return NotConverged(Failure.squeezed if least_J < MAX_REPORTED_J else Failure.newton, steps=steps, least_J=least_J)
