"""Lights of a narrow lobe in Mitsuba: their radiance by direction, the power they give off, and what they cost."""

import time

import numpy as np
import pytest
from helpers.tiny import PLAIN, sensor

from tacgen.optics import mitsuba_dicts
from tacgen.optics.surface_grid import Sheet, Untouched
from tacgen.render import mitsuba_variants
from tacgen.render.mitsuba_path import PathTracer, mitsuba, realise
from tacgen.sensor.model import Led

LIGHT, SIZE = (3.0, 2.0, 1.0), (1.2, 0.4)
PLACE = {"center_mm": [0.3, -0.2, 0.1], "normal": [0.6, 0.2, -0.5]}


def strip(lobe: int) -> Led:
    made = {**PLAIN["leds"][0], **PLACE, "size_mm": SIZE, "radiance": LIGHT, "lobe": lobe, "see_through": True}
    return Led.model_validate(made)


def scene(lobe, **more):
    mi = mitsuba(mitsuba_variants.SCALAR)
    made = {"type": "scene", **mitsuba_dicts.lights([strip(lobe)], 0.0), **more}
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
    """What arrives on a sphere around it: 2 pi / (lobe + 2) of radiance times area."""
    meter = {
        "type": "irradiancemeter",
        "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
    }
    black = {"type": "diffuse", "reflectance": 0.0}
    ball = {"type": "sphere", "radius": 1.6, "flip_normals": True, "bsdf": black, "meter": meter}
    mi, made = scene(lobe, ball=ball, integrator={"type": "volpath", "max_depth": 3})
    arrived = np.array(mi.render(made, spp=300_000, seed=1)).ravel() * 4 * np.pi * 1.6**2
    assert arrived == pytest.approx(np.array(LIGHT) * SIZE[0] * SIZE[1] * 2 * np.pi / (lobe + 2), rel=0.03)


def test_light_of_a_lobe_takes_no_longer_than_even_light():
    """It took six times as long while each ray called Python."""
    seconds = []
    for lobe in (0, 8):
        made = sensor(leds=[{**led, "lobe": lobe, "see_through": True} for led in PLAIN["leds"]])
        tracer = PathTracer(made, Sheet.over(made.gel, 0.5), False, mitsuba_variants.SCALAR)
        tracer.radiance(Untouched(), 1, 0)
        started = time.process_time()
        tracer.radiance(Untouched(), 64, 1)
        seconds.append(time.process_time() - started)
    assert seconds[1] < 1.5 * seconds[0] + 0.05
