"""Runs with the batch engine, here on PyTorch's CPU backend: bundles, what falls back, what is left behind."""

import sys
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.needs import needs
from helpers.small_recipe import HEAD, PRESS
from threadpoolctl import threadpool_limits

from tacgen import batch, mechanics
from tacgen.base.errors import UserError
from tacgen.batch import cuda_engine, pipeline, solution_file
from tacgen.batch.recorder import SceneWork
from tacgen.bundle.bundle import read
from tacgen.mechanics import mesh, presolve
from tacgen.mechanics.problem import Problem
from tacgen.mechanics.solved_scene import SolvedScene
from tacgen.recipe import plan, scene_of_row
from tacgen.recipe.plan import Plan
from tacgen.recipe.row import Row
from tacgen.tensor_engine import planning

pytestmark = pytest.mark.usefixtures("kept_workers")
TWO = """vary: {samples: 2, seed: 1, over: {indenter.radius_mm: {uniform: [2.5, 3.5]}}}
contact: {friction: 0.4}
"""


def planned(folder: Path, moves: str = PRESS, more: str = "") -> Plan:
    """Scenes of a ball on a coarse gel."""
    path = folder / "few.yaml"
    path.write_text(f"{HEAD}  [{moves}]\n{more}")
    return plan.load(path)


@pytest.fixture
def on_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    needs("torch")
    monkeypatch.setattr(cuda_engine, "usable_devices", lambda: ["cpu"])


def test_bundles_are_those_of_the_local_engine_and_say_who_solved_them(on_cpu: None, tmp_path: Path) -> None:
    made = planned(tmp_path, more=TWO)
    for engine in ("cuda", "local"):
        results = batch.run(made, tmp_path / engine, engine=engine)
        assert [result.status for result in results] == ["ok", "ok"]
    for name in ("scene-00000.h5", "scene-00001.h5"):
        ours, theirs = (read(tmp_path / engine / name) for engine in ("cuda", "local"))
        assert ours.attrs["solver"].startswith("batch engine on cpu, torch ")
        assert ours.attrs["input_key"] == theirs.attrs["input_key"]
        np.testing.assert_allclose(ours["/frames/force"][:], theirs["/frames/force"][:], rtol=1e-5, atol=1e-7)
    cuda, local = ({path.name for path in (tmp_path / engine).iterdir()} for engine in ("cuda", "local"))
    assert cuda == local


def test_what_the_batch_engine_lacks_is_solved_on_the_cpu_and_said(on_cpu: None, tmp_path: Path) -> None:
    made = planned(tmp_path, more="mesh: tet\n")
    batch.run(made, tmp_path / "out", engine="cuda")
    bundle = read(tmp_path / "out" / "scene-00000.h5")
    assert not bundle.attrs["solver"].startswith("batch engine")
    assert "solved by the CPU engine: a mesh of tets" in bundle.attrs["notes"]


def test_forces_are_those_of_the_local_engine(on_cpu: None, tmp_path: Path) -> None:
    """On both sides in a mesh that is fine where a coarse one has the force."""
    made = planned(tmp_path, "press: {force_n: 1.5, frames: 1}, slide: {x_mm: 0.3, frames: 1}, release: {frames: 1}")
    ours, theirs = tmp_path / "cuda", tmp_path / "local"
    assert [batch.run(made, folder, engine=folder.name)[0].status for folder in (ours, theirs)] == ["ok", "ok"]
    one, right = (read(folder / "scene-00000.h5") for folder in (ours, theirs))
    assert one.attrs["solver"].startswith("batch engine on cpu, torch ")
    force, expected = one["/frames/force"][:], right["/frames/force"][:]
    assert force[0, 2] == pytest.approx(-1.5, rel=5e-3)
    assert force == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_a_solution_is_labelled_without_a_solve(on_cpu: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (row,) = planned(tmp_path, "press: {force_n: 1, frames: 1}").rows
    (tmp_path / cuda_engine.SOLUTIONS_FOLDER).mkdir()
    with ThreadPoolExecutor(1) as solving:
        (part,) = cuda_engine._begun([row], tmp_path, ["cpu"], solving, 1, map, 0, True)
        assert part.result() == ((), [])
    monkeypatch.setattr(presolve, "presolved", lambda scene: pytest.fail("solved again"))
    assert cuda_engine.run_scene(row, tmp_path).status == "ok"


@pytest.mark.slow
@pytest.mark.parametrize(("outputs", "elements"), [("force, rgb", False), ("force, stress", True)])
def test_known_frames_need_no_matrices(
    outputs: str, elements: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Elements are set up only for stress; either way the labels are those of the engine that solved."""
    planned(tmp_path)
    (row,) = plan.load(tmp_path / "few.yaml", [f"outputs=[{outputs}]"]).rows
    scene = scene_of_row.build(row)
    known = Problem.of(scene, mesh.of(scene))
    mechanics.warm()  # a limit does not reach a BLAS that is loaded later
    with threadpool_limits(1, user_api="blas"):  # as run_scene has: more add up in another order
        states = list(mechanics.states(scene, known))
    pipeline.run_scene(row, tmp_path / "solved")
    monkeypatch.setattr(Problem, "of", lambda *_: pytest.fail("set up to be solved"))
    problem = Problem.of_known_frames(scene, known.mesh, stress=elements)
    assert [len(part.elements.conn) > 0 for part in problem.elastic] == [elements] * len(known.elastic)
    work = SceneWork(row, lambda event: None, SolvedScene("an engine", states))
    pipeline.run_work(work, tmp_path / "known")
    solved, labelled = (read(tmp_path / folder / "scene-00000.h5") for folder in ("solved", "known"))
    assert labelled.attrs["solver"] == "an engine"
    assert solved.verify() == labelled.verify()


def test_finished_scenes_are_not_solved_again(on_cpu: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = planned(tmp_path)
    batch.run(made, tmp_path / "out", engine="local")
    monkeypatch.setattr(cuda_engine, "scene_of", lambda row: pytest.fail("solved again"))
    assert batch.run(made, tmp_path / "out", engine="cuda")[0].status == "ok"


def test_a_full_gpu_leaves_scenes_to_the_workers(on_cpu: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tacgen.tensor_engine import pool

    def full(*args: Any, **how: Any) -> Any:
        raise RuntimeError("CUDA out of memory")

    monkeypatch.setattr(pool, "solved", full)
    events: list[dict[str, Any]] = []
    assert batch.run(planned(tmp_path), tmp_path / "out", engine="cuda", on_event=events.append)[0].status == "ok"
    assert any("the batch engine stopped: CUDA out of memory" in str(event.get("note")) for event in events)
    assert "the batch engine stopped before this scene" in read(tmp_path / "out" / "scene-00000.h5").attrs["notes"]


def test_a_solved_scene_is_written_while_others_are_solved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, out = planned(tmp_path, more=TWO), tmp_path / "out"
    first, second = made.rows
    waited = list[bool]()

    def solve(folder: Path) -> cuda_engine.SolvedPart:
        solution_file.write(cuda_engine._place(folder, second), SolvedScene("", why="solved first"))
        end = time.monotonic() + 60
        while not (out / f"{second.name}.h5").exists() and time.monotonic() < end:
            time.sleep(0.05)
        waited.append((out / f"{second.name}.h5").exists() and not (out / f"{first.name}.h5").exists())
        return cuda_engine.SolvedPart(["all solved"])

    def begun(rows: list[Row], folder: Path, devices: object, solving: Executor, *how: object) -> list[Any]:
        return [solving.submit(solve, folder)]

    monkeypatch.setattr(cuda_engine, "_begun", begun)
    monkeypatch.setattr(cuda_engine, "usable_devices", lambda: ["cpu"])
    events: list[dict[str, Any]] = []
    results = batch.run(made, out, engine="cuda", on_event=events.append)
    assert [(each.name, each.status) for each in results] == [(row.name, "ok") for row in made.rows]
    assert waited == [True]
    assert "solved first" in read(out / f"{second.name}.h5").attrs["notes"]
    assert "stopped before this scene" in read(out / f"{first.name}.h5").attrs["notes"]
    assert "all solved" in [event["note"] for event in events if event["event"] == "note"]
    assert not (out / cuda_engine.SOLUTIONS_FOLDER).exists()


def test_scenes_put_off_are_solved_together_last(on_cpu: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tacgen.tensor_engine import pool

    solve, begun, calls = pool.solved, cuda_engine._begun, list[tuple[list[str], bool]]()
    made = planned(tmp_path, more=TWO)
    one, two = (row.name for row in made.rows)

    def watched(rows: list[Row], *how: Any) -> Any:
        calls.append(([row.name for row in rows], how[-1]))
        return begun(rows, *how)

    def hasty(plans: list[Any], *, patient: bool, **how: Any) -> Any:
        """The second scene of a chunk is put off, and solved when the worker has had time for it."""
        end = time.monotonic() + 60
        while patient and not (tmp_path / "out" / f"{one}.h5").exists() and time.monotonic() < end:
            time.sleep(0.05)
        time.sleep(0.5 * patient)
        for k, found in solve(plans, patient=patient, **how):
            yield k, found if patient or k != 1 else replace(found, late=True)

    monkeypatch.setattr(cuda_engine, "_begun", watched)
    monkeypatch.setattr(pool, "solved", hasty)
    assert [each.status for each in batch.run(made, tmp_path / "out", engine="cuda")] == ["ok", "ok"]
    assert calls == [([one, two], False), ([two], True)]
    for name in (one, two):
        bundle = read(tmp_path / "out" / f"{name}.h5")
        assert bundle.attrs["solver"].startswith("batch engine on cpu, torch ")
        assert "CPU engine" not in bundle.attrs.get("notes", "")
    assert not (tmp_path / "out" / cuda_engine.SOLUTIONS_FOLDER).exists()


def test_chunks_whose_scenes_are_all_put_off_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No chunk waits for scenes that are begun only after it."""
    count, patiently = 4, list[str]()
    made = planned(tmp_path, more=TWO.replace("samples: 2", f"samples: {count}"))

    def solve(row: Row, folder: Path, patient: bool) -> cuda_engine.SolvedPart:
        if not patient:
            return cuda_engine.SolvedPart(late=[row.name])
        patiently.append(row.name)
        solution_file.write(cuda_engine._place(folder, row), SolvedScene("", why="of no matter"))
        return cuda_engine.SolvedPart()

    def begun(rows: list[Row], folder: Path, devices: object, solving: Executor, *how: Any) -> list[Any]:
        return [solving.submit(solve, row, folder, how[-1]) for row in rows]

    monkeypatch.setattr(cuda_engine, "MAX_PLANNED_SCENES", 1)
    monkeypatch.setattr(cuda_engine, "_begun", begun)
    monkeypatch.setattr(cuda_engine, "usable_devices", lambda: ["cpu"])
    results = batch.run(made, tmp_path / "out", engine="cuda")
    assert [each.status for each in results] == ["ok"] * count
    assert sorted(patiently) == [row.name for row in made.rows]


def test_a_closed_run_writes_no_more_solutions_and_a_dead_process_is_told(on_cpu: None, tmp_path: Path) -> None:
    (row,) = planned(tmp_path).rows

    class Dead(ThreadPoolExecutor):
        def submit(self, *args: Any, **how: Any) -> Any:
            raise BrokenProcessPool("killed")

    with Dead(1) as solving:
        events: list[dict[str, Any]] = []
        solutions = cuda_engine._Solutions([row], tmp_path, events.append)
        solutions.make(lambda rows, patient: cuda_engine._begun(rows, tmp_path, ["cpu"], solving, 1, map, 0, patient))
        assert solutions.has(row)
        solutions.close()
        assert "a process of the batch engine died" in events[0]["note"]
        assert not (tmp_path / cuda_engine.SOLUTIONS_FOLDER).exists()
        waiting = Future[cuda_engine.SolvedPart]()
        with ThreadPoolExecutor(1) as ahead:
            closed = cuda_engine._Solutions([row], tmp_path, events.append)
            made = ahead.submit(closed.make, lambda rows, patient: [waiting])
            while not closed._chunks:
                time.sleep(0.01)
            closed.close()
            assert made.result(10) is None
        assert waiting.cancelled()
        assert not (tmp_path / cuda_engine.SOLUTIONS_FOLDER).exists()


def test_solutions_that_a_killed_run_has_left_are_not_used(on_cpu: None, tmp_path: Path) -> None:
    made, out = planned(tmp_path), tmp_path / "out"
    (out / cuda_engine.SOLUTIONS_FOLDER).mkdir(parents=True)
    left = out / cuda_engine.SOLUTIONS_FOLDER / f"{made.rows[0].name}.npz"
    solution_file.write(left, SolvedScene("", why="of another recipe"))
    batch.run(made, out, engine="cuda")
    assert "of another recipe" not in read(out / "scene-00000.h5").attrs.get("notes", "")


@pytest.mark.parametrize(("gpus", "chosen"), [(0, None), (1, "cuda:0"), (2, "cuda:1")])
def test_processes_share_the_gpus(
    gpus: int, chosen: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned(tmp_path)
    (row,) = plan.load(tmp_path / "few.yaml", ["outputs=[rgb]"]).rows
    known, seen = SolvedScene("an engine", [Any]), list[str | None]()  # type: ignore[list-item]
    fake = SimpleNamespace(usable=lambda: [f"cuda:{k}" for k in range(gpus)])
    monkeypatch.setitem(sys.modules, "tacgen.tensor_engine.device", fake)
    monkeypatch.setattr("tacgen.tensor_engine.device", fake, raising=False)
    monkeypatch.setattr(cuda_engine.os, "getpid", lambda: 7)
    monkeypatch.setattr(solution_file, "read", lambda path: known)
    monkeypatch.setattr(pipeline, "run_work", lambda work, folder, **how: seen.append(work.device))
    cuda_engine.run_scene(row, tmp_path)
    assert seen == [chosen]


def test_no_gpu_is_one_line(tmp_path: Path) -> None:
    torch = needs("torch")
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(UserError, match="finds no GPU that it can use; --engine local needs none"):
        batch.run(planned(tmp_path), tmp_path / "out", engine="cuda")


def test_states_and_why_there_are_none_survive_the_file(tmp_path: Path) -> None:
    scene = scene_of_row.build(planned(tmp_path).rows[0])
    states = list(mechanics.states(scene, Problem.of(scene, mesh.of(scene))))
    states = [*states, replace(states[0], residual=np.float64(np.nan), iterations=np.int64(7), unique=False)]
    solution_file.write(tmp_path / "one.npz", SolvedScene("an engine", states, heights=(0.5, 0.25)))
    found = solution_file.read(tmp_path / "one.npz")
    assert (found.engine, found.heights) == ("an engine", (0.5, 0.25))
    for state, other in zip(states, found.states, strict=True):
        assert state.friction is None
        for name in solution_file.STATE_FIELDS:
            value, again = getattr(state, name), getattr(other, name)
            assert type(again) is type(value.item() if isinstance(value, np.generic) else value), name
            np.testing.assert_array_equal(value, again)
    solution_file.write(tmp_path / "one.npz", SolvedScene("an engine", why="it is so"))
    assert solution_file.read(tmp_path / "one.npz") == SolvedScene("an engine", [], "it is so")
    assert solution_file.read(tmp_path / "none.npz") is None


@pytest.mark.slow
def test_several_processes_give_the_same_bytes_again(
    on_cpu: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planning, "MIN_PART_SCENES", 1)  # scenes of a part
    assert cuda_engine.solvers(4, 1) == 2
    for folder in ("out", "again"):
        results = batch.run(planned(tmp_path, more=TWO), tmp_path / folder, engine="cuda", workers=4)
        assert [result.status for result in results] == ["ok", "ok"]
    for name in ("scene-00000.h5", "scene-00001.h5"):
        assert read(tmp_path / "out" / name).attrs["solver"].startswith("batch engine on cpu, torch ")
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


@pytest.mark.parametrize(("workers", "devices", "count"), [(1, 1, 1), (4, 1, 2), (64, 1, 8), (64, 4, 32), (4, 4, 4)])
def test_processes_that_solve(workers: int, devices: int, count: int) -> None:
    assert cuda_engine.solvers(workers, devices) == count
