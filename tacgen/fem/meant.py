"""The J that the stiffness takes its pressure from: what a step was meant to give, not what it gave.

A gel that hardly changes its volume has a pressure of J - 1 times a large modulus. Positions that are right to first
order in a step have a J that is off to second: a pressure far off, and a stiffness that leads astray or is indefinite.
What the step gave to first order is right. So the stiffness takes that, as if pressure were an unknown of its own (the
mixed integration points of Magisano, Leonetti & Garcea 2017), and where positions were guessed, that of the last
answer. After a long step even that is far off where elements are strained most, and its stiffness may be indefinite
without need; `last` is there for such. Energy and gradient, which decide the answer, are the true ones; a stiffness
that is kept for several steps undoes a gradient with that pressure too (Elastic.unbalanced).
"""

import numpy as np

from tacgen.fem import assembly

Array = np.ndarray
MOST = 2.0  # times the true J, or less by as much


class Meant:
    """Of some elements: J (e, q), on the way from one answer to the next."""

    def __init__(self) -> None:
        self.last: Array | None = None  # that of the last answer; None before the first: the true one is taken
        self._J: Array | None = None  # that meant
        self._at: tuple[Array, Array] | None = None  # F (e, q, 3, 3) and true J where the last step led

    def hold(self, J: Array) -> None:
        """That of an answer holds until the first step from the positions guessed next."""
        self.last, self._J, self._at = J, J, None

    def step(self, F: Array, J: Array, taken: Array) -> None:
        """A step by the stiffness `taken` at some F (e, q, 3, 3) led to where F and the true J are these; the same
        again is none."""
        if self._J is None or (self._at is not None and self._at[0] is F):
            return
        if self._at is not None:
            self._J = assembly.carried(taken, *self._at, F)
        self._at = F, J

    def at(self, F: Array, J: Array) -> Array:
        """Where F and the true J are these."""
        if self._J is None or self._at is None or self._at[0] is not F:
            return J
        return np.asarray(np.clip(self._J, J / MOST, MOST * J))
