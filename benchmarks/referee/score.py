"""How far an answer is from the reference: forces, torques, maps and markers."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.referee.case import Array, Case
from benchmarks.referee.player import Answer
from benchmarks.referee.reference import Judged

PX_PER_MM = 16.0  # of markers: 320 px across the pad
BLUR_CELLS = 1.0  # of both maps before they are compared, so that points and faces of any mesh are alike [cells]
LEAST_TORQUE_MM = 0.05  # least arm of a torque that is judged [mm]: that of a straight press is 0
RESOLVED = 0.1  # largest error of a reference as a part of the error that it judges


@dataclass(frozen=True)
class Score:
    """Errors of a case, one a judged frame, none without forces: `normal`, `tangential`, `force` as parts of the size
    of the force, where there is none of the case's largest; `torque` as a part of the case's largest, empty without
    torques; `own`: the reference's own error of the force as such a part. Over all frames: `pressure`, `traction`, L2
    norms as parts; `markers`, rms [px]; None where the player or the reference has none. `seconds`: a frame."""

    judge: str
    normal: list[float]
    tangential: list[float]
    force: list[float]
    own: list[float]
    torque: list[float]
    pressure: float | None
    traction: float | None
    markers: float | None
    seconds: float
    on_gpu: bool

    @property
    def resolved(self) -> bool:
        """Whether the reference is ten times as sure as the answer is wrong."""
        return bool(self.force) and float(np.mean(self.own)) <= RESOLVED * float(np.mean(self.force))


def score(case: Case, said: Answer, judged: Judged) -> Score:
    """The errors of an answer."""
    right = judged.answer
    off = np.asarray(said.force, float) - right.force
    size = np.linalg.norm(right.force, axis=1)
    size = np.where(size > 0, size, size.max())
    arm = np.linalg.norm(right.torque, axis=1)
    turned = np.linalg.norm(said.torque - right.torque, axis=1) / max(arm.max(), 1e-300)
    moved = None
    if said.markers is not None and right.markers is not None:
        moved = PX_PER_MM * float(np.sqrt(np.nanmean(((said.markers - right.markers) ** 2).sum(-1))))
    return Score(
        judge=judged.judge,
        normal=_list(abs(off[:, 2]) / size),
        tangential=_list(np.linalg.norm(off[:, :2], axis=1) / size),
        force=_list(np.linalg.norm(off, axis=1) / size),
        own=_list(np.where(np.isnan(off[:, 2]), np.nan, judged.force_error / size)),
        torque=_list(turned) if arm.max() > LEAST_TORQUE_MM * size.max() else [],
        pressure=_apart(said.pressure, right.pressure),
        traction=_apart(said.traction, right.traction) if case.friction else None,
        markers=moved,
        seconds=said.seconds,
        on_gpu=said.on_gpu,
    )


def _list(values: Array) -> list[float]:
    return [float(value) for value in values if not np.isnan(value)]


def _apart(said: Array | None, right: Array | None) -> float | None:
    """L2 norm of the difference of two maps (n, h, w, ...), both blurred, over that of the right one."""
    if said is None or right is None:
        return None
    blur = (0, BLUR_CELLS, BLUR_CELLS, 0)[: said.ndim]
    a, b = (gaussian_filter(np.nan_to_num(part).astype(float), blur) for part in (said, right))
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))
