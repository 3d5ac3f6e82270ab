"""Pictures drawn by the batch are the single ones; without a GPU on a core."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from helpers.needs import needs

torch = needs("torch")

from helpers.tiny import PLAIN, sensor

from tacgen.optics.adaptive_sampling import SamplingTolerance
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.shadows import Terrain
from tacgen.optics.surface_grid import Surface
from tacgen.render.images import Clear, Renderer
from tacgen.tensor_optics.drawing import Drawing
from tacgen.tensor_optics.faces import terrains

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
EVERYWHERE = SamplingTolerance(1, 0.0, 0.0)  # no sample is interpolated
CAMERA = {**PLAIN["camera"], "width_px": 13, "height_px": 9, "mm_per_px": 3.3 * PLAIN["camera"]["mm_per_px"]}
MATT = {"specular": 0.0}
NOISE = {"shot": [1e-4] * 3, "read": [5e-3, 3e-3, 6e-3]}
STAINED = {"grain": {"contrast": 0.05, "length_mm": 0.3}, "wear": {"loss": 0.3, "radius_mm": 1.0, "center_mm": [1, 0]},
           "relief": {"height_mm": 0.02, "length_mm": 0.3}}  # fmt: skip
SENSORS: dict[str, dict[str, Any]] = {
    "matt": {"markers": None, "coating": MATT},
    "matt with dots beside the middle, stray light": {
        "coating": MATT,
        "camera": {**CAMERA, "ambient": [0.1, 0.2, 0.3], "noise": NOISE},
        "markers": {"offset_mm": [0.5, -0.2]},
    },
    "glossy with dots and grain, out of focus": {
        "coating": STAINED,
        "camera": {
            **CAMERA,
            "blur_mm": 0.3,
            "colour_matrix": [[1, -0.2, -0.3], [0, 1, 0], [0, 0, 1]],
            "glare": {key: [[0.1, -0.2], [0.0, 0.1]] for key in ("red", "green", "blue")},
            "noise": {**NOISE, "patch_px": 4, "correlation": [-0.5, 0.1, -0.4]},
        },
    },
}


def made(**changes: Any) -> tuple[Renderer, Drawing]:
    """A renderer that computes every sample, and the same on a GPU."""
    lit: Any = sensor(**{"camera": CAMERA, **changes})
    renderer = Renderer(lit, 16, 0, lit.markers is not None)
    assert isinstance(renderer.light, Clear)
    renderer.light.direct.tolerance = EVERYWHERE
    parts = renderer.light.direct, renderer.light.glow, renderer.stray, renderer.texture
    return renderer, Drawing(*parts, DEVICE, renderer.glare, renderer.relief)


def on_nodes(renderer: Renderer, faces: Sequence[Surface]) -> tuple[np.ndarray, np.ndarray]:
    """Positions and shares of contact of faces at the nodes of the sheet."""
    sheet = renderer.sheet
    return np.stack([sheet.at(face) for face in faces]), np.stack([sheet.touched(face) for face in faces])


@pytest.mark.parametrize("changes", SENSORS.values(), ids=SENSORS)
def test_pictures_are_the_cpus(changes: dict[str, Any]) -> None:
    renderer, drawing = made(**changes)
    faces = [BallDent(2.0, 1.2, (0.4, -0.3)), renderer.untouched]
    seen = drawing.radiance(*on_nodes(renderer, faces))
    wanted = np.stack([renderer.image(face) for face in faces])
    assert np.abs(wanted[0] - wanted[1]).max() > 0.1 * wanted.max()  # the dent is seen
    assert np.abs(seen.cpu().numpy() - wanted).max() < 1e-6 * wanted.max()

    def noise() -> list[np.random.Generator]:
        return [np.random.default_rng(k) for k in range(2)]

    gains = [None, np.array([1.2, 0.9, 1.0])]
    pictures = drawing.developed(seen, noise(), gains)
    each = zip(seen.cpu().numpy(), noise(), gains, strict=True)
    assert np.array_equal(pictures, [renderer.develop(*one) for one in each])


def test_a_picture_does_not_depend_on_those_beside_it() -> None:
    renderer, drawing = made()
    nodes, touched = on_nodes(renderer, [BallDent(2.0, size) for size in (0.8, 1.2)])
    alone = [drawing.radiance(nodes[k : k + 1], touched[k : k + 1]) for k in range(2)]
    assert torch.equal(drawing.radiance(nodes, touched), torch.cat(alone))


def test_a_fold_hides_what_is_behind_it() -> None:
    renderer, drawing = made()
    nodes = renderer.sheet.at(renderer.untouched)
    over = np.abs(nodes[:, 0]) < 1.0
    nodes[over, 0] *= -1.5  # the middle is turned over,
    nodes[over, 2] -= 0.5  # nearer to the camera
    at = renderer.light.direct.view.look(_Nodes(nodes))  # type: ignore[union-attr]
    assert at.folded
    faces = drawing._faces.draw(torch.as_tensor(nodes[None], device=DEVICE))
    found = (faces.keys[0] & 0xFFFFFFFF).cpu().numpy()
    assert np.array_equal(found, at.hits.triangle)


class _Nodes:
    """A face whose nodes are given."""

    def __init__(self, nodes: np.ndarray) -> None:
        self._nodes = nodes

    def at(self, xy: Any) -> np.ndarray:
        return self._nodes


@pytest.mark.parametrize("shape", [(9, 17), (12, 41), (105, 127), (2, 2)])
def test_blocks_of_terrains(shape: tuple[int, int]) -> None:
    """The least of each block, and beyond which blocks nothing casts shadows."""
    heights = np.random.default_rng(1).normal(size=(2, *shape))
    heights[:, :, : shape[1] // 3] = np.inf
    made = terrains(torch.as_tensor(heights.reshape(2, -1), device=DEVICE), None, shape)
    for k in range(2):
        wanted = Terrain.of(heights[k], (2.0, 1.0))
        assert np.array_equal(made.small[k].cpu(), wanted.small)
        assert np.array_equal(made.large[k].cpu(), wanted.large)
        assert np.array_equal(made.extent[k].cpu(), wanted.extent)


def test_more_rays_a_pixel_are_refused() -> None:
    lit: Any = sensor(camera=CAMERA)
    light = Renderer(lit, 300, 0, False).light
    assert isinstance(light, Clear)
    with pytest.raises(ValueError, match="one ray a pixel"):
        Drawing(light.direct, light.glow, None, None, DEVICE)
