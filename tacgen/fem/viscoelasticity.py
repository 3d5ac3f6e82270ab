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
from typing import Any

import numpy as np

from tacgen.fem.elasticity import Elastic
from tacgen.fem.materials import Stiffened

Array = np.ndarray


@dataclass(frozen=True)
class Step:
    """A step in time: beta, exp(-r) and d of each term, (..., k, e, 1, 1, 1), of NumPy or of PyTorch, as are H
    (..., k, e, q, 3, 3) and s (..., e, q, 3, 3) [MPa]; e may be 1."""

    beta: Any
    decay: Any
    d: Any

    @property
    def stiffening(self) -> Any:
        """Growth of w by the step, over w (..., e, 1, 1, 1) [-]."""
        return (self.beta * self.d).sum(-5)

    def memory(self, H: Any, start: Any) -> Any:
        """M, with H and s at the start."""
        return (self.beta * self.decay * H).sum(-5) - self.stiffening * start

    def after(self, H: Any, start: Any, end: Any) -> Any:
        """H at the end, with s at both."""
        return self.decay * H + self.d * (end - start)[..., None, :, :, :, :]


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
        step = self._step(h)
        law = Stiffened(self.elastic.law, 1 + float(step.stiffening.squeeze()))
        return replace(self.elastic, law=law, memory=step.memory(H, self.elastic.isochoric_stress(start)))

    def after(self, H: Array, start: Array, x: Array, h: float) -> Array:
        """H at x (n, 3), the end of that step."""
        s = self.elastic.isochoric_stress
        return np.asarray(self._step(h).after(H, s(start), s(x)))

    def relaxing(self, H: Array) -> Elastic:
        """The potential whose stress is that of the gel with internal variables H."""
        return replace(self.elastic, memory=np.tensordot(self.beta, H, 1))

    def factors(self, h: float) -> Array:
        """beta, exp(-r) and (1 - exp(-r))/r (3, k) of a step of h [s]."""
        r = h / self.tau
        return np.array([self.beta, np.exp(-r), -np.expm1(-r) / r])

    def _step(self, h: float) -> Step:
        return Step(*self.factors(h)[..., None, None, None, None])
