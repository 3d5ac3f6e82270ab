"""Every law in EXAMPLE_LAWS by existing: derivatives, stress, stiffness, projection."""

import numpy as np
import pytest
from helpers.small import dense, distorted, slope, turn, whole

from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import Elements, elements
from tacgen.fem.materials import EXAMPLE_LAWS, Law
from tacgen.fem.projection import Projection

Array = np.ndarray


@pytest.fixture(params=EXAMPLE_LAWS)
def law(request: pytest.FixtureRequest) -> Law:
    return EXAMPLE_LAWS[request.param]


@pytest.fixture
def strained(law: Law) -> tuple[Elastic, Array]:
    return hex_of(law)


def hex_of(law: Law) -> tuple[Elastic, Array]:
    """A distorted hex and a strained state of it, turned."""
    points, conn = distorted()
    stretched = points @ np.diag([1.3, 0.8, 1.1]) + np.random.default_rng(5).uniform(-0.1, 0.1, points.shape)
    return Elastic.on(whole(conn, 8), elements(points, conn), law), stretched @ turn(2).T


def simplex(law: Law) -> Elastic:
    """One linear tetrahedron whose corners 1..3 at x = F e_a have deformation gradient F and volume 1/6."""
    conn = np.arange(4, dtype=np.int32)[None]
    gradients = np.array([[[[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]]])
    elements = Elements(conn, gradients, np.array([[1 / 6]]), np.inf, np.full((1, 4), 0.25))
    return Elastic.on(whole(conn, 4), elements, law)


def material_tangent(law: Law, F: Array, projection: Projection = Projection.NONE) -> Array:
    """dP/dF (9, 9) as the kernels make it, index 3 J + i."""
    x = np.concatenate([np.zeros((1, 3)), F.T])
    return dense(simplex(law), x, whole(np.arange(4)[None], 4), projection)[3:, 3:] * 6


def gradients_away_from_rest() -> list[Array]:
    rng = np.random.default_rng(0)
    return [turn(k) @ np.diag(rng.uniform(0.4, 1.8, 3)) @ turn(k + 50) for k in range(12)]


def test_the_laws_differ() -> None:
    far = np.diag([1.6, 0.7, 1.0])
    energies = [simplex(law).value(np.concatenate([np.zeros((1, 3)), far])) for law in EXAMPLE_LAWS.values()]
    assert np.diff(sorted(energies)).min() > 1e-5


def test_moduli_at_rest(law: Law) -> None:
    """No stress at rest; shear and bulk moduli are the ones asked for."""
    x = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    assert simplex(law).value(x) == pytest.approx(0, abs=1e-15)
    assert simplex(law).gradient(x) == pytest.approx(np.zeros((4, 3)), abs=1e-15)
    D = material_tangent(law, np.eye(3)).reshape(3, 3, 3, 3)
    mu, kappa = law.mu, law.kappa
    assert (mu, kappa) == pytest.approx((0.05, 0.4))
    assert D[0, 1, 0, 1] == pytest.approx(mu, rel=1e-9)
    assert D[0, 0, 0, 0] == pytest.approx(kappa + 4 / 3 * mu, rel=1e-9)
    assert D[0, 0, 1, 1] == pytest.approx(kappa - 2 / 3 * mu, rel=1e-9)


def test_nodal_forces_are_the_slope_of_the_energy(strained: tuple[Elastic, Array]) -> None:
    potential, x = strained
    g = potential.gradient(x)
    assert np.abs(g).max() > 1e-3
    assert g.ravel() == pytest.approx(slope(potential.value, x, 1e-5), abs=1e-8 * np.abs(g).max())


def test_stiffness_is_the_slope_of_the_nodal_forces(strained: tuple[Elastic, Array]) -> None:
    potential, x = strained
    stiffness = dense(potential, x, whole(np.arange(8)[None], 8))
    size = np.abs(stiffness).max()
    assert size > 1e-2
    by_differences = slope(lambda y: potential.gradient(y).ravel(), x, 1e-5)
    assert stiffness == pytest.approx(by_differences, abs=1e-7 * size)


def test_inverted_has_infinite_energy(strained: tuple[Elastic, Array]) -> None:
    potential, x = strained
    assert np.isfinite(potential.value(x))
    assert potential.value(x * [1, 1, -1]) == np.inf
    assert potential.value(0 * x + x.mean(0)) == np.inf
    one = x.copy()
    one[6] = x[0] - (x[6] - x[0])  # a single corner pushed through the element
    assert potential.value(one) == np.inf


def test_rotating_the_body_rotates_its_forces(strained: tuple[Elastic, Array]) -> None:
    potential, x = strained
    R = turn(9)
    assert potential.value(x @ R.T) == pytest.approx(potential.value(x), rel=1e-12)
    g = potential.gradient(x)
    assert potential.gradient(x @ R.T) == pytest.approx(g @ R.T, abs=1e-12 * np.abs(g).max())
    assert g.sum(0) == pytest.approx(np.zeros(3), abs=1e-13)
    assert np.cross(x, g).sum(0) == pytest.approx(np.zeros(3), abs=1e-13)


def test_projection_clamps_the_eigenvalues_of_the_exact_tangent(law: Law) -> None:
    clamped = 0
    for F in gradients_away_from_rest():
        values, vectors = np.linalg.eigh(material_tangent(law, F))
        clamped += int((values < -1e-3 * values.max()).sum())
        expected = (vectors * np.maximum(values, 0)) @ vectors.T
        assert material_tangent(law, F, Projection.FULL) == pytest.approx(expected, abs=1e-9 * values.max())
    assert clamped >= 3


def test_the_tangent_near_rest_is_exact_with_projection_of_strained_elements(law: Law) -> None:
    for F, like in ((np.diag([1.02, 0.98, 0.99]), Projection.NONE), (np.diag([1.5, 0.6, 1.1]), Projection.FULL)):
        found = material_tangent(law, F, Projection.STRAINED)
        assert found == pytest.approx(material_tangent(law, F, like), abs=1e-14)


def test_projected_stiffness_of_a_hex_has_no_negative_eigenvalue(strained: tuple[Elastic, Array]) -> None:
    potential, x = strained
    pat = whole(np.arange(8)[None], 8)
    squeezed = x @ np.diag([1.5, 0.5, 0.9])
    ways = Projection.NONE, Projection.FULL
    exact, projected = (np.linalg.eigvalsh(dense(potential, squeezed, pat, way)) for way in ways)
    assert exact.min() < -1e-6
    assert projected.min() > -1e-10
    assert projected.max() > 1e-2


def test_cauchy_stress_gives_the_nodal_forces_back(strained: tuple[Elastic, Array]) -> None:
    """f_a = sum over points of sigma grad(N_a) dv, with gradients in the deformed body."""
    potential, x = strained
    sigma, volume = potential.cauchy(potential.evaluate(x))
    e = potential.elements
    F = potential.evaluate(x).F
    now = np.einsum("eqaJ,eqJi->eqai", e.gradients, np.linalg.inv(F))
    forces = np.einsum("eq,eqij,eqaj->eai", volume, sigma, now)[0]
    assert sigma == pytest.approx(sigma.swapaxes(-1, -2), abs=1e-15)
    assert forces == pytest.approx(potential.gradient(x), abs=1e-13)
    assert volume.sum() == pytest.approx((e.weights * np.linalg.det(F)).sum(), rel=1e-12)


def test_evaluation_has_no_memory() -> None:
    """Of one body asked for stiffnesses here and there, exact and projected: to the last bit those of a new one."""
    body, x = hex_of(EXAMPLE_LAWS["neo_hooke"])
    pat = whole(np.arange(8)[None], 8)
    near, far = x + 1e-6 * np.sin(3 * x), x + 0.05 * np.sin(3 * x)
    exact, strained, full = Projection
    for at, projection in ((x, exact), (near, exact), (far, exact), (far, full), (far, strained), (x, exact)):
        new, _ = hex_of(EXAMPLE_LAWS["neo_hooke"])
        assert (dense(body, at, pat, projection) == dense(new, at, pat, projection)).all()
        assert (body.gradient(at) == new.gradient(at)).all()
        assert body.value(at) == new.value(at)
    assert (dense(body, near, pat) != dense(body, x, pat)).any()
