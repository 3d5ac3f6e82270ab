"""The commands about sensor files."""

from pathlib import Path
from typing import Annotated

import typer

from tacgen.cli.common import AsJson, Overwrite, show_result, tell, warn, written

sensors = typer.Typer(no_args_is_help=True, help="Look at sensor files.")


@sensors.callback()
def _group() -> None:
    """Keeps `show` a command of a group though it is the only one."""


@sensors.command()
def show(
    sensor: Annotated[str, typer.Argument(help="The name of a shipped sensor, or a sensor file.")],
    as_yaml: Annotated[bool, typer.Option("--yaml", help="Print the file itself, with its comments.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Draw its untouched picture, a plan and a cut instead.")
    ] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Print the values of a sensor with their units and sources, or its file, or draw it."""
    from tacgen.recipe import assets, loading
    from tacgen.report import sensor_sheet
    from tacgen.sensor import usual_values, yaml_source

    path = assets.sensor_path(sensor)
    found, tree = loading.read_sensor(path)
    if as_yaml:
        tell(yaml_source.text_of(path), end=False)
        return
    warn(usual_values.warnings(found, tree))
    if out is not None:
        from tacgen.api.simulation import untouched
        from tacgen.report import bundle_figure, sensor_figure

        with written(out, [path], overwrite) as picture:
            frames = untouched(path)
            bundle_figure.save(sensor_figure.figure(frames.bundle), picture)
        tell(str(out))
        return
    text = f"{path}\n{sensor_sheet.as_text(found)}"
    show_result(sensor_sheet.as_plain(found), text, as_json)
