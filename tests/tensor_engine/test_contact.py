"""Batched distances, barrier and friction: the CPU's to rounding for every indenter, sticking and sliding."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from helpers.small import patch, turn

from benchmarks import sharp
from tacgen.fem.elements import facet_areas
from tacgen.geometry import analytic_sdf as sdf
from tacgen.geometry import mesh_import
from tacgen.geometry.mesh_file import SolidMesh
from tacgen.geometry.pose import Pose
from tacgen.geometry.sdf_grid import Field
from tacgen.mechanics.barrier import Contact as OneContact
from tacgen.mechanics.coupled import CoupledContact
from tacgen.mechanics.tunnelling import blocked
from tacgen.physics.cores import ShapeNumber
from tacgen.tensor_engine.contact import Contacts
from tacgen.tensor_engine.shapes import Shapes

torch.set_num_threads(1)
Array = np.ndarray


def field(radius: float, cell: float, side: int = 14) -> Field:
    """The distance of a ball on a grid around its lowest point."""
    origin = np.array([-0.45 * side * cell, -0.5 * side * cell, -0.3 * side * cell])
    at = origin + cell * np.stack(np.meshgrid(*[np.arange(side + k) for k in range(3)], indexing="ij"), -1)
    away = np.linalg.norm(at - [0, 0, radius], axis=-1) - radius
    return Field.through(away, origin, cell, smallest_radius=radius, corners=np.eye(3))


def sharp_field(half_angle_deg: float = 40) -> Field:
    """A wedge of triangles whose edges are exact."""
    mesh = sharp.wedge(half_angle_deg, 2.4, 1.5)
    solid = SolidMesh("wedge", np.asarray(mesh.vertices), np.asarray(mesh.faces), np.zeros(len(mesh.faces), int))
    return mesh_import.field(mesh_import.placed(solid), cell=0.15, height=1.5, half=3.0, radius=0.05)


SHAPES: dict[str, sdf.Shape] = {
    "sphere": sdf.SphereSdf(1.0),
    "capsule": sdf.CapsuleSdf(0.8, 1.5),
    "torus": sdf.TorusSdf(1.0, 0.4),
    "cylinder": sdf.CylinderSdf(1.0, 0.2),
    "box": sdf.BoxSdf(1.6, 1.2, 0.15),
    "cone": sdf.ConeSdf(0.8, 0.3),
    "wedge": sdf.WedgeSdf(0.7, 0.2, 1.5),
    "grid": field(1.0, 0.15),
    "another grid": field(0.7, 0.2),
    "sharp wedge": sharp_field(),
    "another sharp wedge": sharp_field(50),
}


def test_all_shapes_are_tried() -> None:
    assert {int(shape.record.numbers[0, 0]) for shape in SHAPES.values()} == set(ShapeNumber)


@pytest.mark.parametrize("names", [[name] for name in SHAPES] + [list(SHAPES), ["grid", "another grid"]], ids=len)
def test_distances_are_those_of_the_cpu(names: list[str]) -> None:
    """At random points in and around the shapes, on their axes and edges, alone and mixed in a batch."""
    special = np.array(
        np.meshgrid(*[[-0.75, -0.4, 0.0, 0.4, 5.0]] * 2, [-5.0, 0.0, 0.2, 0.3, 0.4, 0.8, 1.0])
    ).T.reshape(-1, 3)
    p = np.concatenate([np.random.default_rng(2).uniform(-1.5, 1.5, (400, 3)), special])
    shapes = Shapes.of([SHAPES[name] for name in names], torch.float64, "cpu")
    found = shapes.values_at(torch.tensor(p).expand(len(names), -1, 3))
    for row, name in enumerate(names):
        assert (found[row].numpy() == SHAPES[name].value(p)).all(), name


def test_far_from_a_grid_points_that_are_no_numbers_stay_so() -> None:
    shapes = Shapes.of([SHAPES["grid"]], torch.float64, "cpu")
    d = shapes.values_at(torch.tensor([[[np.nan, 0.0, 0.0], [0.0, 0.0, 0.0]]], dtype=torch.float64))
    assert d.isnan().tolist() == [[True, False]]


class Case:
    """A bent patch under every shape, deep enough that some points overlap; each scene has numbers of its own."""

    def __init__(self, slide: float = 0.05, friction: bool = True) -> None:
        points, self.faces, _ = patch(6, 2.4)
        r = np.random.default_rng(4)
        self.one, self.x, anchors = [], [], []
        for k, shape in enumerate(SHAPES.values()):
            x = points + r.uniform(-0.05, 0.05, points.shape)
            R = turn(k) if isinstance(shape, sdf.SphereSdf) else Pose.of(np.eye(4)).rotation
            pose = Pose(R, np.array([0.02 * k, -0.03, -0.12]))
            if isinstance(shape, sdf.SphereSdf):
                pose = replace(pose, position=np.array([0, 0, 0.9]) - R @ [0, 0, 1.0])
            faces = replace(self.faces, areas=facet_areas(points * (1 + 0.1 * k), self.faces.conn)[0])
            contact = OneContact(faces, shape, pose, 0.08 + 0.005 * k, 0.3 + 0.1 * k, 0.02)
            anchor = faces.at(x) + r.uniform(-slide, slide, (*faces.areas.shape, 3))
            mu = 0.2 * (k % 3 + 1) if friction else 0.0
            self.one.append(CoupledContact(contact, mu, anchor, contact.dhat / 8))
            self.x.append(x)
            anchors.append(anchor)
        c = [one.contact for one in self.one]

        def tensor(parts: list[object]) -> object:
            return torch.tensor(np.array(parts), dtype=torch.float64)

        self.X = tensor(self.x)
        self.many = Contacts(
            Shapes.of(list(SHAPES.values()), torch.float64, "cpu"),
            torch.tensor(self.faces.conn).expand(len(SHAPES), -1, -1),
            tensor(self.faces.N), tensor([one.faces.areas for one in c]), tensor([one.pose.rotation for one in c]),
            tensor([one.pose.position for one in c]), tensor([one.dhat for one in c]),
            tensor([one.kappa for one in c]), tensor([one.offset for one in c]),
            tensor([one.friction for one in self.one]), tensor([one.eps for one in self.one]), tensor(anchors),
        )  # fmt: skip


def close(many: object, one: Array, relative: float = 1e-11) -> bool:
    return bool(np.abs(many.numpy() - one).max() <= relative * max(np.abs(one).max(), 1e-3))


@pytest.mark.parametrize(("slide", "friction"), [(0.05, True), (0.002, True), (0.05, False)],
                         ids=["sliding", "sticking", "frictionless"])  # fmt: skip
def test_forces_and_tangents_are_those_of_the_cpu(slide: float, friction: bool) -> None:
    case = Case(slide, friction)
    found = case.many.evaluate(case.X)
    lengths = []
    for row, (one, x) in enumerate(zip(case.one, case.x, strict=True)):
        alone = one.evaluate(x)
        touching = alone.N > 0
        assert touching.any()
        assert not touching.all()
        for name in ("gap", "normal", "N", "force", "tangent", "definite"):
            assert close(getattr(found, name)[row], getattr(alone, name)), (list(SHAPES)[row], name)
        assert float(found.mean_gap[row]) == pytest.approx(alone.mean_gap, rel=1e-11)
        tangential = np.linalg.norm(alone.force - alone.N[..., None] * alone.normal, axis=-1)[touching]
        lengths += list(tangential / np.maximum(one.friction * alone.N[touching], 1e-300)) if friction else []
    if friction:  # of the largest friction: 1 where points slide
        share = np.mean(np.array(lengths) > 0.999)
        assert share > 0.5 if slide > 0.01 else share < 0.1


def test_merits_are_those_of_the_cpu() -> None:
    case = Case()
    frozen, r = case.many.evaluate(case.X), np.random.default_rng(8)
    p = r.normal(size=case.X.shape) * 0.3
    merit = case.many.merits(case.X, torch.tensor(p), torch.full_like(case.X[:, :1, 0], 0.1), frozen)[:, 0]
    for row, (one, x) in enumerate(zip(case.one, case.x, strict=True)):
        alone = one.evaluate(x)
        assert float(merit[row]) == pytest.approx(one.merit(x + 0.1 * p[row], alone), rel=1e-11)


def test_tangents_are_slopes_of_the_forces() -> None:
    """Where no point overlaps: there the tangents omit the rotation of the normal. Exact edges end at a distance."""
    case, h = Case(), 1e-7
    many = case.many.shrunk(case.many.offset + 0.2)
    many = replace(many, dhat=many.dhat + 0.3)
    p = torch.tensor(np.random.default_rng(1).normal(size=case.X.shape))
    here = many.evaluate(case.X)
    slope = (many.evaluate(case.X + h * p).force - many.evaluate(case.X - h * p).force) / (2 * h)
    along = -(here.tangent @ many.points(p)[..., None]).squeeze(-1)
    smooth = ((here.gap > 0) & (here.N > 0))[..., None]
    assert int(smooth.sum()) > 200
    off = torch.where(smooth, (slope - along).abs(), 0.0)
    ends = (
        off[["sharp" not in name for name in SHAPES]] > 1e-4 * along.abs().max()
    ).sum()  # at edges of a shape, or of the range of the barrier
    assert int(ends) <= 6


def test_a_facet_that_does_not_exist_is_never_touched() -> None:
    case = Case()
    areas = case.many.areas.clone()
    touched = case.many.evaluate(case.X).N[0].sum(-1) > 0
    areas[0, touched] = 0.0
    found = replace(case.many, areas=areas).evaluate(case.X)
    assert float(found.total[0]) == 0
    assert float(found.total[1]) > 0
    assert not found.force[0].any()


@pytest.mark.parametrize(("drop", "reach", "many"), [(0.05, 0.5, 0), (0.6, 9.0, 1), (0.6, 0.7, 8)])
def test_points_that_pass_through(drop: float, reach: float, many: int) -> None:
    """Too deep, and out on the other side; in few parts and in many; beside a scene whose points are not near."""
    case = Case()
    contact, far = case.many, torch.tensor([0.1, 0.05, 0.4])
    old = replace(contact, position=contact.position + far, rotation=contact.rotation[:, [1, 0, 2]].contiguous())
    gap, x = old.gap(case.X), case.X + torch.tensor([0.1, 0.0, drop])
    gap[1] += 9.0
    reaches = torch.full((len(SHAPES),), reach, dtype=torch.float64)
    found = contact.blocked(case.X, x, old.rotation, old.position, gap, reaches)
    for k, (one, before) in enumerate(zip(case.one, case.x, strict=True)):
        known = replace(one.contact, shape=SimpleNamespace(record=one.contact.shape.record, reach=reach))
        was = Pose(old.rotation[k].numpy(), old.position[k].numpy())
        assert bool(found[k]) is blocked(known, was, before, gap[k].numpy(), x[k].numpy()), list(SHAPES)[k]
    assert found.sum() == many
