"""Checks of a grasp: its movements, its object and its sensors together."""

import importlib.util
import math

from tacgen.base.errors import UserError
from tacgen.recipe import matching, trajectory_checks
from tacgen.recipe.indenters import analytic
from tacgen.recipe.model import Grasp, Recipe
from tacgen.recipe.trajectory import Start, Timed
from tacgen.sensor.model import Sensor
from tacgen.sensor.validation_messages import Issue

GRIPPER_MOVES = ("close", "lift")  # movements of a gripper alone
LATE_TABLE_MESSAGE = "can be grip in the first movement alone, where the table says how the grasp begins"
TOO_CLOSE_MESSAGE = "must be above {:.4g}: first touch is at {:.4g} mm"
GRASP_MOVES = (*GRIPPER_MOVES, "tilt", "hold", "replay")  # all movements of a gripper


def problems(recipe: Recipe, sensor: Sensor, folders: trajectory_checks.Folders) -> list[Issue]:
    """Problems of a grasp; without a grasp, of movements that need one."""
    grasp, wrong = recipe.grasp, list[Issue]()
    matches = [(i, step.replay.match) for i, step in enumerate(recipe.trajectory) if step.replay]
    if grasp is None:
        for i, step in enumerate(recipe.trajectory):
            if step.kind in GRIPPER_MOVES:
                text = "needs a grasp: add one, or leave this movement out"
                wrong.append(Issue(("trajectory", i, step.kind), text, at_key=True))
        text = "cannot be grip without a grasp: add one, or take force"
        return wrong + [Issue(("trajectory", i, "replay", "match"), text) for i, match in matches if match == "grip"]
    for i, step in enumerate(recipe.trajectory):
        if step.kind not in GRASP_MOVES:
            text = f"is no movement of a grasp, which has {', '.join(GRASP_MOVES)}"
            wrong.append(Issue(("trajectory", i, step.kind), text, at_key=True))
        if isinstance(step.move, Timed) and step.move.duration_s is not None:
            still = "has no effect in a grasp, which is quasi-static: leave it out"
            wrong.append(Issue(("trajectory", i, step.kind, "duration_s"), still))
    first, known = recipe.trajectory[0], all(step.kind in GRASP_MOVES for step in recipe.trajectory)
    if known and first.kind != "close" and not (first.replay and first.replay.matched):
        text = "must be close, or a replay with match: grip: a grasp begins with closed fingers"
        wrong.append(Issue(("trajectory", 0), text))
    for i, match in matches:
        if match == "force" or (match == "grip" and i):
            text = "cannot be force in a grasp: take grip" if match == "force" else LATE_TABLE_MESSAGE
            wrong.append(Issue(("trajectory", i, "replay", "match"), text))
    if recipe.force_error is not None:
        wrong.append(Issue(("quality", "force_error"), "is not known for a grasp: give edge_mm"))
    for key, usual in (("start", Start()), ("dynamics", None)):
        if getattr(recipe, key) != usual:
            wrong.append(Issue((key,), "has no effect in a grasp: leave it out", at_key=True))
    if importlib.util.find_spec("cvxopt") is None:
        wrong.append(Issue(("grasp",), "needs CVXOPT, which is not installed: pip install cvxopt", at_key=True))
    tables, placed = _tables(recipe, folders)
    return [*wrong, *tables, *solid(sensor), *(_placed(recipe, grasp) if placed else _object(recipe, grasp, sensor))]


def _tables(recipe: Recipe, folders: trajectory_checks.Folders) -> tuple[list[Issue], bool]:
    """Pose tables of the gripper that cannot be used, and whether one says where the object is at the start."""
    wrong, placed = list[Issue](), False
    for i, step in enumerate(recipe.trajectory):
        where = ("trajectory", i, "replay", "file")
        try:
            if step.replay is not None:
                rows = trajectory_checks.replayed(step.replay, folders.get(where))
                placed = placed or (step.replay.match == "grip" and rows[0].held is not None)
                if why := matching.lacks(rows, step.replay):
                    wrong.append(Issue((*where[:-1], "match"), why))
        except UserError as error:
            wrong += [Issue(where, line) for line in error.lines]
    return wrong, placed


def _placed(recipe: Recipe, grasp: Grasp) -> list[Issue]:
    """Keys without effect on an object whose first pose is in a table, and what is not known of it."""
    given = {"height_mm": None, "y_mm": 0.0, "yaw_deg": 0.0}
    text = "has no effect: the table's first row says where the object is: leave it out, or those columns"
    wrong = [Issue(("grasp", key), text) for key, usual in given.items() if getattr(grasp, key) != usual]
    if grasp.centre_mm is None and (shape := analytic(recipe.indenter)) is not None:
        import numpy as np

        if math.isinf(shape.support(np.array([0.0, 0.0, 1.0]))):
            wrong.append(Issue(("grasp",), "must say where an object without a top has its centre of mass: centre_mm"))
    return wrong


def solid(sensor: Sensor) -> list[Issue]:
    """A finger's gel must be a pad."""
    text = f"has a solid gel, {sensor.name}: a grasp needs pads: take another sensor"
    return [Issue(("sensor",), text)] if sensor.gel.solid else []


def _object(recipe: Recipe, grasp: Grasp, sensor: Sensor) -> list[Issue]:
    """The object needs two sides to close on and a height; from first touch on, the fingers may close by the gels'
    thickness at most."""
    if (shape := analytic(recipe.indenter)) is None:
        return []
    c, s = math.cos(yaw := math.radians(grasp.yaw_deg)), math.sin(yaw)
    import numpy as np

    wide, top = shape.support(np.array([c, -s, 0.0])), shape.support(np.array([0.0, 0.0, 1.0]))
    if math.isinf(wide):
        text = "has no upright sides that fingers could close on: turn it, or take another shape"
        return [Issue(("indenter",), text)]
    if grasp.height_mm is None and math.isinf(top):
        text = "must say at which height over its lowest point an object without a top is held: height_mm"
        return [Issue(("grasp",), text)]
    if (grasp.height_mm or 0.0) > top:
        return [Issue(("grasp", "height_mm"), f"must be at most the object's height, {top:g}")]
    from tacgen.mechanics.grasp import first_touch

    gels = sensor.gel.pad, sensor.gel.pad  # as if the other finger's were the same
    opening = first_touch(shape, gels, grasp.height_mm or top / 2, grasp.y_mm, yaw)[1]
    least = opening - 2 * sensor.gel.thickness_mm
    return [
        Issue(("trajectory", i, "close", "width_mm"), TOO_CLOSE_MESSAGE.format(least, opening))
        for i, step in enumerate(recipe.trajectory)
        if step.close is not None and step.close.width_mm is not None and step.close.width_mm <= least
    ]
