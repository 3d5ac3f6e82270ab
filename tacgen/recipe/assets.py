"""Files that ship with tacgen (sensors, recipes, objects), found by name in a checkout and in an installed wheel."""

import difflib
import hashlib
import os
from contextlib import suppress
from pathlib import Path

from tacgen.base import regular_file
from tacgen.base.errors import UserError, why

PACKAGE_FOLDER = Path(__file__).resolve().parent.parent
MAX_ASSET_BYTES = 2**30  # largest file that a recipe may name [bytes]
MESH_SUFFIXES, YAML_SUFFIXES = (".stl", ".obj", ".ply"), (".yaml", ".yml")


def folder(kind: str) -> Path:
    """The folder of one kind of file: next to the package in a checkout, in tacgen/data in a wheel."""
    inside = PACKAGE_FOLDER / "data" / kind
    return inside if inside.is_dir() else PACKAGE_FOLDER.parent / kind


def list_sensors() -> list[str]:
    """Names of the shipped sensors."""
    return _names("sensors")


def list_recipes() -> list[str]:
    """Names of the shipped recipes."""
    return _names("recipes")


def list_objects() -> list[str]:
    """Names of the shipped objects, one folder each."""
    root = folder("objects")
    return sorted(p.name for p in root.iterdir() if p.is_dir()) if root.is_dir() else []


def sensor_path(name_or_path: str, base: Path | None = None) -> Path:
    """The file of a sensor, from a name such as `gelsight_mini` or a path relative to `base`, the recipe's folder."""
    return _find("sensor", name_or_path, base, list_sensors())


def recipe_path(name_or_path: str, base: Path | None = None) -> Path:
    """The file of a recipe, from the name of a shipped one or a path relative to `base`, else to the working folder."""
    return _find("recipe", name_or_path, base, list_recipes())


def beside(path: str, folder: Path | None) -> Path:
    """The file of a path that is absolute, or relative to `folder`; ~ stays as it is if there is no such user."""
    with suppress(ValueError):  # a name that no user can have
        path = os.path.expanduser(path)
    return (folder or Path()) / path


def object_path(name_or_path: str, base: Path | None = None) -> Path:
    """The folder of a shipped object, or the file of a path relative to `base`, the recipe's folder."""
    if _is_path(name_or_path, MESH_SUFFIXES):
        return _existing("object", beside(name_or_path, base), base)
    if name_or_path not in list_objects():
        raise UserError(_unknown("object", name_or_path, list_objects()))
    return folder("objects") / name_or_path


def mesh_path(name_or_path: str, base: Path | None = None) -> Path:
    """The mesh file of a shipped object, or of a path relative to `base`, the recipe's folder."""
    shipped = object_path(name_or_path, base)
    if shipped.is_dir():
        meshes = sorted(p for p in shipped.iterdir() if p.suffix.lower() in MESH_SUFFIXES)
        if not meshes:
            raise UserError(f"{shipped}: holds no mesh ({', '.join(MESH_SUFFIXES)}): name its file instead")
        return meshes[0]
    if shipped.suffix.lower() not in MESH_SUFFIXES:
        raise UserError(f"{shipped}: must be a mesh file ({', '.join(MESH_SUFFIXES)})")
    return shipped


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes. Raises UserError: it cannot be read."""
    try:
        with regular_file.opened(path, MAX_ASSET_BYTES) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read: {why(error)}") from None


def changed(sha256: str) -> str:
    """A message on a file whose SHA-256 is not the one that is asked for."""
    return f"is another file now ({sha256[:12]}...): leave its sha256 out to take it"


def _names(kind: str) -> list[str]:
    return sorted(p.stem for p in folder(kind).glob("*.yaml"))


def _is_path(text: str, suffixes: tuple[str, ...]) -> bool:
    return "/" in text or "\\" in text or text.lower().endswith(suffixes)


def _find(kind: str, text: str, base: Path | None, names: list[str]) -> Path:
    """The file of a name or path of a shipped YAML_SUFFIXES file. Raises UserError: there is no such file or name."""
    if _is_path(text, YAML_SUFFIXES):
        return _existing(kind, beside(text, base), base)
    if text in names:
        return folder(f"{kind}s") / f"{text}.yaml"
    if base is None and _there(Path(text)):
        return Path(text)
    file = f"{text}.yaml"
    raise UserError(_unknown(kind, text, names, file if _there(beside(file, base)) else ""))


def _existing(kind: str, path: Path, base: Path | None) -> Path:
    if not _there(path):
        start = "the working folder" if base is None else "the folder of the file that names it"
        hint = _meant(path.stem, _files_beside(path, kind)) or f": a relative path starts at {start}"
        raise UserError(f"{path}: no such {kind} file{hint}")
    return path


def _there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a name that no file can have
        return False


def _files_beside(path: Path, kind: str) -> dict[str, str]:
    """Names of the files of this kind in a path's folder, by those without suffix, of which typing errors are told."""
    suffixes = MESH_SUFFIXES if kind == "object" else YAML_SUFFIXES
    try:
        return {other.stem: other.name for other in path.parent.iterdir() if other.suffix.lower() in suffixes}
    except (OSError, ValueError):
        return {}


def _unknown(kind: str, name: str, names: list[str], file: str = "") -> str:
    hint = _meant(name, {name: file} if file else {each: each for each in names})
    return f"no {kind} is called {name!r}" + (hint or f"; there are: {', '.join(names) or 'none'}")


def _meant(name: str, known: dict[str, str]) -> str:
    """`; did you mean a or b?`: what begins with the name, else the one that is closest; nothing if none is."""
    begun = sorted(each for each in known if name and each.startswith(name))[:3]
    close = begun or difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {' or '.join(known[each] for each in close)}?" if close else ""
