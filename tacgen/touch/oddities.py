"""Checks of recorded episodes: each problem is one line that names the episode and the row."""

import warnings
from collections.abc import Mapping

import numpy as np

from tacgen.base.errors import LeftOut, UserError
from tacgen.touch.episode import EpisodeLog

Array = np.ndarray
MAX_STEP_RATIO = 1.5  # time between two rows over that of the nominal rate: above it a row is missing [-]
MAX_BODY_SPEED_MM_S = 8000.0  # what falls from 3 m, and what robots do not reach [mm/s]
MAX_TURN_SPEED = 60.0  # of a body [rad/s]: ten turns a second
MIN_SPAN_MM, MAX_SPAN_MM = 5.0, 50_000.0  # of all positions of an episode
MIN_CLOSING_MM = 1.0  # change of a gripper's width that is a grasp


def refuse(episode: EpisodeLog, fps: float, where: str) -> None:
    """Raise UserError if rows are missing, are no numbers or jump, or if lengths can hardly be as they are said to be.

    Args:
        where: file and name of the episode.
    """
    time = episode.time
    if len(time) < 2:
        raise UserError(f"{where}: has {len(time)} rows, and at least 2 are needed")
    if (wrong := ~np.isfinite(time)).any():
        raise UserError(f"{where}: row {wrong.argmax()}: its time is no number")
    step = np.diff(time)
    if (wrong := step <= 0).any():
        raise UserError(f"{where}: row {wrong.argmax() + 1}: time must increase, and goes from {_pair(time, wrong)} s")
    if (wrong := step * fps > MAX_STEP_RATIO).any():
        row = int(wrong.argmax()) + 1
        missing = round(step[row - 1] * fps) - 1
        told = "1 row before it is" if missing == 1 else f"{missing} rows before it are"
        raise UserError(
            f"{where}: row {row}: {told} missing, at {fps:g} rows a second: record them"
            " anew, or leave the episode out by --episodes"
        )
    for name, poses in episode.bodies.items():
        if (lost := ~np.isfinite(poses).all((1, 2))).any():
            raise UserError(f"{where}: row {lost.argmax()}: the pose of {name} is missing or no number")
    _refuse_units(episode.bodies, where)
    for name, poses in episode.bodies.items():
        speed = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / step
        cosine = (np.einsum("nij,nij->n", poses[1:, :3, :3], poses[:-1, :3, :3]) - 1) / 2
        turn = np.arccos(np.clip(cosine, -1, 1)) / step
        for fast, most, told, unit in (
            (speed, MAX_BODY_SPEED_MM_S, "moves", "mm/s"),
            (turn, MAX_TURN_SPEED, "turns", "rad/s"),
        ):
            if (fast > most).any():
                row = int((fast > most).argmax()) + 1
                raise UserError(
                    f"{where}: row {row}: {name} jumps: it {told} at {fast[row - 1]:.3g} {unit}, at most {most:g} is"
                    " plausible; check the recording and the units"
                )


def _pair(time: Array, wrong: Array) -> str:
    row = int(wrong.argmax())
    return f"{time[row]:.6g} to {time[row + 1]:.6g}"


def _refuse_units(bodies: Mapping[str, Array], where: str) -> None:
    if len(bodies) < 2:
        return
    positions = np.concatenate([poses[:, :3, 3] for poses in bodies.values()])
    span = float(np.ptp(positions, axis=0).max())
    if 0 < span < MIN_SPAN_MM:
        raise UserError(f"{where}: all bodies lie within {span:.3g} mm: are its lengths metres? Say units: m")
    if span > MAX_SPAN_MM:
        raise UserError(f"{where}: its bodies are {span / 1000:.3g} m apart: are its lengths mm? Say units: mm")


def note(episode: EpisodeLog, width: Array | None, where: str) -> None:
    """Warn by LeftOut of a gripper that never closes, as far as grip, forces or the width (n,) [mm] tell."""
    told = [grip := episode.grip, width, *episode.forces.values()]
    if all(each is None for each in told):
        return
    closes = [
        grip is not None and bool((np.nan_to_num(grip) > 0).any()),
        width is not None and float(np.ptp(width)) > MIN_CLOSING_MM,
        any(bool(force.any()) for force in episode.forces.values()),
    ]
    if not any(closes):
        warnings.warn(
            f"{where}: its gripper never closes, and no --object presses on it: check grip and forces in --columns",
            LeftOut,
            stacklevel=2,
        )
