"""Resuming a run: a bundle is kept only if it is complete and has the same inputs."""

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from tacgen import atomic_file
from tacgen.bundle import bundle, dataset
from tacgen.bundle.hdf5_file import Damaged
from tacgen.errors import UserError
from tacgen.recipe.plan import Row


@dataclass(frozen=True)
class SceneResult:
    """The outcome of a scene. `seconds` by stage is empty if the bundle existed before."""

    name: str
    path: Path
    status: str  # ok, rejected (a frame did not converge), failed (there is no bundle)
    reason: str
    frames: int
    seconds: dict[str, float] = field(default_factory=dict)


def once(row: Row, folder: Path, make: Callable[[Path], SceneResult], *, overwrite: bool = False) -> SceneResult:
    """Make a scene unless its bundle exists and is complete; with `overwrite` in any case.

    Raises:
        UserError: the bundle's name is taken by a file made from other inputs.
        atomic_file.Busy: another process is making this bundle.
    """
    paths = [folder / f"{each.name}.h5" for each in row.bundles]
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as claims:
        for path in paths:
            claims.enter_context(atomic_file.claim(path))
        if not overwrite:
            whole = [bundle.is_complete(path, each.key) for path, each in zip(paths, row.bundles, strict=True)]
            if all(whole):
                kept = bundle.read(paths[0]).attrs
                return SceneResult(row.name, paths[0], kept["status"], kept["reason"], row.frames)
            for path in (path for path, done in zip(paths, whole, strict=True) if path.exists() and not done):
                _refuse(path)
        return make(paths[0])


def refuse_foreign(rows: Iterable[Row], folder: Path) -> None:
    """UserError if the folder is packed, or a bundle of other inputs has a row's name. Reads attributes only."""
    if dataset.is_packed(folder):
        raise UserError(f"{folder}: holds packed scenes; choose another folder")
    if not any(folder.glob("*.h5")):
        return
    for row in (each for scene in rows for each in scene.bundles):
        path = folder / f"{row.name}.h5"
        if path.exists():
            try:
                ours = bundle.read(path).attrs["input_key"] == row.key
            except (bundle.Unfinished, Damaged):
                continue
            except UserError:
                ours = False
            if not ours:
                _refuse(path)


def _refuse(path: Path) -> None:
    """UserError if the file is a complete bundle; an unfinished or damaged one may be replaced."""
    try:
        other = bundle.read(path)
        other.verify()
    except (bundle.Unfinished, Damaged):
        return
    except UserError as error:
        raise UserError([*error.lines[:-1], f"{error.lines[-1]}; pass --overwrite to replace it"]) from None
    made = other.recipe.get("name", "?")
    raise UserError(f"{path}: made from other inputs (recipe {made}); pass --overwrite or choose another folder")
