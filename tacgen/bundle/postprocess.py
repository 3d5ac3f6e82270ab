"""Quantities computed from a bundle's contents: wrenches, stress invariants, strain energy, stick and slip.

    bundle = read(path)
    von_mises(bundle["/fields/nodal_stress"])        # (N, n) [MPa]
    contact_state(bundle, 7) == SLIP                 # (h, w)
    wrench(bundle, bundle["/frames/pose"])           # (N, 6) [N, N mm] at the tool

Stresses (..., 6) [MPa] are in the bundle's order, xx yy zz yz xz xy; tension is positive.
"""

import numpy as np

from tacgen.bundle.bundle import Bundle
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import elements
from tacgen.fem.stress_recovery import VOIGT_INDEX, Recovery
from tacgen.outputs.contact_maps import tangents

Array = np.ndarray
FREE, EDGE, STICK, SLIP = range(4)  # of `contact_state`


def wrench(bundle: Bundle, pose: Array | None = None) -> Array:
    """Force [N] and torque [N mm] on the gel (N, 6), along the axes of a frame and about its origin.

    `pose` (4, 4) or (N, 4, 4) is the pose of that frame in the sensor frame; None: the sensor frame itself. At the tool
    it is `wrench(bundle, bundle["/frames/pose"])`; a force-torque sensor there would measure minus this.
    """
    force, torque = bundle["/frames/force"], bundle["/frames/torque"]
    pose = np.eye(4) if pose is None else np.asarray(pose)
    about = torque - np.cross(pose[..., :3, 3], force)
    return np.hstack([np.einsum("...ji,...j", pose[..., :3, :3], v) for v in (force, about)])


def map_force(bundle: Bundle, frame: int) -> Array:
    """Force (3,) [N] on the gel by its maps: the integral of traction - pressure n over the deformed face.

    Its error is about that in /frames/quality/pressure_resultant and traction_resultant. The sum of pressure x area is
    larger than the force: on faces that slope to different sides, vectors cancel and pressures do not.

    Raises:
        Missing: the scene lacks one of the outputs traction, force_map (for the area) and normals.
    """
    names = ("pressure", "traction", "area", "normals")
    pressure, traction, area, n = (bundle.frame(f"/frames/{name}", frame).astype(float) for name in names)
    x, y = tangents(n := np.nan_to_num(n))
    per_area = traction[..., :1] * x + traction[..., 1:] * y - pressure[..., None] * n
    return np.asarray((per_area * area[..., None]).sum((0, 1)))


def tensor(stress: Array) -> Array:
    """The symmetric tensors (..., 3, 3)."""
    full: Array = np.asarray(stress)[..., VOIGT_INDEX]
    return full


def principal(stress: Array) -> Array:
    """Principal stresses (..., 3), the largest first."""
    return np.asarray(np.linalg.eigvalsh(tensor(stress).astype(float))[..., ::-1])


def hydrostatic(stress: Array) -> Array:
    """Hydrostatic pressure (...), minus the mean normal stress: positive in compression."""
    return np.asarray(-np.asarray(stress)[..., :3].mean(-1))


def von_mises(stress: Array) -> Array:
    """Von Mises' equivalent stress (...), sqrt(3/2) of the deviator's norm."""
    xx, yy, zz, yz, xz, xy = np.moveaxis(np.asarray(stress, float), -1, 0)
    direct = ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2
    return np.asarray(np.sqrt(direct + 3 * (yz**2 + xz**2 + xy**2)))


def largest_shear(stress: Array) -> Array:
    """The largest shear stress on any plane (...), half the spread of the principal stresses."""
    s = principal(stress)
    return np.asarray((s[..., 0] - s[..., 2]) / 2)


def contact_state(bundle: Bundle, frame: int) -> Array:
    """FREE, EDGE, STICK or SLIP behind each pixel (h, w). EDGE: there is pressure, but at less than 40 % of the
    points around. Without friction all contact is SLIP."""
    contact = bundle.frame("/frames/contact", frame)
    slip = bundle.frame("/frames/slip", frame) if "/frames/slip" in bundle else contact
    state = np.where(bundle.frame("/frames/pressure", frame) > 0, EDGE, FREE)
    return np.where(contact, np.where(slip, SLIP, STICK), state).astype(np.uint8)


def stress_by_layer(bundle: Bundle, frame: int) -> tuple[Array, Array, Array]:
    """Nodal stress of every layer; /fields/nodal_stress has only that of a node's outermost layer.

    Returns:
        nodes (k,), their layers (k,) and stresses (k, 6) [MPa]: a node between two layers has a row for each.
    """
    recovery = Recovery.on(bundle["/mesh/points"], bundle["/mesh/cells"], bundle["/mesh/layer"])
    values = recovery.matrix @ bundle.frame("/fields/cauchy_stress", frame).astype(float)
    outer = np.zeros(len(bundle["/mesh/points"]), int)
    outer[recovery.node] = recovery.material  # the last row of a node belongs to its outermost layer
    last = outer[recovery.node] == recovery.material
    values[last] = bundle.frame("/fields/nodal_stress", frame)[recovery.node[last]]
    return recovery.node, recovery.material, values


def strain_energy(bundle: Bundle, frame: int) -> Array:
    """Strain energy (m,) [N mm] of each cell; of a viscoelastic layer the long-term part.

    Raises:
        UserError: the bundle does not hold its sensor.
    """
    sensor = bundle.sensor
    points, cells, layer = bundle["/mesh/points"], bundle["/mesh/cells"], bundle["/mesh/layer"]
    x = points + bundle.frame("/fields/displacement", frame)
    out = np.zeros(len(cells))
    for number, made_of in enumerate(sensor.gel.layers):
        here = layer == number
        out[here] = Elastic(elements(points, cells[here]), made_of.material()).energies(x)
    return out
