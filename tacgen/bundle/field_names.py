"""Short names of a bundle's datasets: `force` is /frames/force, `displacement` is /fields/displacement."""

from collections.abc import Collection

from tacgen.base.errors import UserError
from tacgen.outputs import LAYOUT

PER_FRAME_GROUPS = ("/frames/", "/fields/")  # groups whose datasets have short names
# other names by which Python takes a dataset: those of the outputs of a recipe, and shorter ones
SHORT_NAMES = {"stress": "nodal_stress", "image": "rgb", "force_std": "uncertainty/force", "unique": "quality/unique"}
SHORT_NAMES |= {name: f"/reference/{name}" for name in ("x_mm", "y_mm")}
FIRST_FIELDS = (
    *("force", "torque", "pressure", "traction", "height", "normals", "nodal_stress", "displacement", "markers", "rgb"),
)


def short(paths: Collection[str]) -> dict[str, str]:
    """Dataset path by short name, those that are read most often first."""
    named = {path.split("/", 2)[2]: path for path in paths if path.startswith(PER_FRAME_GROUPS)}
    return {name: named.pop(name) for name in FIRST_FIELDS if name in named} | named


def path_of(name: str, paths: Collection[str]) -> str:
    """The path of a dataset, given its short name, one of SHORT_NAMES or its path, among `paths`.

    Raises:
        UserError: it is none of them; the message names what was probably meant, and what there is.
    """
    known, name = short(paths), SHORT_NAMES.get(name, name)
    if name in paths or name in known:
        return known.get(name, name)
    if name in (everywhere := short(LAYOUT)) or name in LAYOUT:
        said = f"{name!r}: not among the outputs of this scene"
    else:
        from tacgen.sensor.validation_messages import suggest

        said = f"{name!r}: no such field" + (suggest(name, known) or suggest(name, everywhere))
    plain = [each for each in known if "/" not in each]
    raise UserError(f"{said.rstrip('?')}; there are: {', '.join(plain) or 'none'}")
