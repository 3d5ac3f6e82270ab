"""Shadows by horizons, and the sum over strips by the table, against walks and sums that leave nothing out."""

import numpy as np
import pytest
from helpers.light_paths import horizon
from helpers.tiny import PLAIN, sensor

from tacgen.optics import coating, strip_light, strip_light_table
from tacgen.optics.adaptive_sampling import SamplingTolerance
from tacgen.optics.direct_light import Direct, heights
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.shadows import Terrain
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.physics import runtime, strip_columns

EVER = (-1e9, 1e9)  # every slope is of interest


def test_a_ridge_shades_and_a_clear_way_does_not():
    heights = np.zeros((101, 101))
    seen = horizon(Terrain.of(heights, (10.0, 10.0)), -2.0, 0.0, 0.0, 1.0, 0.0, 8.0, EVER, EVER)
    assert seen == 0.0
    heights[:, 50:53] = -1.0  # pushed toward the camera, between the point and the light
    near, far = (-(2.0 + i) for i in (0.0, 0.2))
    for dy in (0.0, 0.3):
        dx = np.sqrt(1 - dy * dy)
        terrain = Terrain.of(heights, (10.0, 10.0))
        found = horizon(terrain, -2.0, 0.0, 0.0, dx, dy, 8.0, EVER, EVER)
        assert 1 / near * dx - 0.02 < found < 1 / far * dx + 0.02
        assert horizon(terrain, -2.0, 0.0, 0.0, dx, dy, 1.9, EVER, EVER) == 0.0  # the light is before the ridge


def walk(heights, size, x, y, z, dx, dy, reach):
    """The least slope to the face, looked at every 0.005 mm."""
    from scipy.ndimage import map_coordinates

    r = np.arange(0.15, reach, 0.005)
    rows, columns = heights.shape
    u = (x + r * dx + size[0] / 2) / size[0] * (columns - 1)
    v = (y + r * dy + size[1] / 2) / size[1] * (rows - 1)
    inside = (u >= 0) & (v >= 0) & (u < columns - 1) & (v < rows - 1)
    face = map_coordinates(heights, [v[inside], u[inside]], order=1)
    return ((face - z) / r[inside]).min(initial=np.inf)


def test_blocks_are_stepped_over_without_loss():
    """On a dome with a dent, in all directions, from points on the face."""
    rng, size = np.random.default_rng(3), (18.0, 24.0)
    y, x = np.mgrid[-12:12:241j, -9:9:181j]
    heights = -(x * x / 64 + y * y / 144) - 1.2 * np.exp(-((x - 1) ** 2 + y**2) / 3)
    terrain, late, parted = Terrain.of(heights, size), [], []
    for k in range(400):
        row, column = rng.integers(5, 236), rng.integers(5, 176)
        turn = k % 4 * np.pi / 2 if k < 40 else rng.uniform(0, 2 * np.pi)
        ray = (x[row, column], y[row, column], heights[row, column], np.cos(turn), np.sin(turn), rng.uniform(3, 25))
        found, true = horizon(terrain, *ray, EVER, EVER), walk(heights, size, *ray)
        assert found >= true - 2e-3  # it sees no more face than there is
        late.append(found - true if true < 1e9 else 0.0)
        least = rng.uniform(-0.6, 0.0)
        asked = (least, least + 0.1), (least - 0.5, least - 0.05)
        some = horizon(terrain, *ray, *asked)
        for low, high in asked:
            parted.append(abs(np.clip(some, low, high) - np.clip(found, low, high)))
    assert np.percentile(late, 95) < 0.02
    assert np.percentile(parted, 98) < 0.01  # the same answer wherever somebody asks
    assert max(parted) < 0.1


@pytest.mark.parametrize(("gloss", "lobe"), [(0.0, 0), (0.3, 0), (0.0, 4)])
def test_the_table_sums_what_single_connections_do(gloss, lobe):
    made = sensor(coating={"specular": gloss}, leds=[{**led, "lobe": lobe} for led in PLAIN["leds"]])
    sheet = Sheet.over(made.gel, 0.1)
    direct = Direct(made, sheet, False, Untouched.of(made.gel))
    at = direct.view.look(BallDent(2.0, 1.0, (0.6, -0.4), Untouched.of(made.gel)))
    found = direct.light(at)
    slab, panels = strip_light.Slab.of(made), strip_light.Panels.of(made.leds)
    seen, terrain = (at.position, at.normal, direct.view.toward_camera()), heights(sheet, at.nodes)
    fine, rough = strip_light.points(made.leds, 16, 8), made.coating.roughness
    exact = strip_light.gather(*seen, fine, 3, slab, panels, rough, Terrain.of(terrain, sheet.size))
    exact *= direct.view.transmission()[:, None, None]
    kinds = 2 if gloss else 1
    for kind in range(kinds):
        assert np.linalg.norm((found - exact)[..., kind]) < 0.01 * np.linalg.norm(exact[..., kind])
    assert found.shape[-1] == kinds


@pytest.mark.parametrize("pieces", [3, 8])
def test_a_tall_strip_that_another_partly_hides_is_right_in_few_pieces(pieces):
    """The face cuts some of it off, too: a few points up the strip would be wrong by as much as one stands for."""
    tall = {**PLAIN["leds"][0], "center_mm": [1.0, -4.9, -2.4], "size_mm": [6, 3.4]}
    board = {**tall, "name": "board", "center_mm": [0.0, -3.2, -4.5], "size_mm": [12, 0.4], "radiance": [0, 0, 0]}
    made = sensor(leds=[tall, board], camera={"mm_per_px": 0.1})
    sheet = Sheet.over(made.gel, 0.1)
    direct = Direct(made, sheet, False, Untouched.of(made.gel), pieces)
    at = direct.view.look(Untouched.of(made.gel))
    found = direct.light(at)[:, 0, 0]
    slab, panels, fine = (
        strip_light.Slab.of(made),
        strip_light.Panels.of(made.leds),
        strip_light.points(made.leds, 24, 24),
    )
    seen = at.position, at.normal, direct.view.toward_camera()
    exact = strip_light.gather(*seen, fine, 2, slab, panels, 0.4, Terrain.of(heights(sheet, at.nodes), sheet.size))
    exact = exact[:, 0, 0] * direct.view.transmission()
    assert np.abs(found - exact).max() < 0.03 * exact.max()
    assert np.linalg.norm(found - exact) < 0.01 * np.linalg.norm(exact)


def test_only_what_has_drawn_back_shades_anew():
    """Beside what the untouched face hides anyway, which the table of its slopes knows."""
    before = np.zeros((101, 101))
    before[:, 70:73] = -1.0
    after = before.copy()
    after[:, 50:53] = -0.4
    ray = (-2.0, 0.0, 0.0, 1.0, 0.0, 8.0, EVER, EVER)
    whole, old, new = (
        horizon(terrain, *ray)
        for terrain in (
            Terrain.of(after, (10.0, 10.0)),
            Terrain.of(before, (10.0, 10.0)),
            Terrain.of(after, (10.0, 10.0), before),
        )
    )
    assert old < 0.9 * new < 0.0
    assert whole == min(old, new)
    assert horizon(Terrain.of(before, (10.0, 10.0), before), *ray) == EVER[1]


def test_heights_are_0_where_there_is_no_gel():
    gel = sensor().gel
    sheet = Sheet.over(gel, 0.2)
    found = heights(sheet, sheet.at(Untouched.of(gel)) * [0.5, 0.5, 1.0] - [0.0, 0.0, 1.0])
    rows, columns = sheet.shape
    assert found[rows // 2, columns // 2] == pytest.approx(-1.0, abs=0.2)
    assert set(found[0]) | set(found[:, -1]) == {0.0}


def test_the_box_of_what_casts_shadows_loses_none():
    rng, size = np.random.default_rng(5), (9.0, 12.0)
    y, x = np.mgrid[-6:6:121j, -4.5:4.5:91j]
    shaded = 0
    for middle in ((0.0, 0.0), (2.0, -3.0), (-4.0, 5.5)):  # the last at the grid's corner
        dent = -0.8 * np.exp(-((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / 0.5)
        terrain = Terrain.of(dent, size, np.zeros_like(dent))
        everywhere = terrain._replace(extent=np.array([terrain.extent[0], -np.inf, np.inf, -np.inf, np.inf]))
        for k in range(1500):
            row, column, turn = rng.integers(0, 121), rng.integers(0, 91), rng.uniform(0, 2 * np.pi)
            ray = (x[row, column], y[row, column], dent[row, column], np.cos(turn), np.sin(turn), rng.uniform(1, 15))
            asked = EVER if k % 2 else (-0.2, -0.05)
            found = horizon(terrain, *ray, asked, asked)
            assert found == pytest.approx(horizon(everywhere, *ray, asked, asked), rel=1e-12)
            shaded += found < asked[1]
    assert shaded > 300


def test_horizons_of_the_untouched_face_are_tabulated_and_go_on_linearly_above_it():
    y, x = np.mgrid[-6:6:121j, -4.5:4.5:91j]
    dome = -(x * x + y * y) / 40
    terrain, middle, below = Terrain.of(dome, (9.0, 12.0)), np.array([[-7.0, 1.0, -2.0]]), -1.5
    face = dome[40, 60]
    places = np.array([[x[40, 60], y[40, 60], face]])
    levels, out = np.array([below, face + 0.3]), np.empty((2, 1, 1), np.float32)
    seen = *strip_light.shadowing(terrain), out
    runtime.call(strip_columns.untouched_horizons, (1,), places, levels, middle, *seen)
    made = out[:, 0, 0]
    way = middle[0, :2] - places[0, :2]
    reach = np.linalg.norm(way)
    at = {z: horizon(terrain, *places[0, :2], z, *(way / reach), reach, EVER, EVER) for z in (below, face - 0.5, face)}
    assert made[0] == pytest.approx(at[below], rel=1e-6)
    assert made[1] == pytest.approx(at[face] + (at[face] - at[face - 0.5]) * 0.3 / 0.5, rel=1e-6)


@pytest.mark.parametrize(("gloss", "dots"), [(0.0, False), (0.0, True), (0.3, False), (0.3, True)])
def test_the_coating_mixes_the_lights_of_the_strips(gloss: float, dots: bool):
    made = sensor(coating={"specular": gloss})
    everywhere = SamplingTolerance(1)
    direct = Direct(made, Sheet.over(made.gel, 0.2), dots, Untouched.of(made.gel), tolerance=everywhere)
    at = direct.view.look(BallDent(2.0, 1.0, (0.6, -0.4), Untouched.of(made.gel)))
    light = np.einsum("nki,kc->nci", direct.light(at), [led.light for led in made.leds])
    matt, coat = light[..., 0], made.coating
    bare = (1 - gloss) * matt * coat.albedo + (gloss * coating.METAL_REFLECTANCE * light[..., -1] if gloss else 0.0)
    painted = matt * made.markers.albedo if gloss else bare * made.markers.albedo / coating.white(coat)
    expected = (bare + at.paint * (painted - bare)).reshape(32, 40, 3)
    assert bool((at.paint > 0).any()) is dots
    assert direct.seen(at) == pytest.approx(expected, rel=1e-12)


def test_sensors_that_differ_in_radiance_or_dots_share_a_table_and_others_do_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, usual = [], strip_light_table.Columns.of
    monkeypatch.setattr(strip_light_table.Columns, "of", lambda *asked: made.append(asked) or usual(*asked))
    file = sensor()
    sheet, untouched = Sheet.over(file.gel, 0.5), Untouched.of(file.gel)
    bright = tuple(led.model_copy(update={"power": 2.0}) for led in file.leds)
    moved = tuple(led.model_copy(update={"center_mm": (*led.center_mm[:2], -1.0)}) for led in file.leds)
    changes = {}, {"leds": bright}, {"markers": None}, {"leds": moved}
    plain, twice, bare, other = (
        Direct(file.model_copy(update=change), sheet, False, untouched).radiance(untouched) for change in changes
    )
    assert len(made) == 2
    assert twice == pytest.approx(2 * plain, rel=1e-12)
    assert np.array_equal(bare, plain)
    assert np.abs(other - plain).max() > 0.01 * plain.max()
