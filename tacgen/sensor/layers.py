"""The layers of a gel in a sensor file: each has a material law with its constants, and may scatter light."""

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from tacgen.sensor.base_model import NO_SOURCE, Index, NotNegative, Part, Positive, Shares, as_tuple, exactly_one

if TYPE_CHECKING:
    from tacgen.fem.materials import Law

Poisson = Annotated[float, Field(ge=0, lt=0.5)]
# The key that sets a layer's stiffness, and Young's modulus at rest [MPa]; 3 G where no Poisson's ratio is asked for.
Stiffness = tuple[str, float]


class Scattering(Part):
    """Homogeneous scattering in a layer, with the phase function of Henyey and Greenstein."""

    extinction_per_mm: Positive
    """Extinction coefficient: scattering plus absorption."""
    albedo: Shares
    """Single-scattering albedo: scattering over extinction."""
    forward: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    """Mean cosine g of the scattering angle."""
    source: str = NO_SOURCE


class LayerBase(Part):
    """The fields that every layer of gel has, whatever its material law."""

    name: str
    """Name of the layer."""
    thickness_mm: Positive
    """Thickness at the gel's highest point."""
    refractive_index: Index = 1.41
    """Refractive index of the layer."""
    scattering: Scattering | None = None
    """Clear if absent."""
    opaque: bool = False
    """If true, the coating is on the inner side of this layer."""
    source: str = NO_SOURCE

    @property
    def terms(self) -> tuple[tuple[float, float], ...]:
        """g and tau [s] of each term of the Prony series; empty if the layer is elastic."""
        return ()


def bulk_modulus(mu: float, nu: float) -> float:
    """Bulk modulus [MPa] from the shear modulus and Poisson's ratio."""
    return 2 * mu * (1 + nu) / (3 * (1 - 2 * nu))


class PronyTerm(Part):
    """One term of a Prony series: a share g of the instantaneous shear modulus that relaxes with time constant tau."""

    g: Annotated[float, Field(gt=0, lt=1)]
    """Share of the instantaneous shear modulus that relaxes."""
    tau_s: Positive
    """Time constant."""


def _some_left(value: tuple[PronyTerm, ...]) -> tuple[PronyTerm, ...]:
    if (total := sum(term.g for term in value)) >= 1:
        raise ValueError(f"must have g that add up to less than 1 (got {total:g}): nothing is left at rest; lower them")
    return value


Prony = Annotated[tuple[PronyTerm, ...], Field(min_length=1), BeforeValidator(as_tuple), AfterValidator(_some_left)]


class IsochoricLayer(LayerBase):
    """A law whose isochoric part is separate, so that it may be viscoelastic. The law's constants are the long-term
    ones; the instantaneous stiffness is larger by 1/(1 - sum of g)."""

    prony: Prony | None = None
    """A list of terms; elastic if absent."""

    @property
    def terms(self) -> tuple[tuple[float, float], ...]:
        return tuple((term.g, term.tau_s) for term in self.prony or ())


class NeoHookeLayer(IsochoricLayer):
    """Isochoric neo-Hookean; the default law."""

    law: Literal["neo_hooke"] = "neo_hooke"
    """The material law."""
    youngs_modulus_mpa: Positive
    """Young's modulus at rest."""
    poissons_ratio: Poisson
    """Poisson's ratio."""

    @property
    def stiffness(self) -> Stiffness:
        return "youngs_modulus_mpa", self.youngs_modulus_mpa

    def material(self) -> "Law":
        """The law with shear and bulk modulus from E and nu."""
        from tacgen.fem.materials import NeoHooke

        mu = self.youngs_modulus_mpa / (2 * (1 + self.poissons_ratio))
        return NeoHooke(mu, bulk_modulus(mu, self.poissons_ratio))


class StableNeoHookeLayer(LayerBase):
    """The stable neo-Hookean law of Smith et al. (2018), as in UIPC."""

    law: Literal["stable_neo_hooke"] = "stable_neo_hooke"
    """The material law."""
    youngs_modulus_mpa: Positive
    """Young's modulus."""
    poissons_ratio: Poisson
    """Poisson's ratio."""

    @property
    def stiffness(self) -> Stiffness:
        return "youngs_modulus_mpa", self.youngs_modulus_mpa

    def material(self) -> "Law":
        """The law with shear and bulk modulus from E and nu."""
        from tacgen.fem.materials import StableNeoHooke

        mu = self.youngs_modulus_mpa / (2 * (1 + self.poissons_ratio))
        return StableNeoHooke(mu, bulk_modulus(mu, self.poissons_ratio) + mu / 3)


class NearlyIncompressible(IsochoricLayer):
    """Compressibility, given by one of two numbers."""

    poissons_ratio: Poisson | None = None
    """This or `bulk_modulus_mpa`."""
    bulk_modulus_mpa: Positive | None = None
    """This or `poissons_ratio`."""

    _one = exactly_one("one", "poissons_ratio", "bulk_modulus_mpa")

    def kappa(self, mu: float) -> float:
        """Bulk modulus [MPa], at a shear modulus mu if it is not given."""
        return self.bulk_modulus_mpa or bulk_modulus(mu, self.poissons_ratio or 0.0)


class MooneyRivlinLayer(NearlyIncompressible):
    """Mooney-Rivlin: the shear modulus at rest is 2 (c10 + c01)."""

    law: Literal["mooney_rivlin"] = "mooney_rivlin"
    """The material law."""
    c10_mpa: Positive
    """Constant of I1 - 3."""
    c01_mpa: NotNegative
    """Constant of I2 - 3."""

    @property
    def stiffness(self) -> Stiffness:
        return "c10_mpa", 6 * (self.c10_mpa + self.c01_mpa)

    def material(self) -> "Law":
        """The law of these constants."""
        from tacgen.fem.materials import MooneyRivlin

        return MooneyRivlin(self.c10_mpa, self.c01_mpa, self.kappa(2 * (self.c10_mpa + self.c01_mpa)))


class YeohLayer(NearlyIncompressible):
    """Yeoh, of third order: the shear modulus at rest is 2 c10."""

    law: Literal["yeoh"] = "yeoh"
    """The material law."""
    c10_mpa: Positive
    """Constant of I1 - 3."""
    c20_mpa: float = 0.0
    """Constant of (I1 - 3)^2."""
    c30_mpa: NotNegative = 0.0
    """Constant of (I1 - 3)^3."""

    @model_validator(mode="after")
    def _stiff(self) -> Self:
        least = -((3 * self.c10_mpa * self.c30_mpa) ** 0.5)
        if self.c20_mpa < least:  # c10 + 2 c20 y + 3 c30 y^2 falls below zero at some stretch
            raise ValueError(
                f"c20_mpa must be at least -sqrt(3 c10 c30), {least:g} (got {self.c20_mpa:g}): softens to nothing"
            )
        return self

    @property
    def stiffness(self) -> Stiffness:
        return "c10_mpa", 6 * self.c10_mpa

    def material(self) -> "Law":
        """The law of these constants."""
        from tacgen.fem.materials import Yeoh

        return Yeoh(self.c10_mpa, self.c20_mpa, self.c30_mpa, self.kappa(2 * self.c10_mpa))


def _with_law(value: Any) -> Any:
    return {"law": "neo_hooke", **value} if isinstance(value, dict) else value


# Layers are listed from the bonded base outward to the coated face.
Layer = Annotated[
    NeoHookeLayer | StableNeoHookeLayer | MooneyRivlinLayer | YeohLayer,
    Field(discriminator="law"),
    BeforeValidator(_with_law),
]
