"""Laws in a sensor file: each has the moduli it claims, and larger strains follow its own closed form."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import Elements
from tacgen.fem.materials import EXAMPLE_LAWS, Law, MooneyRivlin, NeoHooke, StableNeoHooke, Yeoh
from tacgen.recipe.loading import read_sensor
from tacgen.recipe.scene_of_row import gel_of
from tacgen.sensor.layers import Layer
from tacgen.sensor.model import Gel, Sensor
from tacgen.sensor.validation_messages import validate

SENSOR = Path(__file__).parents[2] / "sensors" / "gelsight_mini.yaml"
Array = np.ndarray
ONE = np.ones((1, 1))
E, NU = 0.3, 0.48
MU = E / (2 * (1 + NU))
KAPPA = E / (3 * (1 - 2 * NU))
WRITTEN: dict[str, dict[str, float]] = {
    "neo_hooke": {"youngs_modulus_mpa": E, "poissons_ratio": NU},
    "stable_neo_hooke": {"youngs_modulus_mpa": E, "poissons_ratio": NU},
    "mooney_rivlin": {"c10_mpa": 0.3 * MU, "c01_mpa": 0.2 * MU, "poissons_ratio": NU},
    "yeoh": {"c10_mpa": MU / 2, "c20_mpa": -0.1 * MU, "c30_mpa": 0.02 * MU, "bulk_modulus_mpa": KAPPA},
}


def gel(law: str | None, **fields: Any) -> tuple[Gel | None, list[str]]:
    """A gel of one layer as a sensor file would have it, or what is wrong with it."""
    layer = {"name": "gel", "thickness_mm": 4.0, "source": "test", **({"law": law} if law else {}), **fields}
    plain = {"width_mm": 20.0, "height_mm": 25.0, "source": "test", "layers": [layer]}
    found, wrong = validate(Gel, plain)
    return found, [f"{'.'.join(map(str, p.path))}: {p.message}" for p in wrong]


def layer(law: str) -> Layer:
    found, wrong = gel(law, **WRITTEN[law])
    assert found, wrong
    return found.layers[0]


def uniaxial(law: Law, stretch: float) -> tuple[float, float]:
    """Axial first Piola stress [MPa] and the free lateral stretch of a bar."""
    gradients = np.array([[[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]])[None]
    cube = Elements(np.arange(4)[None], gradients, ONE, 0.0, ONE)

    def stress(lateral: float) -> Array:
        x = np.concatenate([np.zeros((1, 3)), np.diag([stretch, lateral, lateral])])
        return np.diag(Elastic(cube, law).evaluate(x).stress[0, 0])

    lateral = brentq(lambda b: stress(b)[1], 0.5 * stretch**-0.5, 1.5 * stretch**-0.5, xtol=1e-15)
    return float(stress(lateral)[0]), float(lateral)


def test_every_law_can_be_written():
    assert set(WRITTEN) == set(EXAMPLE_LAWS)
    for name, law in EXAMPLE_LAWS.items():
        assert type(layer(name).material()) is type(law)


@pytest.mark.parametrize("name", WRITTEN)
def test_a_bar_pulled_a_little_has_the_modulus_and_the_ratio_asked_for(name: str):
    law, e = layer(name).material(), 1e-5
    up, down = uniaxial(law, 1 + e), uniaxial(law, 1 - e)
    assert (up[0] - down[0]) / (2 * e) == pytest.approx(E, rel=1e-6)
    assert -(up[1] - down[1]) / (2 * e) == pytest.approx(NU, rel=1e-6)
    assert (law.mu, law.kappa) == pytest.approx((MU, KAPPA), rel=1e-12)


@pytest.mark.parametrize("stretch", [0.6, 1.8])
def test_a_bar_pulled_far_follows_the_incompressible_closed_form(stretch: float):
    """P = 2 (1 - s^-3)(s w1 + w2), Rivlin (1948); a large bulk modulus stands in for incompressible."""
    kappa, c10, c01, c20, c30 = 1e4, 0.03, 0.02, -0.002, 0.001
    y = stretch**2 + 2 / stretch - 3
    forms = {
        "neo_hooke": (MU / 2, 0.0, NeoHooke(MU, kappa)),
        "mooney_rivlin": (c10, c01, MooneyRivlin(c10, c01, kappa)),
        "yeoh": (c10 + 2 * c20 * y + 3 * c30 * y**2, 0.0, Yeoh(c10, c20, c30, kappa)),
        "stable_neo_hooke": (MU / 2, 0.0, StableNeoHooke(MU, kappa)),
    }
    for w1, w2, law in forms.values():
        expected = 2 * (1 - stretch**-3) * (stretch * w1 + w2)
        assert uniaxial(law, stretch)[0] == pytest.approx(expected, rel=1e-4)


def test_a_layer_that_names_no_law_is_neo_hookean():
    found, _ = gel(None, youngs_modulus_mpa=E, poissons_ratio=NU)
    assert found
    assert found.layers[0].law == "neo_hooke"
    assert found.layers[0].model_dump()["law"] == "neo_hooke"


def test_contact_stiffness_takes_youngs_modulus_at_rest():
    sensor, _ = read_sensor(SENSOR)
    for name in WRITTEN:
        found, _ = gel(name, **WRITTEN[name])
        changed: Sensor = sensor.model_copy(update={"gel": found})
        assert gel_of(changed).layers[0].youngs_modulus == pytest.approx(E, rel=1e-12)


@pytest.mark.parametrize(
    ("law", "fields", "says"),
    [
        ("hooke", {}, f"layers.0.law: must be one of {', '.join(WRITTEN)}"),
        ("yeoh", {"poissons_ratio": 0.4}, "layers.0.c10_mpa: is missing"),
        ("yeoh", {"c10_mpa": 0.1, "poissons_ratio": 0.5}, "layers.0.poissons_ratio: must be less than 0.5 (got 0.5)"),
        ("yeoh", {"c10_mpa": 0.1, "c20_mpa": -1.0, "poissons_ratio": 0.4}, "c20_mpa must be at least -sqrt(3 c10 c30)"),
        ("mooney_rivlin", {"c10_mpa": 0.1, "c01_mpa": 0.0}, "exactly one of poissons_ratio, bulk_modulus_mpa"),
        ("mooney_rivlin", {"c10_mpa": 0.1, "c01_mpa": 0, "poissons_ratio": 0.4, "bulk_modulus_mpa": 1},
         "exactly one of poissons_ratio, bulk_modulus_mpa"),
        (None, {"c10_mpa": 0.1, "poissons_ratio": 0.4, "youngs_modulus_mpa": 1}, "layers.0.c10_mpa: is a key of law: "),
        ("stable_neo_hooke", {"youngs_modulus_mpa": 1, "poisons_ratio": 0.4}, "did you mean poissons_ratio?"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_layer_is_reported(law: str | None, fields: dict[str, float], says: str):
    found, wrong = gel(law, **fields)
    assert found is None
    assert any(says in line for line in wrong), wrong
