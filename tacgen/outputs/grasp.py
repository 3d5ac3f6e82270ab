"""The object and the fingers of a grasp, in each finger's bundle."""

from tacgen.outputs.base import Datasets, FrameData, Output, count, number, pose


def _frame(frame: FrameData) -> Datasets:
    assert frame.held is not None
    held, side = frame.held
    return {
        "/frames/grasp/object": held.pose,
        "/frames/grasp/sensor": held.sensors[side],
        "/frames/grasp/width_mm": held.width,
        "/frames/grasp/mode": held.mode,
        "/frames/grasp/unborne": held.unborne,
        "/frames/grasp/balance": held.balance,
    }


OUTPUT = Output(
    "with the block `grasp`: poses of object and sensor, opening, weight that is not held",
    {
        "/frames/grasp/object": pose("pose of the object in the world frame of a grasp"),
        "/frames/grasp/sensor": pose("pose of this finger's sensor frame in the world"),
        "/frames/grasp/width_mm": number("distance of the fingers' untouched faces", "mm"),
        "/frames/grasp/mode": count("the object: 0 stands on the table, 1 is held, 2 falls: friction does not bear it"),
        "/frames/grasp/unborne": number(
            "part of the weight that the fingers do not bear: the table does, or nothing", "N"
        ),
        "/frames/grasp/balance": number(
            "norm of what acts on the object in the directions in which it is free, over grip"
        ),
    },
    _frame,
)
