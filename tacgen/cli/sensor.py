"""The commands about sensor files."""

from typing import Annotated

import typer

from tacgen.cli.common import AsJson, show_result, tell, warn

sensors = typer.Typer(no_args_is_help=True, help="Look at sensor files.")


@sensors.callback()
def _group() -> None:
    """Keeps `show` a command of a group though it is the only one."""


@sensors.command()
def show(
    sensor: Annotated[str, typer.Argument(help="The name of a shipped sensor, or a sensor file.")],
    as_yaml: Annotated[bool, typer.Option("--yaml", help="Print the file itself, with its comments.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print the values of a sensor with their units and sources, or its file."""
    from tacgen.recipe import assets, loading
    from tacgen.report import sensor_sheet
    from tacgen.sensor import usual_values, yaml_source

    path = assets.sensor_path(sensor)
    found, tree = loading.read_sensor(path)
    if as_yaml:
        tell(yaml_source.text_of(path), end=False)
        return
    warn(usual_values.warnings(found, tree))
    text = f"{path}\n{sensor_sheet.as_text(found)}"
    show_result(sensor_sheet.as_plain(found), text, as_json)
