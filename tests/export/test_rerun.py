"""Recordings for Rerun, read back by its own reader; and the face of a scene as triangles, which needs none."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import whole_bundle
from helpers.export_scenes import FRAMES
from helpers.needs import needs

from tacgen.bundle.bundle import Bundle, read
from tacgen.export import export
from tacgen.export import rerun as exporter
from tacgen.optics.camera import PinholeCamera


def rows(path: Path) -> dict[tuple[str, bool], dict[str, list[Any]]]:
    """Entity, and whether its data stand for all times -> name of a column -> its values."""
    chunk = needs("rerun.chunk")
    found: dict[tuple[str, bool], dict[str, list[Any]]] = {}
    for part in chunk.RrdReader(str(path)).stream().to_chunks():
        columns = found.setdefault((part.entity_path, part.is_static), {})
        for name, values in part.to_record_batch().to_pydict().items():
            columns.setdefault(name, []).extend(values)
    return found


def test_its_reader_finds_images_maps_wrench_and_face(folder: Path, scene: Bundle, tmp_path: Path) -> None:
    needs("rerun")
    (made,) = export("rerun", folder / "scene-00001.h5", tmp_path / "scene.rrd")
    found = rows(made)
    assert found["/camera", False]["EncodedImage:media_type"][0] == ["image/png"]
    assert sorted(found["/camera", False]["frame"]) == list(range(FRAMES))
    assert np.array(found["/wrench", False]["Scalars:scalars"]) == pytest.approx(
        np.hstack([scene["/frames/force"], scene["/frames/torque"]])
    )
    order = found["/maps/traction", False]["frame"]
    (tensor,) = found["/maps/traction", False]["Tensor:data"][order.index(9)]
    assert (tensor["shape"], tensor["names"]) == ([60, 80, 2], ["row", "column", "xy"])
    assert np.reshape(tensor["buffer"], (60, 80, 2)) == pytest.approx(scene.frame("/frames/traction", 9))
    face = found["/face", False]
    points = np.array(face["Mesh3D:vertex_positions"][face["frame"].index(9)])
    surface = exporter.face(scene)
    assert surface is not None
    assert points == pytest.approx(surface.points(9), abs=1e-5)
    assert np.array(face["Mesh3D:triangle_indices"][0]).max() == len(points) - 1
    assert ("/camera/untouched", True) in found
    assert not [name for columns in found.values() for name in columns if name in ("log_time", "log_tick")]


def test_times_are_a_timeline_of_their_own(tmp_path: Path) -> None:
    needs("rerun")
    whole_bundle.write(tmp_path / "in" / "scene.h5")
    (made,) = export("rerun", tmp_path / "in", tmp_path / "out")
    assert made == tmp_path / "out" / "scene.rrd"
    seconds = [time.total_seconds() for time in sorted(rows(made)["/force", False]["time"])]
    assert seconds == pytest.approx([0.0, 0.1, 0.2])


def test_the_face_without_a_mesh_lies_on_the_rays_of_the_camera_at_the_height_of_each_sample(scene: Bundle) -> None:
    bare = Bundle(scene.path, scene.attrs, {p: n for p, n in scene.shapes.items() if not p.startswith("/mesh")})
    surface = exporter.face(bare)
    assert surface is not None
    points = surface.points(9)
    assert points[:, 2] == pytest.approx(scene.frame("/frames/height", 9).ravel(), abs=1e-6)
    pixels = PinholeCamera.from_sensor(scene.sensor).project(points)
    down, right = np.indices((60, 80)).reshape(2, -1) + 0.5
    assert pixels == pytest.approx(np.column_stack([4 * right, 4 * down]), abs=1e-6)
    a, b, c = (points[surface.triangles[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(np.ptp(points[:, 0]) * np.ptp(points[:, 1]), rel=0.1)


def test_the_face_with_a_mesh_is_its_facets_moved(tmp_path: Path) -> None:
    bundle = read(whole_bundle.write(tmp_path / "scene.h5"))
    surface = exporter.face(bundle)
    assert surface is not None
    assert surface.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    rest = bundle["/mesh/surface/points"]
    assert surface.points(2) == pytest.approx(rest + bundle.frame("/fields/surface_displacement", 2))


def test_its_reader_of_lerobot_data_sets_takes_our_export(folder: Path, scene: Bundle, tmp_path: Path) -> None:
    readers = needs("rerun.experimental")
    needs("pyarrow")
    export("lerobot", folder, tmp_path / "out")
    reader = readers.LeRobotReader(str(tmp_path / "out"))
    assert list(reader.episodes()) == [0, 1]
    found = {part.entity_path: part for part in reader.stream(1).to_chunks() if not part.is_static}
    wrench = found["/observation.tactile.wrench"].to_record_batch().to_pydict()["Scalars:scalars"]
    assert np.array(wrench) == pytest.approx(np.hstack([scene["/frames/force"], scene["/frames/torque"]]), rel=1e-6)
    assert found["/observation.images.tactile"].num_rows == FRAMES
