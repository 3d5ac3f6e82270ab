"""Every tolerance and switch of the solver, with its unit and reason."""

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class SolverOptions:
    """How an equilibrium is looked for and when it counts as found. Lengths are parts of dhat, forces of the contact
    force, unless said otherwise."""

    # when an equilibrium counts as found
    step_tol: float = 1e-2  # of dhat: the last Newton step moves no node by more
    residual_tol: float = 2e-4  # of the contact force: where Newton stops
    residual_max: float = 1e-3  # of the contact force: residual and force balance of a frame that is handed out
    lag_tol: float = 2e-4  # of the contact force, only with lagged friction (ipctk)
    force_tol: float = 3e-3  # of a force that is asked for; on the way to it 1e-2
    # Newton's method
    max_newton: int = 60  # steps of the bulk in a load step; ordinary frames take 3 to 6
    max_effort: int = 160  # in all that is tried for a load step, or for a force that is asked for; hard ones take 120
    # of the contact within one step of the bulk; ordinary ones take 2 to 10. With 30 hard scenes take 3 %
    # longer, with 14 a punch finds another answer than the oracle
    max_contact: int = 20
    condense: bool = True  # contact is brought to equilibrium on the Schur complement within each step of the bulk
    keep_tangent: bool = True  # a factorised tangent serves several steps, from load step to load step
    patience: float = 2.0  # refactorise if more steps are predicted: a factorisation costs about two
    mixed_pressure: bool = True  # tangents take the pressure that the linearised step predicts
    # load stepping
    predict: bool = True  # a step begins from the gel carried along with the indenter
    sink: float = 0.8  # of the edge: the deepest that a load step may go into the gel as it lies; deeper is slower
    slide: float = 1.0  # of the edge: the farthest that a load step may carry what is in contact
    slide_sharp: float = 0.5  # the same for an indenter with edges sharper than the mesh
    halvings: int = 5  # of a load step that does not converge
    # friction
    slip: float = 1 / 8  # of dhat: slip over which friction builds up


DEFAULT = SolverOptions()


def plain() -> SolverOptions:
    """The oracle: Newton's method on all unknowns at once, each tangent exact and new, nothing predicted."""
    return SolverOptions(
        condense=False, keep_tangent=False, mixed_pressure=False, predict=False, max_newton=200, max_effort=10_000,
        step_tol=2e-3, residual_tol=2e-5,
    )  # fmt: skip


def tighter(options: SolverOptions) -> SolverOptions:
    """The same with a tenth of the tolerances."""
    return replace(options, step_tol=options.step_tol / 10, residual_tol=options.residual_tol / 10)


def short_steps(options: SolverOptions, times: int) -> SolverOptions:
    """The same with load steps `times` as short."""
    shorter = {name: getattr(options, name) / times for name in ("sink", "slide", "slide_sharp")}
    return replace(options, **shorter)
