"""The scenes of a batch: what is fixed of each, the iterates of its solve as rows of tensors, and its course.

A scene has one slot. Kernels take the slots of all scenes that wait for them, read their rows and write new ones.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from tacgen.geometry.analytic_sdf import Shape
from tacgen.mechanics.course import Course
from tacgen.mechanics.options import SolverOptions
from tacgen.mechanics.problem import Problem
from tacgen.physics import facets
from tacgen.physics.runtime import launch
from tacgen.tensor_engine.condensed import Condensed
from tacgen.tensor_engine.contact import Contacts
from tacgen.tensor_engine.elements import HEX_SHAPE_VALUES, Hexes, Topology
from tacgen.tensor_engine.grids import Place
from tacgen.tensor_engine.indices import gathered, index_of, put
from tacgen.tensor_engine.inertia import ManyBodies
from tacgen.tensor_engine.inversion import FoldingBarriers
from tacgen.tensor_engine.reduction import PADDING_PLACE
from tacgen.tensor_engine.replay import Replays
from tacgen.tensor_engine.shapes import Shapes
from tacgen.tensor_engine.slot import Slot

Array = np.ndarray
FLOAT_TYPE = torch.float64
WIDE_SIZE_MULTIPLE = 48  # sizes of WIDE_ARRAYS are multiples of it
# nodes of the smallest class of contacts that are solved together; each is twice as large as the last
MIN_CLASS_NODES = 162
# Part of the patch's nodes for which there is room from the start: of 400 ordinary scenes' contacts, most are on less
# than half of them, the largest on 0.71. Room grows, and recordings are lost, where a contact is wider
INITIAL_NODE_SHARE = 0.75
KEPT_SIZE_MULTIPLE = 144  # unknowns on which contact acts, and others, come in multiples of it
INITIAL_KEPT_DOFS = 6 * KEPT_SIZE_MULTIPLE  # of them there is room for so many from the start: growing loses recordings
# of all unknowns of a contact, at most, have others room from the start; most scenes have half as many
INITIAL_OTHER_SHARE = 0.75
# rows as wide as the largest contact so far, of k unknowns: the Schur complements now and at rest, the load on them,
# and their reduction to a unknowns without e others (see reduction.Reduction)
WIDE_ARRAYS = {"S": "kk", "S_0": "kk", "load": "k", "active": "k", "wanted": "k", "G": "ee", "X": "ea", "K": "aa"}
WIDE_ARRAYS |= {"kept": "a", "lost": "e", "place": "k"}
# of all others it is 0
PADDING_VALUES = {"active": False, "wanted": False, "kept": -1, "lost": -1, "place": PADDING_PLACE}


class Sizes(NamedTuple):
    """Sizes of a call: condensed nodes of the scene with most of them, unknowns kept of that with most, others of that
    with most, and condensed nodes of that with fewest. Where work is recorded they are rounded, so that few occur."""

    nodes: int
    kept: int
    lost: int
    fewest: int

    @property
    def unknowns(self) -> int:
        """Unknowns of the condensed nodes."""
        return 3 * self.nodes


def room_for(patch: int) -> dict[str, int]:
    """Unknowns of a contact for which there is room from the start, on a patch of so many nodes: all of them, those
    kept and others; see WIDE_ARRAYS."""
    k = 3 * math.ceil(INITIAL_NODE_SHARE * patch)
    return {"k": k, "a": min(k, INITIAL_KEPT_DOFS), "e": math.ceil(INITIAL_OTHER_SHARE * k)}


def width_class(nodes: int) -> int:
    """The size of contacts with which one of so many nodes is solved."""
    return MIN_CLASS_NODES << max(0, (nodes - 1) // MIN_CLASS_NODES).bit_length()


class Tensors:
    """The rows of all scenes, by name: `tensors.x` is (B, n, 3). See `Batch.empty` for what there is."""

    def __init__(self, **parts: Tensor) -> None:
        vars(self).update(parts)

    def __getattr__(self, name: str) -> Tensor:
        raise AttributeError(name)

    def put(self, slots: Tensor, which: Tensor | None = None, **values: Tensor) -> None:
        """Write rows, of slots that are marked in `which` (s,) or of all, on a GPU in one launch."""
        put(slots, tuple(getattr(self, name) for name in values), tuple(values.values()), which)


@dataclass
class Batch:
    """Scenes on one numbering of nodes, cells and facets.

    X (B, n, 3) nodes at rest [mm]; exists (B, e); used (B, n) bool: nodes of cells that exist; free (n,) bool: nodes
    above the bonded base; N (q, 4) shape functions at a facet's points, areas (B, f, q) [mm^2]; (B,): dhat, eps, edge,
    reach [mm], friction; corners (q, 8): shape functions of a cell; patch (n,) bool: nodes to which `factors` can
    condense. hexes: as the load step has them; at_rest: with the laws alone.
    """

    topology: Topology
    options: SolverOptions
    factors: Condensed
    scenes: list[Slot]
    X: Tensor
    exists: Tensor
    used: Tensor
    free: Tensor
    hexes: Hexes
    at_rest: Hexes
    folding: FoldingBarriers
    shapes: Shapes
    N: Tensor
    corners: Tensor
    areas: Tensor
    dhat: Tensor
    eps: Tensor
    edge: Tensor
    reach: Tensor
    friction: Tensor
    patch: Tensor
    replays: Replays
    courses: dict[int, Course] = field(default_factory=dict)  # by slot, of the solves in hand
    t: Tensors = field(init=False)

    @classmethod
    def of(
        cls,
        problems: Sequence[Problem],
        places: Sequence[Place],
        topology: Topology,
        factors: Condensed,
        patch: Array,
        device: str = "cpu",
    ) -> Self:
        """Scenes before their first load step; patch (k,): node numbers.

        All have the same options and points in a facet; see `planning.lacks` for scenes that have no place in a batch.
        """
        B, e, f = len(problems), len(topology.conn), len(topology.facets)

        def number(values: object) -> Tensor:
            return torch.as_tensor(np.array(values), dtype=FLOAT_TYPE, device=device)

        contacts = [p.contact for p in problems]
        q = contacts[0].faces.areas.shape[1]
        exists, areas = np.zeros((B, e), bool), np.zeros((B, f, q))
        table, moduli, layer = np.zeros((B, e, 9)), np.ones((B, e)), np.zeros((B, e), int)
        table[..., 0] = table[..., 5] = 1.0  # any law for void cells
        for k, (problem, place) in enumerate(zip(problems, places, strict=True)):
            exists[k, place.cells], areas[k, place.facets] = True, contacts[k].faces.areas
            layer[k, place.cells] = problem.mesh.layer
            laws = [part.law.coefficients for part in problem.elastic]
            table[k, place.cells] = np.array(laws)[problem.mesh.layer]
            moduli[k, place.cells] = np.array([part.law.mu for part in problem.elastic])[problem.mesh.layer]
        nodes = number([place.points for place in places])
        there = torch.as_tensor(exists, device=device)
        hexes = at_rest = Hexes.on(topology, nodes, there, number(table))
        if problems[0].viscous:
            memory = hexes.weights.new_zeros(*hexes.weights.shape, 3, 3)
            hexes = replace(at_rest, laws=at_rest.laws.clone(), memory=memory)
        folding = FoldingBarriers.on(topology, nodes, hexes.weights.sum(-1), number(moduli))
        used, free = torch.zeros(nodes.shape[:2], dtype=torch.bool), torch.ones(topology.nodes, dtype=torch.bool)
        for k, (problem, place) in enumerate(zip(problems, places, strict=True)):
            used[k, place.nodes] = True
            free[place.nodes[np.unique(problem.mesh.facets["bonded"])]] = False
        can = torch.zeros(topology.nodes, dtype=torch.bool)
        can[patch] = True
        dhat = number([c.dhat for c in contacts])
        batch = cls(
            topology, problems[0].options, factors, [Slot(*each) for each in zip(problems, places, strict=True)],
            nodes, there, used.to(device), free.to(device), hexes, at_rest, folding,
            Shapes.of([c.shape for c in contacts], FLOAT_TYPE, device), number(contacts[0].faces.N),
            number(HEX_SHAPE_VALUES), number(areas), dhat,
            problems[0].options.slip * dhat, number([p.edge for p in problems]),
            number([c.shape.reach for c in contacts]), number([p.friction for p in problems]), can.to(device),
            Replays(nodes.device),
        )  # fmt: skip
        batch.t = batch.empty()
        if problems[0].viscous:
            vars(batch.t).update(layer=torch.as_tensor(layer, device=device))
        return batch

    def empty(self) -> Tensors:
        """The rows of all scenes: of the history (h_), the load step, Newton's method and the contact (c_)."""
        B, n, _ = self.X.shape
        _, f, q = self.areas.shape
        m, F = int(self.patch.sum()), self.hexes.weights.shape
        room = room_for(m if self.replays.on else 0)

        def zeros(*shape: int, dtype: torch.dtype = FLOAT_TYPE) -> Tensor:
            return torch.zeros((B, *shape), dtype=dtype, device=self.X.device)

        def index(*shape: int) -> Tensor:
            return zeros(*shape, dtype=torch.long)

        of_face = {"h_N": (f, q), "h_gap": (f, q), "h_anchor": (f, q, 3), "anchor": (f, q, 3)}
        of_face |= {"h_motion": (f, q, 3), "motion": (f, q, 3)}
        of_nodes = ["h_x", "h_error", "ahead", "first_order", "begins", "x", "stepped", "g", "y"]
        alone = ["h_offset", "h_kappa", "h_least", "offset", "kappa", "folds", "energy", "stepped_energy"]
        alone += ["c_offset", "c_length", "c_drift", "c_gap"]
        if terms := max((len(part.tau) for p in self.scenes for part in p.problem.viscous.values()), default=0):
            of_face |= {"h_internal": (terms, *F[1:], 3, 3), "h_isochoric": (*F[1:], 3, 3)}
        if self.inert:
            of_face |= {"inertial": (n, 1), "drag": (n, 1), "corners": (F[1], 8), "damper": (F[1], 24, 24)}
            of_face |= {"coasting": (n, 3), "h_velocity": (n, 3)}
        return Tensors(
            **{name: zeros(*shape) for name, shape in of_face.items()}, **{name: zeros(n, 3) for name in of_nodes},
            **{name: zeros() for name in alone},
            h_rotation=zeros(3, 3), h_position=zeros(3), rotation=zeros(3, 3), position=zeros(3),
            J=zeros(*F[1:]), taken=zeros(*F[1:], 3, 3), c_steps=index(), c_status=index(),
            own=index(), lost_count=index(), kept_count=index(),
            nodes=index(m) - 1, local=index(n) - 1, faces=index(f) - 1,
            c_x=zeros(m, 3), **{name: self._blank(name, B, [room[k] for k in axes]) for name,
            axes in WIDE_ARRAYS.items()},
        )  # fmt: skip

    def _blank(self, name: str, count: int, sizes: Sequence[int]) -> Tensor:
        """Rows of padding of one of WIDE_ARRAYS."""
        padding = PADDING_VALUES.get(name)  # tells the type, too
        dtype = None if padding is not None else FLOAT_TYPE if name == "load" else self.factors.dtype
        out = torch.full((count, *sizes), 0.0 if padding is None else padding, dtype=dtype, device=self.X.device)
        if name in ("S", "S_0", "K"):
            out.diagonal(dim1=1, dim2=2).fill_(1.0)
        return out

    def _widen(self, name: str, sizes: Sequence[int]) -> Tensor:
        """The rows of one of WIDE_ARRAYS, at least as wide as `sizes`."""
        store = getattr(self.t, name)
        if any(new > old for new, old in zip(sizes, store.shape[1:], strict=True)):
            most, each = 3 * self.t.nodes.shape[1], zip(sizes, store.shape[1:], strict=True)
            wider = [
                min(-(-int(1.3 * new) // WIDE_SIZE_MULTIPLE) * WIDE_SIZE_MULTIPLE, most) if new > old else old
                for new, old in each
            ]
            self.replays.forget()
            old, store = store, self._blank(name, len(store), wider)
            store[(slice(None), *map(slice, old.shape[1:]))] = old
            setattr(self.t, name, store)
        return store

    def sizes(self, rows: Sequence[int], reducing: bool = False) -> Sizes:
        """Sizes of a call, for which there is room afterwards; but for what it eliminates only if it is `reducing`."""
        each = [self.scenes[row] for row in rows]
        nodes, kept, fewest = (max(c.nodes for c in each), max(c.kept for c in each), min(c.nodes for c in each))
        lost = max(3 * c.nodes - c.kept for c in each)
        if self.replays.on:
            nodes = min(width_class(nodes), max(self.t.S.shape[1] // 3, nodes))
            kept, lost = (
                min(-(-count // KEPT_SIZE_MULTIPLE) * KEPT_SIZE_MULTIPLE, 3 * nodes) for count in (kept, lost)
            )
            fewest = 3 * fewest // KEPT_SIZE_MULTIPLE * KEPT_SIZE_MULTIPLE // 3
        room = {"k": 3 * nodes, "a": kept, "e": lost if reducing else 0}
        for name, axes in WIDE_ARRAYS.items():
            self._widen(name, [room[axis] for axis in axes])
        if self.factors.reserve(self.t.S.shape[1] // 3):
            self.replays.forget()
        return Sizes(nodes, kept, lost, fewest)

    def keep(self, s: Tensor, **parts: Tensor) -> None:
        """Write rows of WIDE_ARRAYS, which grow where they are too narrow and are padded where they are wider."""
        for name, value in parts.items():
            store = self._widen(name, value.shape[1:])
            row = self._blank(name, len(s), store.shape[1:])
            row[(slice(None), *map(slice, value.shape[1:]))] = value
            store[s] = row

    def wide(self, name: str, *sizes: int) -> Tensor:
        """All rows of one of WIDE_ARRAYS, as wide as `sizes`."""
        return self._widen(name, sizes)[(slice(None), *map(slice, sizes))]

    def read(self, name: str, s: Tensor, *sizes: int) -> Tensor:
        """Rows of one of WIDE_ARRAYS, as wide as `sizes`."""
        return self.wide(name, *sizes)[s]

    def indent(self, slot: int, shape: Shape) -> None:
        """Another indenter for one scene, in the place of the last where there is room."""
        old, new = self.shapes, self.shapes.replaced(slot, shape)
        if any(now.numel() > was.numel() for was, now in zip(old.record, new.record, strict=True)):
            values, lists = (torch.cat([part, torch.zeros_like(part)]) for part in new.record[1:])
            self.shapes = Shapes(new.table, values, lists, new.all)
            self.replays.forget()
            return
        for mine, other in zip(old.record, new.record, strict=True):
            mine[: len(other)].copy_(other)
        self.shapes = replace(old, all=new.all)

    @property
    def inert(self) -> bool:
        """Whether gels have inertia."""
        return self.scenes[0].problem.dynamics is not None

    def problem(self, row: int) -> Problem:
        """The discretised problem of a scene."""
        return self.scenes[row].problem

    def slots(self, rows: Sequence[int]) -> Tensor:
        """Numbers of slots as an index."""
        return index_of(rows, self.X.device)

    def end(self, s: Tensor) -> Tensor:
        """Motion of a node (s,) below which a step is small [mm]."""
        return self.options.step_tol * self.dhat[s]

    def barriers(self, s: Tensor) -> FoldingBarriers:
        """The barrier against inversion in scenes s, stiffened where cells came near to it."""
        return self.folding.stiffened(self.t.folds).rows(s)

    def energy(self, s: Tensor, x: Tensor) -> Tensor:
        """Energy (s,) of the bulk [N mm] at x (s, n, 3), inf if a cell is inverted."""
        energy, inertia = self.hexes.rows(s).energy(x) + self.barriers(s).energy(x), self.inertia(s)
        return energy if inertia is None else energy + inertia.value(x)

    def gradient(self, s: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
        """J (s, e, q), and the gradient of the energy (s, n, 3) [N]."""
        (J, out), inertia = self.elastic(s, x), self.inertia(s)
        return J, out if inertia is None else out + inertia.gradient(x)

    def elastic(self, s: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
        """J, and the gradient without inertia."""
        J, out = self.hexes.rows(s).gradient(x)
        return J, out + self.barriers(s).gradient(x)

    def inertia(self, s: Tensor) -> ManyBodies | None:
        """Inertia of the gels in their load steps; None: they have none."""
        if not self.inert:
            return None
        t, free = self.t, self.free[:, None]
        start, coasting, inertial, drag = gathered(s, t.h_x, t.coasting, t.inertial, t.drag)
        return ManyBodies(start, coasting, inertial, drag, t.damper, s, self.topology, free)

    def face(self, s: Tensor, offset: Tensor) -> Contacts:
        """Contact of the whole face at the pose of the load step."""
        conn, ends = (part.expand(len(s), -1, -1) for part in (self.topology.faces, self.topology.ends))
        areas, anchor = gathered(s, self.areas, self.t.anchor)
        return self._contacts(s, offset, conn, areas, anchor, ends)

    def near(self, s: Tensor, offset: Tensor, nodes: int) -> Contacts:
        """Contact of the facets that are condensed, fewer than so many nodes, with the numbers of these nodes."""
        t, areas = self.t, self.areas
        f, q = min(nodes, t.faces.shape[1]), areas.shape[2]
        conn = t.faces.new_empty(len(s), f, 4, dtype=torch.int32)
        ends = t.faces.new_full((len(s), nodes, 4), -1, dtype=torch.int32)
        area, anchor = areas.new_empty(len(s), f, q), areas.new_empty(len(s), f, q, 3)
        launch(
            facets.near, (len(s), f, max(q, 4)), s, t.faces, t.local, self.topology.facets, areas, t.anchor, conn, area,
            anchor, ends,
        )  # fmt: skip
        return self._contacts(s, offset, conn, area, anchor, ends)

    def _contacts(
        self, s: Tensor, offset: Tensor, conn: Tensor, areas: Tensor, anchor: Tensor, ends: Tensor
    ) -> Contacts:
        """Contact of facets of scenes s at the pose of the load step."""
        t, each = self.t, (self.shapes.table, self.t.rotation, self.t.position, self.dhat)
        table, rotation, position, dhat, kappa, friction, eps = gathered(s, *each, t.kappa, self.friction, self.eps)
        shapes = replace(self.shapes, table=table)
        return Contacts(
            shapes, conn, self.N, areas, rotation, position, dhat, kappa, offset, friction, eps, anchor, ends
        )

    def at_condensed(self, s: Tensor, x: Tensor, nodes: int) -> Tensor:
        """Rows (s, nodes, 3) of x (B, n, 3) at the condensed nodes of scenes s; 0 where padded."""
        out = x.new_empty(len(s), nodes, 3)
        launch(facets.at_condensed, out.shape[:2], s, x, self.t.nodes, out)
        return out
