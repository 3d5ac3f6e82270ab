"""Inertia of the gels of many scenes; see fem.inertia."""

from dataclasses import dataclass

from torch import Tensor

from tacgen.fem.inertia import Inertia
from tacgen.tensor_engine.elements import Topology
from tacgen.tensor_engine.products import slot_times


@dataclass(frozen=True)
class ManyBodies(Inertia):
    """Steps of scenes in `slots` (s,).

    damper (capacity, e, 24, 24): beta K/h of each cell; free (n, 1) bool: nodes that move.
    """

    damper: Tensor
    slots: Tensor
    topology: Topology
    free: Tensor

    def viscous_force(self, moved: Tensor) -> Tensor:
        corners = slot_times(self.damper, self.slots, moved[:, self.topology.conn].flatten(2))
        return self.topology.at_nodes(corners.unflatten(2, (8, 3))) * self.free
