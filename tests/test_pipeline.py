"""One scene down the line: only what is asked for, the same bytes twice, and nothing lost when it is killed."""

import gc
import json
import os
import re
import weakref
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.load_steps import watched
from helpers.program import ran
from scipy.special import ndtri
from threadpoolctl import threadpool_limits

from tacgen import mechanics, outputs
from tacgen.base.clock import Clock
from tacgen.base.errors import UserError
from tacgen.batch import pipeline
from tacgen.bundle import bundle
from tacgen.bundle.check import check
from tacgen.mechanics import cost_note, mesh
from tacgen.mechanics.condensation import Condensation
from tacgen.outputs import OUTPUT_NAMES
from tacgen.outputs.scene_data import FrameData, SceneData
from tacgen.recipe import assets, plan, scene_of_row
from tacgen.sensor.imperfections import NOISE_STREAM

ROOT = Path(__file__).parent.parent
RECIPE = """
tacgen: 1
name: small
sensor: gelsight_mini
indenter: {shape: sphere, radius_mm: 4.0}
trajectory:
  - press: {depth_mm: 0.4, frames: 2}
  - slide: {x_mm: 0.2, frames: 1}
contact: {friction: 0.4}
outputs: [force]
quality: {edge_mm: 1.0, dhat_mm: 0.1, spp: 4}
"""
SMALL_CAMERA = ("sensor.camera.width_px=64", "sensor.camera.height_px=48", "sensor.camera.mm_per_px=0.317")
FLAT = (
    "indenter={shape: box, size_x_mm: 60, size_y_mm: 60}",
    "trajectory=[{press: {depth_mm: 0.3, frames: 1}}]",
    "quality=draft",
)
EVERYTHING = f"outputs=[{', '.join(OUTPUT_NAMES)}]"


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(RECIPE)
    return path


def made(recipe: Path, folder: Path, *sets: str) -> bundle.Bundle:
    """The bundle of the recipe's only scene."""
    return bundle.read(pipeline.run_scene(plan.load(recipe, sets).rows[0], folder).path)


def test_threads_of_blas_change_no_byte(recipe: Path, tmp_path: Path) -> None:
    """OpenBLAS sums in another order on two threads; on one, as here, it waits, so the test needs no second core."""
    sets = ["quality=draft", "trajectory=[{press: {depth_mm: 0.4, frames: 1}}]"]
    program = f"""
from pathlib import Path
from tacgen.batch import pipeline
from tacgen.recipe import plan
pipeline.run_scene(plan.load(Path({str(recipe)!r}), {sets}).rows[0], Path({str(tmp_path / "two")!r}))
"""
    ran("-c", program, OPENBLAS_NUM_THREADS="2", OMP_NUM_THREADS="2")
    with threadpool_limits(1):
        one = made(recipe, tmp_path / "one", *sets).path
    assert one.read_bytes() == (tmp_path / "two" / "scene-00000.h5").read_bytes()


def test_force_alone_imports_no_renderer_and_images_of_a_clear_gel_no_mitsuba(recipe: Path, tmp_path: Path) -> None:
    """Nor is stress computed. Mitsuba need not be installed, and where it is it is not even asked what it can do."""
    program = f"""
import importlib.metadata, sys
from pathlib import Path
from tacgen.batch import pipeline
from tacgen.recipe import plan
row = plan.load(Path({str(recipe)!r})).rows[0]
print(pipeline.run_scene(row, Path({str(tmp_path)!r}) / "force").status)
ours = ("tacgen.render.images", "tacgen.outputs.contact_maps", "tacgen.outputs.cauchy_stress")
heavy = ("mitsuba", "drjit", "matplotlib", "trimesh", "pytetwild", *ours)
print([name for name in heavy if name in sys.modules])

sys.modules["mitsuba"] = sys.modules["drjit"] = None
known = importlib.metadata.version
def version(name):
    assert name not in ("mitsuba", "drjit"), name
    return known(name)
importlib.metadata.version = version
sets = ["outputs=[rgb]", "trajectory=[{{press: {{depth_mm: 0.3, frames: 1}}}}]", *{SMALL_CAMERA}]
row = plan.load(Path({str(recipe)!r}), sets).rows[0]
print(pipeline.run_scene(row, Path({str(tmp_path)!r}) / "images").status)
"""
    assert ran("-c", program).split("\n")[:3] == ["ok", "[]", "ok"]
    shapes = bundle.read(tmp_path / "force" / "scene-00000.h5").shapes
    assert "/frames/force" in shapes
    assert not [path for path in shapes if path.startswith(("/fields", "/mesh", "/reference"))]
    assert not {"/frames/rgb", "/frames/pressure", "/frames/markers", "/frames/height"} & shapes.keys()
    assert bundle.read(tmp_path / "images" / "scene-00000.h5").attrs["renderer"] == "transport"


@pytest.mark.parametrize(
    ("output", "datasets"),
    [
        ("traction", {f"/frames/{name}" for name in ("pressure", "traction", "contact", "slip", "sliding")}),
        ("force_map", {"/frames/force_map", "/frames/area"}),
        ("height", {"/frames/height", "/reference/height"}),
        ("normals", {"/frames/normals", "/reference/normals"}),
        ("gap", {"/frames/gap"}),
        ("markers", {"/frames/markers", "/frames/marker_flow", "/frames/marker_visible", "/reference/markers"}),
        ("flow", {"/frames/flow"}),
        ("material", {"/frames/material"}),
        ("radiance", {"/frames/radiance"}),
    ],
)
def test_an_output_brings_its_datasets_alone(recipe: Path, output: str, datasets: set[str], tmp_path: Path) -> None:
    shapes = made(recipe, tmp_path, f"outputs=[{output}]", *SMALL_CAMERA).shapes
    always = {p for p in shapes if p.startswith("/frames/quality/")}
    always |= {f"/frames/{name}" for name in ("pose", "segment", "force", "normal_force", "friction_force", "torque")}
    always |= set() if output in ("markers", "radiance") else {"/reference/x_mm", "/reference/y_mm"}  # of a map
    assert set(shapes) == datasets | always


def test_flow_carries_the_markers(recipe: Path, tmp_path: Path) -> None:
    """Half a millimetre of shear: the dense flow, read at a marker's reference, is the marker's own to 0.05 px."""
    from scipy.interpolate import RegularGridInterpolator

    sets = ["outputs=[markers, flow]", "trajectory[1].slide.x_mm=0.5", "contact.friction=1.0"]
    found = made(recipe, tmp_path / "out", *sets)
    flow, moved = found.frame("/frames/flow", 2), found.frame("/frames/marker_flow", 2)
    assert found.frame("/frames/marker_visible", 2).all()
    field = RegularGridInterpolator([np.arange(n) + 0.5 for n in flow.shape[:2]], flow)
    assert np.abs(field(found["/reference/markers"][:, ::-1]) - moved).max() < 0.05
    assert 4 < moved[:, 0].max() < 10  # .5 mm are 8 px; the slide drags the gel to the right
    assert moved[:, 0].argmax() == 31  # under the ball, in the middle
    assert check(tmp_path / "out") == []


def test_noise_is_the_frames_own_and_can_be_left_out(recipe: Path, tmp_path: Path) -> None:
    noisy, clean = (
        made(recipe, tmp_path / noise, "outputs=[rgb]", f"render.noise={noise}", *SMALL_CAMERA)
        for noise in ("true", "false")
    )
    grain = noisy["/frames/rgb"].astype(float) - clean["/frames/rgb"]
    assert (grain.std(axis=(1, 2)) > 0.8).all()
    assert (grain.std(axis=(1, 2)) < 4).all()
    assert abs(np.corrcoef(grain[0].ravel(), grain[1].ravel())[0, 1]) < 0.05  # each frame has its own
    untouched = noisy["/reference/rgb"].astype(float) - clean["/reference/rgb"]
    assert 0 < untouched.std() < 0.5 * grain.std()  # the mean of several frames
    random = np.random.default_rng(np.random.SeedSequence((noisy.attrs["seed"], 0, NOISE_STREAM)))
    height, width, _ = grain[0].shape
    first = ndtri((random.integers(0, 2**16, (height, 3 * width), np.uint16) + 0.5) / 2**16)
    assert np.corrcoef(grain[0].ravel(), first.ravel())[0, 1] > 0.8  # by seed and frame, not by order of work


def test_a_scene_leaves_nothing_and_has_the_same_bytes(
    recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference cycles would keep its arrays until Python's garbage collector runs, after some scenes of 50 MB each.
    The renderer stays, for the next scene of its sensor."""
    alive: list[weakref.ref[Any]] = []

    def remembered(kind: type, method: str) -> None:
        made = getattr(kind, method)

        def of(*args: Any, **kwargs: Any) -> Any:
            out = made(*args, **kwargs)
            alive.append(weakref.ref(args[0] if out is None else out))
            return out

        monkeypatch.setattr(kind, method, of if method == "__init__" else staticmethod(of))

    remembered(mechanics.Problem, "of")
    for kind in (SceneData, Condensation):
        remembered(kind, "__init__")
    gc.collect()
    gc.disable()
    try:
        one = pipeline.run_scene(plan.load(recipe, (EVERYTHING, *SMALL_CAMERA)).rows[0], tmp_path / "one")
        assert len(alive) >= 3
        assert [type(found()) for one in alive if (found := one)() is not None] == []
    finally:
        gc.enable()
    two = made(recipe, tmp_path / "two", EVERYTHING, *SMALL_CAMERA)
    assert two.attrs["status"] == "ok"
    assert two.path.read_bytes() == one.path.read_bytes()
    assert check(two.path) == []


def test_a_bundle_is_synced_around_its_naming(recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its times are not: without them nothing is lost, and a disk takes milliseconds for each."""
    calls: list[tuple[str, str]] = []

    def told(name: str, of: Any) -> None:
        real = getattr(os, name)

        def call(*args: Any) -> None:
            calls.append((name, Path(of(*args)).name))
            real(*args)

        monkeypatch.setattr(os, name, call)

    told("fsync", lambda handle: os.readlink(f"/proc/self/fd/{handle}"))
    told("replace", lambda old, new: new)
    pipeline.run_scene(plan.load(recipe).rows[0], tmp_path / "out")
    part, name = f"scene-00000.h5.tacgen-part-{os.getpid()}", "scene-00000.h5"
    bundled = [("fsync", part), ("replace", name), ("fsync", "out")]
    assert calls[-4:] == [*bundled, ("replace", "scene-00000.timing.json")]
    assert ("fsync", "out") not in calls[:-4]


def test_a_frame_without_solution_is_not_shipped(recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failure = mechanics.NotConverged(mechanics.Failure.singular)
    watched(monkeypatch, lambda now: failure if now.index == 2 else None)
    found = pipeline.run_scene(plan.load(recipe).rows[0], tmp_path / "out")
    assert (found.status, found.reason) == ("rejected", f"frame 3 of 3: {mechanics.Failure.singular}")
    kept = bundle.read(found.path)
    assert kept.frames == 2
    assert kept.attrs["status"] == "rejected"
    assert [f.level for f in check(found.path)] == ["rejected"]


@pytest.mark.parametrize("path", ["/frames/uncertainty/force", "/frames/height"])
def test_a_frame_with_a_label_that_is_not_finite_is_rejected(
    recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    """Here one that a float32 cannot hold, or nan where only a height may be nan."""
    usual, value = outputs.OUTPUTS["force"], np.array([1e300, np.nan, 0])

    def with_more(frame: FrameData) -> dict[str, Any]:
        bad = value if frame.state.index == 1 else np.zeros(3)
        return usual.frame(frame) | {path: np.full((2, 3), bad) if path.endswith("height") else bad}

    monkeypatch.setitem(outputs.OUTPUTS, "force", usual._replace(frame=with_more))
    found = pipeline.run_scene(plan.load(recipe, ["outputs=[force]"]).rows[0], tmp_path / "out")
    where = "(0, 0)" if path.endswith("height") else "(1,)"
    assert (found.status, found.reason) == ("rejected", f"frame 2 of 3: {path} is not finite at {where}")
    assert bundle.read(found.path).frames == 1
    assert [f.level for f in check(found.path)] == ["rejected"]


@pytest.mark.parametrize(("radius", "edge", "told"), [(4.0, 0.8, False), (2.0, 1.2, True)])
def test_an_unresolved_indenter_is_reported(
    recipe: Path, tmp_path: Path, radius: float, edge: float, told: bool
) -> None:
    """By the number that stands in the bundle."""
    events: list[dict[str, Any]] = []
    press = "trajectory=[{press: {depth_mm: 0.4, frames: 1}}]"
    sets = (f"indenter={{shape: sphere, radius_mm: {radius}}}", f"quality.edge_mm={edge}", press)
    (done,) = pipeline.run(plan.load(recipe, sets).rows, tmp_path / "out", on_event=events.append)
    found = bundle.read(done.path)
    notes = [event["note"] for event in events if event["event"] == "note"]
    percent = f"about {float(format(100 * found['/frames/quality/expected_force_error'].max(), '.1g')):g} %"
    assert [percent in note for note in notes] == [True] * told
    assert notes == json.loads(found.attrs.get("notes", "[]"))


def test_stages_of_a_scene_are_all_its_time(recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that goes on by 1 s each time it is read."""
    read = count()
    monkeypatch.setattr(Clock, "now", staticmethod(lambda: float(next(read))))
    clock = Clock()
    with clock.stage("outer"):
        for _ in range(2):
            with clock.stage("inner"):
                pass
    assert clock.seconds == {"inner": 2.0, "outer": 3.0}
    begin = next(read)
    (row,) = plan.load(recipe, ["quality.edge_mm=1.2", "outputs=[force]"]).rows
    seconds = pipeline.run_scene(row, tmp_path).seconds
    assert sum(seconds.values()) == pytest.approx(next(read) - begin - 3, abs=1e-3)  # before, between and after stages
    assert seconds.keys() >= {"start", "mesh", "solve", "fields", "bundle"}


def test_a_contact_of_thousands_of_unknowns_is_told_before_it_is_solved() -> None:
    flat = scene_of_row.build(plan.load(assets.recipe_path("quickstart"), FLAT).rows[0])
    said = r"contact has about 4500 unknowns, since 538 mm\^2 of the face .* 0.6 mm: a frame takes about \d\d s"
    assert re.match(said, cost_note.cost_note(flat, len(mesh.of(flat).facets["coated"])))
    way = "trajectory=[{press: {depth_mm: 1, frames: 1}}, {slide: {x_mm: 7, frames: 9}}]"
    sets = [way, "start.x_mm=-4", "quality={edge_mm: 0.2}"]
    ball = scene_of_row.build(plan.load(assets.recipe_path("quickstart"), sets).rows[0])
    assert 3 * len(mesh.touched(ball)) / mesh.FACE_POINTS_PER_EDGE**2 > cost_note.MANY_CONTACT_DOFS  # but not at once
    assert not cost_note.cost_note(ball, len(mesh.of(ball).facets["coated"]))


def test_a_scene_without_contact_is_ok_if_it_may_miss_alone(recipe: Path, tmp_path: Path) -> None:
    """As when metres are taken for mm: forces and maps are zero."""
    sets = ("start.clearance_mm=3", "trajectory=[{slide: {x_mm: 1, frames: 1}}]", "quality.edge_mm=1.2")
    said = "the indenter touches the gel in no frame: closest approach 3 mm"
    for may_miss, level in (("false", "rejected"), ("true", "note")):
        events: list[dict[str, Any]] = []
        rows = plan.load(recipe, (*sets, f"may_miss={may_miss}")).rows
        (done,) = pipeline.run(rows, tmp_path / may_miss, on_event=events.append)
        notes = [event["note"] for event in events if event["event"] == "note"]
        made = bundle.read(done.path)
        assert made.frames == 1
        assert json.loads(made.attrs.get("notes", "[]")) == notes
        (found,) = check(done.path)
        assert (found.level, found.message) == (level, done.reason or notes[0])
        assert found.message.startswith(said)
        assert ("may_miss: true" in found.message) == (level == "rejected")
        (kept,) = pipeline.run(rows, tmp_path / may_miss)
        assert (kept.status, kept.reason, kept.seconds) == (done.status, done.reason, {})


def test_markers_beside_the_face_are_refused(recipe: Path, tmp_path: Path) -> None:
    """As on a solid, of which the recipe's checks know the box alone."""
    row = plan.load(recipe, ["outputs=[markers]"]).rows[0]
    assert row.sensor.markers is not None
    wide = row.sensor.markers.model_copy(update={"columns": 15})
    row = replace(row, sensor=row.sensor.model_copy(update={"markers": wide}))
    with pytest.raises(UserError, match="some markers of gelsight_mini lie beside the gel's face"):
        pipeline.run_scene(row, tmp_path)


COMPILED = """
import sys
from pathlib import Path
from tacgen.base import array_cache, compiled
from tacgen.batch import pipeline
from tacgen.physics import runtime
from tacgen.recipe import plan

made = runtime._made
runtime._made = lambda module: print(module) or made(module)
(row,) = plan.load(Path(sys.argv[1])).rows
pipeline.run_scene(row, Path(sys.argv[2]))
"""


@pytest.mark.slow
def test_another_process_compiles_what_pictures_need(recipe: Path, tmp_path: Path) -> None:
    recipe.write_text(RECIPE.replace("[force]", "[force, traction, height, stress]"))
    code = tmp_path / "code"
    for number, compiles in enumerate((["tacgen.physics"], [])):
        said = ran("-c", COMPILED, recipe, tmp_path / f"out-{number}", TACGEN_CODE_DIR=str(code)).splitlines()
        assert [line for line in said if line.startswith("tacgen.")] == compiles
    assert {path.name.split("-")[0] for path in code.iterdir()} == {"tacgen.optics", "tacgen.physics"}
