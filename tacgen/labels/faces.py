"""A scene's deformed faces alone, as its camera sees them: for calibration and benches, that want no bundle."""

from collections.abc import Iterator

from tacgen import fields, mesh, scene, solve
from tacgen.plan import Row
from tacgen.solve import foresee


def faces(row: Row) -> Iterator[fields.Surface]:
    """The untouched face, then that of each frame."""
    built = foresee.foreseen(scene.build(row))
    problem = solve.Problem.of(built, mesh.of(built))
    untouched = fields.seen(problem.mesh, len(row.sensor.gel.clear_layers))
    yield untouched
    for state in solve.states(built, problem):
        yield untouched.moved(state.x)
