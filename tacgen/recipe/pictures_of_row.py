"""How the pictures of one row of a plan are made."""

from typing import cast

from tacgen.recipe.row import Row
from tacgen.render.pictures import PictureSettings
from tacgen.sensor.model import LitSensor


def settings(row: Row) -> PictureSettings:
    """The settings of a row's pictures; its sensor has lights, which the recipe's checks ask for."""
    recipe, sensor = row.recipe, cast(LitSensor, row.sensor)
    render, spp = recipe.render, recipe.resolved().spp
    return PictureSettings(sensor, render.method, spp, row.seed, render.noise, row.photo_path, recipe.outputs)
