"""The episodes of benchmarks.touch_episodes: simulated grasps, read again by the readers."""

from pathlib import Path

import numpy as np
import pytest
from helpers.needs import needs

from benchmarks import touch_episodes
from tacgen.touch.sources import open_source

EpisodeLog = tuple[Path, list[touch_episodes.RecordedGrasp]]
needs("mujoco")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> EpisodeLog:
    """The folder, and the first two episodes, without pictures."""
    folder = tmp_path_factory.mktemp("episodes")
    model = touch_episodes.prepared(folder)
    black = np.zeros((touch_episodes.PICTURE, touch_episodes.PICTURE, 3), np.uint8)
    made = [touch_episodes.recorded(model, number, 0, lambda _: black) for number in (0, 1)]
    touch_episodes.write_robomimic(made, folder / "robomimic.hdf5")
    return folder, made


def test_poses_and_forces_are_those_of_the_simulation(recorded: EpisodeLog) -> None:
    folder, made = recorded
    source = open_source(folder / "robomimic.hdf5", columns={"ctrl": "actions", "grip": "actions[4]"})
    assert (source.fps, list(source.things)) == (30.0, ["box", "key", "gear", "bottle", "nut"])
    for number, thing in enumerate(("box", "key")):
        episode, grasp = source.episode(number), made[number]
        place = 1000 * grasp.qpos[:, 7 * number : 7 * number + 3]
        np.testing.assert_allclose(episode.bodies[thing][:, :3, 3], place, atol=1e-6)
        pads = np.hstack([episode.forces[pad, thing] for pad in touch_episodes.PADS])
        np.testing.assert_allclose(pads, grasp.forces, rtol=0, atol=0.01)
        assert not np.any([episode.forces[pad, "nut"] for pad in touch_episodes.PADS])


def test_a_held_object_is_lifted_turned_and_put_into_the_other_stand(recorded: EpisodeLog) -> None:
    for number, grasp in enumerate(recorded[1]):
        mass = grasp.kind.mass
        held = (grasp.time > 3.0) & (grasp.time < 3.3)  # lifted and at rest, before the turn has speed
        up = -(grasp.forces[held, 2] + grasp.forces[held, 5])  # of the pads on the object
        assert np.abs(up).mean() == pytest.approx(mass * 9.81, rel=0.02)
        start, end = grasp.qpos[[0, -1], 7 * number : 7 * number + 7]
        np.testing.assert_allclose(end[:2] - start[:2], [touch_episodes.STANDS, 0], atol=2e-3)
        assert end[2] == pytest.approx(start[2], abs=5e-4)
        assert 2 * np.degrees(np.arctan2(end[6], end[3])) == pytest.approx(90, abs=2)
        assert not grasp.forces[-1].any()
        assert 90 < (np.abs(grasp.forces).max(1) > 0).sum() < 130  # rows in contact


def test_lerobots_own_writer_and_our_reader_agree(recorded: EpisodeLog, tmp_path: Path) -> None:
    needs("lerobot")
    _, made = recorded
    model = touch_episodes.prepared(tmp_path)
    list(touch_episodes.write_lerobot(iter(made), model, tmp_path / "lerobot"))
    columns = {"grip": "action[left_finger]", "forces": {"left_pad/key": "observation.pad_force[0:3]"}}
    source = open_source(tmp_path / "lerobot", model=tmp_path / "model.xml", columns=columns)
    assert (len(source), source.fps) == (2, 30.0)
    episode = source.episode(1)
    np.testing.assert_allclose(episode.bodies["key"][:, :3, 3], 1000 * made[1].qpos[:, 7:10], atol=1e-4)
    np.testing.assert_allclose(episode.forces["left_pad", "key"], made[1].forces[:, :3], atol=1e-5)
    np.testing.assert_allclose(episode.grip, np.maximum(made[1].commands[:, 4], 0), atol=1e-5)
    simulated = open_source(tmp_path / "lerobot", model=tmp_path / "model.xml").episode(1).forces
    np.testing.assert_allclose(simulated["left_pad", "key"], made[1].forces[:, :3], rtol=0, atol=0.02)
