"""Extreme scenes, named and random, each as changes to the scene PLAIN."""

from collections.abc import Sequence

Sets = tuple[str, ...]

PLAIN = (
    "outputs=[force]",
    "indenter={shape: sphere, radius_mm: 4}",
    "trajectory=[{press: {depth_mm: 1.0, frames: 2}}, {slide: {x_mm: 0.4, frames: 1}}]",
    "contact.friction=0.6",
    "quality={edge_mm: 0.8, dhat_mm: 0.05}",
)
SKINNED = ("sensor=ninedtact", "trajectory=[{press: {depth_mm: 0.6, frames: 2}}, {slide: {x_mm: 0.4, frames: 1}}]")
MEDIUM = "quality={edge_mm: 0.4, dhat_mm: 0.03}"
FINE = "quality={edge_mm: 0.2, dhat_mm: 0.02}"
SHALLOW = "trajectory=[{press: {depth_mm: 0.3, frames: 2}}, {slide: {x_mm: 0.2, frames: 1}}]"
JUMP = "trajectory=[{press: {depth_mm: 1.0, frames: 1}}, {slide: {x_mm: 6, frames: 1}}]"
DROP = "trajectory=[{press: {depth_mm: 1.2, frames: 1}}, {slide: {x_mm: 3, frames: 1}}]"


def _youngs(*moduli: float) -> Sets:
    return tuple(f"sensor.gel.layers[{i}].youngs_modulus_mpa={E}" for i, E in enumerate(moduli))


def _indenter(text: str) -> str:
    return f"indenter={{{text}}}"


CASES: dict[str, Sets] = {
    "1 kPa": _youngs(0.001),
    "100 MPa": _youngs(100),
    "nu 0": ("sensor.gel.layers[0].poissons_ratio=0",),
    "nu 0.4999": ("sensor.gel.layers[0].poissons_ratio=0.4999",),
    "half deep": ("trajectory=[{press: {depth_mm: 2.0, frames: 2}}]",),
    "three quarters deep at once": ("trajectory=[{press: {depth_mm: 3.0, frames: 1}}]",),
    "three quarters deep, nu 0.4999": (
        "trajectory=[{press: {depth_mm: 3.0, frames: 3}}]",
        "sensor.gel.layers[0].poissons_ratio=0.4999",
    ),
    "three quarters deep, then slid": (
        "trajectory=[{press: {depth_mm: 3.0, frames: 3}}, {slide: {x_mm: 2, frames: 2}}]",
    ),
    "punch three quarters deep": (
        _indenter("shape: cylinder, radius_mm: 3, fillet_mm: 0.3"),
        "trajectory=[{press: {depth_mm: 3.0, frames: 1}}]",
    ),
    "friction 0": ("contact.friction=0",),
    "friction 2": ("contact.friction=2",),
    "cone 30 deg, tip 0.1 mm": (_indenter("shape: cone, half_angle_deg: 30, tip_radius_mm: 0.1"),),
    "ball of 0.3 mm": (_indenter("shape: sphere, radius_mm: 0.3"), FINE, SHALLOW),
    "ball of 0.1 mm": (
        _indenter("shape: sphere, radius_mm: 0.1"),
        "quality={edge_mm: 0.1, dhat_mm: 0.01}",
        "trajectory=[{press: {depth_mm: 0.1, frames: 1}}]",
    ),
    "skin stiffer 1000:1": (*SKINNED, *_youngs(0.01, 10)),
    "skin softer 1000:1": (*SKINNED, *_youngs(10, 0.01)),
    "skin of 0.1 mm": (*SKINNED, "sensor.gel.layers[1].thickness_mm=0.1"),
    "skin of 0.1 mm, stiffer 1000:1": (*SKINNED, *_youngs(0.01, 10), "sensor.gel.layers[1].thickness_mm=0.1"),
    "jump across the pad": (JUMP,),
    "punch jumps across the pad": (_indenter("shape: cylinder, radius_mm: 2, fillet_mm: 0.3"), JUMP),
    "sharp wedge": (_indenter("shape: wedge, half_angle_deg: 30, tip_radius_mm: 0.1, length_mm: 8"),),
    "thin torus": (_indenter("shape: torus, radius_mm: 2.5, tube_radius_mm: 0.4"), MEDIUM, DROP),
    "thin rod": (_indenter("shape: capsule, radius_mm: 0.4, length_mm: 4"), MEDIUM, DROP),
    "needle": (_indenter("shape: capsule, radius_mm: 0.16, length_mm: 3"), FINE, SHALLOW),
    "needle on a coarse mesh": (_indenter("shape: capsule, radius_mm: 0.1, length_mm: 6"), DROP),
    "knife jumps": (
        _indenter("shape: wedge, half_angle_deg: 10, tip_radius_mm: 0.2, length_mm: 8"),
        "trajectory=[{press: {depth_mm: 1.5, frames: 1}}, {slide: {x_mm: 5, frames: 1}}]",
    ),
    "box twisted by 45 deg a frame": (
        _indenter("shape: box, size_x_mm: 5, size_y_mm: 3, fillet_mm: 0.4"),
        "trajectory=[{press: {depth_mm: 0.8, frames: 2}}, {twist: {angle_deg: 90, frames: 2}}]",
    ),
    "sphere spun by 180 deg": ("trajectory=[{press: {depth_mm: 1, frames: 1}}, {twist: {angle_deg: 180, frames: 1}}]",),
    "rough ball dragged, turned, hardly tilted": (
        _indenter("shape: sphere, radius_mm: 2.74"),
        "trajectory=[{press: {depth_mm: 0.8, frames: 2}}, {slide: {x_mm: 1.26, y_mm: 0.32, frames: 2}}, {twist:"
        " {angle_deg: 15.4, frames: 1}}, {tilt: {angle_deg: 0.18, axis_deg: 185, frames: 1}}]",
        "contact.friction=1.83",
        "sensor.gel.layers[0].poissons_ratio=0.376",
    ),
    "letters twisted": (
        _indenter("shape: mesh, file: letters"),
        "trajectory=[{press: {depth_mm: 0.5, frames: 1}}, {twist: {angle_deg: 10, frames: 2}}]",
    ),
    "ball of slivers": (_indenter("shape: mesh, file: {folder}/slivers.obj"),),
    "blade": (_indenter("shape: mesh, file: {folder}/blade.obj"), DROP),
}


def scaled(by: float) -> Sets:
    """The plain scene with all lengths multiplied by `by`."""
    size = {"width_mm": 25.25, "height_mm": 20.75, "corner_radius_mm": 1.5, "layers[0].thickness_mm": 4.0}
    press = f"{{press: {{depth_mm: {by}, frames: 2}}}}, {{slide: {{x_mm: {0.4 * by}, frames: 1}}}}"
    return (
        *(f"sensor.gel.{name}={by * value:g}" for name, value in size.items()),
        f"sensor.camera.mm_per_px={0.06 * by:g}",
        _indenter(f"shape: sphere, radius_mm: {4 * by}"),
        f"trajectory=[{press}]",
        f"quality={{edge_mm: {0.8 * by}, dhat_mm: {0.05 * by}}}",
    )


SCALES = (0.01, 0.1, 10.0, 100.0)
CASES |= {f"all lengths {by:g} times": scaled(by) for by in SCALES}


RANDOM = 12  # numbers that define a random scene


def random(u: Sequence[float]) -> Sets:
    """A scene from RANDOM numbers in [0, 1]. All 0: a ball, pressed little, without friction, slide, twist or tilt, on
    one layer."""
    size = 1.4 + 2.6 * u[1]
    shapes = (
        f"shape: sphere, radius_mm: {size}",
        f"shape: capsule, radius_mm: {size / 2}, length_mm: {size}",
        f"shape: torus, radius_mm: {size}, tube_radius_mm: {size / 2}",
        f"shape: cylinder, radius_mm: {size}, fillet_mm: {size / 4}",
        f"shape: box, size_x_mm: {2 * size}, size_y_mm: {size}, fillet_mm: {size / 4}",
        f"shape: cone, half_angle_deg: {20 + 10 * size}, tip_radius_mm: {size / 8}",
        f"shape: wedge, half_angle_deg: {20 + 10 * size}, tip_radius_mm: {size / 8}, length_mm: {2 * size}",
    )
    frames = 2 if u[10] < 0.7 else 1  # or in one frame
    moves = (
        f"{{press: {{depth_mm: {0.2 + 1.3 * u[2]}, frames: {frames}}}}}",
        f"{{slide: {{x_mm: {2 * u[4]}, y_mm: {u[4] * u[5]}, frames: {frames}}}}}",
        f"{{twist: {{angle_deg: {30 * u[5]}, frames: 1}}}}",
        f"{{tilt: {{angle_deg: {15 * u[8]}, axis_deg: {360 * u[5]}, frames: 1}}}}",
        "{release: {frames: 1}}",
    )
    E, nu = 0.001 * 1e5 ** u[6], 0.4999 * (1 - u[7])
    hard = min(E * 1e4 ** (u[11] - 0.5), 100)
    skin = () if u[9] < 0.5 else ("sensor=ninedtact", f"sensor.gel.layers[1].youngs_modulus_mpa={hard}")
    return (
        *skin,
        _indenter(shapes[min(int(u[0] * len(shapes)), len(shapes) - 1)]),
        f"trajectory=[{', '.join(moves)}]",
        f"contact.friction={2 * u[3]}",
        f"sensor.gel.layers[0].youngs_modulus_mpa={E}",
        f"sensor.gel.layers[0].poissons_ratio={nu}",
    )
