"""Parts that players of Newton share: the shape, how it is led, and time on a core or on a GPU."""

import time
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.referee.case import Array, Case, Pose
from benchmarks.referee.engines import in_metres
from benchmarks.referee.player import Answer
from benchmarks.referee.playing import Settings, answer, place, speed

MADE = ("newton",), ("newton", "warp-lang")  # imported, and installed
CUDA = "cuda:0"  # where alone it builds distance fields


def add_shape(builder: Any, case: Case, body: int, config: Any) -> None:
    """Add the shape [m]: a ball as such, others as meshes, with a distance field for hydroelastic contact."""
    import newton

    if case.shape == "ball":
        builder.add_shape_sphere(body, xform=((0, 0, 0.004), (0, 0, 0, 1)), radius=0.004, cfg=config)
        return
    mesh = newton.Mesh(in_metres(case).vertices, case.mesh().faces.ravel())
    if config.is_hydroelastic:
        mesh.build_sdf(
            device=CUDA, max_resolution=config.sdf_max_resolution, margin=config.sdf_padding,
            narrow_band_range=config.sdf_narrow_band_range,
        )  # fmt: skip
        usual = newton.ModelBuilder.ShapeConfig()  # the mesh brings its own
        names = ("sdf_max_resolution", "sdf_narrow_band_range", "sdf_padding")
        config = replace(config, **{name: getattr(usual, name) for name in names})
    builder.add_shape_mesh(body, mesh=mesh, cfg=config)


def lead(state: Any, before: Pose, pose: Pose, seconds: float) -> None:
    """Set place and speed of the shape, the one body."""
    state.body_q.assign(place(pose)[None, [0, 1, 2, 4, 5, 6, 3]].astype(np.float32))
    state.body_qd.assign(speed(before, pose, seconds)[None].astype(np.float32))


def clock(model: Any) -> float:
    """Seconds of a GPU's wall clock, which waits for it, or of a core."""
    import warp as wp

    wp.synchronize()
    return time.perf_counter() if model.device.is_cuda else time.process_time()


def said(model: Any, found: list[tuple[Array, Array]], start: float, case: Case, how: Settings) -> Answer:
    """The answer of points and forces since `start`."""
    return replace(answer(found, (clock(model) - start) / len(case.poses), how), on_gpu=model.device.is_cuda)
