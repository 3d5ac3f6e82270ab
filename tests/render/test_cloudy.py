"""A gel that scatters: its transport against volpath, its cache, and the fitted response."""

import numpy as np
import pytest
from helpers.tiny import cloudy as sensor
from scipy.ndimage import gaussian_filter

from tacgen.optics import coating, mitsuba_dicts, scattering
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.recipe import assets, loading
from tacgen.render import images, mitsuba_path, traced_maps
from tacgen.render.mitsuba_path import PathTracer
from tacgen.render.mitsuba_variants import SCALAR_VARIANT
from tacgen.sensor.model import Sensor

FACE = Untouched.of(sensor().gel)
DENT = BallDent(2.5, 1.6, (0.5, -0.4), FACE)


pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def renderer():
    return images.Renderer(sensor(), spp=6, seed=0, markers=False, variant=SCALAR_VARIANT)


def test_the_camera_sees_the_inner_side_of_the_skin():
    assert FACE.at([[0.0, 0.0], [3.0, 1.0]])[:, 2] == pytest.approx(-0.3)


@pytest.mark.slow
def test_transport_agrees_with_volpath_within_its_noise(renderer):
    tracer = PathTracer(sensor(), renderer.sheet, False, SCALAR_VARIANT)
    halves = np.array([tracer.radiance(DENT, 192, seed) for seed in (1, 2)])
    truth, image = halves.mean(axis=0), renderer.image(DENT)
    assert image.mean() == pytest.approx(truth.mean(), rel=0.03)
    made, first, second = (a.reshape(8, 4, 10, 4, 3).mean(axis=(1, 3)) for a in (image, *halves))
    noise = np.mean((first - second) ** 2) / 4
    assert np.sqrt(max(np.mean((made - (first + second) / 2) ** 2) - noise, 0.0)) < 0.04 * truth.mean()
    dark = (image / renderer.flat()).mean(axis=2)
    assert dark.min() < 0.85  # so the agreement says something of the dent
    y, x = np.mgrid[:32, :40] + 0.5
    near = np.hypot(x - 22.5, y - 14) < 4
    assert image[near].mean() == pytest.approx(truth[near].mean(), rel=0.06)


@pytest.mark.slow
def test_maps_are_cached_by_optics_and_not_by_mechanics(renderer, monkeypatch):
    monkeypatch.setattr(traced_maps, "PathTracer", None)  # any tracing now would fail
    data = sensor().model_dump()
    data["gel"]["layers"][0]["youngs_modulus_mpa"] = 9.0
    again = images.Renderer(Sensor.model_validate(data), 6, 5, False, SCALAR_VARIANT)
    assert np.array_equal(again.image(DENT), renderer.image(DENT))
    with pytest.raises(TypeError):
        images.Renderer(sensor(walls={"albedo": 0.3}), 6, 0, False, SCALAR_VARIANT)


def test_light_that_varies_alone_is_not_traced_again(monkeypatch):
    """Power and colour of each LED, exposure, stray light, vignette and noise: all of it linear."""
    panel = sensor().leds[0].model_dump()
    left, right = ({**panel, "center_mm": (x, 0, -4.35), "size_mm": (6, 10)} for x in (-3, 3))
    images.Renderer(sensor(leds=[left, right]), 1, 0, False, SCALAR_VARIANT)
    monkeypatch.setattr(traced_maps, "PathTracer", None)  # any tracing now would fail
    grain = {"shot": 1e-4, "read": 0.002, "source": "test"}
    other = sensor(
        leds=[{**left, "power": 1.3}, {**right, "radiance": (1, 2, 3), "power": 0.5}],
        camera={"exposure": 0.7, "ambient": 0.01, "vignette_mm": 12.0, "noise": grain},
    )
    again = images.Renderer(other, 1, 0, False, SCALAR_VARIANT)
    alone = [images.Renderer(sensor(leds=leds), 1, 0, False, SCALAR_VARIANT).light for leds in
             ([{**left, "power": 1.3}, {**right, "power": 0}], [{**left, "power": 0}, {**right, "radiance": (1, 2, 3),
              "power": 0.5}])]  # fmt: skip
    assert again.light.scattered == pytest.approx(alone[0].scattered + alone[1].scattered, rel=1e-9)
    assert alone[0].scattered[:, :10].mean() > 1.2 * alone[0].scattered[:, -10:].mean()
    with pytest.raises(TypeError):
        images.Renderer(sensor(leds=[left, {**right, "center_mm": (3, 0.1, -4.35)}]), 1, 0, False, SCALAR_VARIANT)


@pytest.mark.slow
def test_leds_that_are_traced_together_are_as_traced_alone(monkeypatch):
    panel = sensor().leds[0].model_dump()
    four = sensor(leds=[{**panel, "center_mm": (x, 0, -4.35), "size_mm": (3, 10)} for x in (-4.5, -1.5, 1.5, 4.5)])
    together = traced_maps.scattered(four, 3, SCALAR_VARIANT).alone
    monkeypatch.setattr(traced_maps, "grey", lambda sensor: False)
    monkeypatch.setattr(traced_maps, "SCATTERED_VERSION", -1)  # of another entry in the cache
    alone = traced_maps.scattered(four, 3, SCALAR_VARIANT).alone
    assert together.shape == alone.shape == (4, 32, 40, 3)
    for one, other in zip(together, alone, strict=True):
        assert one.mean() == pytest.approx(other.mean(), rel=0.03)
        assert np.abs(one - other).mean() < 0.06 * other.mean()


def test_a_sensor_of_other_colours_is_not_grey():
    assert traced_maps.grey(sensor())
    assert not traced_maps.grey(sensor(coating={"albedo": [0.03, 0.03, 0.04], "specular": 0.0}))


def test_the_window_around_a_dent():
    there = np.zeros((30, 40), bool)
    assert traced_maps.around(there, 3) == (0, 0, 40, 30)
    there[10:14, 35:37] = True
    assert traced_maps.around(there, 3) == (32, 7, 8, 10)
    assert traced_maps.around(there, 9) == (26, 1, 14, 22)


def test_a_camera_may_look_past_the_gel():
    wide = sensor(camera={"mm_per_px": 3.0, "vignette_mm": None})
    made = images.Renderer(wide, 1, 0, False, SCALAR_VARIANT)
    image = made.image(DENT)
    assert np.isfinite(image).all()
    assert image[14:18, 18:22].mean() > 10 * image[:4].mean()


def test_a_dark_sensor_is_dark():
    assert (images.Renderer(sensor(leds=[{**sensor().leds[0].model_dump(), "power": 0}]), 1, 0, False,
                            SCALAR_VARIANT).image(DENT) == 0).all()  # fmt: skip


def test_a_cache_that_cannot_be_written_costs_nothing_but_time(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("TACGEN_CACHE_DIR", str(blocked))
    made = images.Renderer(sensor(), 1, 0, False, SCALAR_VARIANT)
    assert np.isfinite(made.flat()).all()


@pytest.mark.slow
def test_the_fitted_response_acts_on_thickness_alone(renderer):
    table = {"change_mm": (-2.0, 0.0, 0.5), "gain": ((0.2, 0.3, 0.4), (1, 1, 1), (1.5, 1.5, 1.5)), "source": "test"}
    with_it = images.Renderer(sensor(thickness_response=None), 6, 0, False, SCALAR_VARIANT)
    with_it.sensor = with_it.sensor.model_copy(
        update={"thickness_response": Sensor.model_fields["thickness_response"].annotation.__args__[0](**table)}
    )
    assert with_it.flat() == pytest.approx(renderer.flat(), rel=1e-6)
    share = with_it.image(DENT) / renderer.image(DENT)
    deepest = np.unravel_index(share[..., 0].argmin(), share.shape[:2])
    assert share[deepest][0] < share[deepest][1] < share[deepest][2] < 0.8


def test_brightness_rises_with_thickness_and_is_one_where_untouched():
    shares = np.array(scattering.THICKNESS_SHARES)
    noisy = (0.2 + 0.8 * shares**0.7)[:, None] * [1.0, 2.0, 3.0]
    bright = scattering.Brightness.through(shares, noisy)
    assert bright.at(np.ones(1)) == pytest.approx(np.ones((1, 3)), abs=1e-9)
    assert bright.at(np.array([0.5]))[0] == pytest.approx(0.2 + 0.8 * 0.5**0.7, rel=0.02)
    assert (np.diff(bright.at(np.linspace(0.05, 1.4, 50))[:, 0]) > 0).all()
    anywhere = np.random.default_rng(0).uniform(0.0, 1.6, 1000)
    assert bright.tabulated.at(anywhere) == pytest.approx(bright.at(anywhere), abs=2e-6)


def test_the_tabulated_gain_is_the_shipped_sensors_gain():
    response = loading.read_sensor(assets.sensor_path("ninedtact"))[0].thickness_response
    anywhere = np.append(np.random.default_rng(0).uniform(-2.5, 0.6, 1000), np.nan)
    assert scattering.tabulated(response).at(anywhere) == pytest.approx(scattering.gain(response, anywhere), abs=2e-6)


def test_light_feels_the_thickness_around():
    share = np.ones((40, 40))
    share[:, 20:] = 0.5
    assert scattering.averaged(share, 0.01) == pytest.approx(share)
    blurred = scattering.averaged(share, 3.0)
    assert 0.6 < blurred[20, 19] < 0.9
    y, x = np.mgrid[:121, :163]
    hole = np.where(np.hypot(x - 90, y - 40) < 20, 0.4, 1.0) - 0.001 * y
    for reach in (8.5, 16.0, 31.0):  # by blocks of 2, 4 and 7 pixels
        exact = gaussian_filter(hole, reach, mode="nearest", truncate=5.0)
        assert scattering.averaged(hole, reach) == pytest.approx(exact, abs=2e-3)
    bright = scattering.Brightness(np.array([0.1, 1.0]), np.array([[0.4] * 3, [1.0] * 3]))
    picture = bright.at(blurred.ravel()).reshape(40, 40, 3)
    assert scattering.fitted_reach(bright, share, 0.5, picture) == pytest.approx(1.5, rel=0.02)


@pytest.mark.parametrize("albedo", [(0.03, 0.03, 0.03), (0.5, 0.2, 0.1), (0.0, 0.0, 0.0)])
def test_a_skin_that_ends_the_paths_it_absorbs_reflects_as_much(albedo: tuple[float, ...]) -> None:
    mi = mitsuba_path.mitsuba(SCALAR_VARIANT)
    plain = mitsuba_dicts.diffuse(albedo)
    ending, whole = (mi.load_dict(mitsuba_path.realise(mi, one)) for one in (mitsuba_dicts.absorbing(plain), plain))
    at, context = mi.SurfaceInteraction3f(), mi.BSDFContext()
    at.wi = mi.Vector3f(0.6, 0.0, 0.8)
    points = (np.arange(200) + 0.5) / 200, ((0.1, 0.3), (0.7, 0.2), (0.4, 0.9))
    found = np.array([ending.sample(context, at, a, mi.Point2f(*b))[1] for a in points[0] for b in points[1]])
    assert found.mean(0) == pytest.approx(albedo, rel=1e-5)
    assert (found > 0).any(1).mean() == pytest.approx(max(albedo))
    away = mi.Vector3f(0.0, 0.6, 0.8)
    assert np.array(ending.eval(context, at, away)) == pytest.approx(np.array(whole.eval(context, at, away)))


def test_paths_end_at_skin_and_walls_where_they_are_long() -> None:
    clear = loading.read_sensor(assets.sensor_path("digit"))[0]
    for made, ends in ((sensor(), True), (clear, False)):
        scene, coat = mitsuba_path.description(made, Sheet.over(made.gel, 1.0), False)
        assert (coat != coating.bsdf(made.coating)) == ends
        assert (scene["wall_0"]["bsdf"] != mitsuba_dicts.diffuse(made.walls.albedo)) == ends


def panels(z: float) -> Sensor:
    """Two of unequal size and light above a face of 12 x 10 mm, one of them turned, with a gap around them."""
    panel = sensor().leds[0].model_dump()
    left = {**panel, "center_mm": (-3, 1, z), "size_mm": (4, 6), "radiance": (3, 1, 2)}
    right = {**panel, "center_mm": (2.5, -1, z), "size_mm": (5, 3), "up": (1, 0, 0)}
    return sensor(leds=[left, right])


def test_leds_in_the_air_face_take_its_place() -> None:
    made = panels(-4.3)
    scene, _ = mitsuba_path.description(made, Sheet.over(made.gel, 1.0), False)
    face = [v for k, v in scene.items() if k.startswith(("into_plate", "led_"))]
    assert all(one["bsdf"] == mitsuba_dicts.air_face(made) for one in face)
    x, y = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 1000, 1)) * [[[12.0]], [[10.0]]]
    places = np.array([one["to_world"] for one in face])
    middle, half = places[:, :2, 3], np.abs(places[:, :2, :2]).sum(axis=2)
    covers = (np.abs(x - middle[:, 0]) < half[:, 0]) & (np.abs(y - middle[:, 1]) < half[:, 1])
    assert (covers.sum(axis=1) == 1).all()
    assert {one["to_world"][2, 2] for one in face} == {1.0}
    assert {one["to_world"][2, 3] for one in face} == {-4.3}
    assert mitsuba_dicts.led(panels(-4.25), panels(-4.25).leds[0], False)["bsdf"] == {"type": "null"}
    assert [k for k in mitsuba_dicts.interfaces(panels(-4.25)) if k.startswith("into_plate")] == ["into_plate"]


@pytest.mark.slow
def test_light_from_the_air_face_is_that_of_leds_just_above_it() -> None:
    """It was traced so before, with two surfaces where there is one now."""
    light = []
    for z in (-4.3, -4.2999):
        tracer = PathTracer(panels(z), Sheet.over(sensor().gel, 1.0), False, SCALAR_VARIANT)
        light.append([tracer.radiance(FACE, 144, k).reshape(2, 16, 2, 20, 3).mean((1, 3)) for k in range(4)])
    noise = np.std(light, axis=1, ddof=1).mean() / np.sqrt(2)
    assert np.subtract(*np.mean(light, axis=1)) == pytest.approx(0.0, abs=5 * noise)
    assert 5 * noise < 0.05 * np.mean(light)


@pytest.mark.slow
def test_sampling_directions_toward_leds_changes_only_the_noise_of_a_gel_that_scatters(monkeypatch) -> None:
    """They are sampled where no interface refracts: a path that meets such an LED must not count it again."""
    even = panels(-4.3).model_copy(update={"plate": sensor(plate={"refractive_index": 1.41}).plate})
    light = []
    for sampled in (True, False):
        monkeypatch.setattr(mitsuba_dicts, "in_sight", lambda *_, sampled=sampled: sampled)
        assert mitsuba_dicts.interfaces(even)["into_base"]["exterior"]["sample_emitters"] == sampled
        tracer = PathTracer(even, Sheet.over(even.gel, 1.0), False, SCALAR_VARIANT)
        light.append([tracer.radiance(FACE, 64, k).mean() for k in range(4)])
    noise = np.std(light, axis=1, ddof=1).max() / np.sqrt(2)
    assert np.subtract(*np.mean(light, axis=1)) == pytest.approx(0.0, abs=5 * noise)
    assert 5 * noise < 0.05 * np.mean(light)


@pytest.mark.slow
def test_a_gel_that_scatters_looks_the_same_by_a_third_of_the_nodes_and_without_normals(monkeypatch) -> None:
    own, fine = mitsuba_path.mesh, Sheet.over(sensor().gel, mitsuba_path.SHEET_SPACING_MM)

    def traced(sheet: Sheet) -> np.ndarray:
        tracer = PathTracer(sensor(), sheet, False, SCALAR_VARIANT)
        face = next(shape for shape in tracer._scene.shapes() if shape.id() == "face")
        assert face.has_vertex_normals() == (sheet == fine)
        return tracer.radiance(DENT, 256, 1).reshape(8, 4, 10, 4, 3).mean((1, 3))  # the same random numbers

    coarse = traced(mitsuba_path.traced_sheet(sensor()))
    monkeypatch.setattr(mitsuba_path, "mesh", lambda *parts, **more: own(*parts, **dict.fromkeys(more, True)))
    exact = traced(fine)
    assert coarse == pytest.approx(exact, rel=0.02)
    assert coarse.mean() == pytest.approx(exact.mean(), rel=1e-3)
    picture = images.Renderer(sensor(), 144, 0, False, SCALAR_VARIANT, "path").image(DENT)
    assert picture.mean() == pytest.approx(exact.mean(), rel=0.02)
    assert len(mitsuba_path.traced_sheet(sensor()).rest) < len(fine.rest) / 8
    clear = loading.read_sensor(assets.sensor_path("digit"))[0]
    assert mitsuba_path.traced_sheet(clear) == Sheet.over(clear.gel, mitsuba_path.SHEET_SPACING_MM)
