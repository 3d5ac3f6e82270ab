"""The solved gel and its camera as outputs need them: what several outputs share, made for the first that asks.

A property imports its modules when it is computed. Labels and images share it, since images show the face that carries
the markers.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from tacgen.base.errors import UserError
from tacgen.mechanics import Problem, State
from tacgen.outputs import gel_surface
from tacgen.sensor.model import Sensor

if TYPE_CHECKING:
    from tacgen.mechanics.grasp_balance import Held
    from tacgen.mechanics.scene import Match, Scene
    from tacgen.optics.camera import PinholeCamera
    from tacgen.optics.material_flow import Flow
    from tacgen.optics.surface_grid import Sheet
    from tacgen.outputs.camera_maps import View
    from tacgen.outputs.cauchy_stress import Stress, Stresses
    from tacgen.outputs.contact_maps import Maps, Shares
    from tacgen.outputs.sensitivities import Sensitivities
    from tacgen.render.pictures import Pictures, Shot

Array = np.ndarray
SHEET_MARGIN_MM = 1.0  # [mm] by which a sheet is larger than its first face asks
BOX_OUTWARD = np.array([-1, 1, -1, 1])
# least, most [mm] between the nodes on which height, normals, gap and the flow are drawn
SHEET_SPACING_RANGE_MM = 0.1, 0.2
SHEET_NODES_PER_EDGE = 3  # an edge of the mesh: with more of them labels are no nearer to those on a mesh of .22 mm


class _Faces(ABC):
    """A gel's faces as the camera sees them; each is drawn once, when it is first asked for."""

    touched: gel_surface.GelSurface  # the outer face of the coating, that indenters touch
    printed: gel_surface.GelSurface  # the one seen through the clear layers, with the markers on it; it may be the same

    @cached_property
    def outer(self) -> "View":
        """The touched face, behind each pixel."""
        return self.drawn(self.touched)

    @cached_property
    def seen(self) -> "View":
        """The face that is printed on, behind each pixel."""
        return self.outer if self.printed is self.touched else self.drawn(self.printed)

    @abstractmethod
    def drawn(self, surface: gel_surface.GelSurface) -> "View":
        """A face behind each pixel."""


class SceneData(_Faces):
    """The untouched gel and its camera as outputs need them, the same for all frames of a scene."""

    def __init__(
        self,
        sensor: Sensor,
        problem: Problem,
        pictures: "Callable[[gel_surface.GelSurface], Pictures]",
        *,
        asked: frozenset[str] = frozenset(),
        analytic: bool = False,
        deviations: Mapping[str, float] | None = None,
        again: "Scene | None" = None,
        known: Sequence[State] = (),
        match: "Match | None" = None,
    ) -> None:
        """Nothing is computed yet.

        Args:
            pictures: makes the camera from the face that it sees at rest. asked: names of outputs.
            analytic: whether markers move by formulas. deviations: standard deviations of the uncertain inputs.
            again: the scene, if it is to be solved on a coarser mesh too, for the error of the mesh.
            known: all states, if they are there before the first frame. match: what a table wants of the frames.
        """
        self.sensor, self.problem, self.asked, self.match = sensor, problem, asked, match
        self._pictures, self._analytic, self._deviations, self._again = pictures, analytic, deviations or {}, again
        self._known, self._ahead = known, dict[int, tuple[gel_surface.GelSurface, gel_surface.GelSurface]]()
        self._sheet: Sheet | None = None
        mesh, gel = problem.mesh, sensor.gel
        self.touched = gel_surface.GelSurface(mesh.points, mesh.facets["coated"])
        opaque = len(gel.clear_layers) < len(gel.layers)
        self.printed = gel_surface.seen(mesh, len(gel.clear_layers)).sharing(self.touched) if opaque else self.touched

    def drawn(self, surface: gel_surface.GelSurface) -> "View":
        """A face behind each pixel."""
        from tacgen.outputs.camera_maps import View, in_view

        return View(self.sheet(in_view(surface, self.camera)), surface, self.camera)

    @cached_property
    def camera(self) -> "PinholeCamera":
        """The sensor's pinhole behind its refracting layers."""
        from tacgen.optics.camera import PinholeCamera

        return PinholeCamera.from_sensor(self.sensor)

    def sheet(self, box: Array) -> "Sheet":
        """A grid over rest coordinates on which a face is drawn, at least over a box x0, x1, y0, y1 [mm].

        It is made anew, and with it all that belongs to its nodes, only when a face has moved out of the last.
        """
        from tacgen.optics.surface_grid import Sheet

        if self._sheet is None or (BOX_OUTWARD * (np.array(self._sheet.box) - box) < 0).any():
            spacing = float(np.clip(self.problem.edge / SHEET_NODES_PER_EDGE, *SHEET_SPACING_RANGE_MM))
            self._sheet = Sheet.over(self.sensor.gel, spacing, tuple(box + SHEET_MARGIN_MM * BOX_OUTWARD))
        return self._sheet

    @cached_property
    def markers(self) -> "tuple[Array, Callable[[FrameData], tuple[Array, Array]]]":
        """Pixels (n, 2) of the markers at rest; and from a frame their pixels (n, 2) and whether each is seen (n,)."""
        from tacgen.optics.coating import centers

        sensor = self.sensor
        if sensor.markers is None:
            raise UserError(f"outputs: the sensor {sensor.name} has no markers")
        rest, motion = centers(sensor.markers), sensor.markers.motion
        if self._analytic and motion is not None:
            from tacgen.outputs.fots_markers import FotsMarkers

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
        from tacgen.outputs.cauchy_stress import Stresses

        return Stresses(self.problem)

    @cached_property
    def sensitivities(self) -> "Sensitivities":
        """Derivatives of the frames with respect to the uncertain inputs."""
        from tacgen.outputs.sensitivities import Sensitivities

        return Sensitivities(self.problem, self._deviations, self.sensor.gel)

    @cached_property
    def coarser(self) -> "Iterator[FrameData] | None":
        """The frames of the scene on a coarser mesh, if its error is asked for."""
        if self._again is None:
            return None
        from tacgen.outputs.sensitivities import on_coarser_mesh

        problem, states = on_coarser_mesh(self._again)
        shared = SceneData(self.sensor, problem, self._pictures)
        return (FrameData(shared, state, None) for state in states)

    @cached_property
    def pictures(self) -> "Pictures":
        """The rendered camera."""
        return self._pictures(self.printed)

    def faces(self, state: State) -> tuple[gel_surface.GelSurface, gel_surface.GelSurface]:
        """The touched and the printed face in a solved state."""
        if state.index in self._ahead:
            return self._ahead.pop(state.index)
        touched = self.touched.pressed(self.problem, state)
        return touched, touched if self.printed is self.touched else self.printed.moved(state.x)

    def later(self, frame: int, most: int) -> dict[int, gel_surface.GelSurface]:
        """Printed faces of so many known states after a frame, at most, by their frames, which are given them later."""
        coming = [state for state in self._known if state.index > frame][:most]
        self._ahead = {state.index: self.faces(state) for state in coming}
        return {index: printed for index, (_, printed) in self._ahead.items()}


class FrameData(_Faces):
    """One solved state as outputs need it, and the one before."""

    def __init__(
        self, scene: SceneData, state: State, before: State | None, held: "tuple[Held, int] | None" = None
    ) -> None:
        """`held` is the grasp and the side of this finger, 0 left and 1 right, if there is one."""
        self.scene, self.state, self.before, self.held = scene, state, before, held
        self.touched, self.printed = scene.faces(state)

    def drawn(self, surface: gel_surface.GelSurface) -> "View":
        """A face behind each pixel."""
        return self.scene.drawn(surface)

    @cached_property
    def maps(self) -> "Maps":
        """Contact forces behind each pixel."""
        from tacgen.outputs.contact_maps import spread

        return spread(self.shares, self.state)

    @cached_property
    def shares(self) -> "Shares":
        """How contact forces are shared among the pixels."""
        from tacgen.outputs.contact_maps import Shares

        return Shares(self.scene.problem, self.touched, self.state, self.scene.camera)

    @cached_property
    def stress(self) -> "Stress":
        """Cauchy stress of elements and nodes."""
        return self.scene.stresses.at(self.state.x, self.scene.problem.stressed(self.state.internal))

    @cached_property
    def shot(self) -> "Shot":
        """The pictures."""
        return self.scene.pictures.shot(self.state.index, self.printed, partial(self.scene.later, self.state.index))
