"""Pose of the indenter, force and torque on the gel, and how well the frame is solved: in every bundle."""

from typing import TYPE_CHECKING

from tacgen.outputs.base import FAR, Datasets, Entry, Output

if TYPE_CHECKING:
    from tacgen.outputs.scene_data import FrameData


def _frame(frame: "FrameData") -> Datasets:
    """Every dataset but segment and time, which the pipeline knows."""
    from tacgen.geometry.pose import Pose
    from tacgen.mechanics.barrier import Contact
    from tacgen.mechanics.tunnelling import overlap
    from tacgen.outputs.gel_surface import wrench

    problem, state = frame.scene.problem, frame.state
    force, torque = wrench(problem, state)
    contact = problem.contact.moved(Pose.of(state.pose), state.offset)
    return {
        "/frames/pose": state.pose,
        "/frames/force": force,
        "/frames/torque": torque,
        "/frames/quality/newton_iterations": state.iterations,
        "/frames/quality/damped_steps": state.damped,
        "/frames/quality/substeps": state.substeps,
        "/frames/quality/min_gap_mm": state.min_gap,
        "/frames/quality/mean_gap_mm": state.mean_gap,
        "/frames/quality/overlap_mm": overlap(contact if isinstance(contact, Contact) else contact.distance, state.x),
        "/frames/quality/rounded": state.rounded,
        "/frames/quality/force_balance": state.balance,
        "/frames/quality/residual": state.residual,
        "/frames/quality/least_jacobian": state.least_J,
    }


OUTPUT = Output(
    "pose, force and torque; these are in every bundle",
    {
        "/frames/pose": Entry(
            "<f8", "N 4 4", "mm", "pose of the indenter in the sensor frame", "frame row column", most=FAR
        ),
        "/frames/segment": Entry("<i4", "N", "1", "index of the trajectory segment the frame belongs to", "frame"),
        "/frames/time": Entry("<f8", "N", "s", "time since the start of the path, where time counts", "frame"),
        "/frames/force": Entry("<f8", "N 3", "N", "force on the gel", "frame xyz"),
        "/frames/torque": Entry("<f8", "N 3", "N mm", "torque on the gel about the sensor origin", "frame xyz"),
        "/frames/quality/newton_iterations": Entry("<i4", "N", "1", "Newton iterations spent on the frame", "frame"),
        "/frames/quality/damped_steps": Entry(
            "<i4",
            "N",
            "1",
            "of these, steps that needed damping: the gel folds, wrinkles or slips suddenly, and from then on"
            " forces may depend on the step size",
            "frame",
        ),
        "/frames/quality/substeps": Entry("<i4", "N", "1", "steps the frame was split into", "frame"),
        "/frames/quality/min_gap_mm": Entry("<f8", "N", "mm", "smallest gap between gel and indenter", "frame"),
        "/frames/quality/mean_gap_mm": Entry("<f8", "N", "mm", "pressure-weighted mean gap", "frame"),
        "/frames/quality/overlap_mm": Entry(
            "<f8", "N", "mm", "how deep the face is in the indenter between contact points", "frame"
        ),
        "/frames/quality/rounded": Entry(
            "<f8",
            "N",
            "1",
            "share of friction at points that crossed a sharp edge in one step; above .05 forces depend on the"
            " step size",
            "frame",
        ),
        "/frames/quality/force_balance": Entry("<f8", "N", "1", "norm of force + base reaction, over force", "frame"),
        "/frames/quality/residual": Entry("<f8", "N", "1", "2-norm of the free nodes' forces, over force", "frame"),
        "/frames/quality/least_jacobian": Entry(
            "<f8", "N", "1", "certified lower bound of det F over all of the gel", "frame"
        ),
    },
    _frame,
)
