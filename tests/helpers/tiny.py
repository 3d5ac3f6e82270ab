"""A small sensor for optics tests: few pixels, one coloured strip a side, plate and gel of different indices."""

from typing import Any

from tacgen.sensor.model import Sensor

PLAIN: dict[str, Any] = {
    "tacgen_sensor": 1,
    "name": "tiny",
    "description": "for tests",
    "gel": {"width_mm": 12.0, "height_mm": 10.0, "corner_radius_mm": 1.0, "source": "test", "layers": [
        {"name": "gel", "thickness_mm": 3.0, "youngs_modulus_mpa": 0.3, "poissons_ratio": 0.4, "source": "test"},
    ]},
    "plate": {"thickness_mm": 2.0, "refractive_index": 1.49, "source": "test"},
    "coating": {"albedo": [0.5, 0.4, 0.6], "specular": 0.2, "roughness": 0.4, "source": "test"},
    "walls": {"albedo": 0.05, "source": "test"},
    "leds": [
        {"name": "red", "center_mm": [0, -4.9, -2], "normal": [0, 1, 0], "size_mm": [9, 1.6], "radiance": [9, 0, 0],
         "source": "test"},
        {"name": "green", "center_mm": [5.9, 0, -2], "normal": [-1, 0, 0], "size_mm": [7, 1.6], "radiance": [0, 9, 0],
         "source": "test"},
        {"name": "blue", "center_mm": [0, 4.9, -4], "normal": [0, -1, 0], "size_mm": [9, 1.6], "radiance": [0, 0, 9],
         "source": "test"},
    ],
    "camera": {"distance_mm": 12.0, "mm_per_px": 0.2, "width_px": 40, "height_px": 32, "vignette_mm": 9.0,
               "source": "test"},
    "markers": {"columns": 3, "rows": 3, "pitch_mm": [2.4, 2.0], "diameter_mm": 0.9, "albedo": 0.03, "source": "test"},
}  # fmt: skip


def sensor(**parts: Any) -> Sensor:
    """The tiny sensor with some of its top-level parts' keys replaced."""
    made = {k: {**PLAIN[k], **parts[k]} if k in parts and isinstance(parts[k], dict) else PLAIN[k] for k in PLAIN}
    made.update({k: v for k, v in parts.items() if not isinstance(v, dict)})
    return Sensor.model_validate(made)


def cloudy(**parts: Any) -> Sensor:
    """The tiny sensor with a gel that scatters under an opaque skin, lit evenly through the plate, without dots."""
    gel = {
        "corner_radius_mm": 0.0,
        "layers": [
            {"name": "base", "thickness_mm": 2.0, "youngs_modulus_mpa": 0.1, "poissons_ratio": 0.49, "source": "test",
             "scattering": {"extinction_per_mm": 0.4, "albedo": (0.9, 0.9, 0.9), "source": "test"}},
            {"name": "skin", "thickness_mm": 0.3, "youngs_modulus_mpa": 0.3, "poissons_ratio": 0.49, "source": "test",
             "opaque": True},
        ],
    }  # fmt: skip
    panel = {
        "name": "panel", "center_mm": [0, 0, -4.35], "normal": [0, 0, 1], "up": [0, 1, 0], "size_mm": [12, 10],
        "radiance": [2, 2, 2], "see_through": True, "source": "test",
    }  # fmt: skip
    coat = {"albedo": [0.03, 0.03, 0.03], "specular": 0.0}
    made = {"gel": gel, "leds": [panel], "coating": coat, "markers": None, "camera": {"vignette_mm": None}}
    return sensor(**{**made, **parts})
