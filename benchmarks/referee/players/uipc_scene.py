"""The scene of libuipc's player [m]: the pad, and the shape as an affine body that follows a transform."""

from typing import Any

import numpy as np

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, POISSONS, YOUNGS_MPA, Array, Case, mesh_of
from benchmarks.referee.players.uipc_parts import tetrahedra
from benchmarks.referee.playing import Settings

STEP_S = 0.01  # libuipc's own time step [s]
CHORD_MM, HEAVY_KG = 0.01, 100.0  # between the shape and its facets; mass of the shape, which contact does not move
KAPPA_PA, STRENGTH = 1e8, 100.0  # of the shape, as in libuipc's examples: against its bending; of its constraint


def scene_of(case: Case, how: Settings, aim: Array) -> tuple[Any, Any]:
    """The scene, in which the shape goes each step to where `aim` (4, 4) then is, and the slot of the pad."""
    from uipc import builtin, view
    from uipc.core import Scene

    config = Scene.default_config()
    config["dt"], config["gravity"] = STEP_S, [[0.0], [0.0], [0.0]]
    config["contact"]["d_hat"], config["contact"]["eps_velocity"] = how["d_hat_mm"] / 1000, how["eps_velocity"]
    config["newton"]["velocity_tol"] = how["velocity_tol"]
    config["newton"]["semi_implicit"]["enable"] = how["semi_implicit"]
    scene = Scene(config)
    scene.contact_tabular().default_model(case.friction, how["resistance"])
    pad, _ = scene.objects().create("pad").geometries().create(_pad(how))
    thing = scene.objects().create("shape")
    slot, _ = thing.geometries().create(_shape(case, aim))

    def follow(_: Any) -> None:
        view(slot.geometry().instances().find(builtin.aim_transform))[0] = aim

    scene.animator().insert(thing, follow)
    return scene, pad


def _pad(how: Settings) -> Any:
    """The pad, whose base is fixed."""
    from uipc import builtin, view
    from uipc.constitution import ElasticModuli, StableNeoHookean
    from uipc.geometry import label_surface, tetmesh

    points, tets = tetrahedra(how["cell_mm"])
    mesh = tetmesh(points / 1000, tets)
    label_surface(mesh)
    moduli = ElasticModuli.youngs_poisson(how["young_factor"] * YOUNGS_MPA * 1e6, POISSONS)
    StableNeoHookean().apply_to(mesh, moduli, DENSITY_KG_M3)
    view(mesh.vertices().find(builtin.is_fixed))[:] = points[:, 2] < 1e-6 - PAD_MM[2]
    return mesh


def _shape(case: Case, place: Array) -> Any:
    """The shape, heavy, at a place (4, 4)."""
    from uipc import builtin, view
    from uipc.constitution import AffineBodyConstitution, SoftTransformConstraint
    from uipc.geometry import label_surface, trimesh

    solid = mesh_of(case.shape, CHORD_MM)
    mesh = trimesh(solid.vertices / 1000, solid.faces.astype(np.int32))
    label_surface(mesh)
    view(mesh.transforms())[0] = place
    AffineBodyConstitution().apply_to(mesh, KAPPA_PA, HEAVY_KG / solid.volume * 1e9)
    SoftTransformConstraint().apply_to(mesh, np.array([STRENGTH, STRENGTH]))
    view(mesh.instances().find(builtin.is_constrained))[0] = 1
    return mesh
