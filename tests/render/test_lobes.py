"""Lights in Mitsuba: their radiance by direction, the power they give off, what they cost, and which are sampled."""

import numpy as np
import pytest
from helpers.tiny import PLAIN, sensor

from tacgen.optics import mitsuba_dicts
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.render import mitsuba_path, traced_maps
from tacgen.render.mitsuba_path import PathTracer, mitsuba, realise
from tacgen.render.mitsuba_variants import SCALAR_VARIANT

LIGHT, SIZE = (3.0, 2.0, 1.0), (1.2, 0.4)
PLACE = {"center_mm": [0.3, -0.2, -0.6], "normal": [0.6, 0.2, -0.5]}


def lit(lobe, **led):
    strip = {**PLAIN["leds"][0], **PLACE, "size_mm": SIZE, "radiance": LIGHT, "see_through": True, **led}
    return sensor(leds=[{**strip, "lobe": lobe}])


def scene(lobe, **more):
    mi = mitsuba(SCALAR_VARIANT)
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
        tracer = PathTracer(made, Sheet.over(made.gel, 0.5), False, SCALAR_VARIANT)
        light.append([tracer.radiance(Untouched(), 48, k).mean((0, 1)) for k in range(3)])
    noise = np.std(light, axis=1).max(0) * np.sqrt(2 / 3)
    assert (np.abs(np.subtract(*np.mean(light, axis=1))) < 5 * noise + 1e-3 * np.mean(light)).all()


def test_many_paths_are_traced_in_parts_where_all_at_once_would_fill_the_memory(monkeypatch):
    """Compiled variants hold all paths of a pass at once; the scalar one stands for them here."""
    made = sensor()
    tracer = PathTracer(made, Sheet.over(made.gel, 0.5), False, SCALAR_VARIANT)
    whole, sizes, render = tracer.radiance(Untouched(), 36, 1), [], tracer._mi.render

    def counted(scene, spp, seed):
        sizes.append((spp, seed))
        return render(scene, spp=spp, seed=seed)

    monkeypatch.setattr(tracer._mi, "render", counted)
    assert np.array_equal(tracer.radiance(Untouched(), 36, 1), whole)
    monkeypatch.setattr(mitsuba_path, "MAX_TRACED_PATHS", 10 * 40 * 32)
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
    PathTracer(made, Sheet.over(made.gel, 2.0), False, SCALAR_VARIANT).radiance(Untouched(), min(spp, 64), 0)
    assert capfd.readouterr() == ("", "")
