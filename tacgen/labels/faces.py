"""A scene's deformed faces alone, as its camera sees them: for calibration and benches, that want no bundle."""

from collections.abc import Iterator

from tacgen import solve
from tacgen.labels import gel_surface
from tacgen.recipe.plan import Row
from tacgen.scene import mesh, scene
from tacgen.solve import foresee


def faces(row: Row) -> Iterator[gel_surface.Surface]:
    """The untouched face, then that of each frame."""
    built = foresee.foreseen(scene.build(row))
    problem = solve.Problem.of(built, mesh.of(built))
    untouched = gel_surface.seen(problem.mesh, len(row.sensor.gel.clear_layers))
    yield untouched
    for state in solve.states(built, problem):
        yield untouched.moved(state.x)
