"""Parts that players of one engine share: MuJoCo's shapes and contacts, and Genesis's beginning."""

from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.referee.case import Array, Case

CAPSULES, LEAST_FRICTION = 32, 0.01  # of MuJoCo's ring; that Genesis takes


def begin_genesis() -> Any:
    """The package, on a core; it begins once a process."""
    import genesis as gs

    if not getattr(gs, "_initialized", False):
        gs.init(backend=gs.cpu, precision="64", logging_level="error", seed=0)
    return gs


def in_metres(case: Case) -> Any:
    """The case's mesh [m]."""
    mesh = case.mesh()
    mesh.vertices /= 1000
    return mesh


def add_shape(spec: Any, case: Case, mass_kg: float) -> Any:
    """Add the shape [m] as a free body: a mesh, unless a primitive is exact or a convex hull would fill it."""
    import mujoco

    body, kinds = spec.worldbody.add_body(), mujoco.mjtGeom
    body.add_freejoint(name="shape")
    if case.shape == "ball":
        body.add_geom(type=kinds.mjGEOM_SPHERE, size=(0.004, 0, 0), pos=(0, 0, 0.004))
    elif case.shape == "ring":
        turn = np.linspace(0, 2 * np.pi, CAPSULES + 1)
        at = np.stack([3 * np.cos(turn), 3 * np.sin(turn), np.full(len(turn), 0.8)], -1) / 1000
        for ends in pairwise(at):
            body.add_geom(type=kinds.mjGEOM_CAPSULE, size=(0.0008, 0, 0), fromto=np.ravel(ends))
    else:
        mesh = in_metres(case)
        spec.add_mesh(name="shape", uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel())
        body.add_geom(type=kinds.mjGEOM_MESH, meshname="shape")
    for geom in body.geoms if mass_kg else ():
        geom.mass = mass_kg / len(body.geoms)
    return body


def contacts_on(model: Any, data: Any) -> tuple[Array, Array]:
    """Points (n, 3) [mm] of contact and forces (n, 3) [N] there on what is not the shape."""
    import mujoco

    points, forces, shape = np.zeros((data.ncon, 3)), np.zeros((data.ncon, 3)), model.joint("shape").bodyid[0]
    for i, contact in enumerate(data.contact):
        local, second = np.zeros(6), contact.geom[1]  # on which the force acts; -1 if it is a flex
        mujoco.mj_contactForce(model, data, i, local)
        sign = -1 if second >= 0 and model.geom_bodyid[second] == shape else 1
        points[i], forces[i] = 1000 * contact.pos, sign * contact.frame.reshape(3, 3).T @ local[:3]
    return points, forces
