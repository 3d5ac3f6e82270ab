"""LEDs, walls and clear interfaces as plain dictionaries: a renderer's rectangle is the square [-1, 1]^2, +z its front.

`to_world` is a 4 x 4 array here, and a bitmap one of (rows, columns, channels); the renderer's own home turns them into
the renderer's types.
"""

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from tacgen.optics.housing import WALL_RISE_MM, Floats, bottom_depth, frame, outline

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from tacgen.sensor.layers import Scattering
    from tacgen.sensor.model import Led, LitSensor

LOBE_ROWS = 4097  # latitudes at which a lobe is tabulated; interpolation is off by 3e-6 of the peak at most
TOUCHING_TOL_MM = 1e-6  # distance at which an LED lies in the plate's air face [mm]
OUTSIDE_HOUSING = (0.0, 0.0, 1e3)  # a place outside every housing [mm]


def rectangle(
    center: "Sequence[float]", normal: "Sequence[float]", up: "Sequence[float]", size: tuple[float, float]
) -> Floats:
    """Matrix (4, 4) that takes the unit square to a rectangle of `size` (along, up) [mm] facing `normal`."""
    matrix = np.eye(4)
    matrix[:3, :3] = frame(normal, up) * [size[0] / 2, size[1] / 2, 1.0]
    matrix[:3, 3] = center
    return matrix


def diffuse(albedo: "float | Sequence[float]") -> dict[str, Any]:
    """A Lambertian surface."""
    rgb = [float(albedo)] * 3 if isinstance(albedo, float | int) else [float(a) for a in albedo]
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": rgb}}


def absorbing(bsdf: dict[str, Any]) -> dict[str, Any]:
    """A Lambertian surface (see diffuse) that ends the absorbed share of the paths, and lets the others continue with
    undiminished light; other BSDFs are returned unchanged. The mean is the same; no time goes into long, dim paths.

    Paths end at an interface between equal media, which reflects nothing and is set to transmit nothing. A lobe that
    reflects would add light: Mitsuba weights each direction by all lobes that lead there.
    """
    if bsdf["type"] != "diffuse" or not (most := max(bsdf["reflectance"]["value"])):
        return bsdf
    black = {"specular_reflectance": 0.0, "specular_transmittance": 0.0}
    return {
        "type": "blendbsdf",
        "weight": most,
        "ends": {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.0, **black},
        "goes_on": diffuse([albedo / most for albedo in bsdf["reflectance"]["value"]]),
    }


def lights(sensor: "LitSensor") -> dict[str, dict[str, Any]]:
    """The LED strips by name.

    A renderer that samples directions toward emitters finds none behind an interface that refracts; such LEDs, and
    those with a lobe, have no weight among the sampled emitters. Rays that meet them see them all the same.
    """
    weights = [not light.lobe and in_sight(sensor, light) for light in sensor.leds]
    made = {f"led_{i}": led(sensor, light, weights[i]) for i, light in enumerate(sensor.leds)}
    lit = [any(light.light) for light in sensor.leds]
    if any(lit) and not np.any(np.logical_and(weights, lit)):
        # one emitter must have a weight; this one is dark and costs no shadow rays
        made["unlit"] = {
            "type": "rectangle",
            "to_world": rectangle(OUTSIDE_HOUSING, (0, 0, 1), (0, 1, 0), (1.0, 1.0)),
            "bsdf": {"type": "null"},
            "emitter": {"type": "directionalarea", "radiance": 0.0},
        }
    return made


def in_sight(sensor: "LitSensor", light: "Led") -> bool:
    """Whether straight lines lead from the coated face to an LED's middle: all between has one refractive index."""
    layers = [sensor.plate, *sensor.gel.clear_layers]
    tops = np.cumsum([layer.thickness_mm for layer in layers]) - bottom_depth(sensor)
    return len({layer.refractive_index for layer, z in zip(layers, tops, strict=True) if z > light.center_mm[2]}) < 2


def led(sensor: "LitSensor", light: "Led", sampled: bool) -> dict[str, Any]:
    """One LED strip: it radiates from its front, and reflects as the walls do or, with `see_through`, lets light pass:
    as the plate's air face does if it lies in it, else as if nothing were there."""
    radiance = [float(v) for v in light.light]
    even = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    emitter = {**(lobed(radiance, light.lobe) if light.lobe else even), "sampling_weight": float(sampled)}
    clear = air_face(sensor) if in_air_face(sensor, light) else {"type": "null"}
    return {
        "type": "rectangle",
        "to_world": rectangle(light.center_mm, light.normal, light.up, light.size_mm),
        "bsdf": clear if light.see_through else wall(sensor),
        **({"emitter": emitter} if any(light.light) else {}),  # a dark one would only draw random numbers
    }


def in_air_face(sensor: "LitSensor", light: "Led") -> bool:
    """Whether an LED lies in the plate's air face, shines into the plate and has its sides along x and y."""
    axes = frame(light.normal, light.up)
    aligned = np.isclose(axes[2, 2], 1.0) and np.isclose(np.abs(axes[:2, :2]).max(), 1.0)
    return bool(aligned and np.isclose(light.center_mm[2], -bottom_depth(sensor), rtol=0, atol=TOUCHING_TOL_MM))


def air_face(sensor: "LitSensor") -> dict[str, Any]:
    """The interface to the air below the plate, whose front is the plate's side."""
    return {"type": "dielectric", "int_ior": 1.0, "ext_ior": sensor.plate.refractive_index}


def lobed(radiance: "Sequence[float]", lobe: int) -> dict[str, Any]:
    """Emitter of a rectangle whose radiance falls as cos^lobe of the angle to the normal.

    Mitsuba's area lights are Lambertian. Its environment map is a table of radiance by direction, which is looked up in
    the shape's own frame if it hangs on a shape. Directions sampled toward an environment lead past the shape, so it
    must not be sampled: see lights.
    """
    angles = np.pi * np.arange(LOBE_ROWS) / (LOBE_ROWS - 1)  # latitudes from the normal
    falloff = np.where(angles < np.pi / 2, np.cos(angles), 0.0) ** lobe
    to_map = np.eye(4)
    to_map[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # its pole is +y, its directions run from the viewer
    return {
        "type": "envmap",
        "bitmap": np.repeat(falloff[:, None, None] * radiance, 2, axis=1),
        "to_world": to_map,
    }


def housing(sensor: "LitSensor") -> dict[str, dict[str, Any]]:
    """The dark walls around gel and plate, from the plate's air face past the coated face."""
    bottom = -bottom_depth(sensor)
    middle, tall = (WALL_RISE_MM + bottom) / 2, WALL_RISE_MM - bottom
    corners, walls = outline(sensor), {}
    for k, (a, b) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        length = float(np.linalg.norm(b - a))
        inward = (float(a[1] - b[1]) / length, float(b[0] - a[0]) / length, 0.0)
        center = (*((a + b) / 2).tolist(), middle)
        walls[f"wall_{k}"] = {
            "type": "rectangle",
            "to_world": rectangle(center, inward, (0, 0, 1), (length, tall)),
            "bsdf": wall(sensor),
        }
    return walls


def wall(sensor: "LitSensor") -> dict[str, Any]:
    """The surface of the housing; in a gel that scatters it ends the paths that it absorbs."""
    plain = diffuse(sensor.walls.albedo)
    return absorbing(plain) if scatters(sensor) else plain


def scatters(sensor: "LitSensor") -> bool:
    """Whether a clear layer has particles."""
    return any(layer.scattering for layer in sensor.gel.clear_layers)


def interfaces(sensor: "LitSensor") -> dict[str, dict[str, Any]]:
    """Interfaces from the air inward; none between equal media. An LED that lies in the plate's air face takes the
    place of that part of it: paths then meet one surface there instead of two."""
    w, h = (size + 2 * sensor.walls.margin_mm for size in (sensor.gel.width_mm, sensor.gel.height_mm))
    z, outside, around, made = -bottom_depth(sensor), 1.0, None, {}
    sampled = any(not light.lobe and in_sight(sensor, light) for light in sensor.leds)
    holes = [light for light in sensor.leds if in_air_face(sensor, light)]
    bodies = [
        ("plate", sensor.plate.thickness_mm, sensor.plate.refractive_index, None),
        *((x.name, x.thickness_mm, x.refractive_index, x.scattering) for x in sensor.gel.clear_layers),
    ]
    for name, thickness, index, scattering in bodies:
        if index != outside or scattering != around:
            bends = {"type": "dielectric", "int_ior": outside, "ext_ior": index}
            shared = {
                "type": "rectangle",
                "bsdf": bends if index != outside else {"type": "null"},
                **({"interior": medium(around, sampled)} if around else {}),
                **({"exterior": medium(scattering, sampled)} if scattering else {}),
            }
            for k, (x, y, *size) in enumerate(pieces(w, h, holes if name == "plate" else [])):
                place = rectangle((x, y, z), (0, 0, 1), (0, 1, 0), (size[0], size[1]))
                made[f"into_{name}_{k}" if k else f"into_{name}"] = {**shared, "to_world": place}
        z, outside, around = z + thickness, index, scattering
    return made


def pieces(w: float, h: float, holes: "Sequence[Led]") -> "Iterator[tuple[float, float, float, float]]":
    """Middle and size (x, y, width, height) [mm] of the rectangles that cover a face of w x h around LEDs in it."""
    middles = np.array([light.center_mm[:2] for light in holes]).reshape(-1, 1, 2)
    sides = np.array([np.abs(frame(x.normal, x.up)[:2, :2]) @ x.size_mm for x in holes]).reshape(-1, 1, 2)
    ends = middles + sides * [[-0.5], [0.5]]  # (leds, 2 ends, x and y)
    x, y = (np.unique(np.round([-s / 2, s / 2, *ends[..., k].flat], 9)) for k, s in enumerate((w, h)))
    for left, right in pairwise(x.tolist()):
        for top, bottom in pairwise(y.tolist()):
            at = (left + right) / 2, (top + bottom) / 2
            if not np.any(np.all(np.abs(at - middles[:, 0]) < sides[:, 0] / 2, axis=1)):
                yield *at, right - left, bottom - top


def medium(scattering: "Scattering", sampled: bool) -> dict[str, Any]:
    """The inside of a layer with particles; whether directions toward LEDs are sampled there."""
    phase = {"type": "hg", "g": scattering.forward} if scattering.forward else {"type": "isotropic"}
    return {
        "type": "homogeneous",
        "sigma_t": scattering.extinction_per_mm,
        "albedo": {"type": "rgb", "value": list(scattering.albedo)},
        "phase": phase,
        "sample_emitters": sampled,
        "has_spectral_extinction": False,  # one extinction for all colours needs no weights
    }
