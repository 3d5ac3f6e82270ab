"""Lights in Mitsuba: their radiance by direction, the power they give off, what they cost, and which are sampled."""

import time

import numpy as np
import pytest
from helpers.tiny import PLAIN, sensor

from tacgen.optics import camera_response, mitsuba_dicts
from tacgen.optics.hertz_dent import BallDent
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.recipe import assets, loading
from tacgen.render import mitsuba_path, mitsuba_variants, traced_maps
from tacgen.render.mitsuba_path import PathTracer, mitsuba, realise

LIGHT, SIZE = (3.0, 2.0, 1.0), (1.2, 0.4)
PLACE = {"center_mm": [0.3, -0.2, -0.6], "normal": [0.6, 0.2, -0.5]}


def lit(lobe, **led):
    strip = {**PLAIN["leds"][0], **PLACE, "size_mm": SIZE, "radiance": LIGHT, "see_through": True, **led}
    return sensor(leds=[{**strip, "lobe": lobe}])


def scene(lobe, **more):
    mi = mitsuba(mitsuba_variants.SCALAR)
    made = {"type": "scene", **mitsuba_dicts.lights(lit(lobe)), **more}
    return mi, mi.load_dict(realise(mi, made), parallel=False, optimize=False)


@pytest.mark.parametrize("lobe", [0, 1, 3, 8, 32])
def test_radiance_falls_as_the_power_of_the_cosine_and_is_dark_behind(lobe):
    mi, made = scene(lobe)
    along, up, normal = mitsuba_dicts.frame(PLACE["normal"], [0, 0, 1]).T
    for angle in (0.0, 1.0, 20.0, 45.0, 70.0, 89.0, 91.0, 135.0, 180.0):
        for turn in (0.0, 1.0, 4.0):
            a = np.radians(angle)
            toward = np.cos(a) * normal + np.sin(a) * (np.cos(turn) * along + np.sin(turn) * up)
            start = np.array(PLACE["center_mm"]) + 0.1 * along + 5 * toward
            hit = made.ray_intersect(mi.Ray3f(mi.Point3f(start.tolist()), mi.Vector3f((-toward).tolist())))
            seen = np.array(hit.emitter(made).eval(hit)) / LIGHT
            assert seen == pytest.approx(max(np.cos(a), 0.0) ** lobe if angle < 90 else 0.0, abs=5e-6)


@pytest.mark.parametrize("lobe", [0, 3, 8])
def test_a_light_gives_off_the_power_of_its_lobe(lobe):
    """On a sphere around it arrives 2 pi / (lobe + 2) of radiance times area."""
    meter = {
        "type": "irradiancemeter",
        "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
    }
    black = {"type": "diffuse", "reflectance": 0.0}
    ball = {"type": "sphere", "center": PLACE["center_mm"], "flip_normals": True, "bsdf": black, "meter": meter}
    mi, made = scene(lobe, ball=ball, integrator={"type": "volpath", "max_depth": 3})
    arrived = np.array(mi.render(made, spp=300_000, seed=1)).ravel() * 4 * np.pi
    assert arrived == pytest.approx(np.array(LIGHT) * SIZE[0] * SIZE[1] * 2 * np.pi / (lobe + 2), rel=0.03)


def python_lobe(mi):
    """The plain formula as an emitter, called for each ray."""

    class Formula(mi.Emitter):
        def __init__(self, props):
            super().__init__(props)
            self.lobe, self.light = int(props["lobe"]), mi.Color3f(*(props[c] for c in "rgb"))

        def eval(self, si, active=True):
            return self.light * max(mi.Frame3f.cos_theta(si.wi), 0.0) ** self.lobe

        def sample_direction(self, it, sample, active=True):
            nowhere = mi.DirectionSample3f()
            nowhere.p, nowhere.d, nowhere.dist, nowhere.pdf = it.p, mi.Vector3f(0, 0, 1), 1.0, 0.0
            return nowhere, mi.Color3f(0.0)

        def pdf_direction(self, it, ds, active=True):
            return mi.Float(0.0)

    return Formula


@pytest.mark.parametrize("name", ["gelsight_mini", "digit"])
def test_pictures_are_those_of_the_formula(name, monkeypatch):
    """With the same random numbers, so the difference has no noise: PSNR of the pictures, and mean light."""
    made = traced_maps.zoomed(loading.read_sensor(assets.sensor_path(name))[0], 40)
    sheet, untouched = Sheet.over(made.gel, 0.4), Untouched.of(made.gel)

    def plain(radiance, lobe):
        return {"type": "formula", "lobe": lobe, **dict(zip("rgb", radiance, strict=True))}

    def picture():
        tracer = PathTracer(made, sheet, False, mitsuba_variants.SCALAR)
        return tracer.radiance(BallDent(4.0, 1.5, face=untouched), 24, 1)

    native = picture()
    monkeypatch.setattr(mitsuba_dicts, "lobed", plain)
    mi = mitsuba(mitsuba_variants.SCALAR)
    mi.register_emitter("formula", python_lobe(mi))
    formula = picture()
    assert native.mean((0, 1)) == pytest.approx(formula.mean((0, 1)), rel=1e-4)
    lights = [camera_response.expose(one, made.camera) for one in (native, formula)]
    off = np.subtract(*(camera_response.encoded(light, made.camera) for light in lights))
    assert -10 * np.log10(np.mean(off**2)) > 100  # dB


@pytest.mark.slow
def test_light_of_a_lobe_takes_no_longer_than_even_light():
    """It took six times as long while each ray called Python."""
    seconds = []
    for lobe in (0, 8):
        made = sensor(leds=[{**led, "lobe": lobe, "see_through": True} for led in PLAIN["leds"]])
        tracer = PathTracer(made, Sheet.over(made.gel, 0.5), False, mitsuba_variants.SCALAR)
        tracer.radiance(Untouched(), 1, 0)
        tries = []
        for k in range(3):
            started = time.process_time()
            tracer.radiance(Untouched(), 64, k)
            tries.append(time.process_time() - started)
        seconds.append(min(tries))
    assert seconds[1] < 2.5 * seconds[0] + 0.02


def test_only_even_lights_before_any_interface_are_sampled():
    """From the coated face straight lines lead to them alone; some emitter must always have a weight."""

    def weights(made):
        lights = mitsuba_dicts.lights(made)
        return {name: shape["emitter"].get("sampling_weight", 1.0) for name, shape in lights.items()}

    assert weights(lit(0)) == {"led_0": 1.0}
    assert weights(lit(3)) == {"led_0": 0.0, "unlit": 1.0}
    deep = {"center_mm": [0, 0, -4.0]}  # in the plate, of another index than the gel
    assert weights(lit(0, **deep)) == {"led_0": 0.0, "unlit": 1.0}
    same = lit(0, **deep).model_copy(update={"plate": lit(0).plate.model_copy(update={"refractive_index": 1.41})})
    assert weights(same) == {"led_0": 1.0}
    assert mitsuba_dicts.lights(traced_maps.lit_by(lit(3), set())).keys() == {"led_0"}


@pytest.mark.parametrize("index", [1.41, 1.49])
def test_sampling_lights_changes_no_picture_but_its_noise(index, monkeypatch):
    made = sensor(plate={"refractive_index": index})
    light = []
    for sampled in (True, False):
        monkeypatch.setattr(mitsuba_dicts, "in_sight", lambda *_, sampled=sampled: sampled)
        tracer = PathTracer(made, Sheet.over(made.gel, 0.5), False, mitsuba_variants.SCALAR)
        light.append([tracer.radiance(Untouched(), 48, k).mean((0, 1)) for k in range(3)])
    noise = np.std(light, axis=1).max(0) * np.sqrt(2 / 3)
    assert (np.abs(np.subtract(*np.mean(light, axis=1))) < 5 * noise + 1e-3 * np.mean(light)).all()


def test_many_paths_are_traced_in_parts_where_all_at_once_would_fill_the_memory(monkeypatch):
    """Compiled variants hold all paths of a pass at once; the scalar one stands for them here."""
    made = sensor()
    tracer = PathTracer(made, Sheet.over(made.gel, 0.5), False, mitsuba_variants.SCALAR)
    whole, sizes, render = tracer.radiance(Untouched(), 36, 1), [], tracer._mi.render

    def counted(scene, spp, seed):
        sizes.append((spp, seed))
        return render(scene, spp=spp, seed=seed)

    monkeypatch.setattr(tracer._mi, "render", counted)
    assert np.array_equal(tracer.radiance(Untouched(), 36, 1), whole)
    monkeypatch.setattr(mitsuba_path, "LANES", 10 * 40 * 32)
    monkeypatch.setattr(tracer, "variant", "compiled")
    monkeypatch.setattr(tracer._mi, "set_variant", lambda _: None)
    parts = tracer.radiance(Untouched(), 36, 1)
    assert [spp for spp, _ in sizes] == [36, 9, 9, 9, 9]
    assert len({seed for _, seed in sizes}) == 5
    assert parts.mean() == pytest.approx(whole.mean(), rel=0.02)
    assert not np.array_equal(parts, whole)


@pytest.mark.parametrize(("spp", "paths"), [(1, 1), (2, 2), (16, 16), (32, 35), (37, 42), (4096, 4096)])
def test_paths_a_pixel_are_a_product_so_that_mitsuba_need_not_warn(spp, paths, capfd):
    assert mitsuba_path.stratified(spp) == paths
    made = sensor()
    PathTracer(made, Sheet.over(made.gel, 2.0), False, mitsuba_variants.SCALAR).radiance(Untouched(), min(spp, 64), 0)
    assert capfd.readouterr() == ("", "")


def test_pictures_are_the_same_at_any_thread_count():
    import drjit as dr

    made = lit(3)
    tracer = PathTracer(made, Sheet.over(made.gel, 0.5), False, mitsuba_variants.SCALAR)
    before, pictures = dr.thread_count(), []
    try:
        for threads in (1, 2, 3):
            dr.set_thread_count(threads)
            pictures.append(tracer.radiance(Untouched(), 12, 5))
    finally:
        dr.set_thread_count(before)
    assert pictures[0].max() > 0
    assert np.array_equal(pictures[0], pictures[1])
    assert np.array_equal(pictures[0], pictures[2])


def test_a_rectangle_is_mitsubas_own_without_texture_coordinates() -> None:
    mi, node = mitsuba(mitsuba_variants.SCALAR), mitsuba_dicts.lights(lit(0))["led_0"]
    turned = mi.ScalarTransform4f(node["to_world"].tolist())
    own, made = mi.load_dict({"type": "rectangle", "to_world": turned}), realise(mi, node)
    assert (made.has_vertex_texcoords(), made.has_vertex_normals()) == (False, False)
    assert made.surface_area() == pytest.approx(own.surface_area()) == pytest.approx(SIZE[0] * SIZE[1])
    assert np.ravel([made.bbox().min, made.bbox().max]) == pytest.approx(
        np.ravel([own.bbox().min, own.bbox().max]), abs=1e-6
    )
    scenes = [mi.load_dict({"type": "scene", "shape": one}) for one in (own, made)]
    away = np.array(mitsuba_dicts.frame(PLACE["normal"], [0, 0, 1])[:, 2])
    ray = mi.Ray3f(mi.Point3f((PLACE["center_mm"] + away).tolist()), mi.Vector3f((-away).tolist()))
    normals = [np.array(one.ray_intersect(ray).n) for one in scenes]
    assert normals[1] == pytest.approx(away, abs=1e-6)
    assert normals[1] == pytest.approx(normals[0], abs=1e-6)
    assert made.emitter() is not None


@pytest.mark.slow
def test_texture_coordinates_of_the_face_keep_its_stratified_directions_stratified(monkeypatch) -> None:
    """They turn the frame in which directions are sampled; without, each triangle has a frame of its own."""
    own, noise = mitsuba_path.mesh, []
    for kept in (True, False):
        tracer = PathTracer(sensor(), Sheet.over(sensor().gel, 0.1), False, mitsuba_variants.SCALAR)
        shapes = tracer._scene.shapes()
        assert {shape.id() for shape in shapes if shape.has_vertex_texcoords()} == ({"face"} if kept else set())
        assert {shape.id() for shape in shapes if shape.has_vertex_normals()} == {"face"}
        pictures = np.array([tracer.radiance(Untouched(), 64, k) for k in range(4)])
        noise.append(np.sqrt(pictures.var(0, ddof=1).mean()))
        monkeypatch.setattr(mitsuba_path, "mesh", lambda *parts, smooth=False: own(*parts[:4], smooth=smooth))
    assert noise[1] > 1.05 * noise[0]
