"""Standard deviations of force and maps to first order, for independent errors of the inputs."""

from typing import Any

from tacgen.outputs.base import Datasets, Entry, FrameData, Output, vector


def _frame(frame: FrameData) -> Datasets:
    import numpy as np

    from tacgen.outputs.contact_maps import densities
    from tacgen.outputs.sensitivities import mesh_variance

    scene, out = frame.scene, {}
    names = ("pressure", "traction") if "traction" in scene.asked else ()
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
    if scene.coarser is not None:
        coarse, window = next(scene.coarser), round(2 * scene.problem.edge / min(scene.sensor.camera.pixel_mm))
        variance["force"] += mesh_variance(force, coarse.state.traction_force.sum((0, 1)), window)
        for key in names:
            variance[key] += mesh_variance(getattr(frame.maps, key), getattr(coarse.maps, key), max(window, 1))
    return out | {f"/frames/uncertainty/{key}": np.sqrt(value) for key, value in variance.items()}


OUTPUT = Output(
    "with the block `uncertainty`: standard deviations of the force and of the maps of `traction`, change of the"
    " force by each input",
    {
        "/frames/sensitivity/modulus": vector("change of force by all moduli, over them"),
        "/frames/sensitivity/poissons_ratio": vector("change of force by Poisson's ratio"),
        "/frames/sensitivity/friction": vector("change of force by friction"),
        "/frames/sensitivity/depth": vector("change of force by depth", "N/mm"),
        "/frames/uncertainty/force": vector("standard deviation of the force"),
        "/frames/uncertainty/pressure": Entry("<f4", "N h w", "MPa", "standard deviation of the pressure"),
        "/frames/uncertainty/traction": Entry("<f4", "N h w 2", "MPa", "standard deviation of the traction"),
    },
    _frame,
)
