"""Signed distances of the indenters of many scenes: the analytic shapes, and distances on grids.

Formulas as in geometry.analytic_sdf and geometry.sdf_grid; points p (s, k, 3) in each indenter's own frame, and numbers
of the shapes (s, 1).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from tacgen.geometry import analytic_sdf as sdf
from tacgen.geometry.analytic_sdf import Shape
from tacgen.geometry.sdf_grid import Field
from tacgen.tensor_engine.products import outer

Distances = tuple[Tensor, Tensor, Tensor]
# the numbers of each analytic shape, in the order in which its function takes them
NUMBERS: dict[type, tuple[str, ...]] = {
    sdf.SphereSdf: ("radius",),
    sdf.CapsuleSdf: ("radius", "length"),
    sdf.TorusSdf: ("radius", "tube_radius"),
    sdf.CylinderSdf: ("radius", "fillet"),
    sdf.BoxSdf: ("size_x", "size_y", "fillet"),
    sdf.ConeSdf: ("half_angle", "tip_radius"),
    sdf.WedgeSdf: ("half_angle", "tip_radius", "length"),
}


class _Core(NamedTuple):
    closest: Tensor
    jacobian: Tensor
    depth: Tensor
    out: Tensor


def _vector(x: Tensor | float, y: Tensor | float, z: Tensor | float, like: Tensor) -> Tensor:
    """Vectors (s, k, 3) from components that are numbers or (s, k)."""
    return torch.stack(
        [v.expand_as(like) if isinstance(v, Tensor) else torch.full_like(like, v) for v in (x, y, z)], -1
    )


def _outer(a: Tensor) -> Tensor:
    return outer(a, a)


def _down(like: Tensor) -> Tensor:
    return _vector(0.0, 0.0, -1.0, like)


def _plain(closest: Tensor, jacobian: Tensor) -> _Core:
    """A core without interior."""
    return _Core(closest, jacobian, torch.zeros_like(closest[..., 0]), _down(closest[..., 0]))


def _grown(p: Tensor, core: _Core, radius: Tensor) -> Distances:
    """Distance, gradient and Hessian of a core offset by a radius (s, 1)."""
    v = p - core.closest
    length = torch.linalg.vector_norm(v, dim=-1)
    inside = (core.depth > 0) | (length < 1e-12)
    safe = torch.where(inside, 1.0, length)
    n = torch.where(inside[..., None], core.out, v / safe[..., None])
    H = (torch.eye(3, dtype=p.dtype, device=p.device) - core.jacobian - _outer(n)) / safe[..., None, None]
    return torch.where(inside, -core.depth, length) - radius, n, torch.where(inside[..., None, None], 0.0, H)


def _polar(p: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    rho = torch.hypot(p[..., 0], p[..., 1])
    on_axis = rho < 1e-12
    safe = torch.where(on_axis, 1.0, rho)
    c, s = torch.where(on_axis, 1.0, p[..., 0] / safe), torch.where(on_axis, 0.0, p[..., 1] / safe)
    return rho, _vector(c, s, 0.0, rho), _vector(-s, c, 0.0, rho)


def _inside_box(inside_by: list[Tensor], normals: list[Tensor]) -> tuple[Tensor, Tensor]:
    """Depth and direction out from distances inside each face and their normals."""
    depth, out = inside_by[0], normals[0]
    for other, normal in zip(inside_by[1:], normals[1:], strict=True):
        nearer = other < depth
        depth, out = torch.where(nearer, other, depth), torch.where(nearer[..., None], normal, out)
    return depth.clamp(min=0.0), out


def _sphere(p: Tensor, radius: Tensor) -> Distances:
    centre = _vector(0.0, 0.0, radius, p[..., 0])
    return _grown(p, _plain(centre, p.new_zeros(3, 3)), radius)


def _capsule(p: Tensor, radius: Tensor, length: Tensor) -> Distances:
    x, half = p[..., 0], length / 2
    jacobian = p.new_zeros(*x.shape, 3, 3)
    jacobian[..., 0, 0] = (x.abs() < half).to(p.dtype)
    return _grown(p, _plain(_vector(torch.clamp(x, -half, half), 0.0, radius, x), jacobian), radius)


def _torus(p: Tensor, radius: Tensor, tube: Tensor) -> Distances:
    rho, radial, azimuth = _polar(p)
    closest = radius[..., None] * radial + _vector(0.0, 0.0, tube, rho)
    jacobian = _outer(azimuth) * (radius / rho.clamp(min=1e-12))[..., None, None]
    return _grown(p, _plain(closest, jacobian), tube)


def _cylinder(p: Tensor, radius: Tensor, fillet: Tensor) -> Distances:
    (rho, radial, azimuth), z, rim = _polar(p), p[..., 2], radius - fillet
    closest = torch.minimum(rho, rim)[..., None] * radial + _vector(0.0, 0.0, torch.maximum(z, fillet), rho)
    jacobian = _outer(azimuth) * torch.where(rho > rim, rim / rho.clamp(min=1e-12), 1.0)[..., None, None]
    jacobian = jacobian + _outer(radial) * (rho < rim)[..., None, None]
    jacobian[..., 2, 2] += (z > fillet).to(p.dtype)
    return _grown(p, _Core(closest, jacobian, *_inside_box([z - fillet, rim - rho], [_down(z), radial])), fillet)


def _box(p: Tensor, size_x: Tensor, size_y: Tensor, fillet: Tensor) -> Distances:
    (x, y, z), hx, hy = p.unbind(-1), size_x / 2 - fillet, size_y / 2 - fillet
    closest = _vector(torch.clamp(x, -hx, hx), torch.clamp(y, -hy, hy), torch.maximum(z, fillet), z)
    jacobian = torch.diag_embed((closest == p).to(p.dtype))
    sides = [_vector(_sign(x), 0.0, 0.0, z), _vector(0.0, _sign(y), 0.0, z)]
    within = _inside_box([z - fillet, hx - x.abs(), hy - y.abs()], [_down(z), *sides])
    return _grown(p, _Core(closest, jacobian, *within), fillet)


def _sign(v: Tensor) -> Tensor:
    return torch.where(v >= 0, 1.0, -1.0).to(v.dtype)


def _cone(p: Tensor, half_angle: Tensor, tip: Tensor) -> Distances:
    (rho, radial, azimuth), s, c = _polar(p), torch.sin(half_angle), torch.cos(half_angle)
    z = p[..., 2] - tip
    along, outward = (rho * s + z * c).clamp(min=0.0), rho * c - z * s
    side = along > 0
    closest = (along * s)[..., None] * radial + _vector(0.0, 0.0, along * c + tip, rho)
    generator = radial * s[..., None] + _vector(0.0, 0.0, c, rho)
    turned = _outer(azimuth) * (along * s / rho.clamp(min=1e-12))[..., None, None]
    jacobian = torch.where(side[..., None, None], _outer(generator) + turned, 0.0)
    normal = torch.where(side[..., None], radial * c[..., None] - _vector(0.0, 0.0, s, rho), _down(rho))
    return _grown(p, _Core(closest, jacobian, torch.where(side & (outward < 0), -outward, 0.0), normal), tip)


def _wedge(p: Tensor, half_angle: Tensor, tip: Tensor, length: Tensor) -> Distances:
    x, y, z = p.unbind(-1)
    s, c, sign, up, half = torch.sin(half_angle), torch.cos(half_angle), _sign(x), z - tip, length / 2 - tip
    along, outward = (x.abs() * s + up * c).clamp(min=0.0), x.abs() * c - up * s
    within = (along > 0) & (outward < 0)
    closest = _vector(
        torch.where(within, x, sign * along * s), torch.clamp(y, -half, half),
        torch.where(within, z, along * c + tip), x,
    )  # fmt: skip
    jacobian = torch.where((along > 0)[..., None, None], _outer(_vector(sign * s, 0.0, c, x)), 0.0)
    flat = torch.diag(p.new_tensor([1.0, 0.0, 1.0]))
    jacobian = torch.where(within[..., None, None], flat, jacobian)
    jacobian[..., 1, 1] += (y.abs() < half).to(p.dtype)
    outs = [_vector(sign * c, 0.0, -s, x), _vector(0.0, _sign(y), 0.0, x)]
    box = _inside_box([torch.where(along > 0, -outward, -1.0), half - y.abs()], outs)
    return _grown(p, _Core(closest, jacobian, *box), tip)


FUNCTIONS: dict[type, Callable[..., Distances]] = {
    sdf.SphereSdf: _sphere, sdf.CapsuleSdf: _capsule, sdf.TorusSdf: _torus, sdf.CylinderSdf: _cylinder,
    sdf.BoxSdf: _box, sdf.ConeSdf: _cone, sdf.WedgeSdf: _wedge,
}  # fmt: skip


class _Grids(NamedTuple):
    """Splines of several fields one after the other: all coefficients (c,), where each field's begin and its numbers of
    nodes (s, 1), origins (s, 1, 3) and cells (s, 1) [mm]."""

    values: Tensor
    first: Tensor
    shape: tuple[Tensor, Tensor, Tensor]
    origin: Tensor
    cell: Tensor


def _weights(t: Tensor) -> Tensor:
    """B-spline weights (..., 3, 4) of the four nodes around a point at t in its cell: values, slopes, curvatures."""
    s = 1 - t
    value = [s**3 / 6, (4 - 6 * t**2 + 3 * t**3) / 6, (4 - 6 * s**2 + 3 * s**3) / 6, t**3 / 6]
    slope = [-(s**2) / 2, -2 * t + 1.5 * t**2, 2 * s - 1.5 * s**2, t**2 / 2]
    bend = [s, 3 * t - 2, 3 * s - 2, t]
    return torch.stack([torch.stack(row, -1) for row in (value, slope, bend)], -2)


def _spline(p: Tensor, grids: _Grids) -> Distances:
    at = (p - grids.origin) / grids.cell[..., None]
    shape = torch.stack(grids.shape, -1)
    inner = torch.minimum(at.nan_to_num(1.0).clamp(min=1.0), (shape - 2).to(p.dtype))
    away = (at - inner) * grids.cell[..., None]
    index = torch.minimum(inner.long(), shape - 3)
    wx, wy, wz = _weights(inner - index).unbind(-3)
    i, j, k = ((index[..., a, None] - 1 + torch.arange(4, device=p.device)) for a in range(3))
    _, ny, nz = grids.shape
    rows = (i[..., :, None] * ny[..., None, None] + j[..., None, :]) * nz[..., None, None]
    C = grids.values[grids.first[..., None, None, None] + rows[..., None] + k[..., None, None, :]]
    along = torch.einsum("...abe,...te,...ub,...va->...vut", C, wz, wy, wx)  # derivatives in x, y, z
    cell = grids.cell[..., None]
    d = along[..., 0, 0, 0]
    g = torch.stack([along[..., 1, 0, 0], along[..., 0, 1, 0], along[..., 0, 0, 1]], -1) / cell
    xx, yy, zz = along[..., 2, 0, 0], along[..., 0, 2, 0], along[..., 0, 0, 2]
    xy, xz, yz = along[..., 1, 1, 0], along[..., 1, 0, 1], along[..., 0, 1, 1]
    H = torch.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], -1).unflatten(-1, (3, 3)) / cell[..., None] ** 2
    outside = (away**2).sum(-1)
    far = outside != 0  # there a lower bound; not a number stays so
    reach = torch.sqrt(d * d + outside)
    beside = torch.where(away != 0, away, d[..., None] * g) / reach.clamp(min=1e-300)[..., None]
    g = torch.where((far & (d > 0))[..., None], beside, g)
    d = torch.where(torch.isnan(outside), torch.nan, torch.where(far & (d > 0), reach, d))
    return d, g, torch.where(far[..., None, None], 0.0, H)


KINDS = (*FUNCTIONS, Field)


def _of(kind: int, p: Tensor, table: Tensor, values: Tensor) -> Distances:
    """Indenters of one kind, with their rows of the table."""
    columns = table.T[..., None]
    if KINDS[kind] is Field:
        first, nx, ny, nz = columns[:4].long()
        return _spline(p, _Grids(values, first, (nx, ny, nz), table[:, None, 4:7], columns[7]))
    found: Distances = FUNCTIONS[KINDS[kind]](p, *columns[: len(NUMBERS[KINDS[kind]])])
    return found


def _grouped(p: Tensor, kinds: Tensor, table: Tensor, values: Tensor) -> Distances:
    """Signed distances, kind by kind."""
    d, g, H = p.new_empty(p.shape[:2]), torch.empty_like(p), p.new_empty(*p.shape, 3)
    for kind in kinds.unique().tolist():
        rows = torch.nonzero(kinds == kind).squeeze(1)
        d[rows], g[rows], H[rows] = _of(kind, p[rows], table[rows], values)
    return d, g, H


@dataclass(frozen=True)
class Shapes:
    """An indenter for each scene: its number (s,) in KINDS; a table (s, 8) of numbers: of analytic shapes
    those of NUMBERS, of fields where its coefficients begin, its nodes, origin and cell; and the coefficients of all
    fields one after the other. all: the shapes of a whole batch, empty for a part of one."""

    kinds: Tensor
    table: Tensor
    values: Tensor
    all: tuple[Shape, ...] = ()

    @classmethod
    def of(cls, shapes: Sequence[Shape], dtype: torch.dtype, device: str) -> "Shapes":
        """An indenter for each scene, all `known`; scenes with one field share it."""
        fields = {id(shape): shape for shape in shapes if isinstance(shape, Field)}
        parts, starts, count = [torch.zeros(0, dtype=dtype, device=device)], dict[int, int](), 0
        for key, field in fields.items():
            parts.append(_coefficients(field, dtype, device))
            starts[key], count = count, count + parts[-1].numel()
        rows = [_row(shape, starts.get(id(shape), 0)) for shape in shapes]
        kinds = torch.tensor([_kind(shape) for shape in shapes], device=device)
        return cls(kinds, torch.tensor(rows, dtype=dtype, device=device), torch.cat(parts), tuple(shapes))

    def rows(self, slots: Tensor) -> "Shapes":
        """Only some scenes."""
        return Shapes(self.kinds[slots], self.table[slots], self.values)

    def replaced(self, slot: int, shape: Shape) -> "Shapes":
        """With another indenter of one scene of a whole batch; fields that no scene has any more are dropped."""
        shapes = (*self.all[:slot], shape, *self.all[slot + 1 :])
        if isinstance(shape, Field) or isinstance(self.all[slot], Field):
            return Shapes.of(shapes, self.values.dtype, str(self.values.device))
        kinds, table = self.kinds.clone(), self.table.clone()
        kinds[slot], table[slot] = _kind(shape), table.new_tensor(_row(shape, 0))
        return Shapes(kinds, table, self.values, shapes)

    def values_at(self, p: Tensor) -> Tensor:
        """Signed distance [mm] (s, k) alone."""
        return self.distance(p)[0]

    def distance(self, p: Tensor) -> Distances:
        """Signed distance [mm] (s, k), its gradient (s, k, 3) and Hessian [1/mm] (s, k, 3, 3) at points p (s, k, 3)."""
        if not p.is_cuda:
            return _grouped(p, self.kinds, self.table, self.values)
        from tacgen.tensor_engine import gpu_distance

        return gpu_distance.distances(p, self.kinds, self.table, self.values)


def _kind(shape: Shape) -> int:
    return KINDS.index(type(shape)) if type(shape) in FUNCTIONS else len(FUNCTIONS)


def _row(shape: Shape, first: int) -> list[float]:
    """A row of Shapes.table; first: where a field's coefficients begin."""
    if isinstance(shape, Field):
        return [first, *shape.coefficients.shape, *(float(x) for x in shape.origin), shape.cell]
    numbers = [getattr(shape, name) for name in NUMBERS[type(shape)]]
    return numbers + [0.0] * (8 - len(numbers))


@cache
def _kept(dtype: torch.dtype, device: str) -> WeakKeyDictionary[Field, Tensor]:
    """Coefficients of the fields that are in use."""
    return WeakKeyDictionary()


def _coefficients(field: Field, dtype: torch.dtype, device: str) -> Tensor:
    """The coefficients of a field on a device, copied there once while the field is in use."""
    kept = _kept(dtype, device)
    if field not in kept:
        kept[field] = torch.as_tensor(field.coefficients, dtype=dtype).flatten().to(device)
    return kept[field]


def known(shape: Shape) -> bool:
    """Whether a shape has a function here."""
    return type(shape) in FUNCTIONS or isinstance(shape, Field)
