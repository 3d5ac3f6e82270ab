"""Every tolerance and switch of the solver, with its unit and reason."""

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class SolverOptions:
    """How an equilibrium is computed, and when it has converged."""

    # convergence
    step_tol: float = 1e-2  # of dhat: the last Newton step moves no node by more
    residual_tol: float = 2e-4  # of the contact force: where Newton stops
    residual_max: float = 1e-3  # of the contact force: largest residual and force imbalance of a frame
    force_tol: float = 3e-3  # of a prescribed force, at the end of a movement
    # Newton's method
    max_newton: int = 60  # steps of the bulk in a load step; ordinary frames take 3 to 6
    max_effort: int = 160  # steps of the bulk in all trials of a load step or of a prescribed force; hard ones take 120
    # contact steps in a step of the bulk; ordinary ones take 2 to 10. With 30, hard scenes take 3 % longer; with 14, a
    # punch comes to another equilibrium than with plain()
    max_contact: int = 20
    condense: bool = True  # contact is solved on the Schur complement within each step of the bulk
    keep_tangent: bool = True  # a factorised tangent serves several steps, from load step to load step
    patience: float = 2.0  # refactorise if more steps are predicted: a factorisation costs about two
    mixed_pressure: bool = True  # tangents use the pressure that the linearised step predicts
    through_folds: bool = True  # damped steps lead through instabilities; without them a frame that needs one fails
    # halvings of a load step before it may be damped: steps that are merely long need no damping in their quarters
    fold_halvings: int = 2
    # of the contact force: where Newton stops in a fold. The force is then within some 1 % of the equilibrium's, which
    # itself is not unique
    fold_tol: float = 1e-2
    fold_steps: int = 8  # Newton steps in the folds of a frame, after which it ends at `fold_max`
    fold_max: float = 5e-2  # of the contact force: largest residual in a fold, about the expected error of `draft`
    # load stepping
    predict: bool = True  # Newton starts from the gel moved along with the indenter
    sink: float = 0.8  # of the edge: largest depth of the new pose inside the gel of the last step; deeper is slower
    slide: float = 1.0  # of the edge: largest tangential motion of the contact in a load step
    slide_sharp: float = 0.5  # the same for an indenter with edges sharper than the mesh
    halvings: int = 5  # most halvings of a load step that does not converge
    # friction
    slip: float = 1 / 8  # of dhat: slip over which friction builds up


DEFAULT_OPTIONS = SolverOptions()


def plain() -> SolverOptions:
    """The reference solver: Newton's method on all unknowns at once, with a new exact tangent in each step and no
    prediction."""
    return SolverOptions(
        condense=False, keep_tangent=False, mixed_pressure=False, predict=False, max_newton=200, max_effort=10_000,
        step_tol=2e-3, residual_tol=2e-5,
    )  # fmt: skip


def tighter(options: SolverOptions) -> SolverOptions:
    """Options with a tenth of the tolerances."""
    names = "step_tol", "residual_tol", "fold_tol", "fold_max"
    return replace(options, **{name: getattr(options, name) / 10 for name in names})


def short_steps(options: SolverOptions, times: int) -> SolverOptions:
    """Options with load steps `times` as short."""
    shorter = {name: getattr(options, name) / times for name in ("sink", "slide", "slide_sharp")}
    return replace(options, **shorter)
