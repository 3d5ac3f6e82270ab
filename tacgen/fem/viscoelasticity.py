"""Finite linear viscoelasticity: a Prony series on the isochoric stress, as an incremental potential.

    S = S_vol + J^-2/3 DEV[s + sum_i beta_i H_i],    dH_i/dt + H_i/tau_i = ds/dt,    s = DEV[2 dw/dCbar] = J^2/3 S_iso

with Cbar = J^-2/3 C, DEV[A] = A - (A : C) C^-1/3, and H_i 0 at rest: Simo (1987), "On a fully three-dimensional
finite-strain viscoelastic damage model"; Simo & Hughes (1998), "Computational Inelasticity", section 10.3. The elastic
law is the long-term one, and g_i is the share of the instantaneous shear modulus that relaxes with tau_i:

    G(t) = G_0 (1 - sum_i g_i (1 - exp(-t/tau_i))),    beta_i = g_i/(1 - sum_i g_i)

If s is linear in time over a step of h [s], the exact update is (Taylor, Pister & Goudreau 1970, "Thermomechanical
analysis of viscoelastic solids"; Simo & Hughes use the midpoint rule, exp(-r/2) for d)

    H_i <- exp(-r_i) H_i + d_i (s - s_start),    r_i = h/tau_i,    d_i = (1 - exp(-r_i))/r_i

For constant M, J^-2/3 DEV[M] = d(M : Cbar)/dC, and DEV[s] = s. So the stress at the end of a step is 2 dE/dC of an
energy that depends on the past only through the state at the start of the step:

    E = U(J) + (1 + sum_i beta_i d_i) w + M : Cbar / 2,    M = sum_i beta_i (exp(-r_i) H_i - d_i s_start)
"""

from dataclasses import dataclass, replace

import numpy as np

from tacgen.fem.elasticity import Elastic
from tacgen.fem.materials import Stiffened

Array = np.ndarray


@dataclass(frozen=True)
class Viscoelastic:
    """Elements of one isochoric law with the terms of a Prony series: beta (k,), tau (k,) [s]."""

    elastic: Elastic
    beta: Array
    tau: Array

    @classmethod
    def of(cls, elastic: Elastic, prony: tuple[tuple[float, float], ...]) -> "Viscoelastic":
        """`prony`: g and tau [s] of each term; the g add up to less than 1."""
        g, tau = np.array(prony).T
        return cls(elastic, g / (1 - g.sum()), tau)

    def rest(self) -> Array:
        """H (k, e, q, 3, 3) [MPa] of the untouched gel."""
        return np.zeros((len(self.tau), *self.elastic.elements.weights.shape, 3, 3))

    def step(self, H: Array, start: Array, h: float) -> Elastic:
        """The potential of a step of h [s] from positions `start` (n, 3), where the internal variables are H."""
        decay, d = self._factors(h)
        now = float(self.beta @ d)
        memory = np.tensordot(self.beta * decay, H, 1) - now * self._isochoric(start)
        return replace(self.elastic, law=Stiffened(self.elastic.law, 1 + now), memory=memory)

    def after(self, H: Array, start: Array, x: Array, h: float) -> Array:
        """H at x (n, 3), the end of that step."""
        decay, d = (factor[:, None, None, None, None] for factor in self._factors(h))
        return np.asarray(decay * H + d * (self._isochoric(x) - self._isochoric(start)))

    def relaxing(self, H: Array) -> Elastic:
        """The potential whose stress is that of the gel with internal variables H."""
        return replace(self.elastic, memory=np.tensordot(self.beta, H, 1))

    def _factors(self, h: float) -> tuple[Array, Array]:
        """exp(-r) and (1 - exp(-r))/r, each (k,)."""
        r = h / self.tau
        return np.exp(-r), -np.expm1(-r) / r

    def _isochoric(self, x: Array) -> Array:
        """s = J^2/3 F^-1 P (e, q, 3, 3) [MPa], where P is the isochoric stress."""
        F, J, P = self.elastic.isochoric(x)
        return np.asarray(J[..., None, None] ** (2 / 3) * np.linalg.solve(F, P))
