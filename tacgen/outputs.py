"""Outputs that a recipe can ask for, by name: the datasets of the untouched sensor and those of each frame.

A new output is an entry in OUTPUTS, its datasets' rows in bundle/schema.py and its name in recipe/model.py. What
several outputs need is a property of SceneData or FrameData: computed, and its modules imported, when the first of them
asks for it. Labels and images stand in one table, because images show the face that carries the markers, and because
bundles hold their datasets in the table's order.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tacgen.errors import UserError
from tacgen.geometry.pose import Pose
from tacgen.labels import gel_surface
from tacgen.mechanics import Problem, State
from tacgen.mechanics.barrier import Contact
from tacgen.mechanics.tunnelling import overlap
from tacgen.recipe.row import Row

if TYPE_CHECKING:
    from tacgen.labels.camera_maps import View
    from tacgen.labels.contact_maps import Maps, Shares
    from tacgen.labels.stress import Stress, Stresses
    from tacgen.labels.uncertainty import Sensitivities
    from tacgen.mechanics.grasp_balance import Held
    from tacgen.optics.camera import PinholeCamera
    from tacgen.optics.material_flow import Flow
    from tacgen.optics.surface_grid import Sheet
    from tacgen.render.pictures import Pictures

Array = np.ndarray
Datasets = dict[str, Any]  # by their paths in the bundle
SHEET_MARGIN = 1.0  # [mm] by which a sheet is larger than its first face asks
OUTWARD = np.array([-1, 1, -1, 1])
SHEET_SPACING = 0.1, 0.2  # least, most [mm] between the nodes on which height, normals, gap and the flow are drawn
SHEET_NODES = 3  # an edge of the mesh: with more of them labels are no nearer to those on a mesh of .22 mm


class _Faces(ABC):
    """A gel's faces as the camera sees them; each is drawn once, when it is first asked for."""

    touched: gel_surface.Surface  # the outer face of the coating, that indenters touch
    printed: gel_surface.Surface  # the one seen through the clear layers, with the markers on it; it may be the same

    @cached_property
    def outer(self) -> "View":
        """The touched face, behind each pixel."""
        return self.drawn(self.touched)

    @cached_property
    def seen(self) -> "View":
        """The face that is printed on, behind each pixel."""
        return self.outer if self.printed is self.touched else self.drawn(self.printed)

    @abstractmethod
    def drawn(self, surface: gel_surface.Surface) -> "View":
        """A face behind each pixel."""


class SceneData(_Faces):
    """The untouched gel and its camera as outputs need them, the same for all frames of a scene."""

    def __init__(self, row: Row, problem: Problem) -> None:
        self.row, self.problem = row, problem
        self._sheet: Sheet | None = None
        mesh, gel = problem.mesh, row.sensor.gel
        self.touched = gel_surface.Surface(mesh.points, mesh.facets["coated"])
        opaque = len(gel.clear_layers) < len(gel.layers)
        self.printed = gel_surface.seen(mesh, len(gel.clear_layers)).sharing(self.touched) if opaque else self.touched

    def drawn(self, surface: gel_surface.Surface) -> "View":
        """A face behind each pixel."""
        from tacgen.labels.camera_maps import View, in_view

        return View(self.sheet(in_view(surface, self.camera)), surface, self.camera)

    @cached_property
    def camera(self) -> "PinholeCamera":
        """The sensor's pinhole behind its refracting layers."""
        from tacgen.optics.camera import PinholeCamera

        return PinholeCamera.from_sensor(self.row.sensor)

    def sheet(self, box: Array) -> "Sheet":
        """A grid over rest coordinates on which a face is drawn, at least over a box x0, x1, y0, y1 [mm].

        It is made anew, and with it all that belongs to its nodes, only when a face has moved out of the last.
        """
        from tacgen.optics.surface_grid import Sheet

        if self._sheet is None or (OUTWARD * (np.array(self._sheet.box) - box) < 0).any():
            spacing = float(np.clip(self.problem.edge / SHEET_NODES, *SHEET_SPACING))
            self._sheet = Sheet.over(self.row.sensor.gel, spacing, tuple(box + SHEET_MARGIN * OUTWARD))
        return self._sheet

    @cached_property
    def markers(self) -> "tuple[Array, Callable[[FrameData], tuple[Array, Array]]]":
        """Pixels (n, 2) of the markers at rest; and from a frame their pixels (n, 2) and whether each is seen (n,)."""
        from tacgen.optics.coating import centers

        sensor = self.row.sensor
        if sensor.markers is None:
            raise UserError(f"outputs: the sensor {sensor.name} has no markers")
        rest, motion = centers(sensor.markers), sensor.markers.motion
        if self.row.recipe.markers.method == "analytic" and motion is not None:
            from tacgen.labels.fots_markers import FotsMarkers

            fots = FotsMarkers(motion, rest, sensor.gel, self.problem.contact.shape, self.camera)
            return fots.undisturbed, lambda frame: fots.at(frame.state.pose)
        from tacgen.optics.material_flow import MaterialPoints

        points = MaterialPoints(rest, self.printed, self.camera)
        if np.isnan(points.undisturbed).any():
            raise UserError(f"outputs: some markers of {sensor.name} lie beside the gel's face: fewer, or closer ones")
        return points.undisturbed, lambda frame: points.at(frame.seen)

    @cached_property
    def flow(self) -> "Flow":
        """The coating's points behind the centres of the pixels."""
        from tacgen.optics.material_flow import Flow

        return Flow(self.seen)

    @cached_property
    def stresses(self) -> "Stresses":
        """Stress recovery on this mesh."""
        from tacgen.labels.stress import Stresses

        return Stresses(self.problem)

    @cached_property
    def sensitivities(self) -> "Sensitivities":
        """Derivatives of the frames with respect to the uncertain inputs."""
        from tacgen.labels.uncertainty import Sensitivities

        assert self.row.recipe.uncertainty is not None
        return Sensitivities(self.problem, self.row.recipe.uncertainty, self.row.sensor.gel)

    @cached_property
    def coarser(self) -> "Iterator[FrameData]":
        """The frames of the scene on a coarser mesh."""
        from tacgen.labels.uncertainty import on_coarser_mesh

        problem, states = on_coarser_mesh(self.row)
        shared = SceneData(self.row, problem)
        return (FrameData(shared, state, None) for state in states)

    @cached_property
    def pictures(self) -> "Pictures":
        """The rendered camera."""
        from tacgen.render.pictures import Pictures

        return Pictures(self.row, self.printed)


class FrameData(_Faces):
    """One solved state as outputs need it, and the one before."""

    def __init__(self, scene: SceneData, state: State, before: State | None) -> None:
        self.scene, self.state, self.before = scene, state, before
        self.touched = scene.touched.pressed(scene.problem, state)
        self.printed = self.touched if scene.printed is scene.touched else scene.printed.moved(state.x)

    def drawn(self, surface: gel_surface.Surface) -> "View":
        """A face behind each pixel."""
        return self.scene.drawn(surface)

    @cached_property
    def maps(self) -> "Maps":
        """Contact forces behind each pixel."""
        from tacgen.labels.contact_maps import spread

        return spread(self.shares, self.state)

    @cached_property
    def shares(self) -> "Shares":
        """How contact forces are shared among the pixels."""
        from tacgen.labels.contact_maps import Shares

        return Shares(self.scene.problem, self.touched, self.state, self.scene.camera)

    @cached_property
    def stress(self) -> "Stress":
        """Cauchy stress of elements and nodes."""
        return self.scene.stresses.at(self.state.x, self.scene.problem.stressed(self.state.internal))

    @cached_property
    def radiance(self) -> Array:
        """Linear light (H, W, 3)."""
        return self.scene.pictures.radiance(self.printed)


def _force(frame: FrameData) -> Datasets:
    problem, state = frame.scene.problem, frame.state
    force, torque = gel_surface.wrench(problem, state)
    contact = problem.contact.moved(Pose.of(state.pose), state.offset)
    return {
        "/frames/pose": state.pose,
        "/frames/force": force,
        "/frames/torque": torque,
        "/frames/quality/newton_iterations": state.iterations,
        "/frames/quality/damped_steps": state.damped,
        "/frames/quality/substeps": state.substeps,
        "/frames/quality/min_gap_mm": state.min_gap,
        "/frames/quality/mean_gap_mm": state.mean_gap,
        "/frames/quality/overlap_mm": overlap(contact if isinstance(contact, Contact) else contact.distance, state.x),
        "/frames/quality/rounded": state.rounded,
        "/frames/quality/force_balance": state.balance,
        "/frames/quality/residual": state.residual,
        "/frames/quality/least_jacobian": state.least_J,
    }


def of_grasp(held: "Held", side: int) -> Datasets:
    """Datasets of the whole grasp in a finger's bundle; side 0 is left, 1 right."""
    return {
        "/frames/grasp/object": held.pose,
        "/frames/grasp/sensor": held.sensors[side],
        "/frames/grasp/width_mm": held.width,
        "/frames/grasp/mode": held.mode,
        "/frames/grasp/unborne": held.unborne,
        "/frames/grasp/balance": held.balance,
    }


def _traction(frame: FrameData) -> Datasets:
    from tacgen.labels.contact_maps import resultant_errors

    out = {f"/frames/{name}": getattr(frame.maps, name) for name in ("pressure", "traction", "contact")}
    errors = resultant_errors(frame.shares, frame.touched, frame.state, frame.maps)
    out |= {f"/frames/quality/{name}_resultant": value for name, value in errors.items()}
    out["/frames/quality/unseen_force"] = frame.maps.unseen
    slid = {f"/frames/{name}": getattr(frame.maps, name) for name in ("slip", "sliding")}
    return out if frame.state.sliding is None else out | slid


def _force_map(frame: FrameData) -> Datasets:
    from tacgen.labels.contact_maps import over_force

    missing = frame.maps.force.sum((0, 1)) - frame.state.traction_force.sum((0, 1))
    return {
        "/frames/force_map": frame.maps.force,
        "/frames/area": frame.maps.area,
        "/frames/quality/force_map_resultant": over_force(missing, frame.state),
        "/frames/quality/unseen_force": frame.maps.unseen,
    }


def _events(frame: FrameData) -> Datasets:
    from tacgen.labels.events import events

    found = events(frame.scene.problem, frame.state, frame.before, frame.maps)
    return {f"/frames/events/{name}": value for name, value in vars(found).items()}


def _markers(frame: FrameData) -> Datasets:
    undisturbed, at = frame.scene.markers
    pixels, shown = at(frame)
    return {"/frames/markers": pixels, "/frames/marker_flow": pixels - undisturbed, "/frames/marker_visible": shown}


def _stress(frame: FrameData) -> Datasets:
    state, stress = frame.state, frame.stress
    return {
        "/fields/displacement": state.x - frame.scene.problem.mesh.points,
        "/fields/cauchy_stress": stress.element,
        "/fields/nodal_stress": stress.node,
        **{f"/frames/quality/{name}": value for name, value in frame.scene.stresses.quality(stress, state).items()},
    }


def _surface_stress(frame: FrameData) -> Datasets:
    nodes = frame.scene.stresses.face.nodes
    return {
        "/fields/surface_displacement": (frame.state.x - frame.scene.problem.mesh.points)[nodes],
        "/fields/surface_stress": frame.stress.node[nodes],
    }


def _uncertainty(frame: FrameData) -> Datasets:
    """Standard deviations to first order, for independent errors of the inputs."""
    from tacgen.labels.contact_maps import densities
    from tacgen.labels.uncertainty import mesh_variance

    scene, out = frame.scene, {}
    names = ("pressure", "traction") if "traction" in scene.row.recipe.outputs else ()
    force = frame.state.traction_force.sum((0, 1))
    here = {name: getattr(frame.maps, name)[frame.shares.seen] for name in names}
    variance: dict[str, Any] = {name: np.zeros_like(value) for name, value in here.items()} | {"force": np.zeros(3)}
    for unsure in scene.sensitivities.at(frame.state):
        out[f"/frames/sensitivity/{unsure.name}"] = unsure.force
        variance["force"] += (unsure.deviation * unsure.force) ** 2
        there = densities(frame.shares, unsure.near) if names else {}
        for name in names:
            variance[name] += (unsure.deviation / unsure.step * (there[name] - here[name])) ** 2
    variance |= {name: frame.shares.picture(variance[name]) for name in names}
    if scene.sensitivities.asked.mesh:
        coarse, window = next(scene.coarser), round(2 * scene.problem.edge / scene.row.sensor.camera.mm_per_px)
        variance["force"] += mesh_variance(force, coarse.state.traction_force.sum((0, 1)), window)
        for key in names:
            variance[key] += mesh_variance(getattr(frame.maps, key), getattr(coarse.maps, key), max(window, 1))
    return out | {f"/frames/uncertainty/{key}": np.sqrt(value) for key, value in variance.items()}


def _mesh(scene: SceneData) -> Datasets:
    mesh = scene.problem.mesh
    patches = {f"/mesh/facets/{name}": facets for name, facets in mesh.facets.items()}
    return {"/mesh/points": mesh.points, "/mesh/cells": mesh.cells, "/mesh/layer": mesh.layer, **patches}


def _surface(scene: SceneData) -> Datasets:
    face, points = scene.problem.contact.faces.conn, scene.problem.mesh.points
    nodes = scene.stresses.face.nodes
    return {"/mesh/surface/points": points[nodes], "/mesh/surface/facets": np.searchsorted(nodes, face)}


class Output(NamedTuple):
    """One name that a recipe's `outputs` may hold."""

    frame: Callable[[FrameData], Datasets]  # of one frame, under /frames and /fields
    reference: Callable[[SceneData], Datasets] = lambda scene: {}  # once a scene, under /reference and /mesh


OUTPUTS = {
    "force": Output(_force),  # in every bundle
    "traction": Output(_traction),
    "events": Output(_events),
    "force_map": Output(_force_map),
    "height": Output(lambda f: {"/frames/height": f.outer.height()}, lambda s: {"/reference/height": s.outer.height()}),
    "normals": Output(
        lambda f: {"/frames/normals": f.outer.normals()}, lambda s: {"/reference/normals": s.outer.normals()}
    ),
    "gap": Output(lambda f: {"/frames/gap": f.outer.gap(f.scene.problem.contact.shape, f.state.pose)}),
    "markers": Output(_markers, lambda s: {"/reference/markers": s.markers[0]}),
    "flow": Output(lambda f: {"/frames/flow": f.scene.flow.at(f.seen)}),
    "material": Output(lambda f: {"/frames/material": f.seen.behind(f.seen.sheet.rest)}),
    "rgb": Output(
        lambda f: {"/frames/rgb": f.scene.pictures.developed(f.radiance, f.state.index)},
        lambda s: {"/reference/rgb": s.pictures.developed(s.pictures.flat)},
    ),
    "radiance": Output(lambda f: {"/frames/radiance": f.radiance}),
    "stress": Output(_stress, _mesh),
    "surface_stress": Output(_surface_stress, _surface),
    "uncertainty": Output(_uncertainty),  # where the recipe says how sure its inputs are
}
