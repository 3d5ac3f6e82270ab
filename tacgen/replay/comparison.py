"""Forces and torques of another simulator beside tacgen's on the same frames: a table, a summary, a figure.

All forces are on the gel, in the sensor's frame: x right and y down in the image, z out of the gel. The normal force is
-z, positive in compression.
"""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.base import csv_table, output_file
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.force_error import FORCE_STD_PATH
from tacgen.recipe import pose_table
from tacgen.recipe.trajectory import Placement
from tacgen.replay.contact_log import ContactLog
from tacgen.report import force_figure

Array = np.ndarray
MIN_CONTACT_FORCE_N = 1e-3  # smallest force that counts as contact [N]
MIN_TORQUE_N_MM = 1e-3  # smallest torque that errors are divided by [N mm]
COMPARISON_FILES = ("forces.csv", "forces.txt", "forces.png")
MAX_PRINTED_FRAMES = 12  # frames of a log that are printed
FORCE_AXES = "xyz"


@dataclass(frozen=True)
class Compared:
    """The n frames of a log that tacgen solved; forces (n, 3) [N]."""

    log: ContactLog  # the rows of these frames
    scene: str
    reason: str  # why frames are missing, or ""
    ours: Array
    torque: Array  # (n, 3) on the gel about the sensor's origin, by tacgen [N mm]
    std: Array | None  # standard deviation of `ours`
    theirs: Array | None  # None: the log has no force
    their_torque: Array | None = None  # as `torque`, by the simulator; None: the log has none

    @property
    def contact(self) -> Array:
        """Whether either of the two has contact: (n,) booleans."""
        size = np.linalg.norm(self.ours, axis=1)
        other = size if self.theirs is None else np.linalg.norm(self.theirs, axis=1)
        return np.asarray(np.maximum(size, other) > MIN_CONTACT_FORCE_N)

    def summary(self) -> dict[str, Any]:
        """Largest forces and errors as JSON values; errors are the simulator's force less tacgen's."""
        found: dict[str, Any] = {
            "log": self.log.name, "scene": self.scene, "frames": len(self.ours), "in_contact": int(self.contact.sum()),
            "reason": self.reason,
        }  # fmt: skip
        if not len(self.ours):
            return found
        peak = int(np.argmin(self.ours[:, 2]))
        std = None if self.std is None else self.std[peak]
        found["normal"] = {"ours_n": -float(self.ours[peak, 2]), "std_n": None if std is None else float(std[2])}
        side = int(np.argmax(shear := np.linalg.norm(self.ours[:, :2], axis=1)))
        found["tangential"] = {"ours_n": float(shear[side])}
        if self.theirs is not None:
            found["normal"] |= {"theirs_n": -float(self.theirs[peak, 2]), **_errors(self.ours, self.theirs, [2])}
            if self.log.friction:
                theirs = float(np.linalg.norm(self.theirs[side, :2]))
                found["tangential"] |= {"theirs_n": theirs, **_errors(self.ours, self.theirs, [0, 1])}
            if self.std is not None:
                off, sure = np.abs(self.theirs - self.ours)[:, 2], force_figure.HALF_90_PER_STD * self.std[:, 2]
                found["inside_90"] = float((off <= sure)[self.contact].mean()) if self.contact.any() else None
        if self.their_torque is not None:
            size, theirs = (np.linalg.norm(part, axis=1) for part in (self.torque, self.their_torque))
            most = int(np.argmax(size))
            error = float(np.sqrt(((self.their_torque - self.torque) ** 2).sum(1).mean()))
            found["torque"] = {
                "ours_nmm": float(size[most]), "theirs_nmm": float(theirs[most]), "rms_error_nmm": error,
                "relative": error / rms if (rms := float(np.sqrt((size**2).mean()))) > MIN_TORQUE_N_MM else None,
            }  # fmt: skip
        return found


def _errors(ours: Array, theirs: Array, axes: list[int]) -> dict[str, float | None]:
    """Root mean square of the error over frames, and its ratio to that of our force."""
    error = float(np.sqrt(((theirs - ours)[:, axes] ** 2).sum(1).mean()))
    size = float(np.sqrt((ours[:, axes] ** 2).sum(1).mean()))
    return {"rms_error_n": error, "relative": error / size if size > MIN_CONTACT_FORCE_N else None}


def compare(log: ContactLog, bundle: Bundle, sensor_pose: Placement) -> Compared:
    """The frames of a bundle beside the rows of the log that it replays, one for each."""
    done = log.some(np.arange(bundle.frames))
    theirs = their_torque = None
    if done.force is not None:
        mount = pose_table.matrices([sensor_pose.position_mm], [sensor_pose.quaternion])
        turned = (mount if done.sensor is None else done.sensor @ mount)[:, :3, :3]
        turned = np.broadcast_to(turned, (len(done), 3, 3))
        theirs = np.einsum("nji,nj->ni", turned, done.force)
        if done.torque is not None:  # from the origin of the body to the sensor's
            arm = mount[:, :3, 3] if done.sensor is None else (done.sensor[:, :3, :3] @ mount[0, :3, 3])
            their_torque = np.einsum("nji,nj->ni", turned, done.torque - np.cross(arm, done.force))
    force, torque = bundle["/frames/force"], bundle["/frames/torque"]
    std = bundle[FORCE_STD_PATH] if FORCE_STD_PATH in bundle.shapes else None
    return Compared(done, bundle.path.stem, str(bundle.attrs["reason"]), force, torque, std, theirs, their_torque)


def table(found: Sequence[Compared]) -> str:
    """CSV: a line for each frame of all logs, forces in the sensor's frame."""
    out = io.StringIO()
    lines = csv.writer(out, lineterminator="\n")
    groups = ("force", "std", "simulator", "error")
    named = [f"{group}_{axis}_n" for group in groups for axis in FORCE_AXES]
    turning = ("torque", "simulator_torque")
    named += [f"{group}_{axis}_nmm" for group in turning for axis in FORCE_AXES]
    lines.writerow(["log", "scene", "frame", "row", "time_s", *named])
    for one in found:
        nothing = np.full((len(one.ours), 3), np.nan)
        std, theirs, turned = (nothing if part is None else part for part in (one.std, one.theirs, one.their_torque))
        numbers = np.hstack([one.ours, std, theirs, theirs - one.ours, one.torque, turned])
        time = csv_table.numerals(one.log.time.tolist(), 9)
        for k, values in enumerate(numbers.tolist()):
            cells = ["" if value != value else f"{value:.6g}" for value in values]  # nan: not known
            lines.writerow([one.log.name, one.scene, k, int(one.log.row[k]), time[k], *cells])
    return out.getvalue()


def text(found: Sequence[Compared]) -> str:
    """The summary of all logs, and of a single one its frames, for a terminal."""
    lines = ["normal force [N]: where tacgen's is largest, and the root mean square of the error over the frames"]
    rows = [["log", "frames", "contact", "tacgen", "simulator", "error", "rms error", "of tacgen's rms"]]
    every = [one.summary() for one in found]
    rows += [[one["log"], str(one["frames"]), str(one["in_contact"]), *_cells(one, "normal")] for one in every]
    lines += [*aligned(rows), "tangential force [N]: the same, in the plane of the gel"]
    rows = [["log", "tacgen", "simulator", "error", "rms error", "of tacgen's rms"]]
    rows += [[one["log"], *_cells(one, "tangential")] for one in every]
    lines += aligned(rows)
    if turned := [(one["log"], one["torque"]) for one in every if "torque" in one]:
        lines += ["torque about the sensor's origin [N mm]: the same"]
        rows = [["log", "tacgen", "simulator", "rms error", "of tacgen's rms"]]
        for name, part in turned:
            ratio = "-" if part["relative"] is None else f"{100 * part['relative']:.1f} %"
            rows.append([name, *(f"{part[key]:.3g}" for key in ("ours_nmm", "theirs_nmm", "rms_error_nmm")), ratio])
        lines += aligned(rows)
    lines += [f"{one.log.name}: {one.reason}" for one in found if one.reason]
    if len(found) == 1 and len(found[0].ours):
        lines.append("frames: forces on the gel [N], x right and y down in the image, z out of the gel")
        lines += _frames(found[0])
    return "\n".join(lines)


def _cells(found: dict[str, Any], force: str) -> list[str]:
    """Our normal or tangential force, and the simulator's with its error; `-` where one is not known."""
    if (part := found.get(force)) is None:
        return ["-"] * 5
    ours = part["ours_n"]
    shown = _with(ours, part.get("std_n"))
    if "theirs_n" not in part:
        return [shown, *["-"] * 4]
    theirs, relative = part["theirs_n"], part["relative"]
    off = f"{100 * (theirs / ours - 1):+.1f} %" if ours > MIN_CONTACT_FORCE_N else "-"
    ratio = "-" if relative is None else f"{100 * relative:.1f} %"
    return [shown, _with(theirs, None), off, _with(part["rms_error_n"], None), ratio]


def _with(value: float, std: float | None) -> str:
    """A force [N] with its standard deviation; one below MIN_CONTACT_FORCE_N is rounding or the mesh's."""
    if value < MIN_CONTACT_FORCE_N:
        return f"< {MIN_CONTACT_FORCE_N:g}"
    return f"{value:.3g}" if std is None else f"{value:.3g} +- {std:.2g}"


def _frames(one: Compared) -> list[str]:
    rows = [["row", "time [s]", "tacgen", "+-", "simulator", "error"]]
    time = csv_table.numerals(one.log.time.tolist(), 6)
    for k in range(0, len(one.ours), -(-len(one.ours) // MAX_PRINTED_FRAMES)):
        theirs = None if one.theirs is None else one.theirs[k]
        parts = (one.ours[k], None if one.std is None else one.std[k], theirs)
        error = None if theirs is None else theirs - one.ours[k]
        rows.append([str(one.log.row[k]), time[k], *map(_vector, (*parts, error))])
    return aligned(rows)


def _vector(values: Array | None) -> str:
    return "-" if values is None else " ".join(f"{value:.3f}" for value in values + 0.0)


def aligned(rows: list[list[str]]) -> list[str]:
    """Lines of a table of cells, each column as wide as its widest cell."""
    wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  " + "  ".join(cell.rjust(w) for cell, w in zip(row, wide, strict=True)) for row in rows]


def write(
    found: Sequence[Compared], folder: Path, inputs: Sequence[Path] = (), *, overwrite: bool = False
) -> list[Path]:
    """Write COMPARISON_FILES into a folder and return their paths. Raises UserError: one is an input, or is there and
    is not what tacgen wrote, and there is no `overwrite`."""
    paths = lines, words, picture = [folder / name for name in COMPARISON_FILES]
    options: dict[str, Any] = {"overwrite": overwrite, "within": folder, "kind": "result"}
    for path, content in ((lines, table(found)), (words, text(found) + "\n")):
        output_file.put(path, content.encode(), inputs, **options)
    drawn = [force_figure.Series(one.log.name, one.ours, one.std, one.theirs, one.log.friction) for one in found]
    with output_file.written(picture, inputs, **options) as new:
        force_figure.draw([one for one in drawn if len(one.ours)], new)
    return paths
