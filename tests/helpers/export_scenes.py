"""Scenes for the tests of exports: larger pictures, a force map, events, and the sensor they are of."""

from typing import Any

import numpy as np

from helpers.needs import needs
from tacgen.recipe import assets, loading

SENSOR = loading.read_sensor(assets.sensor_path("gelsight_mini"))[0].model_dump(mode="json", exclude_none=True)
SHAPE = (240, 320)
FRAMES = 12
PACKAGES = {"lerobot": "pyarrow", "webdataset": "webdataset", "zarr": "zarr", "rerun": "rerun"}


def needs_package_of(kind: str) -> None:
    """Skip where the package that writes this kind of export is missing."""
    if kind in PACKAGES:
        needs(PACKAGES[kind])


def real(index: int, arrays: dict[str, Any]) -> None:
    """The force spread over the pressure's samples, so that their sum is the force; a gel that bulges beside."""
    arrays["/frames/height"][0] = 0.02
    weights = arrays["/frames/pressure"] / arrays["/frames/pressure"].sum()
    arrays["/frames/force_map"] = weights[..., None] * arrays["/frames/force"]
    events = {"mode": 1 + (index > 3), "stick_ratio": 1 - index / 20, "friction_used": index / 20, "contact_area": 9.5,
              "center_of_pressure": np.array([index / 10, 0, -0.5]), "patches": 1}  # fmt: skip
    arrays |= {f"/frames/events/{name}": value for name, value in events.items()}
    arrays["/frames/grasp/width_mm"], arrays["/frames/uncertainty/force"] = 9.5 - index, np.full(3, index / 9)
