"""Pose of the indenter, force and torque on the gel, and how well the frame is solved: in every bundle."""

from tacgen.outputs.base import Datasets, FrameData, Output, count, flag, number, pose, vector


def _frame(frame: FrameData) -> Datasets:
    """Every dataset but segment, time and the expected error, which the pipeline knows."""
    import numpy as np

    from tacgen.geometry.pose import Pose
    from tacgen.mechanics.tunnelling import overlap
    from tacgen.outputs.gel_surface import wrench

    problem, state = frame.scene.problem, frame.state
    force, torque = wrench(problem, state)
    contact = problem.contact.moved(Pose.of(state.pose), state.offset)
    friction = np.zeros(3) if state.friction is None else state.friction.sum((0, 1))
    parts = {"/frames/normal_force": force - friction, "/frames/friction_force": friction}
    return (parts if problem.friction else {}) | {
        "/frames/pose": state.pose,
        "/frames/force": force,
        "/frames/torque": torque,
        "/frames/quality/newton_iterations": state.iterations,
        "/frames/quality/damped_steps": state.damped,
        "/frames/quality/unique": state.unique,
        "/frames/quality/substeps": state.substeps,
        "/frames/quality/min_gap_mm": state.min_gap,
        "/frames/quality/mean_gap_mm": state.mean_gap,
        "/frames/quality/overlap_mm": overlap(contact, state.x),
        "/frames/quality/rounded": state.rounded,
        "/frames/quality/force_balance": state.balance,
        "/frames/quality/residual": state.residual,
        "/frames/quality/least_jacobian": state.least_J,
    }


OUTPUT = Output(
    "pose, force and torque; these are in every bundle",
    {
        "/frames/pose": pose("pose of the indenter in the sensor frame"),
        "/frames/segment": count("index of the trajectory segment the frame belongs to"),
        "/frames/time": number("time since the start of the path, where time counts", "s"),
        "/frames/force": vector("force on the gel"),
        "/frames/normal_force": vector(
            "with friction: part of the force by pressure, along the indenter's normals; it has a part along the face"
            " where the indenter ploughs"
        ),
        "/frames/friction_force": vector(
            "with friction: part of the force by friction, at most the coefficient x the sum of pressure x area"
        ),
        "/frames/torque": vector("torque on the gel about the sensor origin", "N mm"),
        "/frames/quality/newton_iterations": count("Newton iterations spent on the frame"),
        "/frames/quality/damped_steps": count(
            "of these, steps in which the gel folds, wrinkles or slips suddenly: from the first that needed damping on"
        ),
        "/frames/quality/unique": flag(
            "no step needed damping since the gel was last untouched: where false, forces may depend on the step size"
        ),
        "/frames/quality/substeps": count("steps the frame was split into"),
        "/frames/quality/min_gap_mm": number("smallest gap between gel and indenter", "mm"),
        "/frames/quality/mean_gap_mm": number("pressure-weighted mean gap", "mm"),
        "/frames/quality/overlap_mm": number("how deep the face is in the indenter between contact points", "mm"),
        "/frames/quality/rounded": number(
            "share of friction at points that crossed a sharp edge in one step; above .05 forces depend on the"
            " step size"
        ),
        "/frames/quality/force_balance": number("norm of force + base reaction, over force; bounds as of residual"),
        "/frames/quality/residual": number(
            "2-norm of the free nodes' forces, over force: at most .001, of frames with damped steps .05"
        ),
        "/frames/quality/expected_force_error": number(
            "expected error of the force by the mesh, over the force, within a factor of 2; nan without contact and"
            " for linear tetrahedra",
            nan=True,
        ),
        "/frames/quality/least_jacobian": number("certified lower bound of det F over all of the gel"),
    },
    _frame,
)
