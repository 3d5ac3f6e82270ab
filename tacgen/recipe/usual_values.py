"""Numbers of a sensor file that are possible but so far from those of known gels that a unit is probably wrong."""

from collections.abc import Iterator

from tacgen.recipe.sensor import Gel, Layer, MooneyRivlinLayer, YeohLayer
from tacgen.recipe.validation_messages import Problem

MODULUS_MPA = (0.005, 5.0)  # Young's modulus of gels and skins, from the softest silicone gels to hard rubber [MPa]
UNITS = {"kPa": 1e-3, "Pa": 1e-6}  # in which moduli are written by mistake [MPa]


def unusual(gel: Gel) -> Iterator[Problem]:
    """A problem for each layer whose Young's modulus at rest is not that of a gel; paths start at the sensor's root."""
    least, most = MODULUS_MPA
    for i, layer in enumerate(gel.layers):
        key, modulus = _modulus(layer)
        if not least <= modulus <= most:
            meant = [f"{modulus * size:g} MPa if it is in {unit}" for unit, size in UNITS.items()]
            fits = [text for text, size in zip(meant, UNITS.values(), strict=True) if least <= modulus * size <= most]
            asked = f"moduli are in MPa: {fits[0]}?" if fits else "moduli are in MPa"
            text = f"a Young's modulus of {modulus:g} MPa; that of gels is {least:g} to {most:g}, and {asked}"
            yield Problem(("gel", "layers", i, key), text)


def _modulus(layer: Layer) -> tuple[str, float]:
    """The key that sets the stiffness, and Young's modulus at rest [MPa]; 3 G where no Poisson's ratio is asked for."""
    match layer:
        case MooneyRivlinLayer():
            return "c10_mpa", 6 * (layer.c10_mpa + layer.c01_mpa)
        case YeohLayer():
            return "c10_mpa", 6 * layer.c10_mpa
        case _:
            return "youngs_modulus_mpa", layer.youngs_modulus_mpa
