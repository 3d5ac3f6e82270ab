"""Frames drawn together on a GPU, for which the CPU stands in here: the bundles are those of the CPU, byte for byte."""

import gc
import json
import sys
import weakref
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.small_recipe import PICTURE, PRESS
from helpers.tiny import sensor
from PIL import Image
from threadpoolctl import threadpool_limits

from tacgen import mechanics
from tacgen.batch import pipeline
from tacgen.batch.recorder import SceneWork
from tacgen.bundle.bundle import Bundle, read
from tacgen.mechanics import mesh
from tacgen.mechanics.solved_scene import SolvedScene
from tacgen.optics import camera_response, coat_texture
from tacgen.outputs.scene_data import SceneData
from tacgen.recipe import plan, scene_of_row
from tacgen.recipe.row import Row
from tacgen.render import pictures, tensor_drawing
from tacgen.render.images import Renderer

MOVES = "press: {depth_mm: 0.4, frames: 2}, slide: {x_mm: 0.2, frames: 1}"
DRIFT = "sensor.camera.drift={gain: 0.05, frames: 4, source: test}"
NAMED = "transport on a GPU at cuda:0, torch 0"


class Log(list[str]):
    """What a device is asked for, which has room for so many batches."""

    room = 9


class Light:
    """Radiance on a device."""

    def __init__(self, made: np.ndarray, log: Log) -> None:
        self.made, self.log = made, log

    def cpu(self) -> Any:
        self.log.append("fetched")
        return SimpleNamespace(numpy=lambda: self.made)


class Touched:
    """A face that knows its share of contact at the nodes alone."""

    def __init__(self, share: np.ndarray) -> None:
        self.share = share

    def at(self, xy: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def touched(self, xy: np.ndarray) -> np.ndarray:
        return self.share


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> Iterator[Log]:
    log = Log()

    class Drawing:
        """The CPU's light for the nodes of faces."""

        def __init__(
            self, direct: Any, glow: Any, stray: Any, texture: Any, device: str, glare: Any, relief: Any
        ) -> None:
            self.direct, self.glow, self.stray, self.texture, self.glare = direct, glow, stray, texture, glare
            self.relief = relief
            log.append(f"drawing at {device}")

        def radiance(self, nodes: np.ndarray, touched: np.ndarray) -> Light:
            log.append(f"radiance of {len(nodes)}")
            log.room -= 1
            if log.room < 0:
                raise RuntimeError("CUDA out of memory\nTried to allocate")
            made = []
            for each, share in zip(nodes, touched, strict=True):
                at = self.direct.view.look(Touched(share))
                at.nodes = each
                if self.relief is not None:
                    at.emboss(self.relief)
                seen = np.asarray(self.direct.seen(at, self.glow), np.float64)
                self.direct.view.add_even(seen, at, self.stray)
                if self.texture is not None:
                    factor = coat_texture.sampled(self.texture, self.direct.sheet.size, at.rest)
                    seen = seen * self.direct.view.picture(factor[:, None])
                seen = camera_response.blurred(seen, self.direct.sensor.camera).astype(np.float32)
                made.append(np.asarray(np.maximum(seen + self.glare, 0), np.float32))
            return Light(np.array(made), log)

        def developed(self, radiance: Light, random: Sequence[Any], gains: Sequence[Any]) -> np.ndarray:
            log.append(f"developed, {sum(each is not None for each in (*random, *gains))} noises and gains")
            eye, each = self.direct.sensor.camera, zip(radiance.made, random, gains, strict=True)
            return np.array([camera_response.develop(light, eye, *how) for light, *how in each])

    of_drawing, of_device = ModuleType("drawing"), ModuleType("device")
    of_drawing.Drawing = Drawing  # type: ignore[attr-defined]
    of_device.shared = lambda device: log.append(f"{device} shared")  # type: ignore[attr-defined]
    of_device.named = lambda device: f"a GPU at {device}, torch 0"  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "tacgen.tensor_optics.drawing", of_drawing)
    monkeypatch.setitem(sys.modules, "tacgen.tensor_engine.device", of_device)
    kept = tensor_drawing.drawing, pictures._rendering
    for each in kept:
        each.cache_clear()
    yield log
    for each in kept:
        each.cache_clear()


@pytest.fixture(scope="module")
def solution(tmp_path_factory: pytest.TempPathFactory) -> SolvedScene:
    scene = scene_of_row.build(row(tmp_path_factory.mktemp("solved"), "outputs=[force]"))
    problem = mechanics.Problem.of(scene, mesh.of(scene))
    mechanics.warm()  # a limit does not reach a BLAS that is loaded later
    with threadpool_limits(1, user_api="blas"):
        return SolvedScene("an engine", list(mechanics.states(scene, problem)))


def row(folder: Path, *sets: str) -> Row:
    path = folder / "small.yaml"
    path.write_text(PICTURE.replace(PRESS, MOVES))
    return plan.load(path, sets).rows[0]


def made(one: Row, folder: Path, solution: SolvedScene, device: str | None) -> tuple[Bundle, list[str]]:
    """The bundle, and the notes that were told."""
    notes: list[str] = []

    def tell(event: dict[str, Any]) -> None:
        if event["event"] == "note":
            notes.append(event["note"])

    done = pipeline.run_work(SceneWork(one, tell, solution, device), folder / str(device))
    return read(done.path), notes


@pytest.mark.parametrize(
    ("sets", "asked"),
    [
        pytest.param(["outputs=[rgb, markers]"], ["developed, 0 noises and gains"], marks=pytest.mark.slow),
        (
            ["outputs=[rgb]", "render.noise=true", DRIFT, "sensor.camera.jpeg_quality=60"],
            ["developed, 6 noises and gains"],
        ),
        pytest.param(["outputs=[radiance]"], ["fetched"], marks=pytest.mark.slow),
        (["outputs=[radiance, rgb]"], ["fetched", "developed, 0 noises and gains"]),
        (["outputs=[rgb]", "render.noise=true", "render.background={folder}/mine.png"], ["fetched"]),
    ],
)
def test_all_frames_are_drawn_at_once_and_are_those_of_the_cpu(
    sets: list[str], asked: list[str], log: Log, solution: SolvedScene, tmp_path: Path
) -> None:
    photo = np.random.default_rng(0).integers(40, 160, (48, 64, 3)).astype(np.uint8)
    Image.fromarray(photo).save(tmp_path / "mine.png")
    one = row(tmp_path, *(each.replace("{folder}", str(tmp_path)) for each in sets))
    expected, _ = made(one, tmp_path, solution, None)
    assert log == []
    assert expected.attrs["renderer"] == "transport"
    found, _ = made(one, tmp_path, solution, "cuda:0")
    assert log == ["cuda:0 shared", "drawing at cuda:0", "radiance of 3", *asked]
    assert found.attrs["renderer"] == NAMED
    assert found.verify() == expected.verify()
    log.clear()
    made(one, tmp_path / "again", solution, "cuda:0")
    assert log == ["cuda:0 shared", "radiance of 3", *asked]  # taken again, since it is another one in each thread


@pytest.mark.slow
def test_frames_are_drawn_in_turns(
    log: Log, solution: SolvedScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = row(tmp_path, "outputs=[rgb, markers]", "render.noise=true")
    expected, _ = made(one, tmp_path, solution, None)
    monkeypatch.setattr(pictures, "MAX_BATCH_PIXELS", 2 * 48 * 64)  # pixels of two frames
    found, _ = made(one, tmp_path, solution, "cuda:0")
    assert [line for line in log if line.startswith("radiance")] == ["radiance of 2", "radiance of 1"]
    assert found.verify() == expected.verify()


@pytest.mark.parametrize(("room", "begin", "renderer"), [(0, "", "transport"), (1, " from frame 2 on", NAMED)])
def test_what_a_full_device_does_not_draw_the_cpu_draws_and_says_so(
    room: int,
    begin: str,
    renderer: str,
    log: Log,
    solution: SolvedScene,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = row(tmp_path, "outputs=[rgb]", "render.noise=true")
    expected, _ = made(one, tmp_path, solution, None)
    monkeypatch.setattr(pictures, "MAX_BATCH_PIXELS", 1)  # less than a frame has
    log.room = room
    found, notes = made(one, tmp_path, solution, "cuda:0")
    assert notes[-1] == f"pictures{begin} drawn by the CPU: CUDA out of memory"
    assert json.loads(found.attrs["notes"])[-1] == notes[-1]
    assert found.attrs["renderer"] == renderer
    assert found.verify() == expected.verify()


@pytest.mark.slow
def test_a_drawn_scene_leaves_nothing(
    log: Log, solution: SolvedScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference cycles would keep its faces and pictures until Python's garbage collector runs."""
    alive, init = list[weakref.ref[SceneData]](), SceneData.__init__

    def remembered(self: SceneData, *args: Any, **how: Any) -> None:
        init(self, *args, **how)
        alive.append(weakref.ref(self))

    monkeypatch.setattr(SceneData, "__init__", remembered)
    one = row(tmp_path, "outputs=[rgb, markers]")
    gc.collect()
    gc.disable()
    try:
        made(one, tmp_path, solution, "cuda:0")
        assert [each() for each in alive] == [None]
    finally:
        gc.enable()


def test_clear_gels_with_a_ray_a_pixel_can_be_drawn_on_a_gpu() -> None:
    usual, fine = Renderer(sensor(), 8, 0, markers=True), Renderer(sensor(), 300, 0, markers=True)
    assert tensor_drawing.drawable(usual)
    assert not tensor_drawing.drawable(fine)
    fitted = usual.sensor.model_copy(update={"thickness_response": object()})
    metered = sensor(camera={"auto_exposure": 0.5})
    for other in (fitted, metered):
        assert not tensor_drawing.drawable(SimpleNamespace(light=usual.light, sensor=other))  # type: ignore[arg-type]
    assert not tensor_drawing.drawable(SimpleNamespace(light=object(), sensor=usual.sensor))  # type: ignore[arg-type]
