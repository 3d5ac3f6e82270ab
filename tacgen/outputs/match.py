"""How a frame differs from the table whose forces it meets: the correction of the object's pose, and both forces."""

from tacgen.outputs.base import Datasets, FrameData, Output, flag, number, vector


def _frame(frame: FrameData) -> Datasets:
    import numpy as np

    from tacgen.geometry.pose import shortest_turn
    from tacgen.mechanics.frames import normal_force
    from tacgen.mechanics.scene import Wanted

    assert frame.scene.match is not None
    state, wanted = frame.state, frame.scene.match[frame.state.index] or Wanted(np.full((4, 4), np.nan))
    table = wanted.pose
    assert table is not None
    found: Datasets = {"/frames/match/asked_force": wanted.force, "/frames/match/met": not state.note}
    if frame.held is None:
        return found | {
            "/frames/match/correction_mm": state.pose[2, 3] - table[2, 3],
            "/frames/match/reached_force": normal_force(state),
        }
    held, side = frame.held
    shift = held.sensors[side][:3, :3].T @ (held.pose - table)[:3, 3]
    turn = np.linalg.norm(shortest_turn(table, held.pose)) if np.isfinite(table).all() else np.nan
    return found | {
        "/frames/match/correction_mm": shift[2],
        "/frames/match/shift": shift,
        "/frames/match/turn_deg": np.degrees(turn),
        "/frames/match/reached_force": sum(map(normal_force, held.states)) / 2,
        "/frames/match/borne": held.weight - held.unborne,
    }


OUTPUT = Output(
    "with `match: force` or `grip` of a replay: the table's force, the one that is reached, and the pose's correction",
    {
        "/frames/match/correction_mm": number(
            "from the object's pose in the table to the solved one, along the sensor's z; nan where the table has none",
            "mm",
            nan=True,
        ),
        "/frames/match/asked_force": number(
            "normal force that the table asks for, in a grasp of each finger; nan where it has none", "N", nan=True
        ),
        "/frames/match/reached_force": number("normal force on the gel; in a grasp the mean of both", "N"),
        "/frames/match/met": flag("the frame is as the table asks: where false, `notes` say why"),
        "/frames/match/shift": vector(
            "in a grasp: correction of the object's origin, in this finger's sensor frame", "mm", nan=True
        ),
        "/frames/match/turn_deg": number("in a grasp: angle by which the object's pose is corrected", "deg", nan=True),
        "/frames/match/borne": number("in a grasp: part of the weight that the fingers bear", "N"),
    },
    _frame,
)
