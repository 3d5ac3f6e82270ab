"""Warnings about a sensor file: numbers so far from those of known gels that a unit is probably wrong, and numbers
without a source."""

from collections.abc import Iterator

from tacgen.sensor.base_model import NO_SOURCE, Part
from tacgen.sensor.model import Gel, Sensor
from tacgen.sensor.validation_messages import Issue
from tacgen.sensor.yaml_source import KeyPath, Tree, format_path

# Young's modulus of gels and skins, from the softest silicone gels to hard rubber [MPa]
USUAL_MODULUS_MPA = (0.005, 5.0)
USUAL_SIDE_MM = (2.0, 200.0)  # width and height of a gel, from a fingertip's to a palm's [mm]
USUAL_THICKNESS_MM = (0.2, 100.0)  # of all its layers, from a skin on a plate to a large half ball [mm]
# in the source of a part that differs from the sensor it is a copy of, before its name
COPIED_SOURCE = "; the rest as in "
Kind = tuple[str, str, dict[str, float]]  # of quantity, its unit, and units in which it is written by mistake
MODULUS_UNITS: Kind = "moduli", "MPa", {"kPa": 1e-3, "Pa": 1e-6}
LENGTH_UNITS: Kind = "lengths", "mm", {"m": 1e3, "cm": 10.0}


def warnings(sensor: Sensor, tree: Tree) -> tuple[str, ...]:
    """Warnings about numbers that are unusual, and one if parts of a sensor file name no source of theirs."""
    told = tuple(problem.place(tree) for problem in (*unusual(sensor.gel), *_beside(sensor)))
    if not (parts := unsourced(sensor)):
        return told
    text = f"{', '.join(parts)}: no source; say where the numbers come from, as in source: assumed"
    return (*told, f"{tree.spot(()).value.source.name}: {text}")


def _beside(sensor: Sensor) -> Iterator[Issue]:
    """A problem where the camera's field of view ends beside the pad: mm_per_px may be wrong, or meant so."""
    gel, camera = sensor.gel, sensor.camera
    pixel = camera.pixel_mm
    view = camera.width_px * pixel[0], camera.height_px * pixel[1]
    middle = (camera.center_mm[k] + camera.crop_mm[k] for k in (0, 1))
    sides = gel.width_mm, gel.height_mm
    if any(abs(m) + v / 2 > s / 2 + p for m, v, s, p in zip(middle, view, sides, pixel, strict=True)):
        text = (
            f"the picture shows {view[0]:.3g} x {view[1]:.3g} mm, which is not all on the pad of {sides[0]:g} x"
            f" {sides[1]:g} mm: pixels beside it have no labels"
        )
        yield Issue(("camera", "mm_per_px"), text)


def unsourced(sensor: Part) -> list[str]:
    """Paths of the parts of a sensor without a `source`."""
    return [format_path(path) for path, part in _parts(sensor) if getattr(part, "source", "") == NO_SOURCE]


def assumed(sensor: Part) -> list[str]:
    """A line for each part of a sensor some of whose numbers are not those of its `base`: path and source."""
    sources = [(path, getattr(part, "source", "")) for path, part in _parts(sensor)]
    return [f"{format_path(path)}: {source}" for path, source in sources if COPIED_SOURCE in source]


def _parts(part: Part, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Part]]:
    """All parts of a sensor with their paths, each after the parts in it."""
    for name, value in part:
        items = enumerate(value) if isinstance(value, tuple) else ()
        for where, held in [((*path, name), value), *(((*path, name, i), item) for i, item in items)]:
            if isinstance(held, Part):
                yield from _parts(held, where)
    yield path, part


def unusual(gel: Gel) -> Iterator[Issue]:
    """A problem for each layer whose Young's modulus at rest, and for each size of the gel, that is not that of a gel;
    paths start at the sensor's root."""
    for name in ("width_mm", "height_mm"):
        size = getattr(gel, name)
        if asked := _asked(size, USUAL_SIDE_MM, LENGTH_UNITS):
            yield Issue(("gel", name), f"a gel of {size:g} mm; gels have {asked}")
    if asked := _asked(gel.thickness_mm, USUAL_THICKNESS_MM, LENGTH_UNITS):
        yield Issue(("gel", "layers", 0, "thickness_mm"), f"a gel {gel.thickness_mm:g} mm thick; gels have {asked}")
    for i, layer in enumerate(gel.layers):
        key, modulus = layer.stiffness
        if asked := _asked(modulus, USUAL_MODULUS_MPA, MODULUS_UNITS):
            yield Issue(("gel", "layers", i, key), f"a Young's modulus of {modulus:g} MPa; that of gels is {asked}")


def _asked(value: float, usual: tuple[float, float], kind: Kind) -> str:
    """The usual range, and the value in the first unit in which it is usual; "" if it is usual as it stands."""
    (least, most), (quantity, unit, mistaken) = usual, kind
    if least <= value <= most:
        return ""
    in_unit = {name: value * size for name, size in mistaken.items()}
    meant = [f": {v:g} {unit} if it is in {name}?" for name, v in in_unit.items() if least <= v <= most]
    return f"{least:g} to {most:g}, and {quantity} are in {unit}{''.join(meant[:1])}"
